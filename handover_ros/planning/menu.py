"""Menus: different handovers that person and robot can do now, to choose from."""

from __future__ import annotations

import time
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np

from handover_ros.errors import ErrorCode, InfeasibleError
from handover_ros.geometry import FloatArray
from handover_ros.planning.choice import MEASURE
from handover_ros.planning.expected_cost import ExpectedCostScheme, RobotBeforeTorso, Situation
from handover_ros.planning.feasible import statistics
from handover_ros.planning.handover import HandoverPlanner, Search
from handover_ros.planning.offers import Offer, RobotSide
from handover_ros.planning.problem import Candidate, ways_of
from handover_ros.planning.types import CellSnapshot, HandoverPlan, HandoverRequest

POSES = 512  # looked at for one object and arm
LEAST_GRASPS = 2  # of the person at an offer: without a choice there is nothing to learn


@dataclass(frozen=True, eq=False)
class Dish:
    """One handover of a menu.

    Attributes:
        object_name: The object.
        scheme: Whose person was asked.
        arm: Of the robot.
        robot_grasp: Name of the robot's grasp region.
        object_from_gripper: Shape (4, 4).
        offer: Pose, and how the person is expected to choose.
    """

    object_name: str
    scheme: str
    arm: str
    robot_grasp: str
    object_from_gripper: FloatArray
    offer: Offer

    def plan(self) -> HandoverPlan:
        """Return it as a plan whose robot motion is not planned yet."""
        offer = self.offer
        return HandoverPlan(
            object_name=self.object_name,
            scheme=self.scheme,
            arm=self.arm,
            robot_grasp=self.robot_grasp,
            object_from_gripper=self.object_from_gripper,
            world_from_object=offer.world_from_object,
            world_from_gripper=offer.world_from_object @ self.object_from_gripper,
            world_from_goal=None,
            facing_region=offer.region,
            world_from_hand=offer.world_from_hand,
            nominal=True,
            stages=(),
            planning_time=0.0,
            candidates=1,
            explanation=f"a way to offer {self.object_name}",
            predicted=offer.predicted,
        )


def menu(
    planner: HandoverPlanner,
    scheme: ExpectedCostScheme,
    object_name: str,
    snapshot: CellSnapshot,
    count: int,
    arm: str = "",
    budget: float = 2.0,
    seed: int = 0,
) -> list[Dish]:
    """Return handovers of one object, at most ``count``, at poses spread evenly over where it may be offered.

    The robot's reach and collisions at the offer are checked, its way there is not.

    Args:
        planner: Of the cell.
        scheme: Tells of the person, and of the space of poses.
        object_name: The object.
        snapshot: The cell as it was seen.
        count: Handovers at most.
        arm: Of the robot; empty: any.
        budget: Wall time [s].
        seed: Of the poses.

    Raises:
        UnknownNameError: No such object or arm.
        StaleDataError: Nobody is tracked.
        InfeasibleError: The object is not seen, or there is no such handover; the message counts why.
    """
    deadline = time.monotonic() + budget
    search = Search(deadline)
    model = planner.motion.object_model(object_name)
    planner.motion.object_pose(snapshot, object_name)
    found: list[list[Dish]] = []
    looked = 0
    arms = [planner.motion.robot.arm(arm).name] if arm else list(planner.motion.robot.arm_names)
    request = HandoverRequest(object_name)
    for each in arms:
        _, ready, picking = planner.picking(each, object_name, snapshot, search)
        if picking is None or not picking.grasps:
            continue
        task = planner.task(request, model, picking, ready, search)
        assert task.robot is not None
        situation = scheme.situation(task)
        candidates, poses = _candidates(situation, task.robot, count, deadline, seed)
        looked += poses
        found.append([])
        for candidate in candidates:
            grip = task.robot.object_from_gripper[candidate.robot_grasp]
            offer = scheme.offer(situation, candidate, True)
            found[-1].append(Dish(object_name, scheme.name, each, _grasp_name(planner, object_name, grip), grip, offer))
    if not any(found):
        raise InfeasibleError(
            f"no handover of {object_name} suits person and robot among {looked} poses; refused: "
            f"{search.offering.sentence()}; let the person come nearer",
            ErrorCode.NOT_FEASIBLE_FOR_PERSON,
        )
    in_turn = [dish for row in zip_longest(*found) for dish in row if dish is not None]
    return in_turn[:count]


def _candidates(
    situation: Situation, robot: RobotSide, wanted: int, deadline: float, seed: int
) -> tuple[list[Candidate], int]:
    """Return handovers that both can do, and how many poses were looked at."""
    problem, before = situation.problem, RobotBeforeTorso(robot, situation.world_from_torso)
    rng = np.random.default_rng(seed)
    points = problem.space.spread(problem.model, POSES, seed)
    poses = problem.space.transforms(problem.model, points)
    kept = problem.space.allowed(problem.model, poses)
    points, poses = points[kept], poses[kept]
    ways = ways_of(problem, before, poses)
    tables = statistics(problem.taker, problem.grasps, poses, problem.choice.hand_rationality)
    open_grasps = ((tables[:, None, :, MEASURE] > 0.0) & problem.free[None]).sum(axis=2)  # (poses, robot grasps)
    possible = np.isfinite(ways) & (open_grasps >= LEAST_GRASPS)
    candidates: list[Candidate] = []
    for place in rng.permutation(np.flatnonzero(possible.any(axis=1))):
        if len(candidates) == wanted or time.monotonic() > deadline:
            break
        rows = rng.permutation(np.flatnonzero(possible[place]))
        able = rows[before.kinematic(np.repeat(poses[place][None], len(rows), axis=0), rows)]
        row = next((int(each) for each in able if before.reachable(poses[place], int(each))), None)
        if row is None:
            continue
        value = problem.objective(tables[place][None], problem.goal, problem.choice, problem.free[row][None])
        candidates.append(Candidate(float(value[0, 0]), points[place], poses[place], row, tables[place]))
    return candidates, len(points)


def _grasp_name(planner: HandoverPlanner, object_name: str, object_from_gripper: FloatArray) -> str:
    """Return the name of the robot's grasp region that a grasp lies in."""
    grasps = planner.motion.object_model(object_name).robot_grasps
    nearest = min(grasps, key=lambda grasp: sum(grasp.region.distance(object_from_gripper)))
    return nearest.region.name
