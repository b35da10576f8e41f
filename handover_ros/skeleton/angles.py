"""A rotation as three turns about orthogonal axes in sequence, and back: the ball joint's map of eq. 2.12.

R = exp(w1 a1) exp(w2 a2) exp(w3 a3). The middle angle beyond +-90 degrees is allowed: each rotation has two triples, and
which one a joint means follows from the frame before.
"""

from __future__ import annotations

import numpy as np

from handover_ros.geometry import FloatArray

FULL_TURN = 2.0 * np.pi


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
    """Return the angles (k, 3) [rad] of rotations (k, 3, 3), the first near ``near`` (3,), each other near the last."""
    sign = np.sign(np.linalg.det(axes))
    local = axes @ rotations @ axes.T
    middle = np.arcsin(np.clip(local[:, 0, 2], -1.0, 1.0))
    first = np.arctan2(-local[:, 1, 2], local[:, 2, 2])
    last = np.arctan2(-local[:, 0, 1], local[:, 0, 0])
    one = sign * np.stack([first, middle, last], axis=1)
    other = sign * np.stack([first + np.pi, np.pi - middle, last + np.pi], axis=1)
    result = np.empty_like(one)
    previous = np.asarray(near, dtype=float)
    for index, candidates in enumerate(np.stack([one, other], axis=1)):
        turned = candidates - FULL_TURN * np.round((candidates - previous) / FULL_TURN)
        previous = turned[np.argmin(np.square(turned - previous).sum(axis=1))]
        result[index] = previous
    return result


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
