"""The query that an offered object is: all configurations with which one hand can take it (Bestick 2017, 4.3)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from handover_ros.arm.inverse_kinematics import feasible_sets
from handover_ros.arm.model import Arm
from handover_ros.errors import BadRequestError
from handover_ros.geometry import FloatArray
from handover_ros.objects.catalogue import ObjectModel
from handover_ros.planning.grasp_set import GraspSet, grasp_set
from handover_ros.planning.gripper_blocks import free_grasps
from handover_ros.preferences.query import Query

STEP = 0.1  # [rad] in configuration space that a sample stands for
MOST = 600  # configurations of a query; with more the samples are set wider apart
WIDER = 1.3


def offered_query(
    model: ObjectModel,
    arm: Arm,
    torso_from_object: FloatArray,
    free: npt.NDArray[np.bool_] | None = None,
    name: str = "",
    most: int = MOST,
) -> Query:
    """Return what a person can choose from when an object is offered to one hand.

    Args:
        model: The object, for one hand.
        arm: The arm.
        torso_from_object: Where it is offered, shape (4, 4).
        free: Which grasps of ``hand_grasps`` the robot's gripper leaves free, shape (grasps,); None: all.
        name: For people.
        most: Configurations at most.

    Raises:
        BadRequestError: The object needs two hands, or the person cannot take it there.
    """
    grasps = hand_grasps(model, arm)
    kept = np.ones(len(grasps), dtype=bool) if free is None else np.asarray(free, dtype=bool)
    hands = torso_from_object @ grasps.poses[0][kept]
    step = STEP
    sets = feasible_sets(arm, hands, step)
    while len(sets.measures) > most:
        step *= WIDER
        sets = feasible_sets(arm, hands, step)
        if step > 10.0:
            break
    names = tuple(region.name for region in model.human_grasps)
    numbers = np.array([names.index(region) for region in grasps.regions[0]], dtype=np.int64)[kept]
    regions = np.repeat(numbers, np.diff(sets.first))
    usable = sets.measures > 0.0
    label = name or f"{model.name} offered to the {arm.side} hand"
    return Query(sets.postures[usable], sets.measures[usable], regions[usable], names, label)


def hand_grasps(model: ObjectModel, arm: Arm) -> GraspSet:
    """Return the grasps of an object for this arm's hand.

    Raises:
        BadRequestError: The object needs two hands: what one arm prefers does not tell how both take it.
    """
    if model.hands != 1:
        raise BadRequestError(f"{model.name} needs two hands; preferences are learned from objects for one hand")
    return grasp_set(model, (arm.side,))


def free_for_hand(
    model: ObjectModel, arm: Arm, gripper: FloatArray, object_from_gripper: FloatArray
) -> npt.NDArray[np.bool_]:
    """Return which grasps of ``hand_grasps`` a gripper leaves free (grasps,).

    Args:
        model: The object.
        arm: The arm.
        gripper: The gripper as points in its own frame [m], shape (n, 3).
        object_from_gripper: The robot's grasp, shape (4, 4).
    """
    return np.asarray(free_grasps(gripper, object_from_gripper[None], hand_grasps(model, arm))[0])
