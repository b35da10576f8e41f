"""One look for all figures of the studies, as PNG and SVG."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
import numpy.typing as npt

from handover_ros.geometry import FloatArray
from handover_ros.studies.statistics import band

# Colours that colour-blind readers can tell apart: M. Okabe and K. Ito, 2008.
COLOURS = {
    "active": "#0072b2",
    "active_value": "#000000",
    "active_grid": "#56b4e9",
    "active_expected": "#009e73",
    "passive": "#d55e00",
    "random": "#7f7f7f",
    "hybrid": "#cc79a7",
}
MARKERS = {
    "active": "o",
    "active_value": "X",
    "active_grid": "^",
    "active_expected": "v",
    "passive": "s",
    "random": "D",
    "hybrid": "P",
}
NAMES = {
    "active_value": "active, value",
    "active_grid": "active, grid (4.8)",
    "active_expected": "active, grid (4.7)",
}
TRUTH, CHOICE, FEASIBLE = "#009e73", "#e69f00", "#222222"  # green and yellow as in figure 4.3
STYLE: Any = {
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9.0,
    "legend.fontsize": 8.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "lines.linewidth": 1.6,
    "lines.markersize": 4.0,
    "svg.hashsalt": "handover_ros",
    "svg.fonttype": "none",
}


@contextmanager
def styled() -> Iterator[Any]:
    """Give pyplot with the style of the studies, without a screen."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    with matplotlib.rc_context(STYLE):
        yield pyplot


def save(pyplot: Any, figure: Any, folder: Path, name: str) -> list[Path]:
    """Write a figure as PNG and SVG, close it, and return both files."""
    files = [folder / f"{name}.png", folder / f"{name}.svg"]
    figure.savefig(files[0], dpi=150)
    figure.savefig(files[1], metadata={"Date": None})
    pyplot.close(figure)
    return files


def draw_band(axes: Any, positions: npt.ArrayLike, curves: FloatArray, strategy: str) -> None:
    """Draw the mean of curves (n, k) and its 95 % confidence band; what the dissertation did not run, thin."""
    mean, low, high = band(curves)
    colour, bold = COLOURS[strategy], strategy in ("active", "passive", "random")
    axes.fill_between(positions, low, high, color=colour, alpha=0.15 if bold else 0.06, linewidth=0.0)
    axes.plot(
        positions,
        mean,
        color=colour,
        linestyle="-" if bold else "--",
        linewidth=1.8 if bold else 1.1,
        marker=MARKERS[strategy],
        label=NAMES.get(strategy, strategy),
    )
