"""The true skeleton of a simulated person: what a calibration should find."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.sim.person_kinematics import arm_axes
from handover_ros.sim.person_spec import ARM_JOINTS, HANDS, JOINTS, PersonSpec
from handover_ros.skeleton.templates import blank_skeleton, load_template
from handover_ros.skeleton.tree import Skeleton

TEMPLATE = "upper_body"


def skeleton_of(person: PersonSpec) -> Skeleton:
    """Return a person's skeleton: template ``upper_body``, root the torso frame, the person's limits and markers.

    Displacements have the names of the person's arm joints; the trunk's six are the pose of the free root, which
    ``PersonKinematics.torso_pose`` gives.
    """
    segments = tuple(marker.segment for marker in person.markers.values())
    blank = blank_skeleton(load_template(TEMPLATE), tuple(person.markers), segments)
    points = _joint_points(person)
    directions = {
        f"{hand}_{name}": axis for hand in HANDS for name, axis in zip(ARM_JOINTS, arm_axes(hand), strict=True)
    }
    joints = tuple(
        replace(
            joint,
            axes=np.array([directions[name] for name in joint.displacement_names]).reshape(-1, 3),
            point=points.get(joint.segment, np.zeros(3)),
        )
        for joint in blank.joints
    )
    positions = [points.get(marker.segment, np.zeros(3)) + marker.position for marker in person.markers.values()]
    columns = [JOINTS.index(name) for name in blank.displacement_names]
    return replace(
        blank,
        joints=joints,
        markers=np.array(positions),
        lower=person.lower[columns],
        upper=person.upper[columns],
    )


def _joint_points(person: PersonSpec) -> dict[str, FloatArray]:
    """Return where the joint that carries each segment of the arms lies in the torso frame (3,) [m]."""
    lengths = person.lengths
    points = {}
    for hand, side in zip(HANDS, (-1.0, 1.0)):
        shoulder = np.array([0.0, side * lengths.shoulder_half_width, 0.0])
        elbow = shoulder - [0.0, 0.0, lengths.upper_arm]
        wrist = elbow - [0.0, 0.0, lengths.forearm]
        points[f"{hand}_upper_arm"] = shoulder
        points |= {f"{hand}_{segment}": elbow for segment in ("elbow", "forearm")}
        points |= {f"{hand}_{segment}": wrist for segment in ("wrist", "hand")}
    return points
