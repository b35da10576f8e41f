"""Rigid-body geometry: rotations, transforms and quaternions as NumPy arrays.

A transform is a 4x4 homogeneous matrix named ``target_from_source``; a quaternion is (x, y, z, w) as in ROS.
A flat pose is the 7 numbers (x, y, z, qx, qy, qz, qw).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

FloatArray = npt.NDArray[np.float64]

QUATERNION_NORM_TOLERANCE = 1e-3


def make_transform(rotation: npt.ArrayLike, translation: npt.ArrayLike) -> FloatArray:
    """Return the 4x4 transform with a 3x3 ``rotation`` and a ``translation`` [m]."""
    transform = np.eye(4)
    transform[:3, :3] = rotation
    transform[:3, 3] = translation
    return transform


def transform_from_xyz_rpy(xyz: npt.ArrayLike, rpy: npt.ArrayLike = (0.0, 0.0, 0.0)) -> FloatArray:
    """Return the transform of a position [m] and roll, pitch, yaw [rad] about fixed axes, as in URDF."""
    return make_transform(Rotation.from_euler("xyz", rpy).as_matrix(), xyz)


def invert_transform(target_from_source: FloatArray) -> FloatArray:
    """Return ``source_from_target``; works on stacks of shape (..., 4, 4)."""
    rotation_inverse = np.swapaxes(target_from_source[..., :3, :3], -1, -2)
    inverse = np.zeros_like(target_from_source)
    inverse[..., :3, :3] = rotation_inverse
    inverse[..., :3, 3] = -(rotation_inverse @ target_from_source[..., :3, 3, None])[..., 0]
    inverse[..., 3, 3] = 1.0
    return inverse


def transform_points(target_from_source: FloatArray, points: npt.ArrayLike) -> FloatArray:
    """Return points [m] of shape (..., 3) given in the source frame, expressed in the target frame."""
    return np.asarray(points) @ target_from_source[:3, :3].T + target_from_source[:3, 3]


def pose_from_transform(transform: FloatArray) -> FloatArray:
    """Return the flat pose (7,) of a 4x4 transform; the quaternion has w >= 0."""
    quaternion = Rotation.from_matrix(transform[:3, :3]).as_quat(canonical=True)
    return np.concatenate([transform[:3, 3], quaternion])


def transform_from_pose(pose: npt.ArrayLike) -> FloatArray:
    """Return the 4x4 transform of a flat pose (7,).

    Raises:
        ValueError: The pose is not 7 finite numbers or its quaternion is not of unit length.
    """
    values = np.asarray(pose, dtype=float)
    if values.shape != (7,) or not np.all(np.isfinite(values)):
        raise ValueError(f"a pose is 7 finite numbers x y z qx qy qz qw, got {values.tolist()}")
    norm = float(np.linalg.norm(values[3:]))
    if abs(norm - 1.0) > QUATERNION_NORM_TOLERANCE:
        raise ValueError(f"the quaternion {values[3:].tolist()} has length {norm:.4g}, not 1")
    return make_transform(Rotation.from_quat(values[3:]).as_matrix(), values[:3])


def rotation_angle(a: FloatArray, b: FloatArray) -> float:
    """Return the angle [rad] between two 3x3 rotations."""
    return float(Rotation.from_matrix(a[:3, :3].T @ b[:3, :3]).magnitude())


def skew(vector: npt.ArrayLike) -> FloatArray:
    """Return the 3x3 matrix of the cross product with ``vector`` (Bestick 2017, eq. 2.2)."""
    x, y, z = np.asarray(vector, dtype=float)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
