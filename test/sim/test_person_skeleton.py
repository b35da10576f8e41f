"""The true skeleton of a simulated person."""

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.arm.hand import hand_frames
from handover_ros.geometry import make_transform
from handover_ros.sim.person_kinematics import PersonKinematics
from handover_ros.sim.person_model import PREFIX, add_person
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.sim.person_spec import JOINTS, load_person
from handover_ros.skeleton.jacobian import WORLD_FRAME, manipulator_jacobian, relative_pose
from handover_ros.skeleton.reference import marker_positions

FEET = make_transform([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [0.4, -0.2, 0.0])
PEOPLE = ("adult", "small", "tall", "restricted")


def posture(person, seed):
    """Return random displacements (20,) within the person's limits."""
    return np.random.default_rng(seed).uniform(person.lower, person.upper)


@settings(max_examples=25, deadline=None)
@given(st.sampled_from(PEOPLE), st.integers(0, 10**6))
def test_markers_are_where_mujoco_has_them(name, seed):
    person = load_person(name)
    skeleton = skeleton_of(person)
    theta = posture(person, seed)
    spec = mujoco.MjSpec()
    add_person(spec, person, FEET)
    model = spec.compile()
    data = mujoco.MjData(model)
    for joint, value in zip(JOINTS, theta):
        data.qpos[model.joint(PREFIX + joint).qposadr[0]] = value
    mujoco.mj_kinematics(model, data)
    expected = [data.site(f"{PREFIX}marker/{marker}").xpos for marker in skeleton.marker_names]
    root = PersonKinematics(person, FEET).torso_pose(theta[:6])
    np.testing.assert_allclose(marker_positions(skeleton, theta[6:], root), expected, atol=1e-9)


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(("adult", "restricted")), st.integers(0, 10**6))
def test_hand_frames_and_jacobians_are_the_persons(name, seed):
    person = load_person(name)
    skeleton, kinematics = skeleton_of(person), PersonKinematics(person, FEET)
    theta = posture(person, seed)
    poses = kinematics.forward(theta)
    for side, hand in hand_frames(skeleton).items():
        pose = relative_pose(skeleton, theta[6:], WORLD_FRAME, hand.frame, poses.torso)
        np.testing.assert_allclose(pose, getattr(poses, f"{side}_hand"), atol=1e-9)
        jacobian = manipulator_jacobian(skeleton, theta[6:], WORLD_FRAME, hand.frame, poses.torso)
        np.testing.assert_allclose(jacobian, kinematics.jacobian(theta, side)[:, 6:], atol=1e-9)


@pytest.mark.parametrize("name", PEOPLE)
def test_names_limits_and_hands(name):
    person = load_person(name)
    skeleton = skeleton_of(person)
    assert skeleton.displacement_names == JOINTS[6:]
    assert skeleton.root == "torso"
    assert dict(skeleton.hands) == {"right": "right_hand", "left": "left_hand"}
    np.testing.assert_array_equal(skeleton.lower, person.lower[6:])
    np.testing.assert_array_equal(skeleton.upper, person.upper[6:])


@pytest.mark.parametrize("name", PEOPLE)
def test_grip_fits_people_of_every_size(name):
    """The grip scales with the forearm: within a millimetre of what the person's own file says."""
    person = load_person(name)
    hands = hand_frames(skeleton_of(person))
    for side, sign in (("right", -1.0), ("left", 1.0)):
        expected = [
            0.0,
            sign * (person.lengths.shoulder_half_width - person.lengths.grip_out),
            -person.lengths.upper_arm - person.lengths.forearm - person.lengths.grip_along,
        ]
        np.testing.assert_allclose(hands[side].zero_from_hand[:3, 3], expected, atol=1e-3)
