"""Menus of handovers, and the plan of one that was chosen."""

from dataclasses import replace

import numpy as np
import pytest
from lab_cell import PLANNER, SCENE, check_plan, snapshot, torso

from handover_ros.arm.model import load_arm
from handover_ros.errors import BadRequestError, InfeasibleError, StaleDataError
from handover_ros.geometry import invert_transform, transform_from_xyz_rpy
from handover_ros.planning import HandoverRequest, TrackedPerson
from handover_ros.planning.menu import LEAST_GRASPS, menu
from handover_ros.planning.types import ChosenOffer
from handover_ros.preferences.offered import free_for_hand, offered_query

SCHEME = PLANNER.schemes["expected_cost"]
PATIENCE = 60.0  # [s]


@pytest.fixture(scope="module")
def mugs():
    return menu(PLANNER, SCHEME, "mug", snapshot(), 6, budget=PATIENCE)


def test_a_menu_has_different_handovers_that_both_can_do(mugs):
    assert len(mugs) == 6
    poses = [dish.offer.world_from_object for dish in mugs]
    for first in range(6):
        for second in range(first):
            assert np.abs(poses[first] - poses[second]).max() > 0.02
    for dish in mugs:
        model, arm = PLANNER.motion.object_model("mug"), load_arm("adult", "right")
        free = free_for_hand(model, arm, PLANNER.grippers[dish.arm], dish.object_from_gripper)
        pose = invert_transform(torso()) @ dish.offer.world_from_object
        query = offered_query(model, arm, pose, free)
        assert len(query) >= LEAST_GRASPS
        likely = dish.offer.predicted.grasps[0].region
        assert query.regions.index(likely) in query.region


def test_the_same_seed_is_the_same_menu(mugs):
    again = menu(PLANNER, SCHEME, "mug", snapshot(), 6, budget=PATIENCE)
    other = menu(PLANNER, SCHEME, "mug", snapshot(), 6, budget=PATIENCE, seed=1)
    for dish, same in zip(mugs, again, strict=True):
        np.testing.assert_array_equal(dish.offer.world_from_object, same.offer.world_from_object)
    assert any(
        np.abs(dish.offer.world_from_object - each.offer.world_from_object).max() > 0.02
        for dish, each in zip(mugs, other)
    )


def test_a_chosen_handover_is_planned_as_it_is(mugs):
    planned = 0
    for dish in mugs:
        offer = ChosenOffer(dish.offer.world_from_object, dish.object_from_gripper)
        request = HandoverRequest("mug", arm=dish.arm, offer=offer, time_budget=PATIENCE)
        try:
            plan = PLANNER.plan(request, snapshot())
        except InfeasibleError:
            continue  # the way there was not part of the menu's promise
        planned += 1
        np.testing.assert_allclose(plan.world_from_object, dish.offer.world_from_object, atol=1e-9)
        np.testing.assert_allclose(plan.object_from_gripper, dish.object_from_gripper, atol=1e-9)
        assert plan.arm == dish.arm
        assert plan.predicted is not None
        check_plan(plan, snapshot())
    assert planned >= 3


def test_what_cannot_be_offered_is_refused(mugs):
    dish = mugs[0]
    grip = dish.object_from_gripper @ transform_from_xyz_rpy([0.05, 0.0, 0.0], [0.0, 0.0, 0.0])
    request = HandoverRequest("mug", arm=dish.arm, offer=ChosenOffer(dish.offer.world_from_object, grip))
    with pytest.raises(BadRequestError, match="no such grasp"):
        PLANNER.plan(request, snapshot())
    far = transform_from_xyz_rpy([0.0, 0.0, 3.0], [0.0, 0.0, 0.0]) @ dish.offer.world_from_object
    request = replace(request, offer=ChosenOffer(far, dish.object_from_gripper))
    with pytest.raises(InfeasibleError, match="cannot take mug"):
        PLANNER.plan(request, snapshot())
    with pytest.raises(BadRequestError, match="cannot tell who takes it how"):
        PLANNER.plan(replace(request, scheme="relative"), snapshot())
    with pytest.raises(BadRequestError, match="offer"):
        ChosenOffer(np.full((4, 4), np.nan), np.eye(4))


def test_menus_that_cannot_be_are_refused():
    with pytest.raises(StaleDataError):
        menu(PLANNER, SCHEME, "mug", snapshot(person=None), 3)
    with pytest.raises(InfeasibleError, match="seen"):
        menu(PLANNER, SCHEME, "mug", snapshot(objects={}), 3)
    away = snapshot(person=TrackedPerson(torso(x=5.0)))
    with pytest.raises(InfeasibleError, match="no handover of mug"):
        menu(PLANNER, SCHEME, "mug", away, 3)


def test_every_object_for_one_hand_has_a_menu():
    for name in SCENE.placements:
        if PLANNER.motion.object_model(name).hands == 1:
            assert menu(PLANNER, SCHEME, name, snapshot(), 2, budget=PATIENCE)
