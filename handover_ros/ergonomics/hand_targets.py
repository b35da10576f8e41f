"""Where hands should be, as errors that a solver brings to nothing, with their derivatives; in the root's frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy.spatial.transform import Rotation

from handover_ros.arm.hand import hand_frames
from handover_ros.errors import BadModelError, BadRequestError, UnknownNameError
from handover_ros.geometry import FloatArray
from handover_ros.skeleton.jacobian import Frame, frame_pose, jacobian_of, move_tree
from handover_ros.skeleton.tree import Skeleton

ANGLE_LENGTH = 0.2  # [m/rad] how an error of the hand's rotation weighs against one of its position


class Match(Enum):
    """What of a hand's pose is wanted."""

    POSITION = "position"
    POSE = "pose"


@dataclass(frozen=True, eq=False)
class HandTarget:
    """Where a hand should be.

    Attributes:
        root_from_hand: Grip pose in the root frame: x along the fingers, z out of the palm, shape (4, 4).
        match: Whether the rotation counts too.
    """

    root_from_hand: FloatArray
    match: Match = Match.POSE


@dataclass(frozen=True, eq=False)
class HandTask:
    """The targets as frames of a skeleton.

    Attributes:
        skeleton: The skeleton.
        frames: Grip of each targeted hand.
        targets: Where each should be.
        root: The frame they are given in.
    """

    skeleton: Skeleton
    frames: tuple[Frame, ...]
    targets: tuple[HandTarget, ...]
    root: Frame

    def errors(self, displacements: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return errors (..., m) of postures (..., n), in metres throughout, and their derivatives (..., m, n)."""
        motion = move_tree(self.skeleton, displacements)
        batch = displacements.shape[:-1]
        rows, slopes = [], []
        for frame, target in zip(self.frames, self.targets):
            pose = frame_pose(self.skeleton, motion, frame)
            jacobian = jacobian_of(self.skeleton, motion, self.root, frame)
            rows.append(pose[..., :3, 3] - target.root_from_hand[:3, 3])
            slopes.append(jacobian[..., :3, :])
            if target.match is Match.POSE:
                turn = (pose[..., :3, :3] @ target.root_from_hand[:3, :3].T).reshape(-1, 3, 3)
                vector = Rotation.from_matrix(turn).as_rotvec()
                rows.append(ANGLE_LENGTH * vector.reshape(*batch, 3))
                spin = rotation_vector_slope(vector).reshape(*batch, 3, 3) @ jacobian[..., 3:, :]
                slopes.append(ANGLE_LENGTH * spin)
        if not rows:
            return np.zeros((*batch, 0)), np.zeros((*batch, 0, displacements.shape[-1]))
        return np.concatenate(rows, axis=-1), np.concatenate(slopes, axis=-2)

    def misses(self, displacements: FloatArray) -> tuple[float, float]:
        """Return the largest error of position [m] and of rotation [rad] of one posture (n,)."""
        errors, _ = self.errors(displacements)
        position = rotation = 0.0
        column = 0
        for target in self.targets:
            position = max(position, float(np.linalg.norm(errors[column : column + 3])))
            column += 3
            if target.match is Match.POSE:
                rotation = max(rotation, float(np.linalg.norm(errors[column : column + 3])) / ANGLE_LENGTH)
                column += 3
        return position, rotation


def hand_task(skeleton: Skeleton, targets: Mapping[str, HandTarget]) -> HandTask:
    """Return the targets as frames of the skeleton.

    Raises:
        UnknownNameError: The skeleton has no hand on a side.
        BadModelError: The grip of a hand cannot be derived.
        BadRequestError: A target is no pose.
    """
    root = Frame(skeleton.root, np.eye(4))
    if not targets:
        return HandTask(skeleton, (), (), root)
    hands = hand_frames(skeleton)
    for side, target in targets.items():
        if side not in hands:
            raise UnknownNameError("hand", side, list(hands))
        if np.shape(target.root_from_hand) != (4, 4):
            raise BadRequestError(f"target of the {side} hand: needs a 4x4 pose, got {np.shape(target.root_from_hand)}")
        try:
            Frame(side, target.root_from_hand)
        except BadModelError as error:
            raise BadRequestError(f"target of the {side} hand: {error}") from None
    return HandTask(skeleton, tuple(hands[side].frame for side in targets), tuple(targets.values()), root)


def rotation_vector_slope(vectors: FloatArray) -> FloatArray:
    """Return d(rotation vector)/d(angular velocity) (k, 3, 3), rotations applied from the left.

    The inverse left Jacobian, 1 - [v]/2 + (1/a^2 - (1 + cos a) / (2 a sin a)) [v]^2 with a = |v| (J. Sola et al., "A
    micro Lie theory for state estimation in robotics", 2018, eq. 146).
    """
    angle = np.linalg.norm(vectors, axis=1)
    safe = np.where(angle < 1e-4, 1.0, np.minimum(angle, np.pi - 1e-6))
    factor = np.where(angle < 1e-4, 1.0 / 12.0, 1.0 / safe**2 - (1.0 + np.cos(safe)) / (2.0 * safe * np.sin(safe)))
    hat = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    hat[:, 0, 1], hat[:, 0, 2], hat[:, 1, 2] = -z, y, -x
    hat -= np.swapaxes(hat, 1, 2)
    return np.asarray(np.eye(3) - 0.5 * hat + factor[:, None, None] * (hat @ hat))
