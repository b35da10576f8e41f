"""Compiled joint limits inside the estimate: the Gaussian is cut at each limit that it reaches over."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.skeleton.angles import GIMBAL
from handover_ros.skeleton.kernels import turn_of_quaternion
from handover_ros.skeleton.tree import FlatTree, IntArray, JointKind, Skeleton
from handover_ros.skeleton.ukf_kernels import apply_shift, truncate

BALL, FREE = int(JointKind.BALL), int(JointKind.FREE)
NEAR_POLE = 2.0 * GIMBAL


def limit_table(skeleton: Skeleton, margin: float) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return (joint of each limited row, axes (rows, 3, 3), lower (rows, 3), upper (rows, 3), home (rows, 3)).

    One row for each joint that has a finite limit; joints with one displacement use the first column.

    Args:
        skeleton: The skeleton.
        margin: How far [rad] or [m] beyond its limits a joint may go.
    """
    joints, axes, lower, upper, home = [], [], [], [], []
    for index, joint in enumerate(skeleton.joints):
        own = skeleton.slice_of(index)
        low, high = skeleton.lower[own], skeleton.upper[own]
        if not len(low) or not (np.isfinite(low).any() or np.isfinite(high).any()):
            continue
        joints.append(index)
        axes.append(joint.axes if joint.kind is JointKind.BALL else np.eye(3))
        pad = [(0, 3 - len(low))]
        lower.append(np.pad(low - margin, pad, constant_values=-np.inf))
        upper.append(np.pad(high + margin, pad, constant_values=np.inf))
        home.append(np.pad(skeleton.middle[own], pad))
    rows = len(joints)
    return (
        np.array(joints, dtype=np.int64),
        np.array(axes, dtype=float).reshape(rows, 3, 3),
        np.array(lower, dtype=float).reshape(rows, 3),
        np.array(upper, dtype=float).reshape(rows, 3),
        np.array(home, dtype=float).reshape(rows, 3),
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def ball_angles(
    axes: FloatArray,
    q: FloatArray,
    start: int,
    home: FloatArray,
    angles: FloatArray,
    rates: FloatArray,
) -> float:
    """Fill the three angles of a ball joint (``angles.euler_angles``) and d(angles)/d(tangent) (3, 3)."""
    turn, local = np.empty((3, 3)), np.empty((3, 3))
    turn_of_quaternion(q, start, turn)
    local[:] = axes @ turn @ axes.T
    sign = 1.0 if np.linalg.det(axes) > 0.0 else -1.0
    middle = math.asin(min(1.0, max(-1.0, local[0, 2])))
    first = math.atan2(-local[1, 2], local[2, 2])
    last = math.atan2(-local[0, 1], local[0, 0])
    best = math.inf
    for k in range(2):
        a = sign * (first + k * math.pi)
        b = sign * (math.pi - middle if k == 1 else middle)
        c = sign * (last + k * math.pi)
        a -= 2.0 * math.pi * round((a - home[0]) / (2.0 * math.pi))
        b -= 2.0 * math.pi * round((b - home[1]) / (2.0 * math.pi))
        c -= 2.0 * math.pi * round((c - home[2]) / (2.0 * math.pi))
        distance = (a - home[0]) ** 2 + (b - home[1]) ** 2 + (c - home[2]) ** 2
        if distance < best:
            best = distance
            angles[0], angles[1], angles[2] = a, b, c
    # The rotation vector of small changes is sum d_i u_i with u_i the axes as turned by the angles before them.
    ca, sa = math.cos(sign * angles[0]), math.sin(sign * angles[0])
    cb, sb = math.cos(sign * angles[1]), math.sin(sign * angles[1])
    columns = np.array([[1.0, 0.0, sb], [0.0, ca, -sa * cb], [0.0, sa, ca * cb]])
    rates[:] = np.linalg.inv(columns) @ axes if abs(cb) > 1e-6 else np.zeros((3, 3))
    return abs(cb)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def apply_limits(
    tree: FlatTree,
    q: FloatArray,
    rates: FloatArray,
    covariance: FloatArray,
    joints: IntArray,
    axes: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    home: FloatArray,
) -> None:
    """Cut the estimate at the joint limits it reaches over, in place; rates that lead further out are changed with it.

    Args:
        tree: The skeleton.
        q: Coordinates, shape (nq,).
        rates: Derivatives of the tangent, shape (order - 1, nv).
        covariance: P, shape (n, n).
        joints: As from ``limit_table``, and so the rest.
        axes: Shape (rows, 3, 3).
        lower: Shape (rows, 3).
        upper: Shape (rows, 3).
        home: Shape (rows, 3).
    """
    nv = rates.shape[1]
    angles, gradient, direction = np.empty(3), np.empty((3, 3)), np.zeros(nv)
    for row in range(joints.shape[0]):
        j = joints[row]
        ball = tree.kind[j] == BALL
        for k in range(3 if ball else 1):
            room = 1.0
            if ball:
                room = ball_angles(axes[row], q, tree.coordinate[j], home[row], angles, gradient)
                value = angles[k]
            else:
                value = q[tree.coordinate[j]]
            if ball and k != 1 and room < NEAR_POLE:
                continue
            for side in range(2):
                limit = upper[row, k] if side == 1 else lower[row, k]
                if not math.isfinite(limit):
                    continue
                direction[:] = 0.0
                for r in range(3 if ball else 1):
                    direction[tree.tangent[j] + r] = gradient[k, r] if ball else 1.0
                shift = np.zeros(covariance.shape[0])
                change = truncate(covariance, direction, value, limit, side == 1, shift)
                if change != 0.0:
                    apply_shift(tree, q, rates, shift)
                    value += change


class DisplacementTable(NamedTuple):
    """What ``read_displacements`` needs of a skeleton."""

    start: IntArray  # (joints,) first displacement of each joint
    axes: FloatArray  # (joints, 3, 3) of ball joints
    home: FloatArray  # (joints, 3) angles near which a ball joint's are chosen


def displacement_table(skeleton: Skeleton, home: FloatArray) -> DisplacementTable:
    """Return the table of a skeleton; ``home`` (n,) are displacements in the middle of what is possible."""
    count = len(skeleton.joints)
    axes, near = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    for index, joint in enumerate(skeleton.joints):
        if joint.kind is JointKind.BALL:
            axes[index], near[index] = joint.axes, home[skeleton.slice_of(index)]
    starts = np.array([skeleton.slice_of(index).start for index in range(count)], dtype=np.int64)
    return DisplacementTable(starts, axes, near)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def read_displacements(
    tree: FlatTree,
    table: DisplacementTable,
    q: FloatArray,
    rates: FloatArray,
    covariance: FloatArray,
    displacements: FloatArray,
    velocities: FloatArray,
    spread: FloatArray,
) -> None:
    """Fill displacements (n,), their rates (n,) and covariance (n, n) from those of posture and tangent."""
    n, nv = displacements.shape[0], rates.shape[0]
    mapping = np.zeros((n, nv))
    angles, gradient = np.empty(3), np.empty((3, 3))
    for j in range(tree.kind.shape[0]):
        kind, own, v = tree.kind[j], table.start[j], tree.tangent[j]
        if kind == BALL:
            ball_angles(table.axes[j], q, tree.coordinate[j], table.home[j], angles, gradient)
            for k in range(3):
                displacements[own + k] = angles[k]
                for r in range(3):
                    mapping[own + k, v + r] = gradient[k, r]
        elif kind != FREE:
            displacements[own] = q[tree.coordinate[j]]
            mapping[own, v] = 1.0
    velocities[:] = mapping @ rates
    spread[:] = mapping @ np.ascontiguousarray(covariance) @ mapping.T
