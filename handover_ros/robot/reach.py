"""Can this arm put its gripper there without a collision? And if not, why not, in counts."""

from __future__ import annotations

from collections import Counter

import numpy as np

from handover_ros.errors import ErrorCode
from handover_ros.geometry import FloatArray
from handover_ros.robot.collision import CollisionChecker, Reason
from handover_ros.robot.inverse_kinematics import InverseKinematics
from handover_ros.robot.model import RobotModel
from handover_ros.robot.path import Validity

SOLUTIONS = 6
KINEMATIC = (Reason.OUT_OF_REACH, Reason.JOINT_LIMITS, Reason.BLOCKED)


class Reasons:
    """Counts why poses were refused, for the message of a plan that failed.

    Attributes:
        counts: Number of refusals by (reason, detail).
    """

    def __init__(self) -> None:
        self.counts: Counter[tuple[Reason, str]] = Counter()

    def add(self, reason: Reason, detail: str = "") -> None:
        """Count one refusal."""
        self.counts[reason, detail] += 1

    @property
    def code(self) -> ErrorCode:
        """Error code of the refusals: only a lack of solutions is ``NOT_REACHABLE``."""
        totals = self.totals()
        if not totals:
            return ErrorCode.NO_PATH
        collisions = sum(n for reason, n in totals.items() if reason not in KINEMATIC)
        return ErrorCode.IN_COLLISION if collisions else ErrorCode.NOT_REACHABLE

    def totals(self) -> Counter[Reason]:
        """Return the number of refusals by reason."""
        totals: Counter[Reason] = Counter()
        for (reason, _), number in self.counts.items():
            totals[reason] += number
        return totals

    def sentence(self) -> str:
        """Return the counts as words, most frequent first, each with its most frequent detail."""
        parts = []
        for reason, number in self.totals().most_common():
            details = Counter({d: n for (r, d), n in self.counts.items() if r is reason and d})
            most = f" (mostly {details.most_common(1)[0][0]})" if details else ""
            parts.append(f"{number} x {reason.value}{most}")
        return ", ".join(parts) or "none refused"


class Reach:
    """Collision-free inverse kinematics of one arm, the rest of the robot standing still.

    Attributes:
        inverse_kinematics: Of the arm.
    """

    def __init__(self, robot: RobotModel, arm: str, inverse_kinematics: InverseKinematics) -> None:
        self.inverse_kinematics = inverse_kinematics
        self._indices = robot.arm_indices(arm)
        self._model = robot.arm(arm)

    def validity(self, checker: CollisionChecker, standing: FloatArray) -> Validity:
        """Return the test of displacements (n,) against limits and collisions.

        Args:
            checker: Of the surroundings.
            standing: Whole configuration (nq,) that holds everything but this arm.
        """
        whole = np.array(standing)
        lower, upper = self._model.lower - 1e-9, self._model.upper + 1e-9

        def valid(displacements: FloatArray) -> bool:
            if np.any(displacements < lower) or np.any(displacements > upper):
                return False
            whole[self._indices] = displacements
            return checker.is_free(whole)

        return valid

    def has_solution(self, world_from_gripper: FloatArray, reasons: Reasons) -> bool:
        """Return whether the gripper can be at a pose at all, collisions aside; a refusal goes to ``reasons``."""
        if len(self.inverse_kinematics.solve(world_from_gripper, wanted=1)):
            return True
        within = self.inverse_kinematics.within_arm_length(world_from_gripper)
        reasons.add(Reason.JOINT_LIMITS if within else Reason.OUT_OF_REACH)
        return False

    def quick_check(
        self,
        world_from_gripper: FloatArray,
        checker: CollisionChecker | None,
        standing: FloatArray,
        reasons: Reasons,
        leaves: Validity = lambda displacements: True,
    ) -> bool:
        """Return whether the gripper can be at a pose free of collisions, and leave it, as far as a quick look tells.

        Args:
            world_from_gripper: Shape (4, 4).
            checker: Of the surroundings; None: collisions aside.
            standing: Whole configuration (nq,) that holds everything but this arm.
            reasons: Where a refusal goes.
            leaves: Whether the arm can draw back from displacements (n,), looked at last.
        """
        found = self.inverse_kinematics.quick(world_from_gripper)
        if not len(found):
            within = self.inverse_kinematics.within_arm_length(world_from_gripper)
            reasons.add(Reason.JOINT_LIMITS if within else Reason.OUT_OF_REACH)
            return False
        whole = np.array(standing)
        problem = "in collision where the object is offered"
        for displacements in found:
            whole[self._indices] = displacements
            if checker is None or checker.is_free(whole):
                if leaves(displacements):
                    return True
                problem = "no straight way back from where the object is offered"
        reasons.add(Reason.BLOCKED, problem)
        return False

    def solutions(
        self,
        world_from_gripper: FloatArray,
        checker: CollisionChecker,
        standing: FloatArray,
        reasons: Reasons,
        preferred: FloatArray | None = None,
        wanted: int = SOLUTIONS,
    ) -> list[FloatArray]:
        """Return collision-free displacements (n,) [rad] at a gripper pose, best first; refusals go to ``reasons``."""
        found = self.inverse_kinematics.solve(world_from_gripper, preferred, wanted)
        if not len(found):
            within = self.inverse_kinematics.within_arm_length(world_from_gripper)
            reasons.add(Reason.JOINT_LIMITS if within else Reason.OUT_OF_REACH)
            return []
        whole = np.array(standing)
        free = []
        for displacements in found:
            whole[self._indices] = displacements
            problem = None if checker.is_free(whole) else checker.why(whole)
            if problem is None:
                free.append(displacements)
            else:
                reasons.add(*problem)
        return free
