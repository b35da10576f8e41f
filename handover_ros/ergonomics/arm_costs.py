"""What an arm posture costs a person, C(q) of Bestick 2017, eq. 3.2: one protocol, three answers.

Another cost is a class with a ``name`` and an ``evaluate``, and a line in ``ARM_COSTS``. Postures are displacements of
``arm.model.JOINT_NAMES``; costs are numbers without unit, the smaller the better.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from handover_ros.arm.model import Arm
from handover_ros.ergonomics.anthropometry import FOREARM, HAND, HAND_OVER_FOREARM, HEAVIEST, LIGHTEST, UPPER_ARM
from handover_ros.errors import BadRequestError, UnknownNameError
from handover_ros.geometry import FloatArray

GRAVITY = 9.80665  # [m/s2]
SHOULDER_STRENGTH, ELBOW_STRENGTH = 60.0, 50.0  # [N m] of an average adult, D. B. Chaffin, Occupational Biomechanics


class ArmCost(Protocol):
    """The cost of holding an arm posture."""

    @property
    def name(self) -> str:
        """Name in ``ARM_COSTS``."""

    def evaluate(self, postures: npt.ArrayLike) -> FloatArray:
        """Return the costs (...) of postures (..., 7) [rad]."""


@dataclass(frozen=True, eq=False)
class Preference:
    """What a person finds comfortable: lambda of Bestick 2017, chapter 4.

    Attributes:
        neutral: q*, the most comfortable posture [rad], shape (7,).
        weights: w >= 0 of the squared distances from it [1/rad2], shape (7,).
    """

    neutral: FloatArray = field(default_factory=lambda: np.array([0.4, 0.2, 0.2, 1.4, 0.2, 0.0, 0.0]))
    weights: FloatArray = field(default_factory=lambda: np.array([1.0, 1.0, 0.7, 0.6, 0.4, 0.6, 1.0]))

    def __post_init__(self) -> None:
        """Check the numbers and make the arrays read-only.

        Raises:
            BadRequestError: Not seven finite numbers each, or a weight is negative.
        """
        for name in ("neutral", "weights"):
            array = np.array(getattr(self, name), dtype=float)
            if array.shape != (7,) or not np.isfinite(array).all():
                raise BadRequestError(f"preference: {name} needs 7 finite numbers, got {array.tolist()}")
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if (self.weights < 0.0).any():
            raise BadRequestError(f"preference: weights must not be negative, got {self.weights.tolist()}")


@dataclass(frozen=True, eq=False)
class SquaredDistance:
    """(q - q*)^T diag(w) (q - q*) (eq. 3.2), with what this person prefers as far as it is known."""

    preference: Preference
    name: str = "squared_distance"

    def evaluate(self, postures: npt.ArrayLike) -> FloatArray:
        """Return the costs (...) of postures (..., 7) [rad]."""
        q = np.asarray(postures, dtype=float)
        if q.shape[-1:] != (7,):
            raise BadRequestError(f"an arm has 7 displacements, got an array of shape {q.shape}")
        offsets = q - self.preference.neutral
        return np.asarray(np.square(offsets) @ self.preference.weights)


@dataclass(frozen=True, eq=False)
class GravityTorque:
    """Effort against gravity: the squared shares of their strength that shoulder and elbow need to hold the arm.

    Taken for a person whose torso is upright.

    Attributes:
        arm: The arm.
        body_mass: Of the person [kg].
        held_mass: In the hand [kg].
    """

    arm: Arm
    body_mass: float
    held_mass: float = 0.0
    name: str = "gravity_torque"

    def __post_init__(self) -> None:
        """Check the masses.

        Raises:
            BadRequestError: One is not that of a person or of something a hand holds.
        """
        if not LIGHTEST <= self.body_mass <= HEAVIEST:
            raise BadRequestError(f"body mass {self.body_mass:g} kg: must lie between {LIGHTEST:g} and {HEAVIEST:g} kg")
        if not 0.0 <= self.held_mass <= self.body_mass:
            raise BadRequestError(f"held mass {self.held_mass:g} kg: must be 0 or more, and less than the person's")

    def evaluate(self, postures: npt.ArrayLike) -> FloatArray:
        """Return the costs (...) of postures (..., 7) [rad]."""
        limbs = self.arm.limbs(postures)
        shoulder, elbow, wrist, grip = (limbs[..., index, :2] for index in range(4))
        upper = shoulder + UPPER_ARM.centre * (elbow - shoulder)
        fore = elbow + FOREARM.centre * (wrist - elbow)
        palm = wrist + HAND.centre * HAND_OVER_FOREARM * self.arm.forearm * _direction(grip - wrist, limbs)
        parts = [(UPPER_ARM.mass * self.body_mass, upper, False), (FOREARM.mass * self.body_mass, fore, True)]
        parts += [(HAND.mass * self.body_mass, palm, True), (self.held_mass, grip, True)]
        # Weight acts downwards, so only the horizontal lever counts.
        about_shoulder = sum(mass * (place - shoulder) for mass, place, _ in parts)
        about_elbow = sum(mass * (place - elbow) for mass, place, below in parts if below)
        return np.asarray(
            np.square(GRAVITY * np.linalg.norm(about_shoulder, axis=-1) / SHOULDER_STRENGTH)
            + np.square(GRAVITY * np.linalg.norm(about_elbow, axis=-1) / ELBOW_STRENGTH)
        )


def _direction(horizontal: FloatArray, limbs: FloatArray) -> FloatArray:
    """Return the horizontal part of the unit vector from the wrist to the grip."""
    length = np.linalg.norm(limbs[..., 3, :] - limbs[..., 2, :], axis=-1)
    return np.asarray(horizontal / np.maximum(length, 1e-9)[..., None])


# RULA's table A: score of the arm by upper arm (1-6), lower arm (1-3), wrist (1-4) and wrist twist (1-2).
RULA_TABLE = np.array(
    [
        [[[1, 2], [2, 2], [2, 3], [3, 3]], [[2, 2], [2, 2], [3, 3], [3, 3]], [[2, 3], [3, 3], [3, 3], [4, 4]]],
        [[[2, 3], [3, 3], [3, 4], [4, 4]], [[3, 3], [3, 3], [3, 4], [4, 4]], [[3, 4], [4, 4], [4, 4], [5, 5]]],
        [[[3, 3], [4, 4], [4, 4], [5, 5]], [[3, 4], [4, 4], [4, 4], [5, 5]], [[4, 4], [4, 4], [4, 5], [5, 5]]],
        [[[4, 4], [4, 4], [4, 5], [5, 5]], [[4, 4], [4, 4], [4, 5], [5, 5]], [[4, 4], [4, 5], [5, 5], [6, 6]]],
        [[[5, 5], [5, 5], [5, 6], [6, 7]], [[5, 6], [6, 6], [6, 7], [7, 7]], [[6, 6], [6, 7], [7, 7], [7, 8]]],
        [[[7, 7], [7, 7], [7, 8], [8, 9]], [[8, 8], [8, 8], [8, 9], [9, 9]], [[9, 9], [9, 9], [9, 9], [9, 9]]],
    ]
)


@dataclass(frozen=True, eq=False)
class RapidUpperLimbAssessment:
    """Score A of RULA (L. McAtamney and E. N. Corlett, Applied Ergonomics 24(2), 1993), from 1 to 9.

    The shoulder counts as raised with the elbow above it, and as abducted beyond 20 degrees; a load and repetition,
    which are the same for every posture, are left out.

    Attributes:
        arm: The arm.
    """

    arm: Arm
    name: str = "rula"

    def evaluate(self, postures: npt.ArrayLike) -> FloatArray:
        """Return the scores (...) of postures (..., 7) [rad]."""
        q = np.asarray(postures, dtype=float)
        limbs = self.arm.limbs(q)
        along = (limbs[..., 1, :] - limbs[..., 0, :]) / self.arm.upper_arm
        outward = along[..., 1] * (-1.0 if self.arm.side == "right" else 1.0)
        raised = np.degrees(np.arccos(np.clip(-along[..., 2], -1.0, 1.0)))
        height = np.select([raised <= 20.0, raised <= 45.0, raised <= 90.0], [1, 2, 3], 4)
        behind = -along[..., 0] > np.abs(along[..., 1])
        height = np.where(behind & (height > 1), 2, height)  # extension has one score, however far
        upper = height + (np.degrees(np.arcsin(np.clip(outward, -1.0, 1.0))) > 20.0) + (along[..., 2] > 0.0)
        bend = np.degrees(q[..., 3])
        hand = limbs[..., 3, 1] * (1.0 if self.arm.side == "right" else -1.0)
        crossed = (hand > 0.0) | (hand < self.arm.right_shoulder[1] - 0.25)  # over the midline, or far out
        lower = np.where((bend >= 60.0) & (bend <= 100.0), 1, 2) + crossed
        wrist = np.select([np.abs(np.degrees(q[..., 5])) <= 2.0, np.abs(np.degrees(q[..., 5])) <= 15.0], [1, 2], 3)
        wrist = wrist + (np.abs(np.degrees(q[..., 6])) > 10.0)
        middle, half = self.arm.limits[:, 4].mean(), np.ptp(self.arm.limits[:, 4]) / 2.0
        twist = np.where(np.abs(q[..., 4] - middle) <= 0.5 * half, 1, 2)
        return np.asarray(RULA_TABLE[np.minimum(upper, 6) - 1, lower - 1, wrist - 1, twist - 1], dtype=float)


@dataclass(frozen=True)
class ArmCostMaker:
    """How a cost is made, and one line about it for people who choose."""

    make: Callable[[Arm, Preference, float, float], ArmCost]
    summary: str


ARM_COSTS: Mapping[str, ArmCostMaker] = {
    "squared_distance": ArmCostMaker(
        lambda arm, preference, body, held: SquaredDistance(preference),
        "weighted squared distance from the neutral posture (eq. 3.2)",
    ),
    "gravity_torque": ArmCostMaker(
        lambda arm, preference, body, held: GravityTorque(arm, body, held),
        "squared torques of shoulder and elbow against gravity, the object held",
    ),
    "rula": ArmCostMaker(
        lambda arm, preference, body, held: RapidUpperLimbAssessment(arm), "score A of RULA, from 1 to 9"
    ),
}


def load_arm_cost(
    name: str, arm: Arm, preference: Preference, body_mass: float = 75.0, held_mass: float = 0.0
) -> ArmCost:
    """Return a cost by name.

    Args:
        name: One of ``ARM_COSTS``.
        arm: Whose postures it judges.
        preference: What the person finds comfortable.
        body_mass: Of the person [kg].
        held_mass: Of the object [kg].

    Raises:
        UnknownNameError: There is no such cost.
        BadRequestError: A mass is not plausible.
    """
    if name not in ARM_COSTS:
        raise UnknownNameError("arm cost", name, list(ARM_COSTS))
    return ARM_COSTS[name].make(arm, preference, body_mass, held_mass)
