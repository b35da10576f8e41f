"""Beliefs, choices and menus to messages and back."""

from __future__ import annotations

from typing import cast

import numpy as np
from builtin_interfaces.msg import Time
from handover_msgs.msg import BeliefSummary, GraspChoice, HandoverPlan
from std_msgs.msg import Header

from handover_ros.arm.model import JOINT_NAMES, SIDES, Side
from handover_ros.cell.preference_learner import OfferedHandover, PreferenceLearner, TakenHandover, point_estimates
from handover_ros.ergonomics.arm_costs import Preference
from handover_ros.errors import BadRequestError, UnknownNameError
from handover_ros.geometry import FloatArray
from handover_ros.nodes.convert import (
    check_frame,
    float_array,
    is_unset,
    numpy_array,
    pose_message,
    transform_from_message,
)
from handover_ros.planning.types import ChosenOffer
from handover_ros.preferences.observed import ObservedChoice


def belief_message(learner: PreferenceLearner, stamp: Time) -> BeliefSummary:
    """Return what is believed of the active person; an empty message when nobody is active."""
    message = BeliefSummary(header=Header(stamp=stamp), surprise=float("nan"), problem=learner.problem)
    person = learner.person
    if person is None:
        return message
    belief = person.belief
    message.profile_id = person.profile_id
    message.observations, message.particles = belief.observations, len(belief.particles)
    message.effective_particles, message.entropy = belief.effective_particles, belief.entropy
    message.parameter_names = list(belief.prior.space.names)
    message.mean, message.mode = float_array(belief.mean), float_array(belief.mode)
    message.covariance = float_array(belief.covariance)
    message.rationality = float(belief.weights @ belief.people.rationality)
    message.joint_names = list(belief.prior.space.joints)
    for name, preference in point_estimates(belief).items():
        setattr(message, f"{name}_neutral", float_array(preference.neutral))
        setattr(message, f"{name}_weights", float_array(preference.weights))
    message.surprise, message.changed = learner.surprise, learner.changed
    return message


def preference_from_message(message: BeliefSummary, kind: str) -> Preference:
    """Return the ``mean``, ``mode`` or ``expected`` preference of a belief.

    Raises:
        BadRequestError: It is not about this arm's joints, or a number cannot be.
    """
    if tuple(message.joint_names) != JOINT_NAMES:
        raise BadRequestError(f"joint_names: need {', '.join(JOINT_NAMES)}, got {', '.join(message.joint_names)}")
    return Preference(
        numpy_array(getattr(message, f"{kind}_neutral"), 7), numpy_array(getattr(message, f"{kind}_weights"), 7)
    )


def chosen_offer(message: HandoverPlan, object_name: str) -> ChosenOffer:
    """Return the offer of a menu.

    Raises:
        BadRequestError: It is of another object, a pose is not finite, or its frame is not known.
    """
    if message.object_name != object_name:
        raise BadRequestError(f"offer: is of {message.object_name!r}, but object_name is {object_name!r}")
    check_frame(message.header.frame_id, "offer")
    return ChosenOffer(
        transform_from_message(message.handover_pose, "offer: handover_pose"),
        transform_from_message(message.object_from_gripper, "offer: object_from_gripper"),
    )


def offered_handover(message: HandoverPlan, world_from_torso: FloatArray) -> OfferedHandover:
    """Return a plan of a menu as a question to the person who stands there.

    Raises:
        BadRequestError: A pose is not finite, or its frame is not known.
    """
    offer = chosen_offer(message, message.object_name)
    return OfferedHandover(
        message.object_name, offer.world_from_object, world_from_torso, message.arm, offer.object_from_gripper
    )


def taken_handover(message: GraspChoice) -> TakenHandover:
    """Return how the person took an object.

    Raises:
        BadRequestError: A pose that is needed is missing or not finite, or a number or its frame cannot be used.
        UnknownNameError: There is no such hand.
    """
    check_frame(message.header.frame_id, "choice")
    if message.hand not in SIDES:
        raise UnknownNameError("hand", message.hand, SIDES)
    if is_unset(message.torso):
        raise BadRequestError("torso: is not known, so what the person could choose from is not either")
    posture, covariance = None, None
    if message.joint_names:
        if tuple(message.joint_names) != JOINT_NAMES:
            raise BadRequestError(
                f"joint_names: need {', '.join(JOINT_NAMES)}, or none; got {list(message.joint_names)}"
            )
        posture = numpy_array(message.displacements, 7)
        covariance = numpy_array(message.covariance, 7, 7) if len(message.covariance) else None
    grip = message.object_from_gripper
    offered = OfferedHandover(
        message.object_name,
        transform_from_message(message.handover_pose, "handover_pose"),
        transform_from_message(message.torso, "torso"),
        message.arm,
        None if is_unset(grip) else transform_from_message(grip, "object_from_gripper"),
    )
    return TakenHandover(
        message.handover_id, offered, cast(Side, message.hand), message.grasp_region, posture, covariance
    )


def fill_choice(message: GraspChoice, seen: ObservedChoice, world_from_torso: FloatArray) -> None:
    """Fill in how a tracked person was seen to take the object."""
    message.hand, message.grasp_region = seen.hand, seen.region
    message.object_from_hand = pose_message(seen.object_from_hand)
    message.torso = pose_message(world_from_torso)
    message.joint_names = list(JOINT_NAMES)
    message.displacements = float_array(seen.posture)
    message.covariance = float_array(np.ravel(seen.covariance))
