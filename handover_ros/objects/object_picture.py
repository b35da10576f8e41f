"""Pictures of objects: where a person's hand and where the robot's gripper can take them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib
import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.objects.catalogue import ObjectModel
from handover_ros.objects.drawing import (
    INK,
    REGION_COLOURS,
    Surface,
    View,
    blank,
    bounds,
    faded,
    gripper_mark,
    gripper_surface,
    hand_mark,
    hand_surface,
    joined,
    object_surface,
    paint,
    save,
    stretched,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HEADING, ELEVATION = 0.75, 0.42  # [rad] of the eye, from the object's x axis
ASIDE = 1.9  # [rad] from where a hand or gripper comes from to the eye
LEAST_COLUMNS, MOST_COLUMNS = 2, 6
WIDTH, HEADER, TITLE = 16.0, 0.75, 0.36  # [inch]
MARGIN = 0.012  # [m] around what is drawn
SCALE = 0.1  # [m] of the bar


@dataclass(frozen=True, eq=False)
class Grasps:
    """Grasps of one region.

    Attributes:
        name: The region's name.
        poses: Of hand or gripper, in the object frame. Shape (n, 4, 4).
        middle: The one that is drawn as a whole. Shape (4, 4).
        width: [m] between the jaws; 0: it is a hand.
    """

    name: str
    poses: FloatArray
    middle: FloatArray
    width: float = 0.0


def draw_object(path: Path, model: ObjectModel, hands: Sequence[Grasps], grippers: Sequence[Grasps]) -> Path:
    """Draw an object once for every region, those of a right hand, then those of the robot; return the PNG's path.

    Args:
        path: The file.
        model: The object.
        hands: Of each human region.
        grippers: Of each robot region.
    """
    matplotlib.use("Agg")
    from matplotlib import pyplot

    columns = min(MOST_COLUMNS, max(LEAST_COLUMNS, len(hands), len(grippers)))
    groups = [list(each[i : i + columns]) for each in (hands, grippers) for i in range(0, len(each), columns)]
    numbers = {id(each): number for group in (hands, grippers) for number, each in enumerate(group)}
    colours = {key: REGION_COLOURS[number % len(REGION_COLOURS)] for key, number in numbers.items()}
    drawn = {id(each): (_surface(model, each, colours[id(each)]), _view(each)) for row in groups for each in row}
    extents = {key: bounds(*pair) for key, pair in drawn.items()}
    size = np.max([extent[1] - extent[0] for extent in extents.values()], axis=0) + 2.0 * MARGIN
    wide = WIDTH / columns
    tall = float(np.clip(wide * size[1] / size[0], 2.2, 4.6))
    height = HEADER + len(groups) * (tall + TITLE)
    figure = pyplot.figure(figsize=(WIDTH, height), dpi=100)
    figure.text(0.008, 1.0 - 0.4 / height, _title(model), fontsize=17, fontweight="bold", color=INK, va="center")
    counts = (sum(len(each.poses) for each in group) for group in (hands, grippers))
    words = "{} grasps of the right hand, {} of the gripper; the middle one of each region drawn whole".format(*counts)
    figure.text(0.992, 1.0 - 0.4 / height, words, fontsize=12, color=INK, ha="right", va="center")
    for row, group in enumerate(groups):
        bottom = height - HEADER - (row + 1) * (tall + TITLE) + 0.04
        for column, each in enumerate(group):
            box = (column / columns + 0.004, bottom / height, 1.0 / columns - 0.008, (tall - 0.04) / height)
            plot = figure.add_axes(box)
            middle = extents[id(each)].mean(axis=0)
            ratio = (wide - 0.008 * WIDTH) / (tall - 0.04)
            blank(plot, stretched(np.stack([middle - size / 2.0, middle + size / 2.0]), ratio))
            surface, view = drawn[id(each)]
            paint(plot, surface, view)
            who = "gripper" if each.width else "hand"
            plot.set_title(
                f"{who}: {each.name} ({len(each.poses)})", loc="left", fontsize=11, color=colours[id(each)], pad=4
            )
            _draw_axes(plot, view)
            if not row and not column:
                _draw_scale(plot)
    pyplot.close(figure)
    return save(figure, path)


def _surface(model: ObjectModel, grasps: Grasps, colour: str) -> Surface:
    """Return the object with the middle grasp and a mark for each other."""
    ink, others = faded(colour), [pose for pose in grasps.poses if not np.allclose(pose, grasps.middle)]
    parts = [object_surface(model, np.eye(4), white=0.2)]
    if grasps.width:
        parts.append(gripper_surface(grasps.middle, grasps.width))
        parts += [gripper_mark(pose, grasps.width, ink) for pose in others]
    else:
        parts.append(hand_surface(grasps.middle, "right", ink))
        parts += [hand_mark(pose, ink) for pose in others]
    return joined(parts)


def _view(grasps: Grasps) -> View:
    """Return a view from beside the middle grasp, from below if it comes from there."""
    approach = grasps.middle[:3, 2]
    if np.hypot(approach[0], approach[1]) < 0.5:
        return View.towards(HEADING, ELEVATION if approach[2] < 0.0 else -ELEVATION)
    comes_from = float(np.arctan2(-approach[1], -approach[0]))
    return View.towards(comes_from + ASIDE / 2.0, ELEVATION)


def _title(model: ObjectModel) -> str:
    """Return name, mass and what is special."""
    hands = "one hand" if model.hands == 1 else "two hands"
    upright = ", kept upright" if model.keep_upright else ""
    return f"{model.name.replace('_', ' ')}: {1e3 * model.mass:.0f} g, for {hands}{upright}"


def _draw_axes(plot: Axes, view: View) -> None:
    """Show the directions of the object frame in a corner."""
    (_, right), (low, high) = plot.get_xlim(), plot.get_ylim()
    size = 0.07 * (high - low)
    left, up = right - 1.7 * size, high - 2.0 * size
    for axis, name in enumerate("xyz"):
        x, y, _ = size * view.project(np.eye(3)[axis])
        ends = (left + x, up + y), (left, up)
        plot.annotate("", *ends, arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 0.8, "shrinkA": 0})
        plot.text(left + 1.35 * x, up + 1.35 * y, name, fontsize=8, color=INK, ha="center", va="center")


def _draw_scale(plot: Axes) -> None:
    """Show how long a tenth of a metre is."""
    (left, right), (low, high) = plot.get_xlim(), plot.get_ylim()
    start, height = left + 0.04 * (right - left), low + 0.05 * (high - low)
    plot.plot([start, start + SCALE], [height, height], color=INK, lw=2.0, solid_capstyle="butt")
    plot.text(start + SCALE / 2.0, height + 0.015 * (high - low), "10 cm", fontsize=8, color=INK, ha="center")
