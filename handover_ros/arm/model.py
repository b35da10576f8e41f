"""A person's arm as seven joints: lengths, shoulder and limits, from a calibrated skeleton or of a generic adult.

The shoulder is a ball joint, the elbow a hinge, forearm and wrist turn about three axes that meet in the wrist. Zero
posture: the arm hangs, the palm faces the body. In the torso frame (x forward, y left, z up; origin between the
shoulders) a right arm's axes are then: flexion -y, abduction -x, internal rotation +z, elbow flexion -y, pronation +z,
wrist flexion +x, radial deviation -y. A left arm is the mirror image in the plane y = 0, with the same displacements.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import AfterValidator, Field
from scipy.spatial.transform import Rotation

from handover_ros.arm import limb_kernels
from handover_ros.arm.hand import hand_frames
from handover_ros.errors import BadModelError, BadRequestError
from handover_ros.geometry import FloatArray, invert_transform, make_transform
from handover_ros.resources import config_file
from handover_ros.skeleton.kernels import segment_poses
from handover_ros.skeleton.tree import Skeleton
from handover_ros.yaml_file import Schema, read_yaml

kernels: Any = limb_kernels  # numba's functions carry no types
Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("right", "left")
JOINT_NAMES = (
    "shoulder_flexion",
    "shoulder_abduction",
    "shoulder_rotation",
    "elbow_flexion",
    "forearm_pronation",
    "wrist_flexion",
    "wrist_deviation",
)
AXES = np.array(
    [[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]
    + [[0.0, -1.0, 0.0]]
)
# Axes of the right hand (x along the fingers, z out of the palm) in the zero posture, columns in the torso frame.
HAND_AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])
HALF_TURN = np.pi


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm of seven joints, ordered as ``JOINT_NAMES``.

    Attributes:
        side: ``left`` or ``right``.
        upper_arm: Shoulder to elbow [m].
        forearm: Elbow to wrist [m].
        shoulder: Its centre in the torso frame [m], shape (3,).
        grip_along: Wrist to the middle of the grip, along the fingers [m].
        grip_out: The same out of the palm [m].
        limits: Lower and upper limits [rad], shape (2, 7).
    """

    side: Side
    upper_arm: float
    forearm: float
    shoulder: FloatArray
    grip_along: float
    grip_out: float
    limits: FloatArray
    right_shoulder: FloatArray = field(init=False, repr=False)
    lengths: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the numbers and make the arrays read-only.

        Raises:
            BadModelError: A length is not positive, a number not finite, limits cross or lie beyond half a turn.
        """
        shoulder, limits = np.array(self.shoulder, dtype=float), np.array(self.limits, dtype=float)
        lengths = np.array([self.upper_arm, self.forearm], dtype=float)
        grip = (self.grip_along, self.grip_out)
        if self.side not in SIDES:
            raise BadModelError(f"arm: side must be left or right, got {self.side!r}")
        if shoulder.shape != (3,) or not np.isfinite([*shoulder, *lengths, *grip]).all() or (lengths <= 0.0).any():
            raise BadModelError(
                f"{self.side} arm: shoulder and lengths must be finite and the lengths positive, got shoulder "
                f"{shoulder.tolist()}, upper_arm {self.upper_arm}, forearm {self.forearm}, grip {grip}"
            )
        if limits.shape != (2, 7) or not np.isfinite(limits).all():
            raise BadModelError(f"{self.side} arm: limits must be finite numbers of shape (2, 7), got {limits.shape}")
        for name, low, high in zip(JOINT_NAMES, *limits):
            if low > high or low < -HALF_TURN or high > HALF_TURN:
                raise BadModelError(
                    f"{self.side} arm: limits of {name} are {low:g} to {high:g} rad; they must not cross and must lie "
                    "within half a turn, -3.1416 to 3.1416"
                )
        mirrored = shoulder if self.side == "right" else shoulder * [1.0, -1.0, 1.0]
        for name, array in (
            ("shoulder", shoulder),
            ("limits", limits),
            ("lengths", lengths),
            ("right_shoulder", np.ascontiguousarray(mirrored)),
        ):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def segment_from_hand(self) -> FloatArray:
        """The grip (x along the fingers, z out of the palm) in the right hand's segment. Shape (4, 4)."""
        return make_transform(HAND_AXES, [0.0, self.grip_out, -self.grip_along])

    def hand_pose(self, displacements: npt.ArrayLike) -> FloatArray:
        """Return torso_from_hand (..., 4, 4), the pose of the grip, of displacements (..., 7) [rad]."""
        return self.mirrored(self._right_frames(displacements)[-1] @ self.segment_from_hand)

    def limbs(self, displacements: npt.ArrayLike) -> FloatArray:
        """Return shoulder, elbow, wrist and grip (..., 4, 3) [m] in the torso frame of displacements (..., 7)."""
        q = np.asarray(displacements, dtype=float)
        if q.shape[-1:] != (7,):
            raise BadRequestError(f"an arm has 7 displacements, got an array of shape {q.shape}")
        points = np.empty((q.size // 7, 4, 3))
        grip = np.array([self.grip_along, self.grip_out])
        kernels.limbs(np.ascontiguousarray(q.reshape(-1, 7)), self.right_shoulder, self.lengths, grip, points)
        if self.side == "left":
            points[..., 1] *= -1.0
        return points.reshape(*q.shape[:-1], 4, 3)

    def segment_poses(self, torso_from_hand: npt.ArrayLike) -> FloatArray:
        """Return the poses (n, 4, 4) of the hand segment, mirrored to the right, with the grip at poses (n, 4, 4)."""
        grips = self.mirrored(np.asarray(torso_from_hand, dtype=float).reshape(-1, 4, 4))
        return np.ascontiguousarray(grips @ invert_transform(self.segment_from_hand))

    def within_limits(self, displacements: npt.ArrayLike, tolerance: float = 1e-9) -> npt.NDArray[np.bool_]:
        """Return whether displacements (..., 7) [rad] are within the limits (...)."""
        q = np.asarray(displacements)
        return np.asarray(((q >= self.limits[0] - tolerance) & (q <= self.limits[1] + tolerance)).all(axis=-1))

    def mirrored(self, poses: FloatArray) -> FloatArray:
        """Return poses (..., 4, 4) of a right arm for this one, or the other way round: unchanged for a right arm."""
        return poses if self.side == "right" else MIRROR @ poses @ MIRROR

    def _right_frames(self, displacements: npt.ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the frames (..., 4, 4) of upper arm, forearm and hand, origins at their proximal joints."""
        q = np.asarray(displacements, dtype=float)
        if q.shape[-1:] != (7,):
            raise BadRequestError(f"an arm has 7 displacements, got an array of shape {q.shape}")
        turns = [
            Rotation.from_rotvec(q[..., index].reshape(-1, 1) * axis).as_matrix().reshape(*q.shape[:-1], 3, 3)
            for index, axis in enumerate(AXES)
        ]
        upper = turns[0] @ turns[1] @ turns[2]
        fore = upper @ turns[3]
        elbow = self.right_shoulder - self.upper_arm * upper[..., 2]
        wrist = elbow - self.forearm * fore[..., 2]
        hand = fore @ turns[4] @ turns[5] @ turns[6]
        shoulder = np.broadcast_to(self.right_shoulder, elbow.shape)
        return _frames(upper, shoulder), _frames(fore, elbow), _frames(hand, wrist)


def _frames(rotations: FloatArray, origins: FloatArray) -> FloatArray:
    """Return transforms (..., 4, 4)."""
    frames = np.zeros((*rotations.shape[:-2], 4, 4))
    frames[..., :3, :3], frames[..., :3, 3], frames[..., 3, 3] = rotations, origins, 1.0
    return frames


def _range(pair: tuple[float, float]) -> tuple[float, float]:
    """Refuse limits that cross."""
    if pair[0] > pair[1]:
        raise ValueError(f"the lower limit {pair[0]:g} must not be above the upper limit {pair[1]:g}")
    return pair


Length = Annotated[float, Field(gt=0.0, lt=1.5)]
Angle = Annotated[float, Field(ge=-HALF_TURN, le=HALF_TURN)]
Range = Annotated[tuple[Angle, Angle], AfterValidator(_range)]


class _LimitsFile(Schema):
    """Range of motion [rad]."""

    shoulder_flexion: Range
    shoulder_abduction: Range
    shoulder_rotation: Range
    elbow_flexion: Range
    forearm_pronation: Range
    wrist_flexion: Range
    wrist_deviation: Range


class _ArmFile(Schema):
    """Content of a file of ``config/arms``, lengths [m]."""

    description: str
    shoulder_half_width: Length
    upper_arm: Length
    forearm: Length
    grip_along: Annotated[float, Field(ge=0.0, lt=0.3)]
    grip_out: Annotated[float, Field(ge=0.0, lt=0.2)]
    limits: _LimitsFile


@lru_cache(maxsize=16)
def load_arm(name: str = "adult", side: Side = "right") -> Arm:
    """Return the arm of ``config/arms/<name>.yaml``.

    Raises:
        UnknownNameError: There is no such arm.
        BadModelError: The file is wrong; the message names file and field.
    """
    content = read_yaml(config_file("arms", name), _ArmFile)
    outward = -1.0 if side == "right" else 1.0
    limits = np.array([getattr(content.limits, joint) for joint in JOINT_NAMES]).T
    shoulder = np.array([0.0, outward * content.shoulder_half_width, 0.0])
    return Arm(side, content.upper_arm, content.forearm, shoulder, content.grip_along, content.grip_out, limits)


def arm_of(skeleton: Skeleton, side: Side) -> Arm:
    """Return the arm of a calibrated person.

    Lengths are those between the fitted joint centres. The fitted axes are not at right angles to the bones; what their
    displacements mean for this arm is read where the person stands still (all zero): the arm's displacements there are
    added to the fitted limits.

    Raises:
        BadModelError: The skeleton lacks this hand or a joint of its arm, or its limits are not known.
    """
    frames = hand_frames(skeleton)
    if side not in frames:
        raise BadModelError(f"skeleton {skeleton.name!r} has no {side} hand; it has {', '.join(frames)}")
    columns = _columns(skeleton, side)
    limits = np.array([skeleton.lower[columns], skeleton.upper[columns]])
    if not np.isfinite(limits).all():
        unknown = [JOINT_NAMES[i] for i in np.flatnonzero(~np.isfinite(limits).all(axis=0))]
        raise BadModelError(
            f"skeleton {skeleton.name!r}: the limits of {side} {', '.join(unknown)} are unknown; calibrate with "
            "motions that move these joints"
        )
    hand = frames[side]
    shoulder = next(joint for joint in skeleton.joints if f"{side}_{JOINT_NAMES[0]}" in joint.displacement_names).point
    along, out = hand.zero_from_hand[:3, 0], hand.zero_from_hand[:3, 2]
    grip = hand.zero_from_hand[:3, 3] - hand.wrist
    upper, fore = float(np.linalg.norm(hand.elbow - shoulder)), float(np.linalg.norm(hand.wrist - hand.elbow))
    bare = Arm(side, upper, fore, shoulder, float(grip @ along), float(grip @ out), np.zeros((2, 7)))
    standing = arm_displacements(bare, shoulder, hand.elbow, hand.zero_from_hand)
    return Arm(
        side, upper, fore, shoulder, bare.grip_along, bare.grip_out, np.clip(limits + standing, -HALF_TURN, HALF_TURN)
    )


def arm_posture(arm: Arm, skeleton: Skeleton, displacements: FloatArray) -> FloatArray:
    """Return the arm's displacements (7,) [rad] in a tracked posture: its elbow and hand where the skeleton has them.

    Args:
        arm: Of ``arm_of``.
        skeleton: The person.
        displacements: Of the skeleton (n,) [rad].
    """
    hand = hand_frames(skeleton)[arm.side]
    poses = segment_poses(skeleton.tree, np.ascontiguousarray(skeleton.coordinates(displacements)[None]))[0]
    upper = next(joint for joint in skeleton.joints if f"{arm.side}_{JOINT_NAMES[0]}" in joint.displacement_names)
    upper_pose = poses[skeleton.joint_carrying(upper.segment)]
    hand_pose = poses[skeleton.joint_carrying(hand.segment)] @ hand.zero_from_hand
    return arm_displacements(arm, upper.point, upper_pose[:3, :3] @ hand.elbow + upper_pose[:3, 3], hand_pose)


def arm_displacements(arm: Arm, shoulder: FloatArray, elbow: FloatArray, torso_from_hand: FloatArray) -> FloatArray:
    """Return the displacements (7,) [rad] of an arm whose elbow and grip are seen; lengths need not agree.

    The elbow bends forwards, wrist flexion stays below a right angle; so does abduction, unless the limits of the
    shoulder fit the other of its two solutions better.

    Args:
        arm: The arm.
        shoulder: Its centre in the torso frame [m] (3,).
        elbow: Centre in the torso frame [m] (3,).
        torso_from_hand: The grip (4, 4).
    """
    mirror = np.array([1.0, 1.0, 1.0]) if arm.side == "right" else np.array([1.0, -1.0, 1.0])
    hand = arm.segment_poses(torso_from_hand)[0]
    up = mirror * (shoulder - elbow)
    up /= np.linalg.norm(up)
    fore_up = mirror * elbow - hand[:3, 3]
    fore_up /= np.linalg.norm(fore_up)
    front = up @ fore_up * up - fore_up
    if np.linalg.norm(front) < 1e-6:  # a straight arm: the elbow's axis is taken across the hand
        front = -np.cross(up, hand[:3, 1])
    front /= np.linalg.norm(front)
    upper = np.column_stack([front, np.cross(up, front), up])
    bend = float(np.arctan2(np.linalg.norm(np.cross(up, fore_up)), up @ fore_up))
    fore = upper @ Rotation.from_rotvec(bend * AXES[3]).as_matrix()
    wrist = fore.T @ hand[:3, :3]
    flexion, abduction = np.arctan2(-up[0], up[2]), np.arcsin(np.clip(up[1], -1.0, 1.0))
    low = np.array([flexion, abduction, np.arctan2(upper[1, 0], upper[1, 1])])
    high = low + np.where(low > 0.0, -np.pi, np.pi)  # the same turn, abduction beyond a right angle
    high[1] = np.copysign(np.pi, abduction) - abduction
    shoulder = min((low, high), key=lambda each: float(np.abs(each - np.clip(each, *arm.limits[:, :3])).max()))
    return np.array(
        [
            *shoulder,
            bend,
            np.arctan2(-wrist[0, 1], wrist[1, 1]),
            np.arcsin(np.clip(wrist[2, 1], -1.0, 1.0)),
            np.arctan2(wrist[2, 0], wrist[2, 2]),
        ]
    )


def _columns(skeleton: Skeleton, side: str) -> list[int]:
    """Return where a skeleton has the displacements of an arm.

    Raises:
        BadModelError: It lacks one.
    """
    names = [f"{side}_{joint}" for joint in JOINT_NAMES]
    missing = [name for name in names if name not in skeleton.displacement_names]
    if missing:
        raise BadModelError(f"skeleton {skeleton.name!r} has no {', '.join(missing)}; use template upper_body")
    return [skeleton.displacement_names.index(name) for name in names]
