"""The manipulator Jacobian between any two frames of a skeleton: the nine steps of Bestick 2017, section 2.5.

Everything takes one posture, displacements (n,), or many, (..., n). A free root only matters against the world frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from handover_ros.errors import BadModelError
from handover_ros.geometry import FloatArray, invert_transform
from handover_ros.skeleton.tree import WORLD, JointKind, Skeleton

ORTHONORMAL_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class Frame:
    """A coordinate frame fixed to a segment.

    Attributes:
        segment: The segment that carries it, or ``world``.
        zero_from_frame: Its pose in the zero frame while all displacements are zero, shape (4, 4).
    """

    segment: str
    zero_from_frame: FloatArray

    def __post_init__(self) -> None:
        """Check the pose and make it read-only.

        Raises:
            BadModelError: It is no rigid transform.
        """
        pose = np.array(self.zero_from_frame, dtype=float)
        if pose.shape != (4, 4) or not np.isfinite(pose).all():
            raise BadModelError(f"frame on {self.segment!r}: the pose must be 4x4 finite numbers, got {pose.shape}")
        if np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max() > ORTHONORMAL_TOLERANCE:
            raise BadModelError(f"frame on {self.segment!r}: the rotation must be orthonormal")
        pose.setflags(write=False)
        object.__setattr__(self, "zero_from_frame", pose)


WORLD_FRAME = Frame(WORLD, np.eye(4))


@dataclass(frozen=True, eq=False)
class Motion:
    """Poses and twists of one or many postures.

    Attributes:
        poses: world_from_zero of what each joint carries, shape (..., joints + 1, 4, 4); row 0 is the world.
        twists: Transformed twists (linear, angular) of the displacements in the world frame, shape (..., n, 6).
    """

    poses: FloatArray
    twists: FloatArray


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return a x b of vectors (..., 3); NumPy's own takes ten times as long for a few vectors."""
    (ax, ay, az), (bx, by, bz) = ((each[..., 0], each[..., 1], each[..., 2]) for each in (a, b))
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


@lru_cache(maxsize=64)
def all_twists(skeleton: Skeleton) -> FloatArray:
    """Return the twists (n, 6) of all displacements in the zero frame, remembered: a skeleton does not change."""
    return np.concatenate([np.zeros((0, 6)), *(joint.twists for joint in skeleton.joints)])


def exponential(twists: FloatArray, displacements: FloatArray) -> FloatArray:
    """Return exp(twist^ displacement) (..., 4, 4) of unit twists (..., 6) and displacements (...) (eq. 2.1).

    Rodrigues' formula with the axis' point nearest to the origin; a twist without rotation is a translation.
    """
    linear, axis = twists[..., :3], twists[..., 3:]
    angle = np.asarray(displacements, dtype=float)[..., None]
    hat = cross(axis[..., None, :], -np.eye(3))
    rotation = np.eye(3) + np.sin(angle)[..., None] * hat + (1.0 - np.cos(angle))[..., None] * (hat @ hat)
    point = cross(axis, linear)
    slides = ~axis.any(axis=-1, keepdims=True)
    result = np.zeros((*rotation.shape[:-2], 4, 4))
    result[..., :3, :3] = rotation
    result[..., :3, 3] = point - (rotation @ point[..., None])[..., 0] + np.where(slides, linear, 0.0) * angle
    result[..., 3, 3] = 1.0
    return result


def adjoint(poses: FloatArray, twists: FloatArray) -> FloatArray:
    """Return Ad_g twist (..., 6), (linear, angular), of poses g (..., 4, 4) and twists (..., 6)."""
    rotation, translation = poses[..., :3, :3], poses[..., :3, 3]
    linear = (rotation @ twists[..., :3, None])[..., 0]
    angular = (rotation @ twists[..., 3:, None])[..., 0]
    return np.concatenate([linear + cross(translation, angular), angular], axis=-1)


def move_tree(skeleton: Skeleton, displacements: npt.ArrayLike, world_from_root: FloatArray | None = None) -> Motion:
    """Return the poses of all segments (eq. 2.3) and step 1: each twist, transformed by what lies before it.

    Args:
        skeleton: The skeleton.
        displacements: [rad] or [m], shape (..., n).
        world_from_root: Pose of a free root (4, 4); default: the world's origin.
    """
    values = np.asarray(displacements, dtype=float)
    twists = all_twists(skeleton)
    steps = exponential(twists, values)
    poses = np.zeros((*values.shape[:-1], len(skeleton.joints) + 1, 4, 4))
    before = np.zeros_like(steps)
    poses[..., 0, :, :] = np.eye(4)
    column = 0
    for index, joint in enumerate(skeleton.joints):
        pose = poses[..., int(skeleton.tree.parent[index]) + 1, :, :]
        if joint.kind is JointKind.FREE and world_from_root is not None:
            pose = pose @ world_from_root
        for _ in joint.displacement_names:
            before[..., column, :, :] = pose
            pose = pose @ steps[..., column, :, :]
            column += 1
        poses[..., index + 1, :, :] = pose
    return Motion(poses, adjoint(before, np.broadcast_to(twists, (*values.shape, 6))))


def frame_pose(skeleton: Skeleton, motion: Motion, frame: Frame) -> FloatArray:
    """Return world_from_frame (..., 4, 4) of moved poses.

    Raises:
        UnknownNameError: No joint carries the frame's segment.
    """
    return np.asarray(motion.poses[..., skeleton.joint_carrying(frame.segment) + 1, :, :] @ frame.zero_from_frame)


def relative_pose(
    skeleton: Skeleton,
    displacements: npt.ArrayLike,
    base: Frame,
    manipulator: Frame,
    world_from_root: FloatArray | None = None,
) -> FloatArray:
    """Return base_from_manipulator (..., 4, 4) at displacements (..., n) [rad, m].

    Raises:
        UnknownNameError: No joint carries a frame's segment.
    """
    motion = move_tree(skeleton, displacements, world_from_root)
    return np.asarray(invert_transform(frame_pose(skeleton, motion, base)) @ frame_pose(skeleton, motion, manipulator))


def manipulator_jacobian(
    skeleton: Skeleton,
    displacements: npt.ArrayLike,
    base: Frame,
    manipulator: Frame,
    world_from_root: FloatArray | None = None,
) -> FloatArray:
    """Return how the manipulator frame moves against the base frame as the displacements change, shape (..., 6, n).

    Rows: linear velocity of the manipulator frame's origin, then angular velocity, both in the base frame, for each
    displacement [m/rad, rad/rad; m/m for a prismatic one]. Columns of displacements off the path between the two
    frames are zero. A ball joint enters with its three twists in sequence (eq. 2.12).

    Args:
        skeleton: The skeleton.
        displacements: [rad] or [m], shape (..., n).
        base: The frame to express everything in; it need not be at the root.
        manipulator: The frame that moves.
        world_from_root: Pose of a free root (4, 4), which matters only if one of the frames is in the world.

    Raises:
        UnknownNameError: No joint carries a frame's segment.
    """
    return jacobian_of(skeleton, move_tree(skeleton, displacements, world_from_root), base, manipulator)


def jacobian_of(skeleton: Skeleton, motion: Motion, base: Frame, manipulator: Frame) -> FloatArray:
    """Return ``manipulator_jacobian`` (..., 6, n) of a tree already moved (step 1)."""
    # Steps 2 to 6: the chains without what they share; which way round a twist counts is all that the order decides.
    base_chain, manipulator_chain = skeleton.chain(base.segment), skeleton.chain(manipulator.segment)
    sign = np.zeros(motion.twists.shape[-2])
    for chain, other, direction in ((base_chain, manipulator_chain, -1.0), (manipulator_chain, base_chain, 1.0)):
        for joint in set(chain) - set(other):
            sign[skeleton.slice_of(joint)] = direction
    # Step 7: the frames' poses at this posture.
    base_from_world = invert_transform(frame_pose(skeleton, motion, base))
    origin = (base_from_world @ frame_pose(skeleton, motion, manipulator))[..., :3, 3]
    # Step 8: the twists in the base frame.
    twists = adjoint(base_from_world[..., None, :, :], sign[:, None] * motion.twists)
    # Step 9: the velocity that each twist gives to the manipulator frame's origin.
    linear = twists[..., :3] + cross(twists[..., 3:], origin[..., None, :])
    return np.asarray(np.swapaxes(np.concatenate([linear, twists[..., 3:]], axis=-1), -1, -2))
