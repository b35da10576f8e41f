"""How heavy a person's segments are, from the body mass and the skeleton's own lengths.

Masses, centres and transverse radii of gyration: D. A. Winter, "Biomechanics and Motor Control of Human Movement", 4th
ed., 2009, table 4.1. It has no radii about a segment's long axis; their ratio to the transverse ones is that of P. de
Leva, J. Biomechanics 29 (1996), table 4 (men), and so is the length from the wrist to the knuckles, where no joint is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handover_ros.errors import BadModelError, BadRequestError
from handover_ros.geometry import FloatArray
from handover_ros.skeleton.landmarks import joint_centres, marker_centroid
from handover_ros.skeleton.tree import Skeleton
from handover_ros.skeleton.urdf import SegmentInertia

LIGHTEST, HEAVIEST = 10.0, 400.0  # [kg] body mass taken as plausible


@dataclass(frozen=True)
class SegmentFractions:
    """A row of the table.

    Attributes:
        mass: Segment mass over body mass.
        centre: Distance of the centre of mass from the proximal end over the length.
        gyration: Radius of gyration about a transverse axis through the centre of mass over the length.
        slenderness: Radius of gyration about the long axis over that about a transverse axis (de Leva 1996).
    """

    mass: float
    centre: float
    gyration: float
    slenderness: float


UPPER_ARM = SegmentFractions(0.028, 0.436, 0.322, 0.158 / 0.285)
FOREARM = SegmentFractions(0.016, 0.430, 0.303, 0.121 / 0.276)
HAND = SegmentFractions(0.006, 0.506, 0.297, 0.401 / 0.628)  # wrist to the knuckle of the middle finger
FOREARM_AND_HAND = SegmentFractions(0.022, 0.682, 0.468, 0.121 / 0.276)  # elbow to wrist
# Trunk, head and neck, greater trochanter to shoulder; here counted from the shoulder down.
TRUNK_AND_HEAD = SegmentFractions(0.578, 1.0 - 0.660, 0.503, 0.191 / 0.372)
HAND_OVER_FOREARM = 86.2 / 268.9  # wrist to knuckle over elbow to wrist, de Leva 1996, table 4
FOREARM_OVER_UPPER_ARM = 0.146 / 0.186  # Drillis and Contini 1966, in Winter 2009, figure 4.1
TRUNK_OVER_UPPER_ARM = (0.818 - 0.530) / 0.186  # shoulder to hip, same figure


def rod_inertia(fractions: SegmentFractions, body_mass: float, start: FloatArray, end: FloatArray) -> SegmentInertia:
    """Return the inertia of a segment that reaches from ``start`` to ``end`` (3,) [m] in the zero frame."""
    bone = end - start
    length = float(np.linalg.norm(bone))
    if length <= 0.0:
        raise BadModelError("a body segment has no length: two of the skeleton's joint centres coincide")
    along = np.outer(bone, bone) / length**2
    mass = fractions.mass * body_mass
    transverse = mass * (fractions.gyration * length) ** 2
    tensor = transverse * (np.eye(3) - along) + transverse * fractions.slenderness**2 * along
    return SegmentInertia(mass, start + fractions.centre * bone, tensor)


def segment_inertias(skeleton: Skeleton, body_mass: float) -> dict[str, SegmentInertia]:
    """Return the inertia of torso, upper arms, forearms and hands of a skeleton, by segment.

    Lengths are those between the skeleton's joint centres. A skeleton whose arm ends at the forearm carries the hand's
    mass there. Segments between two joints of one elbow or wrist have none.

    Args:
        skeleton: With segments named ``<side>_upper_arm`` and ``<side>_forearm``, perhaps ``<side>_hand``, ``torso``.
        body_mass: Of the whole person [kg].

    Raises:
        BadRequestError: The mass is not that of a person.
        BadModelError: The skeleton has no arm.
    """
    if not LIGHTEST <= body_mass <= HEAVIEST:
        raise BadRequestError(f"body mass {body_mass:g} kg: must lie between {LIGHTEST:g} and {HEAVIEST:g} kg")
    centres = joint_centres(skeleton)
    segments = [joint.segment for joint in skeleton.joints]
    result: dict[str, SegmentInertia] = {}
    shoulders, lengths = [], []
    for side in ("right", "left"):
        upper_arm, forearm, hand = (f"{side}_{name}" for name in ("upper_arm", "forearm", "hand"))
        if upper_arm not in segments or forearm not in segments:
            continue
        shoulder = centres[segments.index(upper_arm)]
        elbow = centres[_first_below(skeleton, upper_arm, forearm)]
        result[upper_arm] = rod_inertia(UPPER_ARM, body_mass, shoulder, elbow)
        length = float(np.linalg.norm(elbow - shoulder))
        if hand in segments:
            wrist = centres[_first_below(skeleton, forearm, hand)]
            result[forearm] = rod_inertia(FOREARM, body_mass, elbow, wrist)
            knuckles = wrist + HAND_OVER_FOREARM * (wrist - elbow)
            result[hand] = rod_inertia(HAND, body_mass, wrist, knuckles)
        else:
            seen = marker_centroid(skeleton, forearm)
            line = (elbow - shoulder) if seen is None else seen - elbow
            wrist = elbow + FOREARM_OVER_UPPER_ARM * length * line / np.linalg.norm(line)
            result[forearm] = rod_inertia(FOREARM_AND_HAND, body_mass, elbow, wrist)
        shoulders.append(shoulder)
        lengths.append(length)
    if not result:
        raise BadModelError(
            f"skeleton {skeleton.name!r} has no arm: needs segments <side>_upper_arm and <side>_forearm, "
            f"has {', '.join(segments)}"
        )
    if "torso" in segments:
        top = np.mean(shoulders, axis=0)
        middle = marker_centroid(skeleton, "torso")
        if len(shoulders) == 1 and middle is not None:
            top[:2] = middle[:2]
        hips = top - [0.0, 0.0, TRUNK_OVER_UPPER_ARM * float(np.mean(lengths))]
        result["torso"] = rod_inertia(TRUNK_AND_HEAD, body_mass, top, hips)
    return result


def _first_below(skeleton: Skeleton, segment: str, end: str) -> int:
    """Return the first joint after ``segment`` on the way to ``end``."""
    chain = skeleton.chain(end)
    carrier = skeleton.joint_carrying(segment)
    if carrier not in chain or chain[-1] == carrier:
        raise BadModelError(f"skeleton {skeleton.name!r}: segment {end!r} does not hang on {segment!r}")
    return chain[chain.index(carrier) + 1]
