"""Kinematics of the simulated person: forward, Jacobian and the closed-form inverse of an arm.

Joints are ordered as ``person_spec.JOINTS``. Zero posture: upright, arms hanging, palms to the body. Right-arm axes in
the zero posture (torso frame, x forward, y left, z up): flexion -y, abduction -x, internal rotation +z, elbow flexion
-y, pronation +z, wrist flexion +x, radial deviation -y. The left arm is its mirror image in the plane y = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from handover_ros.arm.model import AXES, HAND_AXES, MIRROR
from handover_ros.geometry import FloatArray, invert_transform, make_transform
from handover_ros.sim.person_spec import ARM_SLICE, HANDS, PersonSpec

TORSO_AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))


def arm_axes(hand: str) -> FloatArray:
    """Return the rotation axes (7, 3) of an arm in the zero posture, torso frame."""
    return AXES.copy() if hand == "right" else AXES * [-1.0, 1.0, -1.0]


def hand_axes(hand: str) -> FloatArray:
    """Return torso_from_hand rotation (3, 3) in the zero posture."""
    if hand == "right":
        return HAND_AXES
    return MIRROR[:3, :3] @ HAND_AXES @ MIRROR[:3, :3]


@dataclass(frozen=True, eq=False)
class BodyPoses:
    """Poses (4, 4) in world of the torso frame and of the grip of each hand."""

    torso: FloatArray
    right_hand: FloatArray
    left_hand: FloatArray


class PersonKinematics:
    """Geometry of one person standing at ``world_from_feet`` (4, 4)."""

    def __init__(self, person: PersonSpec, world_from_feet: FloatArray) -> None:
        self.person = person
        self.world_from_feet = np.array(world_from_feet, dtype=float)
        lengths = person.lengths
        self._lumbar = np.array([0.0, 0.0, lengths.lumbar_height])
        self._trunk = np.array([0.0, 0.0, lengths.trunk])
        self._upper_arm = lengths.upper_arm
        self._forearm = lengths.forearm

    def torso_pose(self, torso: FloatArray) -> FloatArray:
        """Return world_from_torso (4, 4) of the torso coordinates (6,) or (n, 6): shape (n, 4, 4)."""
        torso = np.asarray(torso)
        rotation = Rotation.from_euler("ZYX", torso[..., 3:6]).as_matrix()
        pose = np.zeros((*torso.shape[:-1], 4, 4))
        pose[..., :3, :3] = rotation
        pose[..., :3, 3] = torso[..., :3] + self._lumbar + rotation @ self._trunk
        pose[..., 3, 3] = 1.0
        return self.world_from_feet @ pose

    def torso_coordinates(self, world_from_torso: FloatArray) -> FloatArray:
        """Return the torso coordinates (6,) that give a pose (4, 4); the inverse of ``torso_pose``."""
        pose = invert_transform(self.world_from_feet) @ world_from_torso
        angles = Rotation.from_matrix(pose[:3, :3]).as_euler("ZYX")
        return np.concatenate([pose[:3, 3] - self._lumbar - pose[:3, :3] @ self._trunk, angles])

    def forward(self, displacements: FloatArray) -> BodyPoses:
        """Return the poses of torso and hands at the displacements (20,)."""
        torso = self.torso_pose(displacements[:6])
        right, left = (torso @ self.arm_pose(hand, displacements[ARM_SLICE[hand]]) for hand in HANDS)
        return BodyPoses(torso, right, left)

    def arm_pose(self, hand: str, arm: FloatArray) -> FloatArray:
        """Return torso_from_hand (4, 4) of an arm's displacements (7,)."""
        return self._arm_frames(hand, arm)[-1]

    def jacobian(self, displacements: FloatArray, hand: str) -> FloatArray:
        """Return d(grip position, rotation)/d(displacements) in world, shape (6, 20); rows linear, angular."""
        world_from_torso = self.torso_pose(displacements[:6])
        frames = self._arm_frames(hand, displacements[ARM_SLICE[hand]])
        grip = (world_from_torso @ frames[-1])[:3, 3]
        result = np.zeros((6, 20))
        feet = self.world_from_feet[:3, :3]
        result[:3, :3] = feet
        pivot = self.world_from_feet[:3, 3] + feet @ (displacements[:3] + self._lumbar)
        yaw, pitch = displacements[3], displacements[4]
        turn = Rotation.from_euler("Z", yaw).as_matrix()
        axes = (np.eye(3)[2], turn[:, 1], turn @ Rotation.from_euler("Y", pitch).as_matrix()[:, 0])
        for column, axis in enumerate(axes, start=3):
            world_axis = feet @ axis
            result[:, column] = np.concatenate([np.cross(world_axis, grip - pivot), world_axis])
        for index, (axis, frame) in enumerate(zip(arm_axes(hand), frames[:-1], strict=True)):
            world_frame = world_from_torso @ frame
            world_axis = world_frame[:3, :3] @ axis
            column = ARM_SLICE[hand].start + index
            result[:, column] = np.concatenate([np.cross(world_axis, grip - world_frame[:3, 3]), world_axis])
        return result

    def _arm_frames(self, hand: str, arm: FloatArray) -> list[FloatArray]:
        """Return torso_from_joint frames (4, 4) after each of the 7 joints and the grip frame."""
        lengths = self.person.lengths
        side = -1.0 if hand == "right" else 1.0
        frame = make_transform(np.eye(3), [0.0, side * lengths.shoulder_half_width, 0.0])
        frames = []
        steps = {3: self._upper_arm, 5: self._forearm}
        for index, axis in enumerate(arm_axes(hand)):
            if index in steps:
                frame = frame @ make_transform(np.eye(3), [0.0, 0.0, -steps[index]])
            frame = frame @ make_transform(Rotation.from_rotvec(axis * arm[index]).as_matrix(), np.zeros(3))
            frames.append(frame)
        grip = make_transform(hand_axes(hand), [0.0, -side * lengths.grip_out, -lengths.grip_along])
        return [*frames, frame @ grip]

    def inverse(self, hand: str, torso_from_hand: FloatArray, swivel: FloatArray) -> FloatArray:
        """Return the arm's displacements with which the grip has a pose, elbow turned to a swivel angle.

        The wrist centre fixes the elbow's circle about the line from shoulder to wrist; the swivel [rad] picks the
        point on it (0: elbow low, positive: outward); the rest are two Euler triples. Branches with the abduction or
        the wrist flexion beyond 90 degrees are left out. Limits are not regarded.

        Args:
            hand: ``right`` or ``left``.
            torso_from_hand: Grip poses, shape (n, 4, 4).
            swivel: Angles [rad], shape (m,) for all, or (n, m).

        Returns:
            Displacements [rad], shape (n, m, 7); NaN where the wrist is out of reach.
        """
        poses = np.asarray(torso_from_hand)
        if hand == "left":
            poses = MIRROR @ poses @ MIRROR
        lengths = self.person.lengths
        a, b = self._upper_arm, self._forearm
        rotation = poses[:, :3, :3]
        wrist = poses[:, :3, 3] - lengths.grip_along * rotation[:, :, 0] - lengths.grip_out * rotation[:, :, 2]
        reach = wrist - [0.0, -lengths.shoulder_half_width, 0.0]
        distance = np.sqrt(np.einsum("ni,ni->n", reach, reach)) + 1e-12
        cosine = (distance**2 - a * a - b * b) / (2.0 * a * b)
        cosine = np.where(np.abs(cosine) <= 1.0, cosine, np.nan)
        elbow = np.maximum(np.arccos(cosine), 1e-6)
        sin_elbow, cos_elbow = np.sin(elbow), np.cos(elbow)

        line = reach / distance[:, None]
        low = line * line[:, 2:3]
        low[:, 2] -= 1.0
        low /= np.sqrt(np.einsum("ni,ni->n", low, low))[:, None] + 1e-12
        out = np.cross(low, line)
        angle = np.broadcast_to(swivel, (len(poses), np.shape(swivel)[-1]))
        radial = np.cos(angle)[..., None] * low[:, None] + np.sin(angle)[..., None] * out[:, None]
        along = (a * a + distance**2 - b * b) / (2.0 * distance)
        radius = np.sqrt(np.maximum(a * a - along**2, 0.0))
        upper = ((along / a)[:, None] * line)[:, None] + (radius / a)[:, None, None] * radial
        fore = (reach[:, None] - a * upper) / b
        forward = (fore - cos_elbow[:, None, None] * upper) / sin_elbow[:, None, None]
        side = np.cross(-upper, forward)

        result = np.empty((*angle.shape, 7))
        result[..., 0] = np.arctan2(upper[..., 0], -upper[..., 2])
        result[..., 1] = np.arcsin(np.clip(-upper[..., 1], -1.0, 1.0))
        result[..., 2] = np.arctan2(forward[..., 1], side[..., 1])
        result[..., 3] = elbow[:, None]
        # Wrist: forearm axes (x, y, -fore) against the hand's, brought to the zero posture: Rz(p) Rx(w) Ry(-d).
        segment = rotation @ HAND_AXES.T
        thumb = -sin_elbow[:, None, None] * upper + cos_elbow[:, None, None] * forward

        def dot(first: FloatArray, column: int) -> FloatArray:
            return np.einsum("nmi,ni->nm", first, segment[:, :, column])

        result[..., 4] = np.arctan2(-dot(thumb, 1), dot(side, 1))
        result[..., 5] = np.arcsin(np.clip(-dot(fore, 1), -1.0, 1.0))
        result[..., 6] = np.arctan2(-dot(fore, 0), -dot(fore, 2))
        return result

    def swivel(self, hand: str, arm: FloatArray) -> float:
        """Return the swivel angle [rad] of an arm posture (7,), as ``inverse`` counts it."""
        frames = self._arm_frames(hand, arm)
        mirror = MIRROR[:3, :3] if hand == "left" else np.eye(3)
        shoulder, elbow, wrist = (mirror @ frames[index][:3, 3] for index in (0, 3, 5))
        line = (wrist - shoulder) / np.linalg.norm(wrist - shoulder)
        low = line * line[2] - [0.0, 0.0, 1.0]
        low /= np.linalg.norm(low) + 1e-12
        return float(np.arctan2((elbow - shoulder) @ np.cross(low, line), (elbow - shoulder) @ low))
