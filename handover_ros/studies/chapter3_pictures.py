"""Pictures of the case studies: how the first person takes what each objective offers (figures 3.2 and 3.3)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.objects.catalogue import ObjectModel
from handover_ros.objects.drawing import (
    Surface,
    View,
    ball,
    blank,
    gripper_surface,
    joined,
    loft,
    object_surface,
    paint,
    tube,
)
from handover_ros.planning.plan_picture import BODY, HEAD, HEAD_RADII, TRUNK
from handover_ros.studies.chapter3_cases import AXES, BIN, POINTS, WITH, WITHOUT
from handover_ros.studies.chapter3_charts import COLOURS, NAMES, ORDER
from handover_ros.studies.figure_style import FEASIBLE, save, styled
from handover_ros.studies.tables import Rows, column, only

HEADING, ELEVATION = -1.05, 0.35  # [rad] of the eye, from straight ahead of the person to their right hand
LIMITS = np.array([[-0.30, -0.75], [0.75, 0.35]])  # [m] of a picture: right, up
RADII = ((0.044, 0.036), (0.036, 0.026), (0.026, 0.030))  # [m] of upper arm, forearm and hand at their ends
RGBA = tuple[float, float, float, float]
SKIN: RGBA = (0.90, 0.62, 0.0, 1.0)
JAWS = 0.05  # [m] between the jaws of the gripper that is drawn
MOST = 6.0  # cost that is drawn at most
RASTER = 2  # zorder below which the SVG holds pixels: thousands of faces
TITLES = {
    WITHOUT: ("likeliest configuration", "greatest part of the cost", "all configurations", "costs"),
    WITH: ("likeliest at the handover", "best at the goal with this grasp", "costs of each grasp"),
}


def draw_case(folder: Path, tables: dict[str, Rows], model: ObjectModel, goal: str, torso_from_goal: FloatArray,
              name: str) -> list[Path]:  # fmt: skip
    """Draw one row an objective.

    Args:
        folder: Of the files.
        tables: What the units found.
        model: The object.
        goal: ``with`` or ``without``.
        torso_from_goal: Of the object (4, 4).
        name: Of the files.
    """
    titles = TITLES[goal]
    with styled() as pyplot:
        figure, panels = pyplot.subplots(
            len(ORDER), len(titles), figsize=(2.5 * len(titles), 7.4), layout="constrained", squeeze=False
        )
        for line, objective in zip(panels, ORDER):
            rows = {
                table: only(tables[f"case_{table}"], goal=goal, objective=objective)
                for table in ("limbs", "histograms", "grasps", "poses")
            }
            offered = joined(_offered(rows["poses"][0], model))
            arms = rows["limbs"]
            if goal == WITHOUT:
                _picture(line[0], [offered], only(arms, picture="likely"))
                _picture(line[1], [offered], only(arms, picture="risky"))
                _picture(line[2], [offered], only(arms, picture="all"), thin=True)
                _histogram(line[3], rows["histograms"], COLOURS[objective])
            else:
                _picture(line[0], [offered], only(arms, picture="likely"))
                _picture(line[1], [object_surface(model, torso_from_goal)], only(arms, picture="goal"))
                _costs(line[2], rows["grasps"], COLOURS[objective])
            cost = only(tables["cases"], person=0, goal=goal, objective=objective)[0]["expected_cost"]
            line[0].set_ylabel(f"{NAMES[objective]}:\n{cost:.2f} to be expected")
        for axes, title in zip(panels[0], titles):
            axes.set_title(title)
        return save(pyplot, figure, folder, name)


def _offered(row: dict[str, Any], model: ObjectModel) -> list[Surface]:
    """Return object and gripper in the torso frame."""
    poses = {}
    for name in ("object", "gripper"):
        poses[name] = np.eye(4)
        poses[name][:3] = [[row[f"{name}_{line}{place}"] for place in range(4)] for line in range(3)]
    return [object_surface(model, poses["object"]), gripper_surface(poses["gripper"], JAWS)]


def _limb(row: dict[str, Any]) -> FloatArray:
    """Return shoulder, elbow, wrist and grip (4, 3) [m]."""
    return np.array([[row[f"{point}_{axis}"] for axis in AXES] for point in POINTS])


def _picture(axes: Any, things: list[Surface], arms: Rows, thin: bool = False) -> None:
    """Draw person and things; arms whole, or as lines, the darker the more probable."""
    view = View.towards(HEADING, ELEVATION)
    body = [loft(np.array(TRUNK), np.eye(4), BODY, 32), ball(HEAD_RADII, HEAD, BODY)]
    limbs = [_limb(row) for row in arms]
    whole = [] if thin else [_arm(limb) for limb in limbs]
    blank(axes, LIMITS)
    axes.grid(visible=False)
    axes.set_rasterization_zorder(RASTER)
    paint(axes, joined([*body, *whole, *things]), view)
    if not arms:
        axes.text(0.5, 0.06, "cannot be placed", ha="center", transform=axes.transAxes)
    if thin:
        most = max(column(arms, "probability").max(), 1e-12)
        for limb, row in zip(limbs, arms):
            line = view.project(limb)[:, :2].T
            opacity = 0.15 + 0.85 * row["probability"] / most
            axes.plot(*line, "-", color=SKIN if opacity > 0.3 else FEASIBLE, alpha=opacity, linewidth=1.2, zorder=3)


def _arm(limb: FloatArray) -> Surface:
    """Return an arm (4, 3) [m] that can be painted."""
    return joined([tube(start, end, radii, SKIN) for start, end, radii in zip(limb[:-1], limb[1:], RADII)])


def _histogram(axes: Any, rows: Rows, colour: str) -> None:
    """Draw how many configurations cost how much, and how probable they are."""
    starts, shares = column(rows, "cost_from"), column(rows, "measure")
    axes.bar(starts, shares / shares.sum(), BIN, align="edge", color="#d8d8d8", label="share of configurations")
    axes.bar(
        starts + 0.25 * BIN, column(rows, "probability"), 0.5 * BIN, align="edge", color=colour, label="probability"
    )
    axes.set(xlabel="cost", ylim=(0.0, 1.0), xlim=(0.0, MOST))
    axes.legend(frameon=False, loc="upper right")


def _costs(axes: Any, rows: Rows, colour: str) -> None:
    """Draw each grasp's cost at the handover and at the goal, the larger the more probable."""
    now, chance = column(rows, "hand_cost"), column(rows, "probability")
    later = column(rows, "goal_cost")
    placed = np.isfinite(later)
    top = MOST
    sizes = 12.0 + 160.0 * chance
    axes.scatter(now[placed], later[placed], sizes[placed], color=colour, alpha=0.75, linewidths=0.0)
    axes.scatter(now[~placed], np.full((~placed).sum(), top), sizes[~placed], color=colour, marker="x")
    axes.set(xlabel="cost at the handover", ylabel="cost at the goal", xlim=(0.0, MOST), ylim=(0.0, top + 0.6))
    axes.text(MOST, top - 0.2, "cannot be placed", ha="right", va="top", fontsize=7.5)
