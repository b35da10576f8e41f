"""Compiled forward kinematics and Jacobians of a skeleton's markers: products of exponentials (eq. 2.3, 2.4).

The plain twins are in ``reference.py``; a test holds them together. Arrays of joint poses have one row more than there
are joints: row 0 is the world, row j + 1 the pose of the segment that joint j carries, which maps the zero frame to the
world.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.skeleton.tree import FlatTree, IntArray, JointKind

REVOLUTE, PRISMATIC, BALL, FREE = (int(kind) for kind in JointKind)
SMALL_ANGLE = 1e-8


@numba.njit(cache=True, nogil=True, inline="always")
def turn_about(axis: FloatArray, angle: float, out: FloatArray) -> None:
    """Fill ``out`` (3, 3) with the rotation about a unit axis (Rodrigues)."""
    x, y, z = axis[0], axis[1], axis[2]
    cosine, sine = math.cos(angle), math.sin(angle)
    rest = 1.0 - cosine
    out[0, 0], out[0, 1], out[0, 2] = cosine + x * x * rest, x * y * rest - z * sine, x * z * rest + y * sine
    out[1, 0], out[1, 1], out[1, 2] = y * x * rest + z * sine, cosine + y * y * rest, y * z * rest - x * sine
    out[2, 0], out[2, 1], out[2, 2] = z * x * rest - y * sine, z * y * rest + x * sine, cosine + z * z * rest


@numba.njit(cache=True, nogil=True, inline="always")
def turn_of_quaternion(q: FloatArray, start: int, out: FloatArray) -> None:
    """Fill ``out`` (3, 3) with the rotation of the unit quaternion q[start:start + 4] = (x, y, z, w)."""
    x, y, z, w = q[start], q[start + 1], q[start + 2], q[start + 3]
    out[0, 0], out[0, 1], out[0, 2] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)
    out[1, 0], out[1, 1], out[1, 2] = 2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)
    out[2, 0], out[2, 1], out[2, 2] = 2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def joint_poses(
    tree: FlatTree, q: FloatArray, rotation: FloatArray, translation: FloatArray, local: FloatArray
) -> None:
    """Fill the poses of all segments at the coordinates q (nq,).

    Args:
        tree: The skeleton.
        q: Coordinates, shape (nq,).
        rotation: Filled with world_from_zero rotations, shape (joints + 1, 3, 3).
        translation: Filled with the translations [m], shape (joints + 1, 3).
        local: Filled with each joint's own rotation, shape (joints, 3, 3).
    """
    for r in range(3):
        translation[0, r] = 0.0
        for c in range(3):
            rotation[0, r, c] = 1.0 if r == c else 0.0
    for j in range(tree.kind.shape[0]):
        p = tree.parent[j] + 1
        kind = tree.kind[j]
        start = tree.coordinate[j]
        own = local[j]
        if kind == PRISMATIC:
            for r in range(3):
                shift = 0.0
                for c in range(3):
                    own[r, c] = 1.0 if r == c else 0.0
                    rotation[j + 1, r, c] = rotation[p, r, c]
                    shift += rotation[p, r, c] * tree.axis[j, c]
                translation[j + 1, r] = translation[p, r] + shift * q[start]
            continue
        if kind == REVOLUTE:
            turn_about(tree.axis[j], q[start], own)
        elif kind == BALL:
            turn_of_quaternion(q, start, own)
        else:
            turn_of_quaternion(q, start + 3, own)
        # The joint's own centre stays: t = t_parent + R_parent (c - R c); a free root adds its position.
        for r in range(3):
            for c in range(3):
                rotation[j + 1, r, c] = (
                    rotation[p, r, 0] * own[0, c] + rotation[p, r, 1] * own[1, c] + rotation[p, r, 2] * own[2, c]
                )
        for r in range(3):
            moved = translation[p, r]
            for c in range(3):
                if kind == FREE:
                    moved += rotation[p, r, c] * q[start + c]
                else:
                    moved += (rotation[p, r, c] - rotation[j + 1, r, c]) * tree.point[j, c]
            translation[j + 1, r] = moved


@numba.njit(cache=True, nogil=True, error_model="numpy")
def place_markers(tree: FlatTree, rotation: FloatArray, translation: FloatArray, out: FloatArray) -> None:
    """Fill ``out`` (m, 3) with the markers' world positions [m] (eq. 2.4)."""
    for i in range(tree.marker.shape[0]):
        j = tree.marker_joint[i] + 1
        x, y, z = tree.marker[i, 0], tree.marker[i, 1], tree.marker[i, 2]
        for r in range(3):
            out[i, r] = rotation[j, r, 0] * x + rotation[j, r, 1] * y + rotation[j, r, 2] * z + translation[j, r]


@numba.njit(cache=True, nogil=True)
def marker_positions(tree: FlatTree, coordinates: FloatArray) -> FloatArray:
    """Return world positions (frames, m, 3) [m] of all markers at coordinates (frames, nq)."""
    joints = tree.kind.shape[0]
    rotation, translation = np.empty((joints + 1, 3, 3)), np.empty((joints + 1, 3))
    local = np.empty((joints, 3, 3))
    result = np.empty((coordinates.shape[0], tree.marker.shape[0], 3))
    for k in range(coordinates.shape[0]):
        joint_poses(tree, coordinates[k], rotation, translation, local)
        place_markers(tree, rotation, translation, result[k])
    return result


@numba.njit(cache=True, nogil=True)
def segment_poses(tree: FlatTree, coordinates: FloatArray) -> FloatArray:
    """Return world_from_zero of all segments, (frames, joints, 4, 4), at coordinates (frames, nq)."""
    joints = tree.kind.shape[0]
    rotation, translation = np.empty((joints + 1, 3, 3)), np.empty((joints + 1, 3))
    local = np.empty((joints, 3, 3))
    result = np.zeros((coordinates.shape[0], joints, 4, 4))
    for k in range(coordinates.shape[0]):
        joint_poses(tree, coordinates[k], rotation, translation, local)
        for j in range(joints):
            result[k, j, :3, :3] = rotation[j + 1]
            result[k, j, :3, 3] = translation[j + 1]
            result[k, j, 3, 3] = 1.0
    return result


@numba.njit(cache=True, nogil=True, error_model="numpy")
def turn_quaternion(q: FloatArray, start: int, x: float, y: float, z: float) -> None:
    """Turn q[start:start + 4] by the rotation vector (x, y, z) [rad] from the left, and normalise it."""
    angle = math.sqrt(x * x + y * y + z * z)
    scale = 0.5 if angle < SMALL_ANGLE else math.sin(0.5 * angle) / angle
    ax, ay, az, aw = scale * x, scale * y, scale * z, math.cos(0.5 * angle)
    bx, by, bz, bw = q[start], q[start + 1], q[start + 2], q[start + 3]
    cx = aw * bx + ax * bw + ay * bz - az * by
    cy = aw * by - ax * bz + ay * bw + az * bx
    cz = aw * bz + ax * by - ay * bx + az * bw
    cw = aw * bw - ax * bx - ay * by - az * bz
    norm = 1.0 / math.sqrt(cx * cx + cy * cy + cz * cz + cw * cw)
    q[start], q[start + 1], q[start + 2], q[start + 3] = cx * norm, cy * norm, cz * norm, cw * norm


@numba.njit(cache=True, nogil=True, error_model="numpy")
def move(tree: FlatTree, q: FloatArray, step: FloatArray) -> None:
    """Move coordinates q (nq,) in place by a tangent vector (nv,)."""
    for j in range(tree.kind.shape[0]):
        kind, c, v = tree.kind[j], tree.coordinate[j], tree.tangent[j]
        if kind == BALL:
            turn_quaternion(q, c, step[v], step[v + 1], step[v + 2])
        elif kind == FREE:
            for r in range(3):
                q[c + r] += step[v + r]
            turn_quaternion(q, c + 3, step[v + 3], step[v + 4], step[v + 5])
        else:
            q[c] += step[v]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def difference(tree: FlatTree, q: FloatArray, base: FloatArray, out: FloatArray) -> None:
    """Fill ``out`` (nv,) with the tangent that moves ``base`` (nq,) to ``q`` (nq,): the inverse of ``move``."""
    for j in range(tree.kind.shape[0]):
        kind, c, v = tree.kind[j], tree.coordinate[j], tree.tangent[j]
        if kind == BALL:
            quaternion_difference(q, base, c, out, v)
        elif kind == FREE:
            for r in range(3):
                out[v + r] = q[c + r] - base[c + r]
            quaternion_difference(q, base, c + 3, out, v + 3)
        else:
            out[v] = q[c] - base[c]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def quaternion_difference(q: FloatArray, base: FloatArray, c: int, out: FloatArray, v: int) -> None:
    """Fill out[v:v + 3] with the rotation vector [rad] that turns base[c:c + 4] into q[c:c + 4] from the left."""
    ax, ay, az, aw = q[c], q[c + 1], q[c + 2], q[c + 3]
    bx, by, bz, bw = -base[c], -base[c + 1], -base[c + 2], base[c + 3]
    x = aw * bx + ax * bw + ay * bz - az * by
    y = aw * by - ax * bz + ay * bw + az * bx
    z = aw * bz + ax * by - ay * bx + az * bw
    w = aw * bw - ax * bx - ay * by - az * bz
    if w < 0.0:
        x, y, z, w = -x, -y, -z, -w
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 if sine < SMALL_ANGLE else 2.0 * math.atan2(sine, w) / sine
    out[v], out[v + 1], out[v + 2] = scale * x, scale * y, scale * z


def ancestors(tree: FlatTree) -> IntArray:
    """Return for each joint the joints from the root to it, itself last, padded with -1; shape (joints, depth)."""
    chains: list[list[int]] = []
    for joint, parent in enumerate(tree.parent):
        chains.append([*(chains[parent] if parent >= 0 else []), joint])
    depth = max((len(chain) for chain in chains), default=0)
    table = np.full((len(chains), max(depth, 1)), -1, dtype=np.int64)
    for row, chain in zip(table, chains):
        row[: len(chain)] = chain
    return table


def forward(tree: FlatTree, coordinates: FloatArray) -> FloatArray:
    """Return marker positions (..., m, 3) [m] at coordinates (..., nq): one frame, many frames or sigma points."""
    flat = np.ascontiguousarray(np.reshape(coordinates, (-1, coordinates.shape[-1])), dtype=float)
    return np.asarray(marker_positions(tree, flat)).reshape(*coordinates.shape[:-1], len(tree.marker), 3)
