"""The scheme of a handover that was chosen before, from a menu: its pose and robot grasp, and no other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handover_ros.errors import BadRequestError, ErrorCode, InfeasibleError
from handover_ros.geometry import invert_transform
from handover_ros.planning.choice import MEASURE
from handover_ros.planning.expected_cost import ExpectedCostScheme
from handover_ros.planning.feasible import statistics
from handover_ros.planning.offers import HandoverTask, Offer
from handover_ros.planning.problem import Candidate
from handover_ros.planning.types import ChosenOffer

SAME = 0.03  # [m] and difference of rotation matrices within which two grasps are the same; held things slip a little


@dataclass(frozen=True)
class OfferedScheme:
    """Offers what was chosen; who would take it how is predicted as by another scheme.

    Attributes:
        base: Tells of the person.
        chosen: Pose and robot grasp.
    """

    base: ExpectedCostScheme
    chosen: ChosenOffer
    needs_person: bool = True

    @property
    def name(self) -> str:
        """Name of the scheme that tells of the person."""
        return self.base.name

    def offers(self, task: HandoverTask) -> list[Offer]:
        """Return the one offer.

        Raises:
            StaleDataError: Nobody is tracked.
            BadRequestError: This arm has no such grasp.
            InfeasibleError: The person cannot take the object there.
        """
        situation = self.base.situation(task)
        problem = situation.problem
        apart = np.abs(problem.object_from_gripper - self.chosen.object_from_gripper).max(axis=(1, 2))
        row = int(np.argmin(apart))
        if apart[row] > SAME:
            raise BadRequestError(
                f"offer: the robot has no such grasp on {task.model.name} here (the nearest is {apart[row]:.3f} off); "
                "take one of planner/plan_menu"
            )
        pose = invert_transform(situation.world_from_torso) @ self.chosen.world_from_object
        table = statistics(problem.taker, problem.grasps, pose, problem.choice.hand_rationality)
        value = float(problem.objective(table, problem.goal, problem.choice, problem.free[row][None])[0, 0])
        if not (table[0, problem.free[row], MEASURE] > 0.0).any():
            raise InfeasibleError(
                f"the person cannot take {task.model.name} where it is to be offered; ask for another menu",
                ErrorCode.NOT_FEASIBLE_FOR_PERSON,
            )
        point = problem.space.points_of(task.model, pose[None])[0]
        return [self.base.offer(situation, Candidate(value, point, pose, row, table[0]), True)]
