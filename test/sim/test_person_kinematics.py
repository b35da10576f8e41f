"""The person's kinematics against MuJoCo and against each other."""

from functools import cache

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.geometry import transform_from_xyz_rpy
from handover_ros.sim.person_kinematics import MIRROR, PersonKinematics
from handover_ros.sim.person_model import PREFIX, add_person
from handover_ros.sim.person_spec import ARM_SLICE, HANDS, JOINTS, MARKERS, load_person

WORLD_FROM_FEET = transform_from_xyz_rpy((1.4, 0.1, 0.02), (0.0, 0.0, 2.8))
seeds = st.integers(0, 2**32 - 1)


@cache
def body(name: str):
    person = load_person(name)
    spec = mujoco.MjSpec()
    add_person(spec, person, WORLD_FROM_FEET)
    model = spec.compile()
    return person, PersonKinematics(person, WORLD_FROM_FEET), model, mujoco.MjData(model)


def posture(person, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(person.lower, person.upper)


def put(model, data, displacements: np.ndarray) -> None:
    for name, value in zip(JOINTS, displacements, strict=True):
        data.joint(PREFIX + name).qpos = value
    mujoco.mj_forward(model, data)


@pytest.mark.parametrize("name", ["adult", "small", "tall"])
@given(seed=seeds)
@settings(max_examples=15, deadline=None)
def test_forward_and_jacobian_agree_with_mujoco(name, seed):
    person, kinematics, model, data = body(name)
    displacements = posture(person, seed)
    put(model, data, displacements)
    poses = kinematics.forward(displacements)
    columns = [model.joint(PREFIX + joint).dofadr[0] for joint in JOINTS]
    sites = {"torso": poses.torso, "right_hand_grip": poses.right_hand, "left_hand_grip": poses.left_hand}
    for site, pose in sites.items():
        assert np.allclose(data.site(PREFIX + site).xpos, pose[:3, 3], atol=1e-9)
        assert np.allclose(data.site(PREFIX + site).xmat.reshape(3, 3), pose[:3, :3], atol=1e-9)
    for hand in HANDS:
        linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, linear, angular, model.site(f"{PREFIX}{hand}_hand_grip").id)
        expected = np.concatenate([linear, angular])[:, columns]
        assert np.allclose(kinematics.jacobian(displacements, hand), expected, atol=1e-9)


@given(seed=seeds, swivel=st.floats(-1.5, 2.5), hand=st.sampled_from(HANDS))
@settings(max_examples=60, deadline=None)
def test_the_inverse_reaches_the_pose_with_the_wanted_swivel(seed, swivel, hand):
    person, kinematics, _, _ = body("adult")
    arm = posture(person, seed)[ARM_SLICE[hand]]
    pose = kinematics.arm_pose(hand, arm)
    found = kinematics.inverse(hand, pose[None], np.array([swivel]))[0, 0]
    assert np.allclose(kinematics.arm_pose(hand, found), pose, atol=1e-7)
    turned = kinematics.swivel(hand, found) - swivel
    assert abs((turned + np.pi) % (2 * np.pi) - np.pi) < 1e-4


@given(seed=seeds)
@settings(max_examples=30, deadline=None)
def test_the_arms_are_mirror_images(seed):
    person, kinematics, _, _ = body("adult")
    arm = posture(person, seed)[ARM_SLICE["right"]]
    assert np.allclose(MIRROR @ kinematics.arm_pose("right", arm) @ MIRROR, kinematics.arm_pose("left", arm))


def test_out_of_reach_is_nan():
    _, kinematics, _, _ = body("adult")
    far = transform_from_xyz_rpy((2.0, 0.0, 0.0))
    assert np.isnan(kinematics.inverse("right", far[None], np.array([0.0]))).any()


@given(seed=seeds)
@settings(max_examples=30, deadline=None)
def test_torso_coordinates_invert_the_torso_pose(seed):
    person, kinematics, _, _ = body("adult")
    torso = posture(person, seed)[:6]
    assert np.allclose(kinematics.torso_coordinates(kinematics.torso_pose(torso)), torso, atol=1e-9)


@given(seed=seeds)
@settings(max_examples=20, deadline=None)
def test_markers_stay_rigid_on_their_segments(seed):
    """Distances between markers of one segment do not change with the posture."""
    person, _, model, data = body("adult")
    segments: dict[str, list[str]] = {}
    for label in MARKERS:
        segments.setdefault(person.markers[label].segment, []).append(label)
    for labels in segments.values():
        distances = []
        for displacements in (np.zeros(20), posture(person, seed)):
            put(model, data, displacements)
            points = np.array([data.site(f"{PREFIX}marker/{label}").xpos for label in labels])
            distances.append(np.linalg.norm(points[:, None] - points[None], axis=-1))
        assert np.allclose(*distances, atol=1e-9)


@pytest.mark.parametrize("name", ["adult", "small", "tall", "restricted"])
def test_groups_bits_mass_and_markers_off_the_skin(name):
    person, _, model, data = body(name)
    put(model, data, np.zeros(20))
    assert np.isclose(model.body_mass.sum(), person.mass, rtol=1e-6)
    assert set(model.geom_group) == {2, 4}
    assert not np.any(model.geom_contype & ~np.uint8(8))
    assert not np.any(model.geom_conaffinity)
    assert np.all(model.geom_contype[model.geom_group == 2] == 0)
    assert np.allclose(model.body_gravcomp[1:], 1.0)
    torso = data.site(f"{PREFIX}torso").xpos
    for label in MARKERS:
        site = data.site(f"{PREFIX}marker/{label}").xpos.copy()
        start = data.body(f"{PREFIX}{person.markers[label].segment}").xpos
        inward = start - site if label[1:4] == "ARM" else torso * [1, 1, 0] + [0, 0, site[2]] - site
        group = np.array([0, 0, 0, 0, 1, 0], dtype=np.uint8)
        distance = mujoco.mj_ray(
            model, data, site, inward / np.linalg.norm(inward), group, 1, -1, np.zeros(1, np.int32)
        )
        assert distance > 0.004, label
