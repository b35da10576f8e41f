"""The manipulator Jacobian between any two frames."""

import numpy as np
import pinocchio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_trees import pinocchio_posture, random_pose, random_skeleton
from scipy.spatial.transform import Rotation

from handover_ros.errors import BadModelError, UnknownNameError
from handover_ros.geometry import make_transform
from handover_ros.skeleton.jacobian import (
    WORLD_FRAME,
    Frame,
    exponential,
    manipulator_jacobian,
    move_tree,
    relative_pose,
)
from handover_ros.skeleton.reference import segment_pose
from handover_ros.skeleton.tree import WORLD
from handover_ros.skeleton.urdf import skeleton_urdf

STEP = 1e-6
seeds = st.integers(0, 10**6)


def some_frames(skeleton, rng):
    """Return two frames on random segments, the world included."""
    segments = [WORLD, *(joint.segment for joint in skeleton.joints)]
    return [Frame(segments[rng.integers(len(segments))], random_pose(rng)) for _ in range(2)]


def numerical_jacobian(skeleton, theta, base, manipulator, root):
    """Return the Jacobian (6, n) by central differences of the relative pose."""
    pose = relative_pose(skeleton, theta, base, manipulator, root)
    columns = []
    for step in STEP * np.eye(len(theta)):
        plus = relative_pose(skeleton, theta + step, base, manipulator, root)
        minus = relative_pose(skeleton, theta - step, base, manipulator, root)
        rate = (plus - minus) / (2.0 * STEP)
        spin = rate[:3, :3] @ pose[:3, :3].T
        columns.append([*rate[:3, 3], spin[2, 1], spin[0, 2], spin[1, 0]])
    return np.array(columns).reshape(-1, 6).T


@settings(max_examples=60, deadline=None)
@given(seeds, st.booleans())
def test_equals_finite_differences_of_the_relative_pose(seed, free):
    rng = np.random.default_rng(seed)
    skeleton = random_skeleton(seed, free=free)
    theta = rng.uniform(-2.0, 2.0, len(skeleton.displacement_names))
    base, manipulator = some_frames(skeleton, rng)
    root = random_pose(rng)
    jacobian = manipulator_jacobian(skeleton, theta, base, manipulator, root)
    np.testing.assert_allclose(
        jacobian, numerical_jacobian(skeleton, theta, base, manipulator, root), rtol=1e-6, atol=2e-7
    )


@settings(max_examples=40, deadline=None)
@given(seeds)
def test_equals_pinocchio(seed):
    """Pinocchio knows Jacobians against the world: the relative one follows from two of them."""
    rng = np.random.default_rng(seed)
    skeleton = random_skeleton(seed)
    theta = rng.uniform(-2.0, 2.0, len(skeleton.displacement_names))
    model = pinocchio.buildModelFromXML(skeleton_urdf(skeleton))
    frames = some_frames(skeleton, rng)
    ids = []
    for frame in frames:
        if frame.segment == WORLD:
            body, origin = 0, np.zeros(3)
        else:
            joint = skeleton.joints[skeleton.joint_carrying(frame.segment)]
            body, origin = model.getFrameId(frame.segment, pinocchio.FrameType.BODY), joint.point
        placement = make_transform(np.eye(3), -origin) @ frame.zero_from_frame
        parent = model.frames[body].parentJoint
        in_joint = model.frames[body].placement.homogeneous @ placement
        ids.append(
            model.addFrame(
                pinocchio.Frame(f"f{len(ids)}", parent, body, pinocchio.SE3(in_joint), pinocchio.FrameType.OP_FRAME)
            )
        )
    data = model.createData()
    q = pinocchio_posture(model, skeleton, theta)
    base, manipulator = (
        pinocchio.computeFrameJacobian(model, data, q, each, pinocchio.ReferenceFrame.WORLD) for each in ids
    )
    pinocchio.framesForwardKinematics(model, data, q)
    base_from_world = data.oMf[ids[0]].inverse()
    spatial = base_from_world.toActionMatrix() @ (manipulator - base)
    origin = (base_from_world * data.oMf[ids[1]]).translation
    spatial[:3] += np.cross(spatial[3:].T, origin).T
    order = [model.joints[model.getJointId(name)].idx_v for name in skeleton.displacement_names]
    np.testing.assert_allclose(
        manipulator_jacobian(skeleton, theta, frames[0], frames[1]), spatial[:, order], atol=1e-9
    )


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_poses_are_those_of_the_dissertation(seed):
    rng = np.random.default_rng(seed)
    skeleton = random_skeleton(seed)
    theta = rng.uniform(-2.0, 2.0, len(skeleton.displacement_names))
    root = random_pose(rng)
    poses = move_tree(skeleton, theta, root).poses
    for index, joint in enumerate(skeleton.joints):
        np.testing.assert_allclose(poses[index + 1], segment_pose(skeleton, theta, joint.segment, root), atol=1e-9)


@settings(max_examples=10, deadline=None)
@given(seeds)
def test_many_postures_at_once_are_each_posture_alone(seed):
    rng = np.random.default_rng(seed)
    skeleton = random_skeleton(seed)
    theta = rng.uniform(-2.0, 2.0, (3, 2, len(skeleton.displacement_names)))
    base, manipulator = some_frames(skeleton, rng)
    many = manipulator_jacobian(skeleton, theta, base, manipulator)
    for index in np.ndindex(3, 2):
        np.testing.assert_allclose(many[index], manipulator_jacobian(skeleton, theta[index], base, manipulator))


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_root_pose_does_not_matter_between_two_segments(seed):
    rng = np.random.default_rng(seed)
    skeleton = random_skeleton(seed)
    theta = rng.uniform(-2.0, 2.0, len(skeleton.displacement_names))
    base, manipulator = Frame("segment1", random_pose(rng)), Frame("segment4", random_pose(rng))
    np.testing.assert_allclose(
        manipulator_jacobian(skeleton, theta, base, manipulator, random_pose(rng)),
        manipulator_jacobian(skeleton, theta, base, manipulator),
        atol=1e-9,
    )


def test_a_frame_does_not_move_against_itself():
    rng = np.random.default_rng(0)
    skeleton = random_skeleton(0)
    frame = Frame("segment3", random_pose(rng))
    assert not manipulator_jacobian(skeleton, rng.normal(size=len(skeleton.displacement_names)), frame, frame).any()


def test_exponential_of_an_axis_away_from_the_origin():
    """A quarter turn about the vertical axis through (1, 0, 0) takes the origin to (1, -1, 0)."""
    pose = exponential(np.array([0.0, -1.0, 0.0, 0.0, 0.0, 1.0]), np.array(np.pi / 2.0))
    np.testing.assert_allclose(pose[:3, 3], [1.0, -1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(pose[:3, :3], Rotation.from_euler("z", 90, degrees=True).as_matrix(), atol=1e-12)


def test_what_is_no_frame_is_refused():
    with pytest.raises(BadModelError, match="orthonormal"):
        Frame("hand", 2.0 * np.eye(4))
    with pytest.raises(BadModelError, match="4x4"):
        Frame("hand", np.full((4, 4), np.nan))
    skeleton = random_skeleton(0)
    with pytest.raises(UnknownNameError, match="tail"):
        manipulator_jacobian(skeleton, skeleton.middle, WORLD_FRAME, Frame("tail", np.eye(4)))
