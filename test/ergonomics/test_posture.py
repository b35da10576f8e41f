"""The posture a person takes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from handover_ros.arm.hand import hand_frames
from handover_ros.ergonomics.costs import PreferredPosture, load_cost
from handover_ros.ergonomics.hand_targets import HandTarget, Match
from handover_ros.ergonomics.posture import (
    POSITION_TOLERANCE,
    ROTATION_TOLERANCE,
    predict_posture,
    preferred_posture,
)
from handover_ros.errors import BadModelError, BadRequestError, UnknownNameError
from handover_ros.geometry import make_transform
from handover_ros.sim.person_kinematics import PersonKinematics
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.sim.person_spec import load_person
from handover_ros.skeleton.jacobian import Frame, relative_pose

PERSON = load_person("adult")
SKELETON = skeleton_of(PERSON)
COST = PreferredPosture(SKELETON)
ROOT = Frame("torso", np.eye(4))
HANDS = hand_frames(SKELETON)
seeds = st.integers(0, 10**6)


def some_posture(seed):
    return np.random.default_rng(seed).uniform(SKELETON.lower, SKELETON.upper)


def hand_pose(theta, side):
    return relative_pose(SKELETON, theta, ROOT, HANDS[side].frame)


def within_limits(answer, skeleton=SKELETON):
    return (answer.displacements >= skeleton.lower).all() and (answer.displacements <= skeleton.upper).all()


@settings(max_examples=8, deadline=None)
@given(seeds, st.sampled_from([("right",), ("left",), ("right", "left")]), st.sampled_from(list(Match)))
def test_reaches_what_some_posture_reaches_and_costs_no_more(seed, sides, match):
    theta = some_posture(seed)
    targets = {side: HandTarget(hand_pose(theta, side), match) for side in sides}
    answer = predict_posture(SKELETON, COST, targets)
    assert answer.feasible
    assert within_limits(answer)
    for side in sides:
        pose = hand_pose(answer.displacements, side)
        assert np.linalg.norm(pose[:3, 3] - targets[side].root_from_hand[:3, 3]) <= POSITION_TOLERANCE
        if match is Match.POSE:
            turn = Rotation.from_matrix(pose[:3, :3].T @ targets[side].root_from_hand[:3, :3])
            assert turn.magnitude() <= ROTATION_TOLERANCE
    expected = theta.copy()
    for column, name in enumerate(SKELETON.displacement_names):
        if name.split("_")[0] not in sides:
            expected[column] = SKELETON.middle[column]  # an arm that need not reach rests
    assert answer.cost <= COST.evaluate(np.zeros(14), expected) + 1e-3
    assert answer.cost == pytest.approx(float(COST.evaluate(np.zeros(14), answer.displacements)))


@settings(max_examples=4, deadline=None)
@given(seeds)
def test_no_swivel_of_the_closed_form_inverse_is_cheaper(seed):
    """Of all postures with the hand in a pose, which only turn the elbow about one line, it finds the cheapest."""
    kinematics = PersonKinematics(PERSON, np.eye(4))
    theta = some_posture(seed)
    pose = hand_pose(theta, "right")
    answer = predict_posture(SKELETON, COST, {"right": HandTarget(pose)})
    arms = kinematics.inverse("right", pose[None], np.linspace(-np.pi, np.pi, 2000))[0]
    arms = arms[((arms >= SKELETON.lower[:7]) & (arms <= SKELETON.upper[:7])).all(axis=1)]
    if not len(arms):
        return
    postures = np.concatenate([arms, np.broadcast_to(SKELETON.middle[7:], (len(arms), 7))], axis=1)
    assert answer.cost <= COST.evaluate(np.zeros(14), postures).min() + 5e-3


@settings(max_examples=10, deadline=None)
@given(seeds)
def test_out_of_reach_is_said_and_limits_hold(seed):
    direction = np.random.default_rng(seed).normal(size=3)
    far = make_transform(np.eye(3), 1.5 * direction / np.linalg.norm(direction))
    answer = predict_posture(SKELETON, COST, {"right": HandTarget(far, Match.POSITION)}, starts=16)
    assert not answer.feasible
    assert answer.position_error > 0.4
    assert within_limits(answer)


def test_a_strap_makes_a_pose_infeasible():
    restricted = skeleton_of(load_person("restricted"))
    raised = np.zeros(14)
    raised[0], raised[3] = 2.0, 0.3
    target = {"right": HandTarget(hand_pose(raised, "right"), Match.POSITION)}
    assert predict_posture(SKELETON, COST, target).feasible
    answer = predict_posture(restricted, PreferredPosture(restricted), target)
    assert not answer.feasible
    assert within_limits(answer, restricted)


def test_preferred_posture_is_the_middle_of_the_limits():
    answer = preferred_posture(SKELETON, COST)
    np.testing.assert_allclose(answer.displacements, 0.5 * (SKELETON.lower + SKELETON.upper), atol=1e-6)
    assert answer.feasible
    assert answer.cost == pytest.approx(0.0, abs=1e-6)


def test_preferred_posture_stays_within_limits_when_the_wish_does_not():
    wish = SKELETON.upper + 0.5
    answer = preferred_posture(SKELETON, PreferredPosture(SKELETON, preferred=wish))
    np.testing.assert_allclose(answer.displacements, SKELETON.upper, atol=1e-4)
    assert within_limits(answer)


@pytest.mark.parametrize("name", ["minimum_work", "minimum_torque_change", "minimum_jerk"])
def test_every_cost_finds_a_posture_cheaper_than_the_preferred_one(name):
    cost = load_cost(name, SKELETON, PERSON.mass)
    reach = np.zeros(14)
    reach[[0, 3]] = 0.9, 0.6
    target = {"right": HandTarget(hand_pose(reach, "right"), Match.POSITION)}
    answer = predict_posture(SKELETON, cost, target, starts=24)
    assert answer.feasible
    assert within_limits(answer)
    preferred = predict_posture(SKELETON, COST, target)
    start = np.clip(np.zeros(14), SKELETON.lower, SKELETON.upper)
    assert answer.cost <= cost.evaluate(start, preferred.displacements)


def test_the_same_seed_gives_the_same_answer():
    target = {"left": HandTarget(hand_pose(some_posture(4), "left"))}
    one, other = (predict_posture(SKELETON, COST, target, seed=3) for _ in range(2))
    np.testing.assert_array_equal(one.displacements, other.displacements)


def test_bad_requests_are_refused():
    pose = hand_pose(some_posture(1), "right")
    with pytest.raises(UnknownNameError, match="tail"):
        predict_posture(SKELETON, COST, {"tail": HandTarget(pose)})
    with pytest.raises(BadRequestError, match="orthonormal"):
        predict_posture(SKELETON, COST, {"right": HandTarget(2.0 * pose)})
    with pytest.raises(BadRequestError, match="4x4"):
        predict_posture(SKELETON, COST, {"right": HandTarget(np.zeros(3))})
    with pytest.raises(BadRequestError, match="14 finite"):
        predict_posture(SKELETON, COST, {}, start=[0.0])
    unknown = replace(SKELETON, upper=np.full(14, np.inf))
    with pytest.raises(BadModelError, match="limits of right_shoulder_flexion"):
        predict_posture(unknown, COST, {})
