"""The simulated robot's controller: follows what it may, refuses what it may not, stops within its limits."""

import numpy as np
import pytest
from cell import empty_cell, minimum_jerk, move, robot
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.errors import BadRequestError, UnknownNameError
from handover_ros.sim.joint_path import JointPath
from handover_ros.sim.robot import LimitCounts


@pytest.fixture
def cell():
    simulation = empty_cell()
    simulation.reset(seed=1)
    simulation.enable(True)
    return simulation


def home(arm="left"):
    return robot().arm(arm).home


def small_motion(arm="left", amount=0.3):
    names = robot().arm(arm).joint_names
    return names, *minimum_jerk(home(arm), home(arm) + amount * np.array([1, 0, 1, 0, 1, 0, 1.0]))


@given(
    values=st.lists(st.lists(st.floats(-2, 2), min_size=3, max_size=3), min_size=2, max_size=6),
    seed=st.integers(0, 1000),
)
@settings(deadline=None)
def test_path_meets_its_knots_and_is_smooth(values, seed):
    rng = np.random.default_rng(seed)
    positions = np.array(values)
    times = np.cumsum(rng.uniform(0.1, 1.0, len(positions)))
    velocities = rng.uniform(-1, 1, positions.shape)
    path = JointPath(times, positions, velocities)
    for time, position, velocity in zip(times[:-1], positions, velocities, strict=False):
        np.testing.assert_allclose(path.sample(time), (position, velocity), atol=1e-9)
    moments = np.linspace(times[0], times[-1] - 1e-6, 400)
    speeds = np.abs([path.sample(moment)[1] for moment in moments]).max(axis=0)
    assert np.all(speeds <= path.fastest() + 1e-9)
    np.testing.assert_allclose(speeds, path.fastest(), rtol=0.05, atol=0.05)


@given(velocity=st.lists(st.floats(-1.5, 1.5), min_size=7, max_size=7))
@settings(deadline=None)
def test_stop_keeps_to_the_deceleration(velocity):
    deceleration = robot().arm("left").acceleration
    path = JointPath.stopping(0.0, home(), np.array(velocity), deceleration)
    moments = np.linspace(0.0, path.end, 50)
    speeds = np.array([path.sample(moment)[1] for moment in moments])
    if path.end > 0.0:
        slowing = np.abs(np.diff(speeds, axis=0)) / np.diff(moments)[:, None]
        assert np.all(slowing <= deceleration * (1 + 1e-6))
    np.testing.assert_allclose(path.sample(path.end)[1], 0.0)


@pytest.mark.parametrize("arm", ["left", "right"])
def test_motion_is_tracked_within_a_hundredth_of_a_radian(cell, arm):
    model = robot().arm(arm)
    target = np.clip(model.home + 0.7, model.lower + 0.05, model.upper - 0.05)
    assert move(cell, arm, target) < 0.01
    np.testing.assert_allclose(cell.data.qpos[cell.world.arms[arm].positions], target, atol=0.002)
    assert cell.truth().counts == LimitCounts()


def test_both_arms_move_at_once(cell):
    left, right = small_motion("left"), small_motion("right")
    names = (*right[0], *left[0])
    cell.command_trajectory(names, left[1], np.hstack([right[2], left[2]]), np.hstack([right[3], left[3]]))
    cell.run(left[1][-1] + 0.3)
    for arm, motion in (("left", left), ("right", right)):
        np.testing.assert_allclose(cell.data.qpos[cell.world.arms[arm].positions], motion[2][-1], atol=0.005)


def test_new_trajectory_takes_over_without_a_jump(cell):
    cell.command_trajectory(*small_motion(amount=0.8))
    cell.run(0.3)
    names = robot().arm("left").joint_names
    cell.command_trajectory(names, [1.5], home()[None], np.zeros((1, 7)))
    before = cell.joint_state().velocities
    cell.step()
    assert np.abs(cell.joint_state().velocities - before).max() < 0.05
    cell.run(2.0)
    np.testing.assert_allclose(cell.data.qpos[cell.world.arms["left"].positions], home(), atol=0.005)


def test_disabled_robot_stops_and_stays(cell):
    cell.command_trajectory(*small_motion(amount=0.8))
    cell.run(0.3)
    cell.enable(False)
    cell.run(1.0)
    stopped = cell.data.qpos[cell.world.arms["left"].positions].copy()
    cell.run(1.0)
    np.testing.assert_allclose(cell.data.qpos[cell.world.arms["left"].positions], stopped, atol=1e-4)
    assert cell.truth().counts == LimitCounts()
    with pytest.raises(BadRequestError, match="robot/enable"):
        cell.command_trajectory(*small_motion())
    with pytest.raises(BadRequestError, match="robot/enable"):
        cell.command_gripper("left", 0.03)


def test_held_arm_stops_while_the_other_goes_on(cell):
    cell.command_trajectory(*small_motion("left", 0.5))
    cell.command_trajectory(*small_motion("right", 0.5))
    cell.run(0.2)
    cell.hold("left")
    cell.run(2.0)
    target = small_motion("right", 0.5)[2][-1]
    np.testing.assert_allclose(cell.data.qpos[cell.world.arms["right"].positions], target, atol=0.005)
    assert np.abs(cell.data.qpos[cell.world.arms["left"].positions] - home()).max() < 0.45
    with pytest.raises(UnknownNameError, match="left, right"):
        cell.hold("middle")


def broken(change):
    names, times, positions, velocities = small_motion()
    values = {"names": list(names), "times": times, "positions": positions.copy(), "velocities": velocities.copy()}
    change(values)
    return values["names"], values["times"], values["positions"], values["velocities"]


def put(key, index, value):
    def change(values):
        values[key] = np.array(values[key]) if key != "names" else values[key]
        values[key][index] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (put("positions", (3, 2), np.nan), "finite"),
        (put("velocities", (3, 2), np.inf), "finite"),
        (put("times", 5, 0.0), "increase"),
        (put("names", 0, "left_elbow"), "misses left_s0"),
        (lambda v: v["names"].append("head_pan"), "shape"),
        (put("names", 1, "left_s0"), "twice"),
        (put("positions", (-1, 0), 1.9), "outside"),
        (put("positions", (20, 0), 1.0), "limit is"),
        (put("velocities", (-1, 0), 0.5), "last point"),
        (put("times", 0, -0.1), "start at or above 0"),
        (lambda v: v.update(times=[], positions=np.empty((0, 7)), velocities=np.empty((0, 7))), "at least one"),
        (lambda v: v.update(times=[0.0], positions=home()[None], velocities=np.zeros((1, 7))), "above 0"),
        (
            lambda v: v.update(times=[0.0, 9.0], positions=home() + [[0.2], [0.0]], velocities=np.zeros((2, 7))),
            "starts",
        ),
    ],
)
def test_bad_trajectory_is_refused_and_changes_nothing(cell, change, message):
    with pytest.raises(BadRequestError, match=message):
        cell.command_trajectory(*broken(change))
    cell.run(0.2)
    np.testing.assert_allclose(cell.data.qpos[cell.world.arms["left"].positions], home(), atol=1e-3)


def test_unknown_joint_is_named(cell):
    names, times, positions, _ = small_motion()
    wider = np.hstack([positions, np.zeros((len(times), 1))])
    with pytest.raises(BadRequestError, match="unknown joint 'tail'"):
        cell.command_trajectory((*names, "tail"), times, wider, np.zeros_like(wider))


@pytest.mark.parametrize(("opening", "force"), [(np.nan, 5.0), (0.5, 5.0), (-0.1, 5.0), (0.03, 0.0), (0.03, np.nan)])
def test_bad_gripper_command_is_refused(cell, opening, force):
    with pytest.raises(BadRequestError, match="gripper command"):
        cell.command_gripper("left", opening, force)


def test_gripper_moves_to_its_opening(cell):
    for arm in robot().arm_names:
        closed, wide = robot().arm(arm).opening
        for opening in (closed, 0.5 * (closed + wide), wide):
            cell.command_gripper(arm, opening)
            cell.run(0.8)
            state = cell.gripper_state()
            assert state.openings[state.arms.index(arm)] == pytest.approx(opening, abs=0.001)
            assert state.gripping == (False, False)
