"""The choice that tracking shows is the one the person made."""

import numpy as np
import pytest

from handover_ros.arm.model import JOINT_NAMES, arm_of
from handover_ros.errors import BadRequestError
from handover_ros.geometry import transform_from_xyz_rpy
from handover_ros.objects.catalogue import load_object
from handover_ros.preferences.observed import nearest_region, observed_choice, rehearse_choice
from handover_ros.preferences.offered import hand_grasps, offered_query
from handover_ros.preferences.query import posture_answer
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.sim.person_spec import load_person

SKELETON = skeleton_of(load_person("adult"))
NEAR = {
    "right": transform_from_xyz_rpy(np.array([0.45, -0.2, -0.2]), np.array([0.0, 0.0, 0.5])),
    "left": transform_from_xyz_rpy(np.array([0.45, 0.2, -0.2]), np.array([0.0, 0.0, 0.5])),
}


def tracked(side, posture):
    """Return the skeleton's displacements with one arm in a posture, the other hanging."""
    theta = np.zeros(len(SKELETON.lower))
    columns = [SKELETON.displacement_names.index(f"{side}_{name}") for name in JOINT_NAMES]
    theta[columns] = posture
    return theta


@pytest.mark.parametrize("name", ["mug", "glass", "pitcher", "u_lock"])
@pytest.mark.parametrize("side", ["right", "left"])
def test_what_was_taken_is_what_is_seen(side, name):
    model, arm = load_object(name), arm_of(SKELETON, side)
    query, rng = offered_query(model, arm, NEAR[side]), np.random.default_rng(1)
    for place in rng.integers(len(query), size=10):
        seen = observed_choice(model, NEAR[side], SKELETON, tracked(side, query.configurations[place]))
        assert seen.hand == side
        assert seen.distance < 1e-6
        answer = posture_answer(query, seen.posture, seen.covariance)
        assert place in answer.places
        np.testing.assert_allclose(seen.posture, query.configurations[place], atol=1e-6)
        poses = hand_grasps(model, arm).poses[0]
        assert np.abs(poses - seen.object_from_hand).max(axis=(1, 2)).min() < 1e-6


def test_tracking_noise_does_not_change_the_region():
    """2 degrees in every joint, as tracking leaves at worst."""
    model, arm = load_object("u_lock"), arm_of(SKELETON, "right")
    query, rng = offered_query(model, arm, NEAR["right"]), np.random.default_rng(2)
    same = []
    for place in rng.integers(len(query), size=60):
        noisy = query.configurations[place] + np.radians(2.0) * rng.standard_normal(7)
        seen = observed_choice(model, NEAR["right"], SKELETON, tracked("right", noisy))
        same.append(seen.region == query.regions[query.region[place]])
    assert np.mean(same) > 0.9


def test_covariance_is_that_of_the_arm():
    model, arm = load_object("mug"), arm_of(SKELETON, "right")
    query = offered_query(model, arm, NEAR["right"])
    variances = np.arange(1.0, len(SKELETON.lower) + 1.0)
    seen = observed_choice(
        model, NEAR["right"], SKELETON, tracked("right", query.configurations[0]), np.diag(variances)
    )
    columns = [SKELETON.displacement_names.index(f"right_{name}") for name in JOINT_NAMES]
    np.testing.assert_array_equal(np.diag(seen.covariance), variances[columns])


def test_hands_that_are_elsewhere_are_no_answer():
    with pytest.raises(BadRequestError, match="no hand is at mug"):
        observed_choice(load_object("mug"), NEAR["right"], SKELETON, np.zeros(len(SKELETON.lower)))
    with pytest.raises(BadRequestError, match="finite numbers"):
        observed_choice(load_object("mug"), NEAR["right"], SKELETON, np.full(len(SKELETON.lower), np.nan))


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_middle_of_a_region_is_nearest_to_it(side):
    model = load_object("mug")
    for region in model.human_grasps:
        turn = np.eye(4) if side == "right" else np.diag([-1.0, -1.0, 1.0, 1.0])
        assert nearest_region(model, side, region.centre() @ turn) == (region.name, pytest.approx(0.0, abs=1e-6))


@pytest.mark.parametrize("name", ["mug", "pitcher", "box"])
def test_a_rehearsed_choice_goes_all_the_way(name):
    """It is what loads everything beforehand, so it must not be refused on the way."""
    model = load_object(name)
    seen = rehearse_choice(model, skeleton_of(load_person("adult")))
    assert seen.region == model.human_grasps[0].name
    assert seen.distance < 1e-6
