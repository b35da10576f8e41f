"""What a person's forearm and hand keep out of where an object is put down."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from handover_ros.arm.model import load_arm
from handover_ros.geometry import invert_transform, make_transform, transform_from_xyz_rpy
from handover_ros.planning.obstacles import (
    FOREARM_POINTS,
    FOREARM_RADII,
    HAND_POINTS,
    HAND_RADIUS,
    Obstacles,
    obstacles_of,
)

ARM = load_arm()
seeds = st.integers(0, 10**6)


def boxes_of(seed, count):
    rng = np.random.default_rng(seed)
    return [
        (
            rng.uniform(0.02, 0.5, 3),
            make_transform(
                Rotation.random(random_state=rng).as_matrix(), rng.uniform([0.0, -0.6, -0.6], [0.7, 0.4, 0.4])
            ),
        )
        for _ in range(count)
    ]


def limbs_of(seed, count):
    return ARM.limbs(np.random.default_rng(seed).uniform(*ARM.limits, (count, 7)))


def balls(limb):
    """Yield centre and radius of the balls along forearm and hand of one arm's points (4, 3)."""
    _, elbow, wrist, grip = limb
    for i in range(FOREARM_POINTS):
        share = i / (FOREARM_POINTS - 1)
        thick, thin = FOREARM_RADII
        yield elbow + share * (wrist - elbow), thick + share * (thin - thick)
    for i in range(1, HAND_POINTS + 1):
        yield wrist + i / HAND_POINTS * (grip - wrist), HAND_RADIUS


def plain_free(boxes, world_from_torso, limb):
    """Return whether one arm is free: every ball against every box, in the world."""
    for centre, radius in balls(limb):
        world = world_from_torso[:3, :3] @ centre + world_from_torso[:3, 3]
        for size, pose in boxes:
            local = pose[:3, :3].T @ (world - pose[:3, 3])
            nearest = [min(max(x, -length / 2.0), length / 2.0) for x, length in zip(local, size)]
            if np.linalg.norm(local - nearest) < radius:
                return False
    return True


@given(seeds, st.integers(1, 4))
@settings(max_examples=40, deadline=None)
def test_what_is_free_is_what_the_plain_loop_finds_free(seed, count):
    """Forearm and hand as balls, against boxes in any pose, for a torso in any pose."""
    rng = np.random.default_rng([seed, 1])
    torso = make_transform(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3))
    boxes = [(size, torso @ pose) for size, pose in boxes_of(seed, count)]
    limbs = limbs_of(seed, 25)
    expected = [plain_free(boxes, torso, limb) for limb in limbs]
    assert obstacles_of(boxes, torso).free(limbs).tolist() == expected


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_another_box_never_frees_an_arm(seed):
    """With more boxes fewer postures are free, and with larger ones too; all apart together is each apart."""
    boxes, limbs = boxes_of(seed, 3), limbs_of(seed, 40)
    together = obstacles_of(boxes, np.eye(4)).free(limbs)
    each = [obstacles_of([box], np.eye(4)).free(limbs) for box in boxes]
    np.testing.assert_array_equal(together, np.all(each, axis=0))
    larger = obstacles_of([(size + 0.1, pose) for size, pose in boxes], np.eye(4)).free(limbs)
    assert not (larger & ~together).any()


def test_a_shelf_over_the_object_blocks_hands_from_above():
    """A board 6 cm over the place of the grip stops the forearm that comes down through it, not the one from below."""
    grip = np.array([0.45, -0.2, -0.1])
    wrist_above, elbow_above = grip + [-0.02, 0.0, 0.09], grip + [-0.15, 0.0, 0.33]
    wrist_level, elbow_level = grip + [-0.09, 0.0, -0.01], grip + [-0.34, 0.0, -0.06]
    shoulder = np.array([0.0, -0.18, 0.0])
    limbs = np.array([[shoulder, elbow_above, wrist_above, grip], [shoulder, elbow_level, wrist_level, grip]])
    shelf = [(np.array([0.5, 1.0, 0.02]), transform_from_xyz_rpy([*(grip + [0.0, 0.0, 0.06])]))]
    assert obstacles_of(shelf, np.eye(4)).free(limbs).tolist() == [False, True]


def test_a_thin_board_lets_no_arm_through():
    """The balls overlap: a board of 2 cm across the forearm is met wherever it crosses."""
    shoulder, elbow, wrist = np.zeros(3), np.array([0.2, 0.0, 0.0]), np.array([0.2 + ARM.forearm, 0.0, 0.0])
    limb = np.array([[shoulder, elbow, wrist, wrist + [ARM.grip_along, 0.0, 0.0]]])
    for x in np.linspace(0.2, 0.2 + ARM.forearm + ARM.grip_along, 40):
        board = [(np.array([0.005, 1.0, 1.0]), transform_from_xyz_rpy([x, 0.0, 0.0]))]
        assert not obstacles_of(board, np.eye(4)).free(limb)[0]


def test_an_arm_inside_a_box_is_not_free():
    """Inside the distance is zero, not negative and squared away."""
    limb = limbs_of(0, 5)
    assert not obstacles_of([(np.full(3, 4.0), np.eye(4))], np.eye(4)).free(limb).any()


def test_the_upper_arm_may_touch():
    """Only forearm and hand count: a box at the shoulder blocks nothing."""
    limb = np.array([[[0.0, -0.18, 0.0], [0.0, -0.18, -0.325], [0.255, -0.18, -0.325], [0.34, -0.18, -0.325]]])
    shoulder = [(np.full(3, 0.2), transform_from_xyz_rpy([0.0, -0.18, 0.0]))]
    assert obstacles_of(shoulder, np.eye(4)).free(limb)[0]


def test_no_boxes_are_no_obstacles():
    """None for none; obstacles without boxes block nothing; no arm gives no answer."""
    assert obstacles_of([], np.eye(4)) is None
    assert Obstacles(np.empty((0, 4, 4)), np.empty((0, 3))).free(limbs_of(1, 9)).all()
    assert obstacles_of(boxes_of(0, 2), np.eye(4)).free(np.empty((0, 4, 3))).shape == (0,)


def test_boxes_are_given_in_the_world():
    """box_from_torso leads from the torso to the box, half lengths are halves."""
    torso, pose = transform_from_xyz_rpy([1.0, 2.0, 1.4], [0, 0, 1.0]), transform_from_xyz_rpy([1.5, 2.0, 0.7])
    found = obstacles_of([(np.array([0.4, 0.6, 0.02]), pose)], torso)
    np.testing.assert_allclose(found.box_from_torso[0], invert_transform(pose) @ torso, atol=1e-12)
    assert found.half[0] == pytest.approx([0.2, 0.3, 0.01])
