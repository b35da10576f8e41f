"""The compiled kinematics agree with pinocchio."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from handover_ros.geometry import make_transform
from handover_ros.robot import RobotModel, kinematics_kernels

ROBOT = RobotModel.load()
CHAINS = {arm: tuple(np.ascontiguousarray(part) for part in ROBOT.chain(arm)) for arm in ROBOT.arm_names}
ANGLES = st.lists(st.floats(-3.0, 3.0), min_size=7, max_size=7).map(np.array)
VECTORS = st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3).map(np.array)


@given(st.sampled_from(ROBOT.arm_names), ANGLES)
@settings(max_examples=50, deadline=None)
def test_pose_and_jacobian_equal_their_plain_twin(arm, displacements):
    jacobian = np.empty((6, 7))
    pose = kinematics_kernels.forward(*CHAINS[arm], displacements, jacobian)
    np.testing.assert_allclose(pose, ROBOT.gripper_pose(arm, displacements), atol=1e-10)
    np.testing.assert_allclose(jacobian, ROBOT.jacobian(arm, displacements), atol=1e-10)
    many = kinematics_kernels.forward_many(*CHAINS[arm], displacements[None])
    np.testing.assert_array_equal(many[0], pose)


@given(VECTORS, VECTORS, VECTORS, st.floats(0.0, np.pi))
@settings(deadline=None)
def test_pose_error_is_the_displacement_to_the_target(shift, start, axis, angle):
    """Position difference and rotation vector in world axes, up to half a turn."""
    axis = axis / np.linalg.norm(axis) if np.linalg.norm(axis) > 1e-3 else np.array([1.0, 0.0, 0.0])
    turn = Rotation.from_rotvec(angle * axis)
    pose = make_transform(Rotation.from_rotvec(start).as_matrix(), start)
    target = make_transform(turn.as_matrix() @ pose[:3, :3], start + shift)
    error = np.empty(6)
    kinematics_kernels.pose_error(target, pose, error)
    np.testing.assert_allclose(error[:3], shift, atol=1e-12)
    np.testing.assert_allclose(Rotation.from_rotvec(error[3:]).as_matrix(), turn.as_matrix(), atol=1e-4)
    assert np.linalg.norm(error[3:]) <= np.pi + 1e-3
