"""Joint paths: valid everywhere, with the right ends; straight gripper lines."""

import itertools
import time

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.robot import InverseKinematics, RobotModel
from handover_ros.robot.path import PathSettings, plan_path, segment_is_free, shorten, straight_line

LIMITS = np.array([-2.0, -2.0]), np.array([2.0, 2.0])
START, GOAL = np.array([-1.5, 0.0]), np.array([1.5, 0.0])
SEEDS = st.integers(0, 2**32 - 1)
LATER = 1e9
ROBOT = RobotModel.load()
SOLVER = InverseKinematics(ROBOT, "left")


def wall_with_gap(point):
    """A wall across the way, open beyond y = 1."""
    return bool(np.all(np.abs(point) <= 2.0)) and not (abs(point[0]) < 0.3 and point[1] < 1.0)


def inside_wall(point):
    """Deeper in the wall than the resolution of the check can miss."""
    return bool(abs(point[0]) < 0.26 and point[1] < 0.96)


def length(path):
    return float(np.sum(np.linalg.norm(np.diff(path, axis=0), axis=1)))


@given(SEEDS)
@settings(max_examples=20, deadline=None)
def test_path_goes_round_the_wall(seed):
    """Every point of the path, finely sampled, is valid; the ends are the given ones."""
    path = plan_path(wall_with_gap, START, GOAL, LIMITS, np.random.default_rng(seed), LATER)
    assert path is not None
    np.testing.assert_array_equal(path[[0, -1]], [START, GOAL])
    for a, b in itertools.pairwise(path):
        assert not any(inside_wall(a + t * (b - a)) for t in np.linspace(0, 1, 200))


@given(SEEDS)
@settings(max_examples=20, deadline=None)
def test_shortcuts_never_lengthen(seed):
    rng = np.random.default_rng(seed)
    detour = np.array([START, [-1.5, 1.8], [0.0, 1.5], [1.0, 1.9], [1.5, 1.8], GOAL])
    short = shorten(wall_with_gap, detour, rng, LATER, PathSettings())
    assert length(short) <= length(detour) + 1e-9
    np.testing.assert_array_equal(short[[0, -1]], [START, GOAL])
    assert all(segment_is_free(wall_with_gap, a, b, 0.04) for a, b in itertools.pairwise(short))


def test_straight_when_that_is_free():
    path = plan_path(lambda _: True, START, GOAL, LIMITS, np.random.default_rng(0), LATER)
    np.testing.assert_array_equal(path, [START, GOAL])


def test_the_same_seed_gives_the_same_path():
    first, second = (plan_path(wall_with_gap, START, GOAL, LIMITS, np.random.default_rng(3), LATER) for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_no_way_and_no_time_give_none():
    """A closed wall, an invalid goal and an expired deadline end without a path."""
    closed = lambda point: abs(point[0]) > 0.3  # noqa: E731
    how = PathSettings(iterations=50)
    assert plan_path(closed, START, GOAL, LIMITS, np.random.default_rng(0), LATER, how) is None
    assert plan_path(wall_with_gap, START, np.zeros(2), LIMITS, np.random.default_rng(0), LATER) is None
    assert plan_path(wall_with_gap, START, GOAL, LIMITS, np.random.default_rng(0), time.monotonic() - 1.0) is None


def test_straight_line_moves_the_gripper_straight():
    """The fingertips stay on the line and keep their direction; each point continues the one before."""
    home = np.array(ROBOT.arm("left").home)
    start = ROBOT.gripper_pose("left", home)
    goal = start.copy()
    goal[:3, 3] += [0.05, 0.0, 0.10]
    path = straight_line(SOLVER, lambda _: True, home, start, goal)
    assert path is not None
    axis = goal[:3, 3] - start[:3, 3]
    for point in path:
        pose = ROBOT.gripper_pose("left", point)
        assert np.linalg.norm(np.cross(pose[:3, 3] - start[:3, 3], axis)) / np.linalg.norm(axis) < 1e-5
        np.testing.assert_allclose(pose[:3, :3], start[:3, :3], atol=1e-5)
    assert np.max(np.abs(np.diff(path, axis=0))) < 0.2


def test_straight_line_out_of_reach_or_blocked_is_none():
    home = np.array(ROBOT.arm("left").home)
    start = ROBOT.gripper_pose("left", home)
    goal = start.copy()
    goal[0, 3] += 2.0
    assert straight_line(SOLVER, lambda _: True, home, start, goal) is None
    goal[0, 3] = start[0, 3] + 0.05
    assert straight_line(SOLVER, lambda _: False, home, start, goal) is None
