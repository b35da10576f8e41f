"""The feasible workspace as a volume."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.arm.hand import hand_frames
from handover_ros.arm.workspace import Workspace, frame_workspace, hand_workspace
from handover_ros.errors import BadModelError, BadRequestError, UnknownNameError
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.sim.person_spec import load_person
from handover_ros.skeleton.jacobian import WORLD_FRAME, Frame, relative_pose
from handover_ros.skeleton.tree import WORLD, Joint, JointKind, Skeleton

ADULT, RESTRICTED = (skeleton_of(load_person(name)) for name in ("adult", "restricted"))
COARSE = 0.06
seeds = st.integers(0, 10**6)


def box(sides):
    """Three slides: a workspace that is a box with a corner at the origin."""
    segments = (WORLD, "a", "b", "c")
    joints = tuple(
        Joint(name, JointKind.PRISMATIC, parent, name, (f"along_{name}",), np.eye(3)[i : i + 1], np.zeros(3))
        for i, (parent, name) in enumerate(pairwise(segments))
    )
    return Skeleton("box", joints, (), (), np.zeros((0, 3)), np.zeros(3), np.array(sides))


def boxes(seed, voxel=0.1):
    rng = np.random.default_rng(seed)
    filled = np.zeros((12, 12, 12), dtype=bool)
    filled[2:-2, 2:-2, 2:-2] = rng.random((8, 8, 8)) < 0.5
    return Workspace(voxel, rng.integers(-5, 5, 3), filled)


@pytest.fixture(scope="module")
def spaces():
    return {name: hand_workspace(s, "right", COARSE) for name, s in (("adult", ADULT), ("restricted", RESTRICTED))}


@settings(max_examples=6, deadline=None)
@given(st.tuples(*[st.floats(0.3, 0.9)] * 3))
def test_volume_of_a_box(sides):
    """The rim is known to one voxel in each direction."""
    voxel = 0.03
    space = frame_workspace(box(sides), Frame("c", np.eye(4)), voxel)
    assert np.prod(np.subtract(sides, voxel)) <= space.volume <= np.prod(np.add(sides, voxel))
    assert space.litres == pytest.approx(1e3 * space.volume)


def test_volume_of_a_ball():
    """A shoulder that turns all ways and a slide of 0.5 m reach a ball of that radius."""
    joints = (
        Joint("shoulder", JointKind.BALL, WORLD, "arm", ("x", "y", "z"), np.eye(3), np.zeros(3)),
        Joint("slide", JointKind.PRISMATIC, "arm", "tip", ("out",), np.eye(3)[:1], np.zeros(3)),
    )
    limits = np.array([np.pi, np.pi, np.pi, 0.5])
    skeleton = Skeleton("ball", joints, (), (), np.zeros((0, 3)), np.array([*-limits[:3], 0.0]), limits)
    space = frame_workspace(skeleton, Frame("tip", np.eye(4)), 0.03)
    assert space.volume == pytest.approx(4.0 / 3.0 * np.pi * 0.5**3, rel=0.03)


@settings(max_examples=10, deadline=None)
@given(seeds)
def test_holds_the_hand_in_every_posture_within_limits(spaces, seed):
    theta = np.random.default_rng(seed).uniform(ADULT.lower, ADULT.upper, (500, 14))
    hands = relative_pose(ADULT, theta, WORLD_FRAME, hand_frames(ADULT)["right"].frame)[:, :3, 3]
    assert spaces["adult"].contains(hands).mean() > 0.995


def test_no_point_is_beyond_the_arm(spaces):
    lengths = load_person("adult").lengths
    hand = np.hypot(lengths.grip_along, lengths.grip_out)
    reach = lengths.upper_arm + lengths.forearm + hand + COARSE
    distance = np.linalg.norm(spaces["adult"].centres + [0.0, lengths.shoulder_half_width, 0.0], axis=1)
    assert distance.max() <= reach


def test_a_strap_takes_most_of_the_workspace(spaces):
    adult, restricted = spaces["adult"], spaces["restricted"]
    assert restricted.volume < 0.1 * adult.volume
    assert restricted.difference(adult).volume < 0.05 * restricted.volume
    assert restricted.overlap(adult).volume == pytest.approx(restricted.volume, rel=0.1)


def test_left_and_right_are_mirror_images(spaces):
    left = hand_workspace(ADULT, "left", COARSE)
    assert left.volume == pytest.approx(spaces["adult"].volume, rel=0.01)
    assert spaces["adult"].contains(left.centres * [1.0, -1.0, 1.0]).mean() > 0.97


@given(seeds, seeds)
def test_overlap_difference_and_union_are_those_of_sets(seed, other):
    a, b = boxes(seed), boxes(other)
    points = np.random.default_rng(seed).uniform(-1.0, 2.0, (200, 3))
    in_a, in_b = a.contains(points), b.contains(points)
    np.testing.assert_array_equal(a.overlap(b).contains(points), in_a & in_b)
    np.testing.assert_array_equal(a.difference(b).contains(points), in_a & ~in_b)
    np.testing.assert_array_equal(a.union(b).contains(points), in_a | in_b)
    assert a.filled.sum() == a.overlap(b).filled.sum() + a.difference(b).filled.sum()


@given(seeds)
def test_contains_its_own_voxels_and_nothing_far(seed):
    space = boxes(seed)
    assert space.contains(space.centres).all()
    assert not space.contains([[50.0, 0.0, 0.0], [-50.0, 0.0, 0.0]]).any()
    assert space.contains(space.centres[0]).shape == ()


def test_the_same_seed_gives_the_same_volume(spaces):
    np.testing.assert_array_equal(hand_workspace(RESTRICTED, "right", COARSE).filled, spaces["restricted"].filled)


def test_what_has_no_workspace_is_refused():
    upper = ADULT.upper.copy()
    upper[3] = np.inf
    with pytest.raises(BadModelError, match="right_elbow_flexion are unknown"):
        hand_workspace(ADULT.with_limits(ADULT.lower, upper), "right")
    with pytest.raises(UnknownNameError, match="left"):
        hand_workspace(replace(ADULT, hands=(("right", "right_hand"),)), "left")
    with pytest.raises(BadRequestError, match="voxel"):
        hand_workspace(ADULT, "right", 0.0)
    with pytest.raises(BadModelError, match="does not move"):
        frame_workspace(ADULT, Frame("torso", np.eye(4)))
    with pytest.raises(BadRequestError, match="one size"):
        boxes(0).overlap(boxes(0, voxel=0.2))
