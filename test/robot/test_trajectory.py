"""Trajectories: on the path, within the limits, from rest to rest."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.errors import BadRequestError
from handover_ros.robot import RobotModel, parameterise

ARM = RobotModel.load().arm("left")
SEEDS = st.integers(0, 2**32 - 1)
BLENDS = st.sampled_from([0.0, 0.02, 0.06, 0.2])


def random_path(seed):
    """Waypoints as a planner makes them: far apart, or the close ones of a straight gripper line."""
    rng = np.random.default_rng(seed)
    count = rng.integers(2, 10)
    if seed % 2:
        return np.clip(ARM.home + np.cumsum(rng.normal(scale=0.06, size=(count, 7)), axis=0), ARM.lower, ARM.upper)
    return rng.uniform(ARM.lower, ARM.upper, size=(count, 7))


def nearest_distance(path, point):
    """Distance of a point from a polyline."""
    best = np.inf
    for a, b in itertools.pairwise(path):
        t = np.clip((point - a) @ (b - a) / max((b - a) @ (b - a), 1e-12), 0.0, 1.0)
        best = min(best, float(np.linalg.norm(a + t * (b - a) - point)))
    return best


@given(SEEDS, BLENDS)
@settings(max_examples=80, deadline=None)
def test_limits_hold_at_all_times(seed, blend):
    """Dense samples between the knots stay within velocity, acceleration and position limits."""
    trajectory = parameterise(random_path(seed), ARM.planning_velocity, ARM.acceleration, blend)
    positions, velocities, accelerations = trajectory.sample(np.linspace(0.0, trajectory.duration, 3000))
    assert np.all(np.abs(velocities) <= ARM.planning_velocity * 1.001)
    assert np.all(np.abs(accelerations) <= ARM.acceleration * 1.01)
    assert np.all((positions >= ARM.lower - 1e-9) & (positions <= ARM.upper + 1e-9))


@given(SEEDS, BLENDS)
@settings(max_examples=40, deadline=None)
def test_it_follows_the_path_from_rest_to_rest(seed, blend):
    """Ends are the path's ends at rest; between, it leaves the path by no more than the blend; times increase."""
    path = random_path(seed)
    trajectory = parameterise(path, ARM.planning_velocity, ARM.acceleration, blend)
    np.testing.assert_allclose(trajectory.positions[[0, -1]], path[[0, -1]], atol=1e-9)
    np.testing.assert_allclose(trajectory.velocities[[0, -1]], 0.0, atol=1e-9)
    assert np.all(np.diff(trajectory.times) > 0)
    positions, _, _ = trajectory.sample(np.linspace(0.0, trajectory.duration, 200))
    assert max(nearest_distance(path, point) for point in positions) <= blend + 2e-3


@given(SEEDS)
@settings(max_examples=20, deadline=None)
def test_samples_are_consistent(seed):
    """Sampled velocities are the derivative of sampled positions."""
    trajectory = parameterise(random_path(seed), ARM.planning_velocity, ARM.acceleration, 0.06)
    times = np.linspace(0.01, trajectory.duration - 0.01, 50)
    before, after = trajectory.sample(times - 1e-6)[0], trajectory.sample(times + 1e-6)[0]
    np.testing.assert_allclose((after - before) / 2e-6, trajectory.sample(times)[1], atol=1e-3)


@given(SEEDS)
@settings(max_examples=20, deadline=None)
def test_reversed_is_the_same_motion_backwards(seed):
    trajectory = parameterise(random_path(seed), ARM.planning_velocity, ARM.acceleration, 0.06)
    backwards = trajectory.reversed()
    times = np.linspace(0.0, trajectory.duration, 100)
    np.testing.assert_allclose(backwards.sample(trajectory.duration - times)[0], trajectory.sample(times)[0], atol=1e-9)


def test_one_straight_motion_is_nearly_time_optimal():
    """A single joint over one radian takes the time of a trapezoid, but for the reserve."""
    path = np.vstack([np.zeros(7), [1.0, 0, 0, 0, 0, 0, 0]])
    v, a = ARM.planning_velocity[0], ARM.acceleration[0]
    optimal = 1.0 / v + v / a
    assert optimal <= parameterise(path, ARM.planning_velocity, ARM.acceleration).duration <= 1.1 * optimal


def test_rounded_corners_are_faster_than_stops():
    path = random_path(8)
    stops, rounded = (parameterise(path, ARM.planning_velocity, ARM.acceleration, blend) for blend in (0.0, 0.1))
    assert rounded.duration < stops.duration


def test_paths_without_motion_take_no_time():
    trajectory = parameterise(np.stack([ARM.home, ARM.home]), ARM.planning_velocity, ARM.acceleration, 0.05)
    assert trajectory.duration == 0.0
    position, velocity, acceleration = trajectory.sample(1.0)
    np.testing.assert_array_equal(position, ARM.home)
    assert not velocity.any()
    assert not acceleration.any()


@pytest.mark.parametrize(
    ("path", "velocity"),
    [(np.full((2, 7), np.nan), ARM.velocity), (np.zeros((2, 7)), -ARM.velocity), (np.zeros((2, 7)), np.ones(3))],
)
def test_bad_numbers_are_refused(path, velocity):
    with pytest.raises(BadRequestError):
        parameterise(path, velocity, ARM.acceleration)
