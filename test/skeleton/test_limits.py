"""Joint limits from motion: what was reached several times, whatever single frames say."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.skeleton.limits import estimate_limits, smoothed
from handover_ros.skeleton.tree import WORLD, Joint, JointKind, Skeleton

RATE = 50.0
FRAMES = 1500
DEGREE = np.deg2rad(1.0)


def skeleton_of(*kinds):
    """Return joints in series of some kinds."""
    joints, parent = [], WORLD
    for index, kind in enumerate(kinds):
        count = 3 if kind is JointKind.BALL else 1
        names = tuple(f"d{index}_{k}" for k in range(count))
        joints.append(Joint(f"j{index}", kind, parent, f"s{index}", names, np.eye(3)[:count], np.zeros(3)))
        parent = f"s{index}"
    size = sum(len(joint.displacement_names) for joint in joints)
    return Skeleton("s", tuple(joints), (), (), np.zeros((0, 3)), np.full(size, -np.inf), np.full(size, np.inf))


ELBOW = skeleton_of(JointKind.REVOLUTE)


def sweeps(low, high, times=3, frames=FRAMES, share=0.4):
    """Return a joint at rest at zero, swept ``times`` from limit to limit in the middle ``share`` of the time."""
    result = np.zeros(frames)
    start, count = int(0.3 * frames), int(share * frames)
    phase = np.linspace(0.0, 1.0, count)
    blend = np.minimum(1.0, 12.0 * np.minimum(phase, 1.0 - phase))
    result[start : start + count] = blend * (
        0.5 * (low + high) - 0.5 * (high - low) * np.cos(2.0 * np.pi * times * phase)
    )
    return result


def limits(values, deviations=None, skeleton=ELBOW, rate=RATE):
    values = np.reshape(values, (len(values), -1))
    deviations = np.full(values.shape, 0.5 * DEGREE) if deviations is None else deviations
    return estimate_limits(skeleton, values, deviations, rate)


@pytest.mark.parametrize("seed", range(12))
def test_known_motion_with_noise_and_bad_frames_gives_the_limits(seed):
    """Half a degree of noise and five frames that are off by up to a radian: within two degrees."""
    rng = np.random.default_rng(seed)
    low, high = -rng.uniform(0.1, 1.5), rng.uniform(0.3, 2.5)
    values = sweeps(low, high) + 0.5 * DEGREE * rng.normal(size=FRAMES)
    values[rng.choice(FRAMES, 5, replace=False)] += rng.uniform(-1.0, 1.0, 5)
    lower, upper = limits(values)
    assert abs(lower[0] - low) < 2.0 * DEGREE
    assert abs(upper[0] - high) < 2.0 * DEGREE


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(0, FRAMES // 10 - 1), min_size=1, max_size=10, unique=True), st.floats(-2.0, 2.0))
def test_single_bad_frames_do_not_widen_the_limits(places, jump):
    values = sweeps(-0.6, 1.2)
    clean = limits(values)
    values[10 * np.array(places)] += jump
    lower, upper = limits(values)
    assert lower[0] > clean[0][0] - 1.0 * DEGREE
    assert upper[0] < clean[1][0] + 1.0 * DEGREE


def test_noise_does_not_widen_the_limits_as_extremes_do():
    values = sweeps(-0.6, 1.2) + 1.5 * DEGREE * np.random.default_rng(0).normal(size=FRAMES)
    lower, upper = limits(values)
    assert values.max() - 1.2 > 2.0 * DEGREE
    assert abs(upper[0] - 1.2) < 1.5 * DEGREE
    assert abs(lower[0] + 0.6) < 1.5 * DEGREE


@settings(max_examples=30, deadline=None)
@given(st.floats(-1.0, 1.0), st.floats(0.2, 3.0))
def test_limits_move_and_grow_with_the_motion(shift, scale):
    values = sweeps(-0.6, 1.2) + DEGREE * np.random.default_rng(0).normal(size=FRAMES)
    lower, upper = limits(values)
    other_lower, other_upper = limits(shift + scale * values)
    np.testing.assert_allclose(other_lower, shift + scale * lower, atol=1e-9)
    np.testing.assert_allclose(other_upper, shift + scale * upper, atol=1e-9)


def test_frames_in_which_a_joint_is_hardly_known_say_nothing():
    """For a second the elbow seems to bend backwards, but no marker shows it well."""
    values = sweeps(0.0, 2.0)
    deviations = np.full((FRAMES, 1), 0.5 * DEGREE)
    values[100:150] = -1.0
    assert limits(values, deviations)[0][0] < -0.9
    deviations[95:155] = 30.0 * DEGREE
    assert limits(values, deviations)[0][0] > -0.05


def test_outer_angles_of_a_ball_near_its_pole_say_nothing():
    """Where the middle angle is 90 degrees the outer ones jump."""
    ball = skeleton_of(JointKind.BALL)
    values = np.column_stack([sweeps(-0.5, 1.0), sweeps(0.0, np.pi / 2.0), sweeps(-0.3, 0.4)])
    pole = np.abs(np.cos(values[:, 1])) < 0.1
    values[pole, 0] += 1.5
    values[pole, 2] -= 1.5
    lower, upper = limits(values, skeleton=ball)
    assert upper[0] < 1.0 + 2.0 * DEGREE
    assert lower[2] > -0.3 - 2.0 * DEGREE
    assert abs(upper[1] - np.pi / 2.0) < 2.0 * DEGREE


def test_a_drawer_has_limits_in_metres():
    drawer = skeleton_of(JointKind.PRISMATIC)
    values = sweeps(0.0, 0.35) + 0.0005 * np.random.default_rng(0).normal(size=FRAMES)
    lower, upper = limits(values, np.full((FRAMES, 1), 0.0005), drawer)
    assert abs(lower[0]) < 0.003
    assert abs(upper[0] - 0.35) < 0.005


def test_what_was_never_seen_has_no_limits():
    both = skeleton_of(JointKind.REVOLUTE, JointKind.REVOLUTE)
    values = np.column_stack([sweeps(0.0, 1.0), np.full(FRAMES, np.nan)])
    lower, upper = limits(values, np.full((FRAMES, 2), DEGREE), both)
    assert np.isfinite([lower[0], upper[0]]).all()
    assert lower[1] == -np.inf
    assert upper[1] == np.inf


def test_few_frames_are_taken_as_they_are():
    values = np.linspace(0.0, 1.0, 8)[:, None]
    np.testing.assert_array_equal(smoothed(values, 100.0), values)
    np.testing.assert_array_equal(smoothed(np.tile(values, (20, 1)), 10.0), np.tile(values, (20, 1)))


def test_smoothing_keeps_slow_motion():
    times = np.arange(300) / 50.0
    values = np.sin(2.0 * np.pi * 0.5 * times)[:, None]
    np.testing.assert_allclose(smoothed(values, 50.0)[5:-5], values[5:-5], atol=0.01)
