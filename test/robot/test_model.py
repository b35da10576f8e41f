"""The robot's kinematics."""

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.errors import BadModelError, BadRequestError, UnknownNameError
from handover_ros.resources import config_file
from handover_ros.robot import RobotModel

ROBOT = RobotModel.load()
UNIT = st.lists(st.floats(0.02, 0.98), min_size=7, max_size=7)
ARMS = st.sampled_from(ROBOT.arm_names)


def displacements(arm, fractions):
    model = ROBOT.arm(arm)
    return model.lower + np.array(fractions) * (model.upper - model.lower)


@given(ARMS, UNIT)
@settings(max_examples=30, deadline=None)
def test_jacobian_is_the_derivative_of_the_pose(arm, fractions):
    """J dq is the change of the gripper pose, to first order."""
    q, step = displacements(arm, fractions), 1e-6
    pose, jacobian = ROBOT.gripper_pose(arm, q), ROBOT.jacobian(arm, q)
    for joint in range(7):
        moved = ROBOT.gripper_pose(arm, q + step * np.eye(7)[joint])
        turn = (moved[:3, :3] @ pose[:3, :3].T - np.eye(3)) / step
        angular = np.array([turn[2, 1], turn[0, 2], turn[1, 0]])
        numeric = np.concatenate([(moved[:3, 3] - pose[:3, 3]) / step, angular])
        np.testing.assert_allclose(jacobian[:, joint], numeric, atol=1e-4)


@given(ARMS, UNIT, st.lists(st.floats(-20.0, 20.0), min_size=3, max_size=3))
@settings(max_examples=30, deadline=None)
def test_external_force_is_recovered_from_the_torques_that_balance_it(arm, fractions, force):
    """Torques -J_v^T f give back f, but for the little damping."""
    q = displacements(arm, fractions)
    linear = ROBOT.jacobian(arm, q)[:3]
    least = np.linalg.svd(linear)[1][-1]
    found = ROBOT.external_force(arm, q, -linear.T @ np.array(force))
    np.testing.assert_allclose(found, force, atol=1e-9 + 1e-3 * np.linalg.norm(force) / max(least, 1e-3) ** 2)


def test_arms_mirror_each_other():
    """With mirrored displacements the grippers are mirrored in the robot's middle plane."""
    left = ROBOT.gripper_pose("left", ROBOT.arm("left").home)
    right = ROBOT.gripper_pose("right", ROBOT.arm("right").home)
    np.testing.assert_allclose(right[:3, 3], left[:3, 3] * [1, -1, 1], atol=1e-4)


def test_zero_pose_is_that_of_the_urdf():
    """The chain of fixed numbers in Baxter's URDF, by hand: the gripper at zero displacements."""
    along = 0.055695 + 0.069 + 0.102 + 0.26242 + 0.10359 + 0.2707 + 0.115975 + 0.11355 + 0.025 + 0.1327
    height = 0.93 + 0.118588 + 0.011038 + 0.27035 - 0.069 - 0.01
    expected = [0.024645 + along * np.cos(0.7854), 0.219645 + along * np.sin(0.7854), height]
    np.testing.assert_allclose(ROBOT.gripper_pose("left", np.zeros(7))[:3, 3], expected, atol=1e-4)


def test_limits_are_those_of_the_urdf():
    arm = ROBOT.arm("left")
    np.testing.assert_allclose(arm.velocity, [1.5] * 4 + [4.0] * 3)
    np.testing.assert_allclose(arm.effort, [50.0] * 4 + [15.0] * 3)
    np.testing.assert_allclose(arm.planning_velocity, 0.7 * arm.velocity)
    with pytest.raises(ValueError, match="read-only"):
        arm.lower[0] = 0.0


@given(ARMS, st.floats(0.0, 0.1))
def test_fingers_stay_in_limits_and_open_monotonically(arm, opening):
    """Any opening maps to finger displacements within their limits; wider means farther from zero."""
    fingers = ROBOT.finger_displacements(arm, opening)
    assert np.all(np.abs(fingers) <= 0.020833 + 1e-12)
    assert np.all(np.abs(ROBOT.finger_displacements(arm, opening + 0.01)) >= np.abs(fingers) - 1e-12)


@pytest.mark.parametrize(
    ("values", "words"), [([0.0] * 6, "7 finite"), ([np.nan] * 7, "7 finite"), ([9.0] + [0.0] * 6, "left_s0")]
)
def test_displacements_are_checked(values, words):
    with pytest.raises(BadRequestError, match=words):
        ROBOT.arm("left").check(values)


def test_unknown_names_list_the_known():
    with pytest.raises(UnknownNameError, match="left, right"):
        ROBOT.arm("middle")
    with pytest.raises(UnknownNameError, match="home"):
        ROBOT.arm("left").posture("yoga")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda arm: arm.update(tip_frame="nose"), "nose"),
        (lambda arm: arm["joints"].__setitem__(0, "left_s9"), "left_s9"),
    ],
)
def test_names_that_the_urdf_has_not_are_told(tmp_path, change, words):
    content = yaml.safe_load(config_file("robots", "baxter").read_text())
    change(content["arms"]["left"])
    path = tmp_path / "robot.yaml"
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(BadModelError, match=words):
        RobotModel.load(str(path))
