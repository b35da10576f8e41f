"""Errors of hands against their targets."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.arm.hand import hand_frames
from handover_ros.ergonomics.hand_targets import ANGLE_LENGTH, HandTarget, Match, hand_task, rotation_vector_slope
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.sim.person_spec import load_person
from handover_ros.skeleton.jacobian import Frame, relative_pose

SKELETON = skeleton_of(load_person("adult"))
ROOT = Frame("torso", np.eye(4))
HANDS = hand_frames(SKELETON)
seeds = st.integers(0, 10**6)


def some_posture(seed):
    return np.random.default_rng(seed).uniform(SKELETON.lower, SKELETON.upper)


def hand_pose(theta, side):
    return relative_pose(SKELETON, theta, ROOT, HANDS[side].frame)


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_errors_have_the_slopes_they_claim(seed):
    theta = some_posture(seed)
    task = hand_task(SKELETON, {side: HandTarget(hand_pose(some_posture(seed + 1), side)) for side in HANDS})
    errors, slopes = task.errors(theta)
    if any(np.linalg.norm(errors[rows]) > 2.8 * ANGLE_LENGTH for rows in (slice(3, 6), slice(9, 12))):
        return  # half a turn away the rotation vector jumps
    steps = 1e-6 * np.eye(14)
    numerical = (task.errors(theta + steps)[0] - task.errors(theta - steps)[0]).T / 2e-6
    np.testing.assert_allclose(slopes, numerical, rtol=1e-5, atol=1e-6)


def test_slope_of_a_rotation_vector_near_none_is_one():
    np.testing.assert_allclose(rotation_vector_slope(np.zeros((1, 3)))[0], np.eye(3))


@settings(max_examples=10, deadline=None)
@given(seeds)
def test_nothing_is_missed_in_the_posture_itself(seed):
    theta = some_posture(seed)
    for match in Match:
        task = hand_task(SKELETON, {side: HandTarget(hand_pose(theta, side), match) for side in HANDS})
        np.testing.assert_allclose(task.misses(theta), 0.0, atol=1e-6)


def test_misses_are_metres_and_radians():
    theta, turned = np.zeros(14), np.zeros(14)
    turned[3] = 0.5  # the right elbow: the hand turns by as much
    task = hand_task(SKELETON, {side: HandTarget(hand_pose(theta, side)) for side in HANDS})
    position, rotation = task.misses(turned)
    np.testing.assert_allclose(rotation, 0.5)
    moved = hand_pose(turned, "right")[:3, 3] - hand_pose(theta, "right")[:3, 3]
    np.testing.assert_allclose(position, np.linalg.norm(moved))
