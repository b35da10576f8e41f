"""The grip frame of a hand."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from handover_ros.arm.hand import hand_frames
from handover_ros.errors import BadModelError
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.sim.person_spec import load_person

SKELETON = skeleton_of(load_person("adult"))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6))
def test_does_not_depend_on_which_point_describes_an_axis(seed):
    shift = np.random.default_rng(seed).normal(size=(len(SKELETON.joints), 1))
    points = SKELETON.tree.point + np.where(SKELETON.tree.kind[:, None] == 0, shift * SKELETON.tree.axis, 0.0)
    moved = SKELETON.with_geometry(SKELETON.tree.axis, points, SKELETON.markers)
    for side, hand in hand_frames(moved).items():
        np.testing.assert_allclose(hand.zero_from_hand, hand_frames(SKELETON)[side].zero_from_hand, atol=1e-9)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6))
def test_stays_a_frame_when_the_axes_are_not_perfect(seed):
    rng = np.random.default_rng(seed)
    axes = Rotation.from_rotvec(0.15 * rng.normal(size=(len(SKELETON.joints), 3))).apply(SKELETON.tree.axis)
    points = SKELETON.tree.point + 0.005 * rng.normal(size=SKELETON.tree.point.shape)
    for hand in hand_frames(SKELETON.with_geometry(axes, points, SKELETON.markers)).values():
        rotation = hand.zero_from_hand[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        assert rotation[2, 0] < -0.5  # the fingers hang down


def test_palms_face_each_other():
    hands = hand_frames(SKELETON)
    np.testing.assert_allclose(hands["right"].zero_from_hand[:3, 2], [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(hands["left"].zero_from_hand[:3, 2], [0.0, -1.0, 0.0], atol=1e-12)


def test_a_skeleton_without_hands_is_refused():
    with pytest.raises(BadModelError, match="has no hands"):
        hand_frames(replace(SKELETON, hands=()))


def test_a_missing_wrist_joint_is_named():
    with pytest.raises(BadModelError, match="right_wrist_flexion"):
        hand_frames(replace(SKELETON, hands=(("right", "right_forearm"),)))


def test_axes_that_give_no_direction_are_refused():
    axes = SKELETON.tree.axis.copy()
    axes[SKELETON.joint_carrying("right_hand")] = [0.0, 0.0, 1.0]
    with pytest.raises(BadModelError, match="right_wrist_deviation"):
        hand_frames(SKELETON.with_geometry(axes, SKELETON.tree.point, SKELETON.markers))
