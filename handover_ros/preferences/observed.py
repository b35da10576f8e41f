"""The answer that was seen: hand, grasp region and posture with which a tracked person took an object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handover_ros.arm.hand import hand_frames
from handover_ros.arm.model import JOINT_NAMES, SIDES, Side, arm_of, arm_posture
from handover_ros.errors import BadRequestError
from handover_ros.geometry import FloatArray, invert_transform
from handover_ros.objects.catalogue import ObjectModel
from handover_ros.objects.regions import TaskSpaceRegion
from handover_ros.planning.grasp_set import HALF_TURN
from handover_ros.skeleton.jacobian import WORLD_FRAME, relative_pose
from handover_ros.skeleton.tree import Skeleton

METRES_PER_RADIAN = 0.1  # how far off a hand is counts as much as this much turned
FARTHEST = 0.25  # [m], turn included, from every region: the hand is not at the object


@dataclass(frozen=True, eq=False)
class ObservedChoice:
    """How a person was seen to take an object.

    Attributes:
        hand: ``left`` or ``right``.
        region: Name of the nearest grasp region.
        distance: Of the hand from it [m], its turn included.
        object_from_hand: The grip, shape (4, 4).
        posture: Displacements of the arm (``arm.model.JOINT_NAMES``) [rad], shape (7,).
        covariance: Of the posture [rad2], shape (7, 7).
    """

    hand: Side
    region: str
    distance: float
    object_from_hand: FloatArray
    posture: FloatArray
    covariance: FloatArray


def observed_choice(
    model: ObjectModel,
    torso_from_object: FloatArray,
    skeleton: Skeleton,
    displacements: FloatArray,
    covariance: FloatArray | None = None,
) -> ObservedChoice:
    """Return how a tracked person holds an object: with the hand that is nearest to a grasp region.

    Args:
        model: The object.
        torso_from_object: Where it is, shape (4, 4).
        skeleton: The calibrated person.
        displacements: Tracked, of the skeleton (n,) [rad].
        covariance: Of the displacements (n, n) [rad2]; None: taken as exact.

    Raises:
        BadRequestError: No hand is at a region, or a number is not finite.
        BadModelError: The skeleton has no hands.
    """
    theta = np.asarray(displacements, dtype=float)
    if theta.shape != skeleton.lower.shape or not np.isfinite(theta).all():
        raise BadRequestError(f"displacements: need {len(skeleton.lower)} finite numbers, got {theta.shape}")
    frames = hand_frames(skeleton)
    found = []
    for side in (each for each in SIDES if each in frames):
        torso_from_hand = relative_pose(skeleton, theta, WORLD_FRAME, frames[side].frame)
        object_from_hand = invert_transform(torso_from_object) @ torso_from_hand
        region, distance = nearest_region(model, side, object_from_hand)
        found.append((distance, side, region, object_from_hand))
    distance, side, region, object_from_hand = min(found, key=lambda each: each[0])
    if distance > FARTHEST:
        raise BadRequestError(
            f"no hand is at {model.name}: the nearest, the {side} one, is {distance:.2f} m from region {region}"
        )
    names = [skeleton.displacement_names.index(f"{side}_{joint}") for joint in JOINT_NAMES]
    known = np.zeros((7, 7)) if covariance is None else np.asarray(covariance, dtype=float)[np.ix_(names, names)]
    arm = arm_of(skeleton, side)
    return ObservedChoice(side, region, distance, object_from_hand, arm_posture(arm, skeleton, theta), known)


def rehearse_choice(model: ObjectModel, skeleton: Skeleton) -> ObservedChoice:
    """Return the choice of a person who holds an object in the middle of all joint limits: all is loaded then.

    Raises:
        BadModelError: The skeleton has no hands.
    """
    frames = hand_frames(skeleton)
    side = next(each for each in SIDES if each in frames)
    torso_from_hand = relative_pose(skeleton, skeleton.middle, WORLD_FRAME, frames[side].frame)
    grip = model.human_grasps[0].centre() @ (HALF_TURN if side == "left" else np.eye(4))
    return observed_choice(model, torso_from_hand @ invert_transform(grip), skeleton, skeleton.middle)


def nearest_region(model: ObjectModel, side: Side, object_from_hand: FloatArray) -> tuple[str, float]:
    """Return the grasp region nearest to a hand, and its distance [m], turn included."""
    hand = object_from_hand @ HALF_TURN if side == "left" else object_from_hand

    def apart(region: TaskSpaceRegion) -> float:
        metres, angle = region.distance(hand)
        return metres + METRES_PER_RADIAN * angle

    region = min(model.human_grasps, key=apart)
    return region.name, apart(region)
