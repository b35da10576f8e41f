"""``handover objects``: pictures of the objects with the grasps of a hand and of the robot's gripper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from handover_ros.arm.model import SIDES
from handover_ros.cell.report import output_folder, write_json
from handover_ros.geometry import FloatArray
from handover_ros.objects.catalogue import ObjectModel, load_object
from handover_ros.objects.object_picture import Grasps, draw_object
from handover_ros.planning.grasp_set import grasp_set
from handover_ros.planning.picking import grasp_poses
from handover_ros.resources import config_names
from handover_ros.robot import RobotModel


@dataclass(frozen=True)
class ObjectsRequest:
    """What ``handover objects`` was asked for.

    Attributes:
        names: As in ``config/objects``; none: all.
        robot: A file of ``config/robots``.
        json_file: Where to write the numbers too.
        out: Folder of everything written.
    """

    names: tuple[str, ...] = ()
    robot: str = "baxter"
    json_file: Path | None = None
    out: Path | None = None


def run_objects(request: ObjectsRequest, console: Console) -> int:
    """Draw and tell; return the exit status.

    Raises:
        HandoverError: Bad input.
    """
    models = [load_object(name) for name in request.names or config_names("objects")]
    robot = RobotModel.load(request.robot)
    folder = output_folder(request.out, "objects")
    table = Table(title="Objects", title_justify="left", box=SIMPLE_HEAD)
    table.add_column("object", no_wrap=True)
    table.add_column("mass [kg]", justify="right")
    for heading in ("hands", "grasps of a hand", "of the gripper"):
        table.add_column(heading, justify="right")
    table.add_column("arms that can hold it")
    metrics: dict[str, float] = {"objects": len(models)}
    files = []
    for model in models:
        hands, grippers = hand_grasps(model), gripper_grasps(model, robot)
        files.append(draw_object(folder / f"{model.name}.png", model, hands, grippers))
        counts = tuple(sum(len(each.poses) for each in group) for group in (hands, grippers))
        arms = [arm for arm in robot.arm_names if grasp_poses(model, robot.arm(arm))]
        table.add_row(model.name, f"{model.mass:.2f}", str(model.hands), *map(str, counts), ", ".join(arms) or "none")
        metrics |= {f"{model.name}_hand_grasps": counts[0], f"{model.name}_gripper_grasps": counts[1]}
    console.print(table)
    for target in filter(None, (folder / "objects.json", request.json_file)):
        write_json(target, "objects", True, 0, metrics, files=files, folder=str(folder))
    console.print(f"everything is in {folder}", highlight=False, markup=False, soft_wrap=True)
    return 0


def hand_grasps(model: ObjectModel) -> list[Grasps]:
    """Return the grasps of a right hand that the planner looks at, by region."""
    grasps = grasp_set(model, SIDES[: model.hands])
    return [
        Grasps(region.name, _chosen(grasps.poses[0], grasps.regions[0], region.name), region.centre())
        for region in model.human_grasps
    ]


def gripper_grasps(model: ObjectModel, robot: RobotModel) -> list[Grasps]:
    """Return the grasps of the robot that the planner looks at, by region; none where every gripper is too narrow."""
    by_region: dict[str, list[FloatArray]] = {}
    for arm in robot.arm_names:
        own: dict[str, list[FloatArray]] = {}
        for grasp, pose in grasp_poses(model, robot.arm(arm)):
            own.setdefault(grasp.region.name, []).append(pose)
        by_region = own | by_region  # the arms have the same ones
    return [
        Grasps(
            grasp.region.name,
            np.array(by_region.get(grasp.region.name, [])).reshape(-1, 4, 4),
            grasp.region.centre(),
            grasp.width,
        )
        for grasp in model.robot_grasps
    ]


def _chosen(poses: FloatArray, regions: Sequence[str], name: str) -> FloatArray:
    """Return the poses of one region."""
    return poses[[place for place, region in enumerate(regions) if region == name]]
