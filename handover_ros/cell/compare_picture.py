"""The picture of two sessions: one timeline above the other on a common time axis, and both beliefs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from handover_ros.bags.timeline_picture import (
    PLAIN_TEXT,
    WIDTH,
    draw_belief,
    draw_events,
    draw_handovers,
    draw_rates,
    draw_troubles,
    name_panel,
    panels_of,
)
from handover_ros.bags.timeline_types import Timeline
from handover_ros.cell.session_compare import Comparison

COLOURS = ("#2f6a9f", "#c8641b")
SHOWN = (draw_handovers, draw_events, draw_troubles)
BARS_HEIGHT, BELIEF_HEIGHT, JOINTS_HEIGHT = 0.6, 2.0, 2.3  # [in]


def draw_comparison(comparison: Comparison, path: Path) -> Path | None:
    """Draw two sessions and return the PNG's path; None: neither has a timeline or a belief."""
    timelines = [(name, s.timeline) for name, s in zip(comparison.names, comparison.both) if s.timeline is not None]
    joints = bool(comparison.joints())
    if not timelines and not joints:
        return None
    matplotlib.use("Agg")
    with matplotlib.rc_context(PLAIN_TEXT):
        return _draw(comparison, timelines, joints, path)


def _draw(comparison: Comparison, timelines: Sequence[tuple[str, Timeline]], joints: bool, path: Path) -> Path:
    from matplotlib import pyplot

    panels: list[tuple[float, str, Any, Timeline]] = []
    for name, timeline in timelines:
        chosen = [(height, draw) for height, draw in panels_of(timeline) if draw in SHOWN]
        chosen = chosen or [(height, draw) for height, draw in panels_of(timeline) if draw is draw_rates]
        panels += [(height, name, draw, timeline) for height, draw in chosen]
    beliefs = any(timeline.beliefs for _, timeline in timelines)
    heights = [height for height, *_ in panels] + [BELIEF_HEIGHT] * beliefs + [JOINTS_HEIGHT] * joints
    figure, grid = pyplot.subplots(
        len(heights), 1, figsize=(WIDTH, 0.6 + sum(heights)), height_ratios=heights, squeeze=False, layout="constrained"
    )
    span = max([timeline.duration for _, timeline in timelines], default=1.0) or 1.0
    colours = dict(zip(comparison.names, COLOURS))
    rows = list(grid[:, 0])
    for axes, (_, name, draw, timeline) in zip(rows, panels):
        draw(axes, timeline, span)
        axes.set_title(f"{name}: {axes.get_title(loc='left')}", fontsize=9, loc="left", color=colours[name], pad=3)
        if timeline.duration < 0.995 * span:
            axes.axvspan(timeline.duration, span, color="#eeeeee", zorder=0)
    if beliefs:
        axes = rows[len(panels)]
        for name, timeline in timelines:
            draw_belief(axes, timeline, span, colours[name], name)
    timed = rows[: len(panels) + beliefs]
    for axes in timed:
        axes.set_xlim(0.0, span)
        axes.tick_params(axis="x", labelbottom=axes is timed[-1], labelsize=8)
    if timed:
        timed[-1].set_xlabel("time since the first message of each [s]", fontsize=9)
    if joints:
        draw_joints(rows[-1], comparison)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
    pyplot.close(figure)
    return path


def draw_joints(axes: Any, comparison: Comparison) -> None:
    """Draw the mean neutral posture of the last beliefs, joint by joint; the dots are as large as the weights."""
    beliefs = comparison.joints()
    heaviest = max(max(weight.first, weight.second) for _, _, weight in beliefs)
    sides: Sequence[str] = ("first", "second")
    for number, (side, name, colour) in enumerate(zip(sides, comparison.names, COLOURS)):
        places = np.arange(len(beliefs)) + 0.16 * (2 * number - 1)
        neutral = [getattr(pair, side) for _, pair, _ in beliefs]
        sizes = [30.0 + 170.0 * getattr(weight, side) / max(heaviest, 1e-9) for _, _, weight in beliefs]
        axes.vlines(places, 0.0, neutral, color=colour, linewidth=1.0)
        axes.scatter(places, neutral, sizes, color=colour, label=name)
    axes.axhline(0.0, color="#888888", linewidth=0.8)
    axes.set_xticks(range(len(beliefs)), [joint.replace("_", " ") for joint, *_ in beliefs], fontsize=8)
    axes.tick_params(axis="y", labelsize=8)
    axes.set_ylabel("mean neutral [deg]", fontsize=8)
    axes.margins(y=0.2)
    axes.legend(frameon=False, fontsize=8, markerscale=0.5)
    name_panel(axes, "believed at last: neutral posture, larger dots for larger weights")
