"""The skeleton's mathematics as the dissertation writes it: plain, slow, the twin of the compiled code."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm

from handover_ros.geometry import FloatArray, skew
from handover_ros.skeleton.tree import WORLD, JointKind, Skeleton


def hat(twist: npt.ArrayLike) -> FloatArray:
    """Return the 4x4 matrix of a twist (linear, angular) (eq. 2.2)."""
    values = np.asarray(twist, dtype=float)
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = skew(values[3:])
    matrix[:3, 3] = values[:3]
    return matrix


def segment_pose(
    skeleton: Skeleton, displacements: FloatArray, segment: str, world_from_root: FloatArray | None = None
) -> FloatArray:
    """Return g_j (4, 4), which maps the zero frame to the world for what a segment carries (eq. 2.3)."""
    pose = np.eye(4) if world_from_root is None or not skeleton.is_free else world_from_root
    for index in skeleton.chain(segment):
        joint = skeleton.joints[index]
        if joint.kind is JointKind.FREE:
            continue
        for twist, theta in zip(joint.twists, displacements[skeleton.slice_of(index)]):
            pose = pose @ expm(hat(twist) * theta)
    return np.asarray(pose)


def marker_positions(
    skeleton: Skeleton, displacements: FloatArray, world_from_root: FloatArray | None = None
) -> FloatArray:
    """Return the world positions (m, 3) [m] of all markers of one posture (eq. 2.4)."""
    rows = []
    for position, segment in zip(skeleton.markers, skeleton.marker_segments):
        pose = np.eye(4) if segment == WORLD else segment_pose(skeleton, displacements, segment, world_from_root)
        rows.append((pose @ np.append(position, 1.0))[:3])
    return np.array(rows)


def prediction_error(
    skeleton: Skeleton, displacements: FloatArray, world_from_root: FloatArray, measured: FloatArray
) -> float:
    """Return the sum of squared distances [m^2] of eq. 2.6; markers that are NaN are left out.

    Args:
        skeleton: The skeleton.
        displacements: Of each frame [rad, m], shape (frames, n).
        world_from_root: Root pose of each frame, shape (frames, 4, 4).
        measured: Marker positions [m], shape (frames, m, 3).
    """
    total = 0.0
    for theta, pose, positions in zip(displacements, world_from_root, measured):
        error = marker_positions(skeleton, theta, pose) - positions
        total += float(np.nansum(error**2))
    return total
