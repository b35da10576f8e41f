"""A person's arm: its geometry, where it comes from, and what is refused."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.arm import model
from handover_ros.arm.hand import hand_frames
from handover_ros.arm.model import JOINT_NAMES, Arm, arm_displacements, arm_of, arm_posture, load_arm
from handover_ros.errors import BadModelError, BadRequestError, UnknownNameError
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.sim.person_spec import load_person
from handover_ros.skeleton.jacobian import move_tree

PEOPLE = ("adult", "small", "tall", "restricted")
SIDES = ("right", "left")
HANGING = np.zeros(7)
FILE = """description: somebody
shoulder_half_width: 0.18
upper_arm: 0.3
forearm: 0.25
grip_along: 0.09
grip_out: 0.04
limits:
  shoulder_flexion: [-0.87, 2.9]
  shoulder_abduction: [-0.45, 2.4]
  shoulder_rotation: [-1.1, 1.4]
  elbow_flexion: [0.02, 2.5]
  forearm_pronation: [-1.45, 1.4]
  wrist_flexion: [-1.15, 1.25]
  wrist_deviation: [-0.6, 0.4]
"""


@pytest.mark.parametrize("side", SIDES)
def test_a_hanging_arm_hangs(side):
    arm = load_arm("adult", side)
    shoulder, elbow, wrist, grip = arm.limbs(HANGING)
    outward = -1.0 if side == "right" else 1.0
    np.testing.assert_allclose(shoulder, [0.0, outward * 0.18, 0.0])
    np.testing.assert_allclose(elbow - shoulder, [0.0, 0.0, -0.325], atol=1e-15)
    np.testing.assert_allclose(wrist - elbow, [0.0, 0.0, -0.255], atol=1e-15)
    np.testing.assert_allclose(grip - wrist, [0.0, -outward * 0.04, -0.088], atol=1e-15)
    pose = arm.hand_pose(HANGING)
    np.testing.assert_allclose(pose[:3, 3], grip)
    np.testing.assert_allclose(pose[:3, 0], [0.0, 0.0, -1.0], atol=1e-15)  # fingers down
    np.testing.assert_allclose(pose[:3, 2], [0.0, -outward, 0.0], atol=1e-15)  # palm to the body


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize(
    ("joint", "moves"),
    [  # which way the grip goes: forward, outward, up; the elbow bent for turns about the upper arm or forearm
        ("shoulder_flexion", (1, 0, 0)),
        ("shoulder_abduction", (0, 1, 0)),
        ("shoulder_rotation", (0, -1, 0)),
        ("elbow_flexion", (1, 0, 0)),
        ("wrist_flexion", (0, -1, 0)),
        ("wrist_deviation", (1, 0, 0)),
    ],
)
def test_positive_displacements_are_what_their_names_say(side, joint, moves):
    arm = load_arm("adult", side)
    q = HANGING.copy()
    if joint == "shoulder_rotation":
        q[3] = 0.5 * math.pi
    moved = q.copy()
    moved[JOINT_NAMES.index(joint)] += 0.1
    way = arm.limbs(moved)[3] - arm.limbs(q)[3]
    way[1] *= -1.0 if side == "right" else 1.0
    assert way @ np.array(moves, dtype=float) > 0.008


@pytest.mark.parametrize("side", SIDES)
@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**9))
def test_seen_limbs_give_the_displacements_back(side, seed):
    arm = load_arm("adult", side)
    lower, upper = np.maximum(arm.limits[0], -1.5), np.minimum(arm.limits[1], 1.5)
    q = np.random.default_rng(seed).uniform(lower, upper)
    shoulder, elbow, _, _ = arm.limbs(q)
    np.testing.assert_allclose(arm_displacements(arm, shoulder, elbow, arm.hand_pose(q)), q, atol=1e-7)


def test_poses_of_many_are_those_of_each():
    arm = load_arm("adult", "left")
    q = np.random.default_rng(0).uniform(*arm.limits, size=(3, 4, 7))
    poses = arm.hand_pose(q)
    assert poses.shape == (3, 4, 4, 4)
    assert arm.limbs(q).shape == (3, 4, 4, 3)
    np.testing.assert_allclose(poses[2, 1], arm.hand_pose(q[2, 1]), atol=1e-15)
    assert arm.within_limits(q).shape == (3, 4)
    assert arm.within_limits(q).all()
    assert not arm.within_limits(arm.limits[1] + 0.01)
    with pytest.raises(BadRequestError, match="7 displacements"):
        arm.hand_pose(np.zeros(6))


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("name", PEOPLE)
def test_the_arm_of_a_skeleton_is_the_persons(name, side):
    person = load_person(name)
    arm = arm_of(skeleton_of(person), side)
    lengths = person.lengths
    assert (arm.upper_arm, arm.forearm) == (pytest.approx(lengths.upper_arm), pytest.approx(lengths.forearm))
    outward = -1.0 if side == "right" else 1.0
    np.testing.assert_allclose(arm.shoulder, [0.0, outward * lengths.shoulder_half_width, 0.0], atol=1e-12)
    columns = [skeleton_of(person).displacement_names.index(f"{side}_{joint}") for joint in JOINT_NAMES]
    expected = [skeleton_of(person).lower[columns], skeleton_of(person).upper[columns]]
    np.testing.assert_allclose(arm.limits, np.clip(expected, -math.pi, math.pi), atol=1e-9)


@pytest.mark.parametrize("side", SIDES)
def test_the_posture_of_an_arm_is_the_tracked_one(side):
    """A true skeleton's displacements are the arm's, wherever the torso is; so is the pose of the grip."""
    skeleton = skeleton_of(load_person("adult"))
    arm = arm_of(skeleton, side)
    columns = [skeleton.displacement_names.index(f"{side}_{joint}") for joint in JOINT_NAMES]
    rng = np.random.default_rng(1)
    for _ in range(40):  # abduction beyond a right angle too
        displacements = np.zeros(len(skeleton.lower))
        displacements[columns] = q = rng.uniform(*arm.limits)
        np.testing.assert_allclose(arm_posture(arm, skeleton, displacements), q, atol=1e-7)
        frame = hand_frames(skeleton)[side]
        pose = move_tree(skeleton, displacements).poses[skeleton.joint_carrying(frame.segment) + 1]
        np.testing.assert_allclose(arm.hand_pose(q), pose @ frame.zero_from_hand, atol=1e-9)


def test_skeletons_without_an_arm_are_refused():
    skeleton = skeleton_of(load_person("adult"))
    with pytest.raises(BadModelError, match="no left hand"):
        arm_of(replace(skeleton, hands=tuple(hand for hand in skeleton.hands if hand[0] == "right")), "left")
    upper = skeleton.upper.copy()
    upper[skeleton.displacement_names.index("right_elbow_flexion")] = np.inf
    with pytest.raises(BadModelError, match="elbow_flexion are unknown"):
        arm_of(replace(skeleton, upper=upper), "right")


GOOD = load_arm("adult")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"side": "middle"}, "left or right"),
        ({"upper_arm": 0.0}, "positive"),
        ({"forearm": -0.1}, "positive"),
        ({"forearm": math.nan}, "finite"),
        ({"grip_out": math.inf}, "finite"),
        ({"shoulder": np.zeros(2)}, "shoulder"),
        ({"shoulder": np.array([0.0, np.nan, 0.0])}, "finite"),
        ({"limits": np.zeros((7, 2))}, "shape"),
        ({"limits": np.full((2, 7), np.nan)}, "finite"),
        ({"limits": np.array([[0.1] * 7, [0.0] * 7])}, "shoulder_flexion are 0.1 to 0 rad"),
        ({"limits": np.array([[-3.2] * 7, [0.0] * 7])}, "within half a turn"),
    ],
)
def test_impossible_arms_are_refused(changes, message):
    with pytest.raises(BadModelError, match=message):
        replace(GOOD, **changes)


def test_arrays_are_read_only_and_not_the_callers():
    limits = np.array(GOOD.limits)
    arm = Arm("right", 0.3, 0.25, np.zeros(3), 0.09, 0.04, limits)
    limits[0, 0] = -3.0
    assert arm.limits[0, 0] == GOOD.limits[0, 0]
    for array in (arm.limits, arm.shoulder, arm.lengths, arm.right_shoulder):
        assert not array.flags.writeable


def test_an_unknown_arm_is_refused_with_the_known_ones():
    with pytest.raises(UnknownNameError, match="adult"):
        load_arm("octopus")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("upper_arm: 0.3", "upper_arm: -0.3", "upper_arm"),
        ("forearm: 0.25\n", "", "forearm"),
        ("grip_out: 0.04", "grip_out: much", "grip_out"),
        ("[-0.87, 2.9]", "[2.9, -0.87]", "lower limit"),
        ("[-0.6, 0.4]", "[-0.6, 4.0]", "wrist_deviation"),
        ("  wrist_deviation: [-0.6, 0.4]\n", "", "wrist_deviation"),
        ("description: somebody", "description: somebody\nhat: true", "hat"),
    ],
)
def test_wrong_files_are_refused_with_file_and_field(tmp_path, monkeypatch, old, new, message):
    path = tmp_path / "odd.yaml"
    path.write_text(FILE.replace(old, new), encoding="utf-8")
    monkeypatch.setattr(model, "config_file", lambda *_: path)
    with pytest.raises(BadModelError, match=message) as caught:
        load_arm("odd")
    assert "odd" in str(caught.value)


def test_a_right_file_is_taken(tmp_path, monkeypatch):
    path = tmp_path / "odd.yaml"
    path.write_text(FILE, encoding="utf-8")
    monkeypatch.setattr(model, "config_file", lambda *_: path)
    assert load_arm("odd", "left").shoulder.tolist() == [0.0, 0.18, 0.0]
