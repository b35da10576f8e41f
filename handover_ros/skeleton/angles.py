"""A rotation as three turns about orthogonal axes in sequence, and back: the ball joint's map of eq. 2.12.

R = exp(w1 a1) exp(w2 a2) exp(w3 a3). The middle angle may go beyond +-90 degrees: each rotation has two triples.
"""

from __future__ import annotations

import numpy as np

from handover_ros.geometry import FloatArray

FULL_TURN = 2.0 * np.pi
GIMBAL = 0.15  # cosine of the middle angle below which the outer two are hardly known


def rotation_of(axes: FloatArray, angles: FloatArray) -> FloatArray:
    """Return rotations (..., 3, 3) of angles (..., 3) [rad] about orthonormal axes (3, 3), one a row."""
    sign = np.sign(np.linalg.det(axes))
    a, b, c = np.moveaxis(sign * np.asarray(angles, dtype=float), -1, 0)
    (ca, cb, cc), (sa, sb, sc) = np.cos([a, b, c]), np.sin([a, b, c])
    local = np.empty((*a.shape, 3, 3))
    local[..., 0, 0], local[..., 0, 1], local[..., 0, 2] = cb * cc, -cb * sc, sb
    local[..., 1, 0] = sa * sb * cc + ca * sc
    local[..., 1, 1] = -sa * sb * sc + ca * cc
    local[..., 1, 2] = -sa * cb
    local[..., 2, 0] = -ca * sb * cc + sa * sc
    local[..., 2, 1] = ca * sb * sc + sa * cc
    local[..., 2, 2] = ca * cb
    return np.asarray(axes.T @ local @ axes)


def euler_angles(axes: FloatArray, rotations: FloatArray, near: FloatArray) -> FloatArray:
    """Return the angles (..., 3) [rad] of rotations (..., 3, 3): of the two triples, the one nearer to ``near`` (3,).

    The triples differ by half a turn in the outer angles, far more than a joint's range is wide, so that each frame can
    be read without the ones before. (Following the last frame instead goes wrong where a motion passes near the pole.)
    """
    sign = np.sign(np.linalg.det(axes))
    local = axes @ rotations @ axes.T
    middle = np.arcsin(np.clip(local[..., 0, 2], -1.0, 1.0))
    first = np.arctan2(-local[..., 1, 2], local[..., 2, 2])
    last = np.arctan2(-local[..., 0, 1], local[..., 0, 0])
    one = sign * np.stack([first, middle, last], axis=-1)
    other = sign * np.stack([first + np.pi, np.pi - middle, last + np.pi], axis=-1)
    candidates = np.stack([one, other])
    candidates -= FULL_TURN * np.round((candidates - near) / FULL_TURN)
    distance = np.square(candidates - near).sum(axis=-1)
    return np.asarray(np.where((distance[0] <= distance[1])[..., None], candidates[0], candidates[1]))


def euler_rates(axes: FloatArray, angles: FloatArray) -> FloatArray:
    """Return d(angles)/d(rotation vector) (..., 3, 3) for small rotations applied on the left, exp(v) R.

    Grows without bound where the middle angle is 90 degrees; there the pseudo-inverse of the columns is taken.
    """
    values = np.asarray(angles, dtype=float)
    columns = np.empty((*values.shape[:-1], 3, 3))
    zeros = np.zeros(values.shape[:-1])
    columns[..., :, 0] = axes[0]
    columns[..., :, 1] = rotation_of(axes, np.stack([values[..., 0], zeros, zeros], axis=-1)) @ axes[1]
    columns[..., :, 2] = rotation_of(axes, np.stack([values[..., 0], values[..., 1], zeros], axis=-1)) @ axes[2]
    return np.asarray(np.linalg.pinv(columns, rcond=1e-4))
