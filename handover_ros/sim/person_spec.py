"""The description of a simulated person, read from ``config/people/*.yaml``."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from handover_ros.arm.model import JOINT_NAMES
from handover_ros.errors import BadModelError
from handover_ros.geometry import FloatArray
from handover_ros.resources import config_file
from handover_ros.yaml_file import Schema, Vector3, read_yaml

HANDS = ("right", "left")
TORSO_JOINTS = ("torso_x", "torso_y", "torso_z", "torso_yaw", "torso_pitch", "torso_roll")
ARM_JOINTS = JOINT_NAMES
ARM_SLICE = {"right": slice(6, 13), "left": slice(13, 20)}
JOINTS = TORSO_JOINTS + tuple(f"{hand}_{joint}" for hand in HANDS for joint in ARM_JOINTS)
MARKER_SET = "upper_body_24"
MARKERS = (
    *(f"{group}{i}" for group in ("CHEST", "BACK") for i in range(1, 5)),
    *(f"{group}{i}" for group in ("RARM", "LARM") for i in range(1, 9)),
)

Hand = Literal["right", "left"]
SegmentName = Literal[
    "torso", "right_upper_arm", "left_upper_arm", "right_forearm", "left_forearm", "right_hand", "left_hand"
]
Length = Annotated[float, Field(gt=0.01, lt=1.5)]
Seconds = Annotated[float, Field(ge=0.0, le=20.0)]
Weight = Annotated[float, Field(ge=0.0, le=1000.0)]
Angle = Annotated[float, Field(ge=-np.pi, le=np.pi)]


def _ordered(pair: tuple[float, float]) -> tuple[float, float]:
    """Refuse a range whose lower end is not below its upper end."""
    if pair[0] >= pair[1]:
        raise ValueError(f"the lower limit {pair[0]:g} must be below the upper limit {pair[1]:g}")
    return pair


AngleRange = Annotated[tuple[Angle, Angle], AfterValidator(_ordered)]
LengthRange = Annotated[
    tuple[Annotated[float, Field(ge=-5.0, le=5.0)], Annotated[float, Field(ge=-5.0, le=5.0)]], AfterValidator(_ordered)
]


class Lengths(Schema):
    """Segment lengths [m]; joint centres to joint centres.

    ``lumbar_height``: floor to the lumbar joint; ``trunk``: lumbar joint to the middle between the shoulders;
    ``hand``: wrist to finger tips; ``grip_along`` and ``grip_out``: wrist to the centre of the grip along the fingers
    and out of the palm.
    """

    lumbar_height: Length
    trunk: Length
    shoulder_half_width: Length
    neck: Length
    head: Length
    hip_half_width: Length
    upper_arm: Length
    forearm: Length
    hand: Length
    grip_along: Length
    grip_out: Length


class TorsoLimits(Schema):
    """How far the trunk moves from standing upright at its place, as far as the person wants to: [m] and [rad]."""

    torso_x: LengthRange
    torso_y: LengthRange
    torso_z: LengthRange
    torso_yaw: AngleRange
    torso_pitch: AngleRange
    torso_roll: AngleRange


class ArmLimits(Schema):
    """Range of motion of one arm [rad]; zero: the arm hangs, the palm faces the body."""

    shoulder_flexion: AngleRange
    shoulder_abduction: AngleRange
    shoulder_rotation: AngleRange
    elbow_flexion: AngleRange
    forearm_pronation: AngleRange
    wrist_flexion: AngleRange
    wrist_deviation: AngleRange


class ArmAngles(Schema):
    """One arm posture [rad]."""

    shoulder_flexion: Angle
    shoulder_abduction: Angle
    shoulder_rotation: Angle
    elbow_flexion: Angle
    forearm_pronation: Angle
    wrist_flexion: Angle
    wrist_deviation: Angle


class ArmWeights(Schema):
    """Weight of each squared displacement from the neutral posture [1/rad2]."""

    shoulder_flexion: Weight
    shoulder_abduction: Weight
    shoulder_rotation: Weight
    elbow_flexion: Weight
    forearm_pronation: Weight
    wrist_flexion: Weight
    wrist_deviation: Weight


class TorsoWeights(Schema):
    """Weight of each squared displacement of the trunk from standing upright [1/m2] or [1/rad2]."""

    torso_x: Weight
    torso_y: Weight
    torso_z: Weight
    torso_yaw: Weight
    torso_pitch: Weight
    torso_roll: Weight


class BothLimits(Schema):
    """Limits of all joints."""

    torso: TorsoLimits
    right: ArmLimits
    left: ArmLimits


class Timing(Schema):
    """Speed of the person: [s], [m/s] and [N].

    ``patience``: how long it pulls at an object that the robot does not release before it rests and tries again.
    """

    reaction: Seconds
    reach: Annotated[float, Field(ge=0.3, le=10.0)]
    close: Seconds
    patience: Annotated[float, Field(ge=0.2, le=60.0)]
    carry_speed: Annotated[float, Field(ge=0.05, le=2.0)]
    pull_force: Annotated[float, Field(ge=0.0, le=30.0)]


class Sway(Schema):
    """Amplitude of standing sway: [m] and [rad], and its shortest period [s]."""

    position: Annotated[float, Field(ge=0.0, le=0.05)]
    angle: Annotated[float, Field(ge=0.0, le=0.1)]
    period: Annotated[float, Field(ge=0.5, le=20.0)]


class Comfort(Schema):
    """What the person finds comfortable; only the simulated person knows it.

    ``other_hand``: cost of using the hand that is not dominant; ``myopia``: weight of the cost at the handover against
    the cost at the goal (1: the goal is ignored); ``rationality``: Boltzmann coefficient of the choice among grasps
    (Bestick 2017, eq. 3.3), absent: always the best.
    """

    neutral: ArmAngles
    weights: ArmWeights
    torso_weights: TorsoWeights
    other_hand: Weight
    myopia: Annotated[float, Field(gt=0.0, le=1.0)]
    rationality: Annotated[float, Field(gt=0.0)] | None = None


class Marker(Schema):
    """A marker on a body segment, position [m] in the segment frame.

    Segment frames have their origin at the segment's proximal joint (torso: between the shoulders) and, in the zero
    posture, the axes of the torso frame.
    """

    segment: SegmentName
    position: Vector3


class PersonSpec(Schema):
    """One simulated person.

    Attributes follow the YAML file: lengths [m], limits [rad] and [m], mass [kg], stature [m], timing, sway, comfort
    and markers. Arrays derived from them are read-only; joints are ordered as ``JOINTS``.
    """

    description: str
    stature: Annotated[float, Field(gt=0.8, lt=2.6)]
    mass: Annotated[float, Field(gt=15.0, lt=250.0)]
    dominant: Hand
    lengths: Lengths
    limits: BothLimits
    timing: Timing
    sway: Sway
    comfort: Comfort
    markers: dict[str, Marker]

    @model_validator(mode="after")
    def _is_whole(self) -> PersonSpec:
        """Check what concerns several fields."""
        if missing := [name for name in MARKERS if name not in self.markers]:
            raise ValueError(f"markers: {MARKER_SET} needs {', '.join(missing)}")
        if unknown := [name for name in self.markers if name not in MARKERS]:
            raise ValueError(f"markers: {', '.join(unknown)} not in {MARKER_SET}")
        if self.lengths.lumbar_height + self.lengths.trunk + self.lengths.neck >= self.stature:
            raise ValueError("stature: must exceed lengths.lumbar_height + lengths.trunk + lengths.neck")
        for name in HANDS:
            if getattr(self.limits, name).elbow_flexion[0] < 0.0:
                raise ValueError(f"limits.{name}.elbow_flexion: the lower limit must be >= 0 (the elbow bends one way)")
        return self

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> PersonSpec:
        """Return a changed person, checked anew; arrays that were derived of this one are not taken over.

        Raises:
            ValidationError: The changes do not fit.
        """
        kept = {name: getattr(self, name) for name in type(self).model_fields}
        return type(self).model_validate({**kept, **(update or {})})

    @cached_property
    def lower(self) -> FloatArray:
        """Lower limits [m], [rad], shape (20,)."""
        return self._limit(0)

    @cached_property
    def upper(self) -> FloatArray:
        """Upper limits [m], [rad], shape (20,)."""
        return self._limit(1)

    def _limit(self, end: int) -> FloatArray:
        """Return one end of all limits, shape (20,)."""
        tables = (self.limits.torso, self.limits.right, self.limits.left)
        return _constant([pair[end] for table in tables for pair in table.__dict__.values()])

    @cached_property
    def neutral(self) -> FloatArray:
        """Most comfortable posture [m], [rad], within the limits, shape (20,)."""
        arm = list(self.comfort.neutral.__dict__.values())
        return _constant(np.clip(np.concatenate([np.zeros(6), arm, arm]), self.lower, self.upper))

    @cached_property
    def weights(self) -> FloatArray:
        """Weights of the squared displacements from ``neutral``, shape (20,)."""
        arm = list(self.comfort.weights.__dict__.values())
        return _constant([*self.comfort.torso_weights.__dict__.values(), *arm, *arm])

    @cached_property
    def standing(self) -> FloatArray:
        """Posture of standing with hanging arms [m], [rad], within the limits, shape (20,)."""
        arm = [0.03, 0.12, 0.0, 0.22, 0.1, 0.0, 0.0]
        return _constant(np.clip(np.array([0.0] * 6 + arm + arm), self.lower, self.upper))


def _constant(values: object) -> FloatArray:
    """Return a read-only array."""
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array


def load_person(name: str) -> PersonSpec:
    """Return the person of ``config/people/<name>.yaml``, or of a path to such a file.

    Raises:
        UnknownNameError: There is no such person.
        BadModelError: The file is wrong; the message names file and field.
    """
    path = config_file("people", name)
    person = read_yaml(path, PersonSpec)
    outside = (person.standing < person.lower) | (person.standing > person.upper)
    if np.any(outside):
        raise BadModelError(f"{path}: limits: no posture fits {JOINTS[int(np.argmax(outside))]}")
    return person
