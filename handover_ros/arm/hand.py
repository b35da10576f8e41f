"""Where a hand takes things: the grip frame of a calibrated skeleton, x along the fingers, z out of the palm.

The axes of the wrist say where the palm looks, since deviation turns the hand in the palm's plane: the palm's normal is
minus the axis of radial deviation on the right and plus that axis on the left. The axis of pronation runs along the
forearm to the fingers. Zero posture: arms hanging, palms to the body, so the normals point medially.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from handover_ros.errors import BadModelError
from handover_ros.geometry import FloatArray, make_transform
from handover_ros.skeleton.jacobian import Frame
from handover_ros.skeleton.landmarks import axes_meet
from handover_ros.skeleton.tree import Joint, JointKind, Skeleton

# From the wrist to the middle of a grip, over the forearm's length: along the fingers and out of the palm, as
# config/people/adult.yaml has them.
GRIP_ALONG, GRIP_OUT = 0.088 / 0.255, 0.04 / 0.255
PALM_NORMAL_SIGN = {"right": -1.0, "left": 1.0}
WRIST_JOINTS = ("elbow_flexion", "forearm_pronation", "wrist_flexion", "wrist_deviation")
NEARLY_PARALLEL = 0.2  # sine of the angle between forearm and palm normal below which the hand has no direction


@dataclass(frozen=True, eq=False)
class HandFrame:
    """The grip of one hand.

    Attributes:
        side: ``left`` or ``right``.
        segment: The segment that carries it.
        zero_from_hand: Grip frame in the zero frame: x along the fingers, z out of the palm, shape (4, 4).
        elbow: Centre of the elbow in the zero frame [m], shape (3,).
        wrist: Centre of the wrist in the zero frame [m], shape (3,).
    """

    side: str
    segment: str
    zero_from_hand: FloatArray
    elbow: FloatArray
    wrist: FloatArray

    @property
    def frame(self) -> Frame:
        """The grip as a frame of the skeleton, for poses and Jacobians."""
        return Frame(self.segment, self.zero_from_hand)


def hand_frames(skeleton: Skeleton) -> Mapping[str, HandFrame]:
    """Return the grip frame of each hand of a skeleton, by side.

    Raises:
        BadModelError: The skeleton has no hands, or an arm lacks a joint the grip is derived from.
    """
    if not skeleton.hands:
        raise BadModelError(
            f"skeleton {skeleton.name!r} has no hands that take objects; use a template that names them under `hands`, "
            "such as upper_body"
        )
    return {side: _hand_frame(skeleton, side, segment) for side, segment in skeleton.hands}


def _hand_frame(skeleton: Skeleton, side: str, segment: str) -> HandFrame:
    """Return the grip frame of one hand."""
    elbow, forearm, flexion, deviation = (
        _joint(skeleton, side, segment, f"{side}_{displacement}") for displacement in WRIST_JOINTS
    )
    elbow_centre, _ = axes_meet(elbow, forearm)
    wrist_centre, _ = axes_meet(flexion, deviation)
    bone = wrist_centre - elbow_centre
    length = float(np.linalg.norm(bone))
    out = PALM_NORMAL_SIGN[side] * deviation.axes[0]
    distal = forearm.axes[0] * np.sign(forearm.axes[0] @ bone)
    along = distal - (distal @ out) * out
    sine = float(np.linalg.norm(along))
    if sine < NEARLY_PARALLEL:
        raise BadModelError(
            f"skeleton {skeleton.name!r}: {side}_wrist_deviation and {side}_forearm_pronation turn about nearly the "
            f"same axis ({np.rad2deg(np.arcsin(sine)):.0f} degrees apart, at least "
            f"{np.rad2deg(np.arcsin(NEARLY_PARALLEL)):.0f} needed); calibrate again, moving the wrist more"
        )
    along /= sine
    grip = wrist_centre + length * (GRIP_ALONG * along + GRIP_OUT * out)
    zero_from_hand = make_transform(np.column_stack([along, np.cross(out, along), out]), grip)
    return HandFrame(side, segment, zero_from_hand, elbow_centre, wrist_centre)


def _joint(skeleton: Skeleton, side: str, segment: str, displacement: str) -> Joint:
    """Return the revolute joint of a displacement on the way to a hand."""
    for index in skeleton.chain(segment):
        joint = skeleton.joints[index]
        if joint.kind is JointKind.REVOLUTE and joint.displacement_names == (displacement,):
            return joint
    raise BadModelError(
        f"skeleton {skeleton.name!r}: no joint {displacement!r} of one axis between the root and {segment!r}; the grip "
        f"frame of the {side} hand needs {', '.join(f'{side}_{name}' for name in WRIST_JOINTS)}"
    )
