"""The grasps with which a person can take an object."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.errors import BadRequestError
from handover_ros.objects import load_catalogue
from handover_ros.planning.grasp_set import HALF_TURN, LEAST_APART, grasp_set

CATALOGUE = load_catalogue()
ONE_HAND = sorted(name for name, model in CATALOGUE.items() if model.hands == 1)
TWO_HANDS = sorted(name for name, model in CATALOGUE.items() if model.hands == 2)
BOTH = ("right", "left")
seeds = st.integers(0, 10**6)


def region_of(model, name):
    return next(region for region in model.human_grasps if region.name == name)


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_every_pose_lies_in_the_region_whose_name_it_bears(name):
    """For the right hand as the region is written, for the left after half a turn about the approach."""
    model = CATALOGUE[name]
    grasps = grasp_set(model, BOTH, 0.05, 0.6)
    for number, side in enumerate(grasps.sides):
        turn = HALF_TURN if side == "left" else np.eye(4)
        for pose, region in zip(grasps.poses[number], grasps.regions[number], strict=True):
            np.testing.assert_allclose(region_of(model, region).distance(pose @ turn), 0.0, atol=1e-7)


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_a_left_hand_is_half_a_turn_from_the_right_one(name):
    """Same place and palm, the fingers the other way."""
    grasps = grasp_set(CATALOGUE[name], BOTH)
    right, left = grasps.poses
    np.testing.assert_allclose(right[:, :3, 3], left[:, :3, 3], atol=1e-12)
    np.testing.assert_allclose(right[:, :3, 2], left[:, :3, 2], atol=1e-12)
    np.testing.assert_allclose(right[:, :3, :2], -left[:, :3, :2], atol=1e-12)


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_the_same_object_has_the_same_grasps(name):
    """Made anew, a set is the same number for number, and nobody can change it."""
    model = CATALOGUE[name]
    first = grasp_set(model, BOTH)
    grasp_set.cache_clear()
    second = grasp_set(model, BOTH)
    assert second is not first
    assert second.grasp_regions == first.grasp_regions
    np.testing.assert_array_equal(second.hands, first.hands)
    for a, b in zip(first.poses, second.poses, strict=True):
        np.testing.assert_array_equal(a, b)
        assert not b.flags.writeable
    assert not second.hands.flags.writeable


@pytest.mark.parametrize("name", ONE_HAND)
def test_each_grasp_of_one_hand_is_one_pose_of_one_hand(name):
    """All poses of all sides, each once; more steps give more of them."""
    model = CATALOGUE[name]
    grasps = grasp_set(model, BOTH)
    assert len(grasps) == sum(len(poses) for poses in grasps.poses)
    used = set()
    for index in range(len(grasps)):
        ((side, pose),) = grasps.hand_poses(index).items()
        number = grasps.sides.index(side)
        assert np.abs(grasps.poses[number] - pose).max(axis=(1, 2)).min() == 0.0
        used.add((side, int(grasps.hands[index, number])))
        assert grasps.region(index) == grasps.regions[number][grasps.hands[index, number]]
    assert len(used) == len(grasps)
    assert len(grasp_set(model, BOTH, 0.01, 0.1)) > len(grasps) > len(grasp_set(model, BOTH, 1.0, 3.0))
    assert len(grasp_set(model, ("right",))) * 2 == len(grasps)


@pytest.mark.parametrize("name", TWO_HANDS)
def test_two_hands_are_apart_and_every_pair_that_is_counts(name):
    """Each grasp has both hands, in two regions at least 0.15 m from each other; no such pair is missing."""
    model = CATALOGUE[name]
    grasps = grasp_set(model, BOTH)
    pairs = set()
    for index in range(len(grasps)):
        hands = grasps.hand_poses(index)
        assert set(hands) == set(BOTH)
        assert np.linalg.norm(hands["right"][:3, 3] - hands["left"][:3, 3]) >= LEAST_APART
        first, second = (grasps.regions[n][grasps.hands[index, n]] for n in range(2))
        assert grasps.region(index) == f"{first} and {second}"
        pairs.add((first, second))
    centres = {region.name: region.centre()[:3, 3] for region in model.human_grasps}
    expected = {(a, b) for a in centres for b in centres if np.linalg.norm(centres[a] - centres[b]) >= LEAST_APART}
    assert pairs == expected
    assert len(grasps) == len(expected)


@given(st.sampled_from(sorted(CATALOGUE)), seeds, st.floats(0.0, 1.0))
@settings(max_examples=60, deadline=None)
def test_a_subset_keeps_poses_and_regions_of_what_it_keeps(name, seed, share):
    """The kept grasps are what they were, and no pose is left that none of them needs."""
    grasps = grasp_set(CATALOGUE[name], BOTH)
    kept = np.random.default_rng(seed).random(len(grasps)) < share
    subset = grasps.subset(kept)
    assert len(subset) == kept.sum()
    assert subset.sides == grasps.sides
    for new, old in enumerate(np.flatnonzero(kept)):
        assert subset.region(new) == grasps.region(old)
        mine, before = subset.hand_poses(new), grasps.hand_poses(old)
        assert mine.keys() == before.keys()
        for side in mine:
            np.testing.assert_array_equal(mine[side], before[side])
    for number in range(len(grasps.sides)):
        used = subset.hands[subset.hands[:, number] >= 0, number]
        assert set(used.tolist()) == set(range(len(subset.poses[number])))
        assert len(subset.regions[number]) == len(subset.poses[number])


@pytest.mark.parametrize("sides", [(), ("right", "right")])
def test_hands_must_be_named_once(sides):
    """No hand, or one hand twice, is refused."""
    with pytest.raises(BadRequestError, match="each hand once"):
        grasp_set(CATALOGUE["mug"], sides)


@pytest.mark.parametrize("name", TWO_HANDS)
def test_an_object_for_two_hands_needs_both(name):
    """The message names the object and the hand that is known."""
    with pytest.raises(BadRequestError, match=f"{name} needs two hands.*left"):
        grasp_set(CATALOGUE[name], ("left",))
