"""Queries made of offered objects."""

import numpy as np
import pytest

from handover_ros.arm.model import load_arm
from handover_ros.errors import BadRequestError
from handover_ros.geometry import transform_from_xyz_rpy
from handover_ros.objects.catalogue import load_catalogue, load_object
from handover_ros.preferences.offered import MOST, hand_grasps, offered_query

ARM = load_arm("adult", "right")
NEAR = transform_from_xyz_rpy(np.array([0.45, -0.2, -0.2]), np.array([0.0, 0.0, 0.5]))
ONE_HANDED = [name for name, model in load_catalogue().items() if model.hands == 1]


@pytest.mark.parametrize("name", ONE_HANDED)
def test_every_configuration_has_the_hand_at_a_grasp_of_its_region(name):
    model = load_object(name)
    query = offered_query(model, ARM, NEAR)
    grasps = NEAR @ hand_grasps(model, ARM).poses[0]
    regions = np.array(hand_grasps(model, ARM).regions[0])
    hands = ARM.hand_pose(query.configurations)
    for hand, region in zip(hands, query.region):
        same = np.abs(grasps - hand).max(axis=(1, 2)) < 1e-6
        assert regions[same].tolist().count(query.regions[region]) == same.sum() > 0
    assert ARM.within_limits(query.configurations, 1e-6).all()


def test_both_hands_have_the_same_choice_at_mirrored_places():
    model, left = load_object("mug"), load_arm("adult", "left")
    query = offered_query(model, left, NEAR)
    hands = left.hand_pose(query.configurations)
    grasps = NEAR @ hand_grasps(model, left).poses[0]
    assert all(np.abs(grasps - hand).max(axis=(1, 2)).min() < 1e-6 for hand in hands)


def test_what_the_gripper_blocks_is_not_on_offer():
    model = load_object("mug")
    whole = offered_query(model, ARM, NEAR)
    grasps = hand_grasps(model, ARM)
    blocked = np.array(grasps.regions[0]) == whole.regions[whole.region[0]]
    rest = offered_query(model, ARM, NEAR, ~blocked)
    assert whole.region[0] not in rest.region
    assert len(rest) < len(whole)


def test_large_sets_are_thinned_and_keep_their_measure():
    model = load_object("pitcher")
    few, many = offered_query(model, ARM, NEAR, most=60), offered_query(model, ARM, NEAR, most=10_000)
    assert len(few) <= 60 < len(many)
    assert few.measures.sum() == pytest.approx(many.measures.sum(), rel=1e-6)
    assert len(offered_query(model, ARM, NEAR)) <= MOST


def test_what_cannot_be_taken_is_refused():
    far = NEAR.copy()
    far[0, 3] = 3.0
    with pytest.raises(BadRequestError, match="feasible set is empty"):
        offered_query(load_object("mug"), ARM, far)
    with pytest.raises(BadRequestError, match="two hands"):
        offered_query(load_object("box"), ARM, NEAR)
