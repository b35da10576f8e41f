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


class LimitTable(NamedTuple):
    """What ``apply_limits`` needs of a skeleton; one row for each joint that has a limit."""

    joints: IntArray  # (rows,)
    axes: FloatArray  # (rows, 3, 3) of ball joints
    lower: FloatArray  # (rows, 3)
    upper: FloatArray  # (rows, 3)
    home: FloatArray  # (rows, 3) angles near which a ball joint's are chosen


def limit_table(skeleton: Skeleton, margin: float) -> LimitTable:
    """Return the table of a skeleton.

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
    return LimitTable(
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
    for r in range(3):
        for k in range(3):
            local[r, k] = 0.0
            for m in range(3):
                for n in range(3):
                    local[r, k] += axes[r, m] * turn[m, n] * axes[k, n]
    handed = 0.0
    for r in range(3):
        m, n = (r + 1) % 3, (r + 2) % 3
        handed += axes[0, r] * (axes[1, m] * axes[2, n] - axes[1, n] * axes[2, m])
    sign = 1.0 if handed > 0.0 else -1.0
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
    # They are the columns (1, 0, 0), (0, ca, sa), (sb, -sa cb, ca cb) in the joint's axes; this is the inverse.
    if abs(cb) > 1e-6:
        for k in range(3):
            x, y, z = axes[0, k], axes[1, k], axes[2, k]
            rates[2, k] = (ca * z - sa * y) / cb
            rates[1, k] = ca * y + sa * z
            rates[0, k] = x - sb * rates[2, k]
    else:
        rates[:] = 0.0
    return abs(cb)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def apply_limits(tree: FlatTree, q: FloatArray, rates: FloatArray, covariance: FloatArray, limits: LimitTable) -> None:
    """Cut the estimate at the joint limits it reaches over, in place; rates that lead further out are changed with it.

    Args:
        tree: The skeleton.
        q: Coordinates, shape (nq,).
        rates: Derivatives of the tangent, shape (order - 1, nv).
        covariance: P, shape (n, n).
        limits: The limits.
    """
    nv = rates.shape[1]
    angles, gradient = np.empty(3), np.empty((3, 3))
    direction, shift = np.zeros(nv), np.zeros(covariance.shape[0])
    for row in range(limits.joints.shape[0]):
        j = limits.joints[row]
        ball = tree.kind[j] == BALL
        for k in range(3 if ball else 1):
            room = 1.0
            if ball:
                room = ball_angles(limits.axes[row], q, tree.coordinate[j], limits.home[row], angles, gradient)
                value = angles[k]
            else:
                value = q[tree.coordinate[j]]
            if ball and k != 1 and room < NEAR_POLE:
                continue
            for side in range(2):
                limit = limits.upper[row, k] if side == 1 else limits.lower[row, k]
                if not math.isfinite(limit):
                    continue
                direction[:] = 0.0
                for r in range(3 if ball else 1):
                    direction[tree.tangent[j] + r] = gradient[k, r] if ball else 1.0
                change = truncate(covariance, direction, value, limit, side == 1, shift)
                if change != 0.0:
                    apply_shift(tree, q, rates, shift)
                    shift[:] = 0.0
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
    # A displacement is a sum over the (one or three) tangents of its joint.
    n = displacements.shape[0]
    base, width, mapping = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64), np.zeros((n, 3))
    angles, gradient = np.empty(3), np.empty((3, 3))
    for j in range(tree.kind.shape[0]):
        kind, own, v = tree.kind[j], table.start[j], tree.tangent[j]
        if kind == BALL:
            ball_angles(table.axes[j], q, tree.coordinate[j], table.home[j], angles, gradient)
            for k in range(3):
                displacements[own + k], base[own + k], width[own + k] = angles[k], v, 3
                for r in range(3):
                    mapping[own + k, r] = gradient[k, r]
        elif kind != FREE:
            displacements[own], base[own], width[own], mapping[own, 0] = q[tree.coordinate[j]], v, 1, 1.0
    for i in range(n):
        velocities[i] = 0.0
        for a in range(width[i]):
            velocities[i] += mapping[i, a] * rates[base[i] + a]
        for k in range(i + 1):
            total = 0.0
            for a in range(width[i]):
                for b in range(width[k]):
                    total += mapping[i, a] * covariance[base[i] + a, base[k] + b] * mapping[k, b]
            spread[i, k] = spread[k, i] = total
