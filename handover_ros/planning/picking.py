"""Picking an object up: robot grasps within reach, with the straight ways to the object and up from its support."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import zip_longest

import numpy as np
import numpy.typing as npt

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
POSTURES_PER_POSE = 4
OPENING_CLEARANCE = 0.004  # [m] the open gripper must be wider than the object


@dataclass(frozen=True, eq=False)
class Pick:
    """A reachable way to pick an object up, or to carry one that is held already.

    Attributes:
        arm: The arm.
        grasp: The robot grasp; None: the object is held already.
        object_from_gripper: Shape (4, 4).
        approach_line: Displacements from before the object to the grasp (k, n) [rad]; k = 1 when it is held already.
        lift_line: Displacements from the grasp straight up (k, n) [rad]; k = 1: it is free already.
        held: The object as held afterwards.
        carrying: Collision checks while it is carried.
    """

    arm: str
    grasp: RobotGrasp | None
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


class Picking:
    """Reachable ways of one arm to pick one object up from where it is; each is worked out once, when it is asked for.

    Attributes:
        arm: The arm.
        name: The object.
        grasps: Poses ``object_from_gripper``, as ``grasp_poses`` orders them.
        found: Number of reachable ones so far.
    """

    def __init__(self, planner: MotionPlanner, arm: str, name: str, snapshot: CellSnapshot, reasons: Reasons) -> None:
        self._grasps = grasp_poses(planner.object_model(name), planner.robot.arm(arm))
        self.grasps = [pose for _, pose in self._grasps]
        self.found = 0
        self.arm = arm
        self.name = name
        self._planner = planner
        self._snapshot, self._reasons = snapshot, reasons
        self._world_from_object = planner.object_pose(snapshot, name)
        self._standing = planner.standing(snapshot)
        self._touching = planner.checker(arm, snapshot, touched=name)
        self._clear = planner.checker(arm, snapshot)
        self._known: dict[int, Pick | None] = {}
        self._plausible: npt.NDArray[np.bool_] | None = None

    def __getitem__(self, index: int) -> Pick | None:
        """Return the pick of a grasp, or None when it cannot be reached; refusals go to the reasons."""
        if index not in self._known:
            self._known[index] = self._make(*self._grasps[index])
            self.found += self._known[index] is not None
        return self._known[index]

    def refused(self, index: int) -> bool:
        """Return whether a grasp is already known to be out of reach."""
        return index in self._known and self._known[index] is None

    @property
    def refusals(self) -> int:
        """How many grasps are known to be out of reach."""
        return sum(pick is None for pick in self._known.values())

    def usable(self) -> npt.NDArray[np.bool_]:
        """Return which grasps may be picked up with (grasps,): not known to be out of reach, and in it by a quick look.

        That look, all grasps together and at the first call only, is at the grasp and before it, not at the way.
        """
        if self._plausible is None:
            at_grasp = self._world_from_object @ np.stack(self.grasps)
            before = at_grasp.copy()
            before[:, :3, 3] -= self._planner.settings.pregrasp_distance * at_grasp[:, :3, 2]
            solver = self._planner.reaches[self.arm].inverse_kinematics
            self._plausible = solver.quick_many(at_grasp) & solver.quick_many(before)
            self._reasons.counts[Reason.JOINT_LIMITS, ""] += int((~self._plausible).sum())
        refused = [self.refused(index) for index in range(len(self.grasps))]
        return self._plausible & ~np.array(refused)

    def _make(self, grasp: RobotGrasp, object_from_gripper: FloatArray) -> Pick | None:
        planner, arm, standing, reasons = self._planner, self.arm, self._standing, self._reasons
        reach = planner.reaches[arm]
        at_grasp, before = reach.validity(self._touching, standing), reach.validity(self._clear, standing)
        world_from_gripper = self._world_from_object @ object_from_gripper
        back = -planner.settings.pregrasp_distance * world_from_gripper[:3, 2]
        held = planner.held_object(arm, self.name, invert_transform(object_from_gripper))
        carrying = None
        for posture in reach.solutions(world_from_gripper, self._touching, standing, reasons)[:POSTURES_PER_POSE]:
            away = planner.line(arm, posture, back, at_grasp)
            if away is None or not before(away[-1]):
                reasons.add(Reason.BLOCKED, "straight way to the object")
                continue
            carrying = carrying or planner.checker(arm, self._snapshot, held)
            lift = _lift(planner, arm, posture, self._snapshot, carrying, held)
            if lift is None:
                reasons.add(Reason.BLOCKED, "straight way up with the object")
                continue
            return Pick(arm, grasp, object_from_gripper, away[::-1].copy(), lift, held, carrying)
        return None


class Holding:
    """The one way to go on with an object that is held already; used like ``Picking``.

    Attributes:
        arm: The arm.
        name: The object.
        grasps: The one pose ``object_from_gripper``.
        found: 1.
        refusals: 0.
    """

    refusals = 0

    def __init__(self, pick: Pick) -> None:
        self.arm = pick.arm
        self.name = pick.held.name
        self.grasps = [pick.object_from_gripper]
        self.found = 1
        self._pick = pick

    def __getitem__(self, index: int) -> Pick | None:
        """Return the pick."""
        return self._pick

    def refused(self, index: int) -> bool:
        """Return False: the object is in the gripper."""
        return False

    def usable(self) -> npt.NDArray[np.bool_]:
        """Return True for the one grasp: the object is in the gripper."""
        return np.ones(1, dtype=bool)


def held_pick(planner: MotionPlanner, arm: str, name: str, snapshot: CellSnapshot) -> Pick | None:
    """Return how to go on with an object that an arm holds, or None when it cannot be lifted off its support."""
    posture = planner.start_of(arm, snapshot)
    world_from_gripper = planner.robot.gripper_pose(arm, posture)
    object_from_gripper = invert_transform(planner.object_pose(snapshot, name)) @ world_from_gripper
    held = planner.held_object(arm, name, invert_transform(object_from_gripper))
    carrying = planner.checker(arm, snapshot, held)
    free = planner.reaches[arm].validity(carrying, planner.standing(snapshot))
    lift = posture[None] if free(posture) else _lift(planner, arm, posture, snapshot, carrying, held)
    if lift is None:
        return None
    return Pick(arm, None, object_from_gripper, posture[None], lift, held, carrying)


def _lift(
    planner: MotionPlanner,
    arm: str,
    posture: FloatArray,
    snapshot: CellSnapshot,
    carrying: CollisionChecker,
    held: HeldObject,
) -> FloatArray | None:
    """Return displacements (k, n) that lift a grasped object off its support to where it is free, or None."""
    standing = planner.standing(snapshot)
    checker = planner.checker(arm, snapshot, held)
    whole = standing.copy()
    whole[planner.robot.arm_indices(arm)] = posture
    checker.ignore_support(whole)
    valid = planner.reaches[arm].validity(checker, standing)
    free = planner.reaches[arm].validity(carrying, standing)
    for share in (1.0, 0.6):
        path = planner.line(arm, posture, share * planner.settings.lift_height * UP, valid)
        if path is not None and free(path[-1]):
            return path
    return None


def _spread(count: int, kept: int) -> list[int]:
    """Return at most ``kept`` of 0 ... count-1, evenly spread, from 0."""
    if count <= kept:
        return list(range(count))
    return [int(i) for i in np.linspace(0, count - 1, kept)]
