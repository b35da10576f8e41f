"""Inverse kinematics of a human arm, complete: the feasible set of a hand pose, sampled, weighed or searched."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from handover_ros.arm import posture_kernels, swivel_kernels
from handover_ros.arm.model import Arm
from handover_ros.errors import BadRequestError
from handover_ros.geometry import FloatArray
from handover_ros.threads import in_parts

IntArray = npt.NDArray[np.int64]
kernels: Any = posture_kernels  # numba's functions carry no types
swivels: Any = swivel_kernels

LEAST_CHUNK = 200  # hand poses below which another thread does not pay
SAMPLES_PER_POSE = 12  # room made at first
ROTATION_TOLERANCE = 1e-6


@dataclass(frozen=True)
class SwivelArc:
    """A stretch of the swivel angle along which the hand stays at its pose and every joint within its limits.

    Attributes:
        branch: Which of the 8 ways to take the angles: 1 elbow bent backwards, 2 the other Euler triple of the
            shoulder, 4 that of the wrist, added.
        start: [rad]; 0 is the elbow at its lowest.
        end: [rad], at most a full turn above ``start``; equal to it for a single point.
    """

    branch: int
    start: float
    end: float


@dataclass(frozen=True, eq=False)
class FeasibleSets:
    """Samples of the feasible sets of n hand poses.

    Attributes:
        postures: Displacements of all samples [rad], shape (total, 7); those of one pose follow each other.
        measures: Length in configuration space that each sample stands for [rad], shape (total,).
        first: Where the samples of each pose begin, shape (n + 1,).
    """

    postures: FloatArray
    measures: FloatArray
    first: IntArray

    def of(self, index: int) -> FloatArray:
        """Return the postures (k, 7) [rad] of one pose."""
        return self.postures[self.first[index] : self.first[index + 1]]


def feasible_arcs(arm: Arm, torso_from_hand: FloatArray) -> tuple[SwivelArc, ...]:
    """Return all feasible arcs of one hand pose (4, 4); none: the arm cannot have its hand there.

    Raises:
        BadRequestError: It is not a finite rigid transform.
    """
    pose = _checked(arm, torso_from_hand)[0]
    sums, bend = _prepared(arm, pose)
    if bend < 0.0:
        return ()
    found = np.empty((swivels.MOST_ARCS, 3))
    count = swivels.arcs(sums, bend, arm.limits, swivels.make_gates(arm.limits), np.empty(64), found)
    return tuple(SwivelArc(int(branch), float(start), float(end)) for branch, start, end in found[:count])


def posture_at(arm: Arm, torso_from_hand: FloatArray, branch: int, swivel: float) -> FloatArray | None:
    """Return the displacements (7,) [rad] at a swivel angle of a branch; None: out of reach or limits.

    Raises:
        BadRequestError: The pose is not a finite rigid transform.
    """
    sums, bend = _prepared(arm, _checked(arm, torso_from_hand)[0])
    q = np.empty(7)
    return q if bend >= 0.0 and swivels.posture(sums, bend, float(swivel), branch, arm.limits, q) else None


def feasible_sets(arm: Arm, torso_from_hand: FloatArray, step: float) -> FeasibleSets:
    """Return samples of the feasible sets of hand poses (n, 4, 4), evenly spaced along every arc.

    Args:
        arm: The arm.
        torso_from_hand: Grip poses in the torso frame.
        step: Largest length in configuration space that one sample stands for [rad], > 0.

    Raises:
        BadRequestError: A pose is not a finite rigid transform, or the step is not positive.
    """
    poses = _checked(arm, torso_from_hand)
    if not step > 0.0:
        raise BadRequestError(f"step: must be positive [rad], got {step}")

    def chunk(start: int, end: int) -> FeasibleSets:
        room = SAMPLES_PER_POSE * (end - start)
        while True:
            postures, measures = np.empty((room, 7)), np.empty(room)
            first = np.empty(end - start + 1, dtype=np.int64)
            total = kernels.sample(
                poses[start:end], arm.right_shoulder, arm.lengths, arm.limits, step, postures, measures, first
            )
            if total <= room:
                return FeasibleSets(postures[:total], measures[:total], first)
            room = total

    parts = in_parts(len(poses), chunk, LEAST_CHUNK)
    if len(parts) == 1:
        return parts[0]
    offsets = np.cumsum([0, *(len(part.measures) for part in parts)])
    first = [part.first[:-1] + offset for part, offset in zip(parts, offsets)]
    return FeasibleSets(
        np.concatenate([part.postures for part in parts]),
        np.concatenate([part.measures for part in parts]),
        np.concatenate([*first, offsets[-1:]]),
    )


def weigh(sets: FeasibleSets, costs: FloatArray, rationality: float) -> FloatArray:
    """Return the statistics (n, 5) of feasible sets whose samples cost ``costs`` (total,).

    Columns: measure [rad]; log of sum m exp(-rationality C) (-inf: infeasible); mean of C under these weights (3.3);
    mean of C under m alone; least C. An infinite rationality leaves the samples of least cost only.
    """
    table = np.empty((len(sets.first) - 1, 5))
    values = np.ascontiguousarray(costs, dtype=float)
    kernels.weigh(values, sets.measures, sets.first, float(rationality), table)
    return table


def weigh_quadratic(
    arm: Arm, torso_from_hand: FloatArray, step: float, neutral: FloatArray, weights: FloatArray, rationality: float
) -> FloatArray:
    """Return what ``weigh`` gives for the cost sum w (q - q*)^2 (3.2), without keeping the samples: faster.

    Raises:
        BadRequestError: As for ``feasible_sets``.
    """
    return weigh_quadratic_segments(arm, _checked(arm, torso_from_hand), step, neutral, weights, rationality)


def weigh_quadratic_segments(
    arm: Arm, segment_poses: FloatArray, step: float, neutral: FloatArray, weights: FloatArray, rationality: float
) -> FloatArray:
    """Return what ``weigh_quadratic`` gives, for poses (n, 4, 4) as ``Arm.segment_poses`` returns them.

    For many products of few rigid transforms: the poses are not checked again.

    Raises:
        BadRequestError: The step or the cost is wrong.
    """
    poses = np.ascontiguousarray(segment_poses)
    if not step > 0.0:
        raise BadRequestError(f"step: must be positive [rad], got {step}")
    table = np.empty((len(poses), 5))
    cost = _row(neutral, "neutral"), _row(weights, "weights")

    def chunk(start: int, end: int) -> None:
        kernels.weigh_quadratic(
            poses[start:end],
            arm.right_shoulder,
            arm.lengths,
            arm.limits,
            step,
            *cost,
            float(rationality),
            table[start:end],
        )

    in_parts(len(poses), chunk, LEAST_CHUNK)
    return table


def best_postures(
    arm: Arm, torso_from_hand: FloatArray, neutral: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the postures (n, 7) [rad] of least cost sum w (q - q*)^2 at hand poses (n, 4, 4), and these costs (n,).

    Minimised along the arcs, not over samples. NaN and inf: infeasible.

    Raises:
        BadRequestError: A pose is not a finite rigid transform.
    """
    poses = _checked(arm, torso_from_hand)
    postures, costs = np.full((len(poses), 7), np.nan), np.empty(len(poses))
    cost = _row(neutral, "neutral"), _row(weights, "weights")

    def chunk(start: int, end: int) -> None:
        kernels.best(
            poses[start:end],
            arm.right_shoulder,
            arm.lengths,
            arm.limits,
            *cost,
            postures[start:end],
            costs[start:end],
        )

    in_parts(len(poses), chunk, LEAST_CHUNK)
    return postures, costs


def _prepared(arm: Arm, pose: FloatArray) -> tuple[FloatArray, float]:
    """Return the sums of one pose and the elbow's bend."""
    sums = np.zeros((swivels.SUMS, 3))
    bend = swivels.prepare(pose, arm.right_shoulder, arm.upper_arm, arm.forearm, sums, np.empty((3, 3)))
    return sums, float(bend)


def _row(values: npt.ArrayLike, name: str) -> FloatArray:
    """Return seven finite numbers as an array."""
    array = np.ascontiguousarray(values, dtype=float)
    if array.shape != (7,) or not np.isfinite(array).all():
        raise BadRequestError(f"{name}: needs 7 finite numbers, got {np.asarray(values).tolist()}")
    return array


def _checked(arm: Arm, torso_from_hand: npt.ArrayLike) -> FloatArray:
    """Return the poses (n, 4, 4) of the hand segment after a check."""
    poses = np.asarray(torso_from_hand, dtype=float)
    if poses.shape[-2:] != (4, 4) or not np.isfinite(poses).all():
        raise BadRequestError(f"hand poses must be finite transforms (n, 4, 4), got an array of shape {poses.shape}")
    rotations = poses[..., :3, :3]
    gram = np.swapaxes(rotations, -1, -2) @ rotations - np.eye(3)
    if poses.size and np.abs(gram).max() > ROTATION_TOLERANCE:
        raise BadRequestError("hand poses must have rotation matrices (orthonormal)")
    if (np.linalg.det(rotations) < 0.0).any():
        raise BadRequestError("hand poses must have rotation matrices (right-handed), got a reflection")
    if poses.size and np.abs(poses[..., 3, :] - [0.0, 0.0, 0.0, 1.0]).max() > ROTATION_TOLERANCE:
        raise BadRequestError("hand poses must be rigid transforms with the last row 0 0 0 1")
    return arm.segment_poses(poses)
