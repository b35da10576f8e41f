"""Pictures of a person's motion: each displacement over time with its limits, each marker's error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib
import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.skeleton.tree import JointKind, Skeleton

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import SubFigure

INK, PALE, LIMIT, TRACE, BAND = "#30343b", "#c9ced6", "#e8edf4", "#2f6db3", "#9dbfe6"
HELD_OUT = "#e07b39"
SEGMENT_COLOURS = ("#2f6db3", "#3f8f6b", "#8a5fb0", "#b0842f", "#b04a5f", "#4f93a8", "#7a7f88", "#a0662f")
COLUMNS = 2
MOST_POINTS = 4000  # drawn of a trace
MARGIN = 0.06  # of the range, above and below


@dataclass(frozen=True, eq=False)
class Motion:
    """A person's displacements over time.

    Attributes:
        times: (frames,) [s].
        displacements: (frames, n) [rad] or [m]; NaN where not known.
        deviations: (frames, n) standard deviations; None: not known.
        joins: Times [s] at which another recording begins.
    """

    times: FloatArray
    displacements: FloatArray
    deviations: FloatArray | None = None
    joins: tuple[float, ...] = ()


@dataclass(frozen=True)
class MarkerBar:
    """One marker's error [m]: mean on the frames of the picture, and on frames left out of a fit (NaN: none)."""

    name: str
    segment: str
    error: float
    held_out: float


def draw_motion(
    path: Path, skeleton: Skeleton, motion: Motion, bars: Sequence[MarkerBar], title: str, labels: tuple[str, str]
) -> Path:
    """Draw the markers' errors above, the displacements below, and return the PNG's path.

    Args:
        path: The file.
        skeleton: Whose limits are shaded.
        motion: The traces.
        bars: One for each marker.
        title: Above all.
        labels: What ``error`` and ``held_out`` of the bars are.
    """
    matplotlib.use("Agg")
    from matplotlib import pyplot

    names = skeleton.displacement_names
    rows = -(-len(names) // COLUMNS)
    figure = pyplot.figure(figsize=(12.0, 3.4 + 1.25 * rows), layout="constrained")
    grid = figure.add_gridspec(2, 1, height_ratios=(2.9, 1.25 * rows))
    upper, lower = figure.add_subfigure(grid[0]), figure.add_subfigure(grid[1])
    figure.suptitle(title, x=0.01, ha="left", fontsize=13, fontweight="bold", color=INK)
    _draw_bars(upper.subplots(), bars, labels)
    _draw_traces(lower, skeleton, motion, rows)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)
    return path


def _draw_bars(axes: Axes, bars: Sequence[MarkerBar], labels: tuple[str, str]) -> None:
    """Draw one bar for each marker, coloured by segment, and a mark for the error on left-out frames."""
    segments = list(dict.fromkeys(bar.segment for bar in bars))
    ordered = sorted(bars, key=lambda bar: segments.index(bar.segment))
    places = np.arange(len(ordered)) + 0.8 * np.array([segments.index(bar.segment) for bar in ordered])
    errors = 1e3 * np.array([bar.error for bar in ordered])
    held_out = 1e3 * np.array([bar.held_out for bar in ordered])
    for number, segment in enumerate(segments):
        own = [index for index, bar in enumerate(ordered) if bar.segment == segment]
        axes.bar(places[own], errors[own], width=0.72, color=SEGMENT_COLOURS[number % len(SEGMENT_COLOURS)])
        axes.text(
            places[own].mean(), 1.02, segment.replace("_", " "), transform=axes.get_xaxis_transform(), ha="center",
            fontsize=8.5, color=INK,
        )  # fmt: skip
    axes.bar(0, 0, color="#7a7f88", label=labels[0])
    if np.isfinite(held_out).any():
        axes.plot(places, held_out, "_", ms=11, mew=2.2, color=HELD_OUT, label=labels[1])
    axes.set_xticks(places, [bar.name for bar in ordered], rotation=60, ha="right", fontsize=8, rotation_mode="anchor")
    axes.set_xlim(places[0] - 0.8, places[-1] + 0.8)
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("marker error [mm]", fontsize=9, color=INK)
    handles, texts = axes.get_legend_handles_labels()
    axes.legend(handles[::-1], texts[::-1], loc="upper left", fontsize=8.5, frameon=False, ncols=2)
    _clean(axes)


def _draw_traces(figure: SubFigure, skeleton: Skeleton, motion: Motion, rows: int) -> None:
    """Draw one small plot for each displacement; what lies between the limits is shaded."""
    names = skeleton.displacement_names
    grid = figure.subplots(rows, COLUMNS, sharex=True, squeeze=False)
    step = max(1, len(motion.times) // MOST_POINTS)
    times = motion.times[::step]
    for index, name in enumerate(names):
        axes = grid[index % rows, index // rows]
        angle = skeleton.joints[skeleton.displacement_joints[index]].kind is not JointKind.PRISMATIC
        scale, unit = (180.0 / np.pi, "deg") if angle else (1e3, "mm")
        values = scale * motion.displacements[::step, index]
        low, high = scale * skeleton.lower[index], scale * skeleton.upper[index]
        if np.isfinite([low, high]).all():
            axes.axhspan(low, high, color=LIMIT, lw=0)
        for limit in (low, high):
            if np.isfinite(limit):
                axes.axhline(limit, color=PALE, lw=0.9)
        if motion.deviations is not None:
            spread = 2.0 * scale * motion.deviations[::step, index]
            axes.fill_between(times, values - spread, values + spread, color=BAND, lw=0)
        for time in motion.joins:
            values[np.searchsorted(times, time) : np.searchsorted(times, time) + 1] = np.nan
            axes.axvline(time, color=PALE, lw=0.9, ls=(0, (3, 3)))
        axes.plot(times, values, color=TRACE, lw=0.9)
        known = np.concatenate([values[np.isfinite(values)], [each for each in (low, high) if np.isfinite(each)]])
        if len(known):
            bottom, top = float(known.min()), float(known.max())
            room = max(MARGIN * (top - bottom), 1.0)
            axes.set_ylim(bottom - room, top + room)
        axes.set_title(f"{name.replace('_', ' ')} [{unit}]", fontsize=9, loc="left", color=INK, pad=3)
        axes.margins(x=0.0)
        _clean(axes)
    for axes in grid.ravel(order="F")[len(names) :]:
        axes.set_visible(False)
    for column in range(COLUMNS):
        last = min(rows, len(names) - column * rows) - 1
        if last >= 0:
            grid[last, column].tick_params(labelbottom=True)
    figure.supxlabel("time [s]", fontsize=9, color=INK)


def _clean(axes: Axes) -> None:
    """Take away what carries nothing."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(PALE)
    axes.tick_params(labelsize=8, color=PALE, labelcolor=INK)
