"""Picking an object up: robot grasps that can be reached, with the straight ways to the object and up from its support."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np

from handover_ros.geometry import FloatArray, invert_transform
from handover_ros.objects.catalogue import ObjectModel, RobotGrasp
from handover_ros.planning.motion import UP, MotionPlanner
from handover_ros.planning.types import CellSnapshot
from handover_ros.robot.collision import CollisionChecker, HeldObject, Reason
from handover_ros.robot.model import ArmModel
from handover_ros.robot.reach import Reasons

GRID_LENGTH = 0.04  # [m]
GRID_ANGLE = 0.35  # [rad]
POSES_PER_REGION = 14
POSTURES_PER_POSE = 3
OPENING_CLEARANCE = 0.004  # [m] the open gripper must be wider than the object


@dataclass(frozen=True, eq=False)
class Pick:
    """A reachable way to pick an object up.

    Attributes:
        arm: The arm.
        grasp: The robot grasp.
        object_from_gripper: Shape (4, 4).
        approach_line: Displacements from before the object to the grasp (k, n) [rad].
        lift_line: Displacements from the grasp straight up (k, n) [rad].
        held: The object as held afterwards.
        carrying: Collision checks while it is carried.
    """

    arm: str
    grasp: RobotGrasp
    object_from_gripper: FloatArray
    approach_line: FloatArray
    lift_line: FloatArray
    held: HeldObject
    carrying: CollisionChecker

    @property
    def gripper_from_object(self) -> FloatArray:
        """Pose of the object in the gripper. Shape (4, 4)."""
        return invert_transform(self.object_from_gripper)


def grasp_poses(model: ObjectModel, arm: ArmModel) -> list[tuple[RobotGrasp, FloatArray]]:
    """Return the grasps an arm's gripper is wide enough for, with poses ``object_from_gripper`` (4, 4).

    The middles of all regions come first, then poses ever farther from them.
    """
    widest = arm.opening[1] - OPENING_CLEARANCE
    regions = []
    for grasp in model.robot_grasps:
        if not arm.opening[0] <= grasp.width <= widest:
            continue
        middle = grasp.region.centre()
        poses = grasp.region.grid(GRID_LENGTH, GRID_ANGLE)
        offsets = np.linalg.norm(poses[:, :3, 3] - middle[:3, 3], axis=1) / GRID_LENGTH
        turns = np.linalg.norm((poses - middle)[:, :3, :3], axis=(1, 2)) / GRID_ANGLE
        nearest = poses[np.argsort(offsets + turns, kind="stable")]
        kept = nearest[_spread(len(nearest), POSES_PER_REGION)]
        regions.append([(grasp, pose) for pose in kept])
    return [pair for row in zip_longest(*regions) for pair in row if pair is not None]


def picks(
    planner: MotionPlanner, arm: str, name: str, snapshot: CellSnapshot, reasons: Reasons
) -> Iterator[Pick]:
    """Yield reachable ways of an arm to pick an object up from where it is; refusals go to ``reasons``.

    At most one posture a grasp pose is yielded.
    """
    model = planner.object_model(name)
    world_from_object = planner.object_pose(snapshot, name)
    reach = planner.reaches[arm]
    standing = planner.standing(snapshot)
    touching = planner.checker(arm, snapshot, touched=name)
    clear = planner.checker(arm, snapshot)
    at_grasp, before = reach.validity(touching, standing), reach.validity(clear, standing)
    for grasp, object_from_gripper in grasp_poses(model, planner.robot.arm(arm)):
        world_from_gripper = world_from_object @ object_from_gripper
        postures = reach.solutions(world_from_gripper, touching, standing, reasons)
        for posture in postures[:POSTURES_PER_POSE]:
            back = -planner.settings.pregrasp_distance * world_from_gripper[:3, 2]
            away = planner.line(arm, posture, back, at_grasp)
            if away is None or not before(away[-1]):
                reasons.add(Reason.JOINT_LIMITS, "straight way to the object")
                continue
            held = planner.held_object(arm, name, invert_transform(object_from_gripper))
            carrying = planner.checker(arm, snapshot, held)
            lift = _lift(planner, arm, posture, snapshot, held)
            if lift is None or not reach.validity(carrying, standing)(lift[-1]):
                reasons.add(Reason.JOINT_LIMITS, "straight way up with the object")
                continue
            yield Pick(arm, grasp, object_from_gripper, away[::-1].copy(), lift, held, carrying)
            break


def _lift(
    planner: MotionPlanner, arm: str, posture: FloatArray, snapshot: CellSnapshot, held: HeldObject
) -> FloatArray | None:
    """Return displacements (k, n) that lift a grasped object off its support, or None."""
    checker = planner.checker(arm, snapshot, held)
    whole = planner.standing(snapshot)
    whole[planner.robot.arm_indices(arm)] = posture
    checker.ignore_support(whole)
    valid = planner.reaches[arm].validity(checker, planner.standing(snapshot))
    return planner.line(arm, posture, planner.settings.lift_height * UP, valid)


def _spread(count: int, kept: int) -> list[int]:
    """Return at most ``kept`` of 0 ... count-1, evenly spread, from 0."""
    if count <= kept:
        return list(range(count))
    return [int(i) for i in np.linspace(0, count - 1, kept)]
