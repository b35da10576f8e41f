"""What it costs a person to take a posture (Bestick 2017, section 2.2, "Pose Prediction"): one protocol, four answers.

Another cost is a class with a ``name`` and an ``evaluate``, and a line in ``COSTS``. Postures are displacements in the
order of ``Skeleton.displacement_names``. Costs that look at the way lead from start to end along a minimum-jerk curve.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from handover_ros.arm.hand import hand_frames
from handover_ros.ergonomics.dynamics import BodyDynamics
from handover_ros.ergonomics.reach import check_duration, differentiation, minimum_jerk_reach
from handover_ros.errors import BadModelError, BadRequestError, UnknownNameError
from handover_ros.geometry import FloatArray
from handover_ros.skeleton.jacobian import Frame
from handover_ros.skeleton.kernels import segment_poses
from handover_ros.skeleton.tree import WORLD, Skeleton

DURATION = 1.1  # [s] of a reach without haste, as config/people/adult.yaml has it
WORK_SAMPLES = 48  # power has corners where a muscle changes from driving to braking
SAMPLES = 24  # smooth integrands: more change nothing at 1e-6
DIFFERENCE_STEP = 1e-5  # [rad] or [m]


class PostureCost(Protocol):
    """The cost of ending in a posture, smooth almost everywhere.

    Attributes:
        name: Name in the registry.
    """

    name: str

    def evaluate(self, start: npt.ArrayLike, ends: npt.ArrayLike) -> FloatArray:
        """Return the costs (...) of end displacements (..., n) [rad, m], given the start's (n,)."""
        ...


def cost_gradient(cost: PostureCost, start: FloatArray, end: FloatArray) -> FloatArray:
    """Return d(cost)/d(end displacements) (n,) by central differences, all in one evaluation."""
    steps = DIFFERENCE_STEP * np.eye(len(end))
    values = cost.evaluate(start, end + np.concatenate([steps, -steps]))
    return np.asarray((values[: len(end)] - values[len(end) :]) / (2.0 * DIFFERENCE_STEP))


class PreferredPosture:
    """Distance from a preferred posture, sqrt(sum w (theta - theta*)^2) (eq. 2.11).

    Without another one given, theta* is the middle of the limits, (theta_M + theta_m) / 2; the dissertation prints the
    difference, which is no posture halfway between the limits. Where a limit is unknown it is zero, the arm hanging.
    """

    name = "preferred_posture"

    def __init__(
        self, skeleton: Skeleton, preferred: npt.ArrayLike | None = None, weights: npt.ArrayLike | None = None
    ) -> None:
        """Choose the posture and the weights.

        Args:
            skeleton: The skeleton.
            preferred: theta* [rad, m], shape (n,); default: the middle of the limits.
            weights: w >= 0 [1/rad2, 1/m2], shape (n,); default: all 1.

        Raises:
            BadRequestError: An array has another shape, a number is not finite, or a weight is negative.
        """
        shape = skeleton.lower.shape
        self.preferred = np.array(skeleton.middle if preferred is None else preferred, dtype=float)
        self.weights = np.array(np.ones(shape) if weights is None else weights, dtype=float)
        for name, array in (("preferred", self.preferred), ("weights", self.weights)):
            if array.shape != shape or not np.isfinite(array).all():
                raise BadRequestError(f"{name}: needs {shape[0]} finite numbers, got {array.tolist()}")
        if (self.weights < 0.0).any():
            raise BadRequestError(f"weights: must not be negative, got {self.weights.tolist()}")

    def evaluate(self, start: npt.ArrayLike, ends: npt.ArrayLike) -> FloatArray:
        """Return the distances (...) [rad] of end displacements (..., n); the start does not matter."""
        return np.sqrt(np.square(np.asarray(ends, dtype=float) - self.preferred) @ self.weights)


class MinimumWork:
    """Positive work of the muscles along the reach [J] (eq. 2.10): int sum_i max(tau_i dtheta_i/dt, 0) dt.

    The integral as printed, with signed power, is the change of the potential energy alone, whatever the way: its
    least value lets every arm hang. Muscles do not get back what they brake, and braking costs them a fraction of what
    driving costs, so joint powers count where they are positive, joint by joint, gravity included.
    """

    name = "minimum_work"

    def __init__(self, dynamics: BodyDynamics, duration: float = DURATION) -> None:
        """Choose the body and the duration of a reach [s].

        Raises:
            BadRequestError: The duration is none of a reach.
        """
        self.dynamics, self.duration = dynamics, check_duration(duration)

    def evaluate(self, start: npt.ArrayLike, ends: npt.ArrayLike) -> FloatArray:
        """Return the work (...) [J] of end displacements (..., n), given the start's (n,)."""
        reach = minimum_jerk_reach(np.asarray(start, dtype=float), np.asarray(ends), self.duration, WORK_SAMPLES)
        torques = self.dynamics.inverse_dynamics(reach.displacements, reach.rates, reach.accelerations)
        return reach.integral(np.maximum(torques * reach.rates, 0.0).sum(axis=-1))


class MinimumTorqueChange:
    """Change of the joint torques along the reach [N2 m2/s] (eq. 2.9): int |dtau/dt|^2 dt."""

    name = "minimum_torque_change"

    def __init__(self, dynamics: BodyDynamics, duration: float = DURATION) -> None:
        """Choose the body and the duration of a reach [s].

        Raises:
            BadRequestError: The duration is none of a reach.
        """
        self.dynamics, self.duration = dynamics, check_duration(duration)

    def evaluate(self, start: npt.ArrayLike, ends: npt.ArrayLike) -> FloatArray:
        """Return the torque changes (...) of end displacements (..., n), given the start's (n,)."""
        reach = minimum_jerk_reach(np.asarray(start, dtype=float), np.asarray(ends), self.duration, SAMPLES)
        rates = self.dynamics.torque_rate(reach.displacements, reach.rates, reach.accelerations, reach.jerks)
        return reach.integral(np.square(rates).sum(axis=-1))


class MinimumJerk:
    """Jerk of the hands along the reach [m2/s5] (eq. 2.8, with the third derivative that the name means).

    The sum over the hands of int |d3x/dt3|^2 dt, x a hand's position.
    """

    name = "minimum_jerk"

    def __init__(self, skeleton: Skeleton, points: tuple[Frame, ...] | None = None, duration: float = DURATION) -> None:
        """Choose what moves and for how long [s].

        Args:
            skeleton: The skeleton.
            points: Frames whose origins are the hands; default: the grips of the skeleton's hands.
            duration: [s].

        Raises:
            BadModelError: The skeleton has no hands.
            BadRequestError: The duration is none of a reach.
        """
        self.skeleton, self.duration = skeleton, check_duration(duration)
        frames = points or tuple(hand.frame for hand in hand_frames(skeleton).values())
        if any(frame.segment == WORLD for frame in frames):
            raise BadModelError("minimum_jerk: a point of the world does not move; name a segment of the person")
        self._rows = [skeleton.joint_carrying(frame.segment) for frame in frames]
        self._points = np.array([np.append(frame.zero_from_frame[:3, 3], 1.0) for frame in frames])

    def evaluate(self, start: npt.ArrayLike, ends: npt.ArrayLike) -> FloatArray:
        """Return the jerks (...) of end displacements (..., n), given the start's (n,)."""
        reach = minimum_jerk_reach(np.asarray(start, dtype=float), np.asarray(ends), self.duration, SAMPLES)
        coordinates = self.skeleton.coordinates(reach.displacements)
        flat = np.ascontiguousarray(coordinates.reshape(-1, coordinates.shape[-1]))
        poses = segment_poses(self.skeleton.tree, flat)[:, self._rows]
        positions = np.einsum("khij,hj->khi", poses[:, :, :3], self._points)
        way = positions.reshape(*coordinates.shape[:-1], -1)
        third = np.linalg.matrix_power(differentiation(SAMPLES) / self.duration, 3)
        return reach.integral(np.square(third @ way).sum(axis=-1))


@dataclass(frozen=True)
class CostMaker:
    """How a cost is made, and one line about it for people who choose."""

    make: Callable[[Skeleton, float], PostureCost]
    summary: str


COSTS: Mapping[str, CostMaker] = {
    PreferredPosture.name: CostMaker(
        lambda skeleton, _: PreferredPosture(skeleton), "distance from the middle of the joint limits (eq. 2.11)"
    ),
    MinimumWork.name: CostMaker(
        lambda skeleton, mass: MinimumWork(BodyDynamics(skeleton, mass)), "positive work of the muscles (eq. 2.10)"
    ),
    MinimumTorqueChange.name: CostMaker(
        lambda skeleton, mass: MinimumTorqueChange(BodyDynamics(skeleton, mass)),
        "change of the joint torques along the reach (eq. 2.9)",
    ),
    MinimumJerk.name: CostMaker(
        lambda skeleton, _: MinimumJerk(skeleton), "jerk of the hands along the reach (eq. 2.8)"
    ),
}


def load_cost(name: str, skeleton: Skeleton, body_mass: float) -> PostureCost:
    """Return a cost by name.

    Args:
        name: One of ``COSTS``.
        skeleton: Whose postures it judges.
        body_mass: Of the person [kg]; only costs with torques need it.

    Raises:
        UnknownNameError: There is no such cost.
        BadRequestError: The mass is not that of a person.
        BadModelError: The skeleton lacks what the cost looks at.
    """
    if name not in COSTS:
        raise UnknownNameError("posture cost", name, list(COSTS))
    return COSTS[name].make(skeleton, body_mass)
