"""What the optimiser of a handover is asked, and what it answers."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from handover_ros.geometry import FloatArray
from handover_ros.objects.catalogue import ObjectModel
from handover_ros.planning.choice import ChoiceModel, GoalCosts
from handover_ros.planning.feasible import Taker
from handover_ros.planning.grasp_set import GraspSet
from handover_ros.planning.objectives import Objective
from handover_ros.planning.pose_space import PoseSpace

BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]

FROM_PERSON = 0.5  # cosine between gripper and the person's reach above which the robot would come from their side
GOOD_GRASPS = 8  # the best at the goal, by which a search for a goal starts,
GOOD_SHARE = 0.5  # if they are in the better half of the range of costs there


class Robot(Protocol):
    """The arm that is to offer the object, as the search asks it; object poses are in the torso frame."""

    def stretches(self, torso_from_object: FloatArray) -> FloatArray:
        """Return how far its grasps stretch it [m] at poses (n, 4, 4), shape (n, robot grasps); inf: too far. Cheap."""

    def kinematic(self, torso_from_object: FloatArray, robot_grasps: IntArray) -> BoolArray:
        """Return whether it can be at poses (n, 4, 4) with grasps (n,), collisions aside, shape (n,): quick."""

    def reachable(self, torso_from_object: FloatArray, robot_grasp: int) -> bool:
        """Return whether it can be at a pose (4, 4) with a grasp, free of collisions: dear."""


@dataclass(frozen=True, eq=False)
class Problem:
    """What is to be decided, and what is known.

    Attributes:
        model: The object.
        grasps: Of the person.
        object_from_gripper: Robot grasps, shape (r, 4, 4).
        free: Which grasps each robot grasp leaves to the person, shape (r, grasps).
        taker: The person's arms and what they find comfortable.
        choice: How they choose.
        goal: What each grasp costs at the goal.
        objective: To be minimised.
        space: Poses to choose from.
        comfortable: torso_from_hand (4, 4) of a comfortable hand of each side of ``grasps``, in that order.
    """

    model: ObjectModel
    grasps: GraspSet
    object_from_gripper: FloatArray
    free: BoolArray
    taker: Taker
    choice: ChoiceModel
    goal: GoalCosts
    objective: Objective
    space: PoseSpace
    comfortable: tuple[FloatArray, ...]


@dataclass(frozen=True, eq=False)
class Candidate:
    """A robot grasp and a pose of the object.

    Attributes:
        value: Of the objective.
        point: The pose's numbers, see ``PoseSpace``. Shape (6,).
        torso_from_object: Shape (4, 4).
        robot_grasp: Row of ``Problem.object_from_gripper``.
        table: Statistics of every grasp there, shape (grasps, 5).
    """

    value: float
    point: FloatArray
    torso_from_object: FloatArray
    robot_grasp: int
    table: FloatArray


@dataclass
class SearchReport:
    """What a search found and looked at.

    Attributes:
        candidates: Feasible ones, the best first.
        poses: Number of poses looked at.
        refused: Why others were not taken, in counts.
        robot_checks: How often the robot was asked.
        seconds: Wall time.
        stopped: Whether the time ran out.
    """

    candidates: list[Candidate] = field(default_factory=list)
    poses: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    robot_checks: int = 0
    seconds: float = 0.0
    stopped: bool = False


def good_at_goal(problem: Problem) -> BoolArray:
    """Return which few grasps are best at the goal (grasps,)."""
    later = np.broadcast_to(problem.goal.mean, (len(problem.grasps),))
    good = np.zeros(len(later), dtype=bool)
    good[np.argsort(later, kind="stable")[:GOOD_GRASPS]] = True
    return good & (later <= later.min() + GOOD_SHARE * (later.max() - later.min()) + 1e-12)


def ways_of(problem: Problem, robot: Robot | None, torso_from_object: FloatArray) -> FloatArray:
    """Return how far each robot grasp stretches the arm at poses (n, 4, 4), shape (n, r) [m].

    Infinite: beyond its length, or the gripper would come from the person's side.
    """
    axes = np.einsum("nj,rj->nr", torso_from_object[:, 0, :3], problem.object_from_gripper[:, :3, 2])
    stretches = np.zeros(axes.shape) if robot is None else robot.stretches(torso_from_object)
    # The person reaches forward, which is x; the gripper's axis must not point along that.
    return np.where(axes <= FROM_PERSON, stretches, np.inf)
