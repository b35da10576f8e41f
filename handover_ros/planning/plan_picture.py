"""Pictures of plans as in Bestick 2017, figures 3.2 and 3.3: likely grasps at handover and goal, and their costs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib
import numpy as np

from handover_ros.geometry import FloatArray, invert_transform, transform_points
from handover_ros.objects.catalogue import ObjectModel
from handover_ros.objects.drawing import (
    INK,
    PALE,
    REGION_COLOURS,
    Surface,
    View,
    ball,
    blank,
    bounds,
    box,
    faded,
    gripper_surface,
    hand_surface,
    joined,
    loft,
    object_surface,
    paint,
    save,
    stretched,
    tube,
)
from handover_ros.objects.scene import SceneBox
from handover_ros.planning.facing import object_centre
from handover_ros.planning.goal_stance import stances
from handover_ros.planning.offers import levelled
from handover_ros.planning.types import PredictedChoice, PredictedGrasp

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HEADING, ELEVATION = 1.05, 0.40  # [rad] of the eye, from straight ahead of the person to the hand that takes it
FROM_ABOVE = 1.25  # [rad] elevation of the second view when there is no goal
WIDTH, ROW, HEADER, FOOTER = 16.0, 4.1, 1.15, 0.15  # [inch]
SHARES = (0.31, 0.31, 0.38)  # of the width
NAMES = 1.55  # [inch] for the names of regions
LEAST_DRAWN, FAINTEST = 0.005, 0.14  # probability of an arm that is drawn, opacity of one
MARGIN = 0.06  # [m]
UNDER, BEFORE = 0.06, 0.03  # [m] that a table counts as farther away, and an arm as nearer than the shoulder
BODY, IDLE, ROBOT = (0.72, 0.75, 0.80, 1.0), (0.78, 0.81, 0.85, 1.0), (0.55, 0.57, 0.62, 1.0)
# The trunk about the torso frame's origin between the shoulders: half depth, half width, height [m].
TRUNK = ((0.02, 0.02, -0.52), (0.10, 0.15, -0.50), (0.085, 0.135, -0.34), (0.105, 0.165, -0.10), (0.085, 0.165, -0.01),
         (0.06, 0.10, 0.035), (0.05, 0.055, 0.06), (0.045, 0.05, 0.13))  # fmt: skip
HEAD, HEAD_RADII = (0.015, 0.0, 0.225), (0.095, 0.078, 0.118)  # [m]
ELBOW, WRIST = (0.0, 0.06, -0.30), (0.06, 0.07, -0.53)  # [m] from the shoulder of an arm that hangs, left
LIMB_RADII = (0.044, 0.036, 0.026)  # [m] at shoulder, elbow and wrist
GRIP_RADII = (0.014, 0.014)  # [m] from wrist to grip, of a grasp that is not the most probable
THIN = 0.6  # of these, for a grasp that is not the most probable
LEAST_LINES, MOST_LINES = 4, 7  # of a chart: room made, and grasps shown at most


@dataclass(frozen=True, eq=False)
class ShownPlan:
    """One plan in the picture.

    Attributes:
        title: What it is called.
        predicted: How the person is expected to choose.
        world_from_object: Where it is offered. Shape (4, 4).
        world_from_gripper: Shape (4, 4).
        jaws: [m] between the jaws of the gripper.
        robot_arm: Points along the robot's arm [m], from its shoulder (k, 3).
    """

    title: str
    predicted: PredictedChoice
    world_from_object: FloatArray
    world_from_gripper: FloatArray
    jaws: float
    robot_arm: FloatArray


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What is the same for all plans.

    Attributes:
        model: The object.
        world_from_torso: Of the person. Shape (4, 4).
        world_from_goal: Object pose to which the person brings it; None: there is none. Shape (4, 4).
        boxes: Of the scene that are drawn at the goal.
    """

    model: ObjectModel
    world_from_torso: FloatArray
    world_from_goal: FloatArray | None = None
    boxes: Sequence[SceneBox] = ()


def draw_plans(path: Path, plans: Sequence[ShownPlan], around: Surroundings, title: str) -> Path:
    """Draw one row a plan and return the PNG's path.

    The columns: the handover; the same at the goal, or from above without one; what each region costs.

    Args:
        path: The file.
        plans: At least one, top to bottom.
        around: Object, person and goal.
        title: Above all.
    """
    matplotlib.use("Agg")
    from matplotlib import pyplot

    colours = _colours(plans)
    torso = levelled(around.world_from_torso)
    eye, goal = _eye(plans, torso), around.world_from_goal
    shown = [[_handover(plan, around.model, torso, colours) for plan in plans]]
    shown.append(shown[0] if goal is None else [_goal(plan, around, goal, torso, colours) for plan in plans])
    views = (View.towards(eye, ELEVATION), View.towards(eye, FROM_ABOVE if goal is None else ELEVATION))
    height = HEADER + ROW * len(plans) + FOOTER
    figure = pyplot.figure(figsize=(WIDTH, height), dpi=100)
    figure.text(0.01, 1.0 - 0.34 / height, title, fontsize=17, fontweight="bold", color=INK, va="center")
    _head_columns(figure, height, with_goal=goal is not None)
    for column, (pictures, view) in enumerate(zip(shown, views)):
        limits = _limits([main for main, _ in pictures], view)
        for row, (main, robot) in enumerate(pictures):
            place = _place(column, row, len(plans), height)
            plot = figure.add_axes(place)
            blank(plot, stretched(limits, place[2] * WIDTH / (place[3] * height)))
            paint(plot, joined([main, robot]), view)
            if not column:
                _name(plot, plans[row].title)
    for row, plan in enumerate(plans):
        left, bottom, wide, tall = _place(2, row, len(plans), height)
        figure.text(left + 0.01, bottom + tall - 0.30 / height, _expected(plan.predicted), fontsize=13, color=INK)
        inside = (left + NAMES / WIDTH, bottom + 0.55 / height, wide - NAMES / WIDTH, tall - 1.1 / height)
        _draw_costs(figure.add_axes(inside), plan.predicted, colours, _dearest(plans))
    pyplot.close(figure)
    return save(figure, path)


def region_probabilities(predicted: PredictedChoice) -> dict[str, float]:
    """Return the probability of each region, the most probable first."""
    sums: dict[str, float] = {}
    for grasp in predicted.grasps:
        sums[grasp.region] = sums.get(grasp.region, 0.0) + grasp.probability
    return dict(sorted(sums.items(), key=lambda entry: -entry[1]))


def goal_torso(grasp: PredictedGrasp, around: Surroundings) -> FloatArray:
    """Return where the torso is when the object is placed with a grasp (4, 4): the stance its shoulder belongs to."""
    torso = levelled(around.world_from_torso)
    side = next(iter(grasp.goal_limbs), "")
    if around.world_from_goal is None or not side or side not in grasp.limbs:
        return torso
    shoulder = transform_points(invert_transform(torso), grasp.limbs[side][0])
    placed = invert_transform(torso) @ around.world_from_goal
    frames, _ = stances(torso, transform_points(placed, object_centre(around.model)))
    misses = np.linalg.norm(frames[:, :3] @ np.append(shoulder, 1.0) - grasp.goal_limbs[side][0], axis=1)
    return np.asarray(frames[int(np.argmin(misses))])


# What is drawn


def _handover(
    plan: ShownPlan, model: ObjectModel, torso: FloatArray, colours: Mapping[str, str]
) -> tuple[Surface, Surface]:
    """Return person, object and gripper, and the robot's arm."""
    arms = [(grasp, grasp.limbs, grasp.hands) for grasp in plan.predicted.grasps]
    person = _person(torso, _shoulders(plan.predicted, torso), arms, colours)
    gripper = gripper_surface(plan.world_from_gripper, plan.jaws)
    robot = [tube(*pair, (0.045, 0.045), ROBOT) for pair in pairwise(plan.robot_arm)]
    return joined([*person, object_surface(model, plan.world_from_object), gripper]), joined(robot)


def _goal(
    plan: ShownPlan, around: Surroundings, goal: FloatArray, torso: FloatArray, colours: Mapping[str, str]
) -> tuple[Surface, Surface]:
    """Return person and object, and what they stand at."""
    placing = [grasp for grasp in plan.predicted.grasps if grasp.goal_limbs]
    there = goal_torso(placing[0], around) if placing else torso
    arms = []
    for grasp in placing:
        hands = {side: goal @ invert_transform(plan.world_from_object) @ hand for side, hand in grasp.hands.items()}
        if np.allclose(goal_torso(grasp, around), there, atol=1e-6):  # another stance is another picture
            arms.append((grasp, grasp.goal_limbs, hands))
    person = _person(there, _shoulders(plan.predicted, torso), arms, colours)
    table = [
        box(each.size, each.world_from_box, faded(each.colour, white=0.35), 0.03).brought(-UNDER)
        for each in around.boxes
    ]
    return joined([*person, object_surface(around.model, goal)]), joined(table)


def _person(
    torso: FloatArray,
    shoulders: Mapping[str, FloatArray],
    arms: Sequence[tuple[PredictedGrasp, Mapping[str, FloatArray], Mapping[str, FloatArray]]],
    colours: Mapping[str, str],
) -> list[Surface]:
    """Return trunk, head and arms: those that take it, the most probable whole; an idle one hangs."""
    trunk = loft(np.array(TRUNK), torso, BODY, 32)
    head = ball(HEAD_RADII, HEAD, BODY).placed(torso)
    parts = [trunk, head]
    drawn = [entry for entry in arms if entry[1]]
    for side, shoulder in shoulders.items():
        parts.append(ball(0.050, shoulder, BODY).placed(torso))
        if not drawn or side not in drawn[0][1]:
            mirror = np.array([1.0, 1.0 if side == "left" else -1.0, 1.0])
            elbow, wrist = (transform_points(torso, shoulder + mirror * place) for place in (ELBOW, WRIST))
            parts += _limb(np.stack([transform_points(torso, shoulder), elbow, wrist]), IDLE, 0.9)
    most = max((grasp.probability for grasp, _, _ in drawn), default=1.0)
    for number, (grasp, limbs, hands) in enumerate(drawn):
        if number and grasp.probability < LEAST_DRAWN:
            continue
        opacity = 1.0 if not number else max(FAINTEST, 0.6 * grasp.probability / most)
        colour = faded(colours[grasp.region], opacity)
        for side, points in limbs.items():
            whole = not number
            arm = _limb(points[:3], colour, 1.0 if whole else THIN)
            hand = hand_surface(hands[side], side, colour) if whole else tube(points[2], points[3], GRIP_RADII, colour)
            parts += [*(each.brought(BEFORE) for each in arm), hand]
    return parts


def _limb(points: FloatArray, colour: tuple[float, float, float, float], size: float) -> list[Surface]:
    """Return upper arm and forearm through shoulder, elbow and wrist (3, 3)."""
    thick = tuple(size * radius for radius in LIMB_RADII)
    return [
        tube(points[0], points[1], (thick[0], thick[1]), colour),
        tube(points[1], points[2], (thick[1], thick[2]), colour),
    ]


def _shoulders(predicted: PredictedChoice, torso: FloatArray) -> dict[str, FloatArray]:
    """Return both shoulders in the torso frame [m]; one that takes no part mirrors the other."""
    found: dict[str, FloatArray] = {}
    for grasp in predicted.grasps:
        for side, points in grasp.limbs.items():
            found.setdefault(side, np.asarray(transform_points(invert_transform(torso), points[0])))
    for side, other in (("left", "right"), ("right", "left")):
        if side not in found and other in found:
            found[side] = found[other] * [1.0, -1.0, 1.0]
    return found


# How it is seen


def _eye(plans: Sequence[ShownPlan], torso: FloatArray) -> float:
    """Return the heading of the eye [rad]: on the side of the hand that most probably takes it."""
    sides = [side for plan in plans for side in plan.predicted.grasps[0].hands]
    sign = 1.0 if sides.count("left") > sides.count("right") else -1.0
    return float(np.arctan2(torso[1, 0], torso[0, 0]) + sign * HEADING)


def _limits(surfaces: Sequence[Surface], view: View) -> FloatArray:
    """Return limits (2, 2) that hold all surfaces."""
    extents = np.array([bounds(surface, view) for surface in surfaces])
    return np.stack([extents[:, 0].min(axis=0) - MARGIN, extents[:, 1].max(axis=0) + MARGIN])


def _place(column: int, row: int, rows: int, height: float) -> tuple[float, float, float, float]:
    """Return left, bottom, width and height of a plot as shares of the figure."""
    left, bottom = sum(SHARES[:column]), FOOTER + ROW * (rows - 1 - row)
    return left + 0.006, (bottom + 0.05) / height, SHARES[column] - 0.012, (ROW - 0.10) / height


def _head_columns(figure: Figure, height: float, with_goal: bool) -> None:
    """Write what the columns show, and what dot and ring mean."""
    second = "At the goal" if with_goal else "At the handover, from above"
    for column, words in enumerate(("At the handover", second, "Who takes it where, and what it costs")):
        place = sum(SHARES[:column]) + 0.008
        figure.text(place, 1.0 - 0.88 / height, words, fontsize=13, color=INK, va="center")
    figure.text(0.99, 1.0 - 0.88 / height, "\u25cf now   \u25cb at the goal" if with_goal else "\u25cf now",
                fontsize=11, color=INK, va="center", ha="right")  # fmt: skip


def _name(plot: Axes, title: str) -> None:
    """Write what a row is called."""
    plot.text(
        0.97, 0.96, title, transform=plot.transAxes, fontsize=13, fontweight="bold", color=INK, va="top", ha="right"
    )


def _expected(predicted: PredictedChoice) -> str:
    """Return the expected cost in words."""
    later = predicted.goal_cost
    parts = "" if np.isnan(later) else f"  =  {predicted.hand_cost:.2f} now  +  {later:.2f} at the goal"
    return f"expected cost {predicted.expected_cost:.2f}{parts}"


# Costs


def _colours(plans: Sequence[ShownPlan]) -> dict[str, str]:
    """Return a colour for each region, the most probable one of any plan first."""
    most: dict[str, float] = {}
    for plan in plans:
        for name, probability in region_probabilities(plan.predicted).items():
            most[name] = max(most.get(name, 0.0), probability)
    ranked = sorted(most, key=lambda name: -most[name])
    return {name: REGION_COLOURS[number % len(REGION_COLOURS)] for number, name in enumerate(ranked)}


def _dearest(plans: Sequence[ShownPlan]) -> float:
    """Return the end of the axis of costs: the same for all plans."""
    costs = [value for p in plans for g in p.predicted.grasps for value in (g.hand_cost, g.goal_cost)]
    return 1.1 * max((cost for cost in costs if np.isfinite(cost)), default=1.0)


def _draw_costs(plot: Axes, predicted: PredictedChoice, colours: Mapping[str, str], dearest: float) -> None:
    """Draw one line a grasp: its probability as a bar, its costs as a dot (now) and a ring (at the goal)."""
    shown, others = predicted.grasps[:MOST_LINES], predicted.grasps[MOST_LINES:]
    chances, costs = plot.inset_axes((0.0, 0.0, 0.27, 1.0)), plot.inset_axes((0.36, 0.0, 0.64, 1.0))
    plot.axis("off")
    with_goal = predicted.goal_infeasible > 0.0 or any(np.isfinite(each.goal_cost) for each in predicted.grasps)
    for place, grasp in enumerate(shown):
        ink, now, later = colours[grasp.region], grasp.hand_cost, grasp.goal_cost
        chances.barh(place, grasp.probability, height=0.56, color=ink)
        chances.text(grasp.probability + 0.03, place, _percent(grasp.probability), va="center", fontsize=10, color=INK)
        strength = 0.3 + 0.7 * min(1.0, grasp.probability / 0.05)
        if np.isfinite(later):
            costs.plot([now, later], [place, place], color=ink, lw=2.0, alpha=0.5 * strength, zorder=1)
            costs.plot(later, place, "o", ms=9, mfc="white", mec=ink, mew=2.2, alpha=strength, zorder=2)
        elif with_goal:
            costs.text(now + 0.035 * dearest, place, "cannot be placed", va="center", fontsize=9, color=INK)
        costs.plot(now, place, "o", ms=9, color=ink, mec="white", mew=0.8, alpha=strength, zorder=3)
    if others:
        rest = sum(grasp.probability for grasp in others)
        words = f"{len(others)} more, {_percent(rest)} together"
        costs.text(0.0, len(shown) - 0.35, f" {words}", va="center", fontsize=9, color=INK)
    chances.set(xlim=(0.0, 1.45), xticks=(0.0, 1.0), xlabel="probability")
    names = [grasp.region.replace("_", " ").replace(" and ", "\nand ") for grasp in shown]
    chances.set_yticks(range(len(shown)), names)
    chances.set_xticklabels(["0", "100 %"])
    costs.set(xlim=(0.0, dearest), yticks=[], xlabel=f"cost ({predicted.cost_name.replace('_', ' ')})")
    costs.grid(axis="x", color=PALE, lw=0.6, alpha=0.6)
    costs.set_axisbelow(True)
    for each in (chances, costs):
        each.set_ylim(max(LEAST_LINES, len(shown) + bool(others)) - 0.4, -0.6)
        each.spines[["top", "right"]].set_visible(False)
        each.spines[["left", "bottom"]].set_color(PALE)
        each.tick_params(labelsize=10, color=PALE, labelcolor=INK, length=3)
        each.xaxis.label.set(fontsize=10, color=INK)
    chances.tick_params(axis="y", length=0)


def _percent(probability: float) -> str:
    """Return a probability in words."""
    return "< 0.1 %" if probability < 0.001 else f"{100.0 * probability:.{1 if probability < 0.1 else 0}f} %"
