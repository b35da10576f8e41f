"""The kinematic tree: what it refuses, its two descriptions of a posture, and its compiled forward kinematics."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_trees import KINDS, random_pose, random_skeleton
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from handover_ros.errors import BadModelError, UnknownNameError
from handover_ros.skeleton.angles import euler_rates
from handover_ros.skeleton.kernels import difference, forward, move, segment_poses
from handover_ros.skeleton.reference import hat, marker_positions, prediction_error, segment_pose
from handover_ros.skeleton.tree import WORLD, Joint, JointKind, Skeleton

seeds = st.integers(0, 10**6)


def shuffled_quaternions(skeleton, coordinates, rng):
    """Return the same postures with the sign of some quaternions turned: the same rotations."""
    result = coordinates.copy()
    for kind, start in zip(skeleton.tree.kind, skeleton.tree.coordinate):
        if kind == JointKind.BALL:
            result[..., start : start + 4] *= rng.choice([-1.0, 1.0])
    return result


# What is refused.


def one_joint(**changes):
    """Return a valid joint with some attributes changed."""
    content = {
        "name": "elbow",
        "kind": JointKind.REVOLUTE,
        "parent": WORLD,
        "segment": "forearm",
        "displacement_names": ("flexion",),
        "axes": np.array([[0.0, 1.0, 0.0]]),
        "point": np.zeros(3),
    }
    return Joint(**{**content, **changes})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"displacement_names": ("a", "b")}, "2 displacement names, a revolute joint has 1"),
        ({"displacement_names": ()}, "0 displacement names"),
        ({"axes": np.eye(3)}, "expected (1, 3)"),
        ({"point": np.zeros(2)}, "point (2,)"),
        ({"axes": np.array([[0.0, np.nan, 0.0]])}, "finite"),
        ({"point": np.array([0.0, np.inf, 0.0])}, "finite"),
        ({"axes": np.array([[0.0, 2.0, 0.0]])}, "unit length"),
        (
            {
                "kind": JointKind.BALL,
                "displacement_names": ("a", "b", "c"),
                "axes": np.array([[1.0, 0, 0], [0, 1.0, 0], [0.6, 0.8, 0]]),
            },
            "right angles",
        ),
    ],
)
def test_a_wrong_joint_is_refused_by_name(changes, words):
    with pytest.raises(BadModelError, match=re.escape(words)) as caught:
        one_joint(**changes)
    assert "'elbow'" in str(caught.value)


def two_joints(first=None, second=None, **changes):
    """Return a skeleton of two joints with some attributes changed."""
    joints = (
        one_joint(**(first or {})),
        one_joint(
            **{
                "name": "wrist",
                "parent": "forearm",
                "segment": "hand",
                "displacement_names": ("bending",),
                **(second or {}),
            }
        ),
    )
    content = {
        "name": "arm",
        "joints": joints,
        "marker_names": ("A", "B"),
        "marker_segments": ("forearm", "hand"),
        "markers": np.zeros((2, 3)),
        "lower": np.array([-1.0, -1.0]),
        "upper": np.array([1.0, 1.0]),
    }
    return Skeleton(**{**content, **changes})


FREE_AXES = {"kind": JointKind.FREE, "displacement_names": (), "axes": np.zeros((0, 3))}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"second": {"parent": "shoulder"}}, "'wrist': parent 'shoulder' is not carried by an earlier joint"),
        ({"first": {"parent": "hand"}}, "'elbow': parent 'hand' is not carried by an earlier joint"),
        ({"second": {"segment": "forearm"}}, "segment 'forearm' is carried by two joints"),
        ({"second": {"segment": WORLD}}, "'world' is carried by two joints"),
        ({"second": FREE_AXES}, "'wrist': only the root can be free"),
        ({"second": {"name": "elbow"}}, "joint 'elbow' appears twice"),
        ({"second": {"displacement_names": ("flexion",)}}, "displacement 'flexion' appears twice"),
        ({"markers": np.zeros((2, 3)) * np.nan}, "markers must be numbers of shape (2, 3)"),
        ({"markers": np.full((2, 3), np.inf)}, "marker positions must be finite"),
        ({"lower": np.zeros(3)}, "lower must be numbers of shape (2,)"),
        ({"upper": np.array([np.nan, 0.0])}, "upper must be numbers"),
        ({"marker_segments": ("forearm",)}, "every marker needs a segment"),
        ({"marker_segments": ("forearm", "foot")}, "marker segment 'foot' is carried by no joint"),
        ({"hands": (("left", "foot"),)}, "hand segment 'foot' is carried by no joint"),
        ({"lower": np.array([-1.0, 2.0])}, "the lower limit of bending is above its upper limit"),
    ],
)
def test_a_wrong_tree_is_refused_in_words(changes, words):
    two_joints()
    with pytest.raises(BadModelError, match=re.escape(words)) as caught:
        two_joints(**changes)
    assert "\n" not in str(caught.value)


def test_unknown_names_list_the_known_ones():
    skeleton = two_joints()
    with pytest.raises(UnknownNameError, match="elbow, wrist"):
        skeleton.joint("knee")
    with pytest.raises(UnknownNameError, match="forearm, hand, world"):
        skeleton.joint_carrying("foot")
    with pytest.raises(UnknownNameError, match="A, B"):
        skeleton.with_markers(("C",))


def test_a_skeleton_cannot_be_changed_by_accident():
    skeleton = two_joints()
    for array in (skeleton.markers, skeleton.lower, skeleton.joints[0].axes, skeleton.joints[0].point):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


# Names and places.


def test_chain_and_places_of_a_branched_tree():
    skeleton = random_skeleton(3, joints=9)
    for joint in skeleton.joints:
        chain = skeleton.chain(joint.segment)
        assert skeleton.joints[chain[-1]] is joint
        assert skeleton.joints[chain[0]].parent == WORLD
        for outer, inner in zip(chain[1:], chain):
            assert skeleton.joints[outer].parent == skeleton.joints[inner].segment
    assert skeleton.chain(WORLD) == ()
    names = [name for index in range(9 + 1) for name in skeleton.displacement_names[skeleton.slice_of(index)]]
    assert tuple(names) == skeleton.displacement_names
    stops = [skeleton.tangent_slice(index).stop for index in range(9 + 1)]
    assert stops[-1] == skeleton.size[1]


def test_middle_is_half_of_the_sum_of_the_limits():
    """Equation 2.11 as it is meant; unknown limits count as a middle of zero."""
    skeleton = two_joints(lower=np.array([0.2, -np.inf]), upper=np.array([1.0, 3.0]))
    np.testing.assert_allclose(skeleton.middle, [0.6, 0.0])


def test_with_markers_and_with_limits_change_nothing_else():
    skeleton = random_skeleton(1)
    fewer = skeleton.with_markers(("m4", "m1"))
    np.testing.assert_array_equal(fewer.markers, skeleton.markers[[4, 1]])
    assert fewer.marker_segments == (skeleton.marker_segments[4], skeleton.marker_segments[1])
    assert fewer.joints == skeleton.joints
    limited = skeleton.with_limits(skeleton.lower - 1.0, skeleton.upper)
    np.testing.assert_array_equal(limited.lower, skeleton.lower - 1.0)
    assert limited.joints == skeleton.joints


def test_with_geometry_keeps_the_axes_of_balls():
    skeleton = random_skeleton(5)
    rng = np.random.default_rng(0)
    tree = skeleton.tree
    axes = rng.normal(size=tree.axis.shape)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    changed = skeleton.with_geometry(axes, tree.point + 1.0, tree.marker + 2.0)
    for index, (old, new) in enumerate(zip(skeleton.joints, changed.joints)):
        expected = axes[index : index + 1] if len(old.axes) == 1 else old.axes
        np.testing.assert_array_equal(new.axes, expected)
        np.testing.assert_array_equal(new.point, old.point + 1.0)
    np.testing.assert_array_equal(changed.markers, skeleton.markers + 2.0)


# Twists (eq. 2.1, 2.12).


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_twists_fix_their_axis_and_have_unit_pitchless_turns(seed):
    """Equation 2.12: a revolute twist is (p x w, w), a prismatic one (w, 0), a ball three turns about one point."""
    skeleton = random_skeleton(seed)
    for joint in skeleton.joints:
        for axis, twist in zip(joint.axes, joint.twists):
            pose = expm(hat(twist) * 0.7)
            if joint.kind is JointKind.PRISMATIC:
                np.testing.assert_allclose(pose[:3, :3], np.eye(3), atol=1e-12)
                np.testing.assert_allclose(pose[:3, 3], 0.7 * axis, atol=1e-12)
            else:
                on_axis = np.append(joint.point + 0.3 * axis, 1.0)
                np.testing.assert_allclose(pose @ on_axis, on_axis, atol=1e-12)
                np.testing.assert_allclose(pose[:3, :3], Rotation.from_rotvec(0.7 * axis).as_matrix(), atol=1e-12)


# Displacements and coordinates.


@settings(max_examples=100, deadline=None)
@given(seeds, st.booleans())
def test_displacements_survive_the_way_through_coordinates(seed, free):
    """Also ball joints whose middle angle is beyond 90 degrees, told which of the two triples is meant."""
    rng = np.random.default_rng(seed)
    skeleton = random_skeleton(seed, free=free)
    theta = rng.uniform(-2.8, 2.8, (4, len(skeleton.displacement_names)))
    near = theta + rng.uniform(-0.4, 0.4, theta.shape)
    coordinates = shuffled_quaternions(skeleton, skeleton.coordinates(theta, random_pose(rng)), rng)
    for own, hint, coordinate in zip(theta, near, coordinates):
        np.testing.assert_allclose(skeleton.displacements(coordinate, near=hint), own, atol=1e-7)


@settings(max_examples=60, deadline=None)
@given(seeds)
def test_any_coordinates_have_displacements_of_the_same_posture(seed):
    """Whatever triple is chosen, and however far the hint is off, the markers stay."""
    rng = np.random.default_rng(seed)
    skeleton = random_skeleton(seed)
    theta = rng.uniform(-3.1, 3.1, len(skeleton.displacement_names))
    pose = random_pose(rng)
    coordinates = skeleton.coordinates(theta, pose)
    back = skeleton.displacements(coordinates, near=rng.uniform(-9.0, 9.0, theta.shape))
    again = skeleton.coordinates(back, skeleton.world_from_root(coordinates))
    np.testing.assert_allclose(forward(skeleton.tree, again), forward(skeleton.tree, coordinates), atol=1e-9)


def test_ball_beyond_ninety_degrees_by_its_limits():
    """A shoulder lifted sideways to 120 degrees reads 120 degrees when its limits allow that, without any hint."""
    ball = one_joint(kind=JointKind.BALL, displacement_names=("a", "b", "c"), axes=np.eye(3))
    skeleton = Skeleton(
        "shoulder",
        (ball,),
        ("A",),
        ("forearm",),
        np.ones((1, 3)),
        np.array([-0.5, 0.0, -0.5]),
        np.array([0.5, 2.4, 0.5]),
    )
    theta = np.array([0.1, np.deg2rad(120.0), -0.2])
    np.testing.assert_allclose(skeleton.displacements(skeleton.coordinates(theta)), theta, atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(seeds)
def test_rates_of_ball_angles_are_their_derivatives(seed):
    rng = np.random.default_rng(seed)
    axes = Rotation.random(rng=rng).as_matrix() * rng.choice([-1.0, 1.0], size=(3, 1))
    ball = one_joint(kind=JointKind.BALL, displacement_names=("a", "b", "c"), axes=axes)
    skeleton = Skeleton("b", (ball,), (), (), np.zeros((0, 3)), np.full(3, -3.0), np.full(3, 3.0))
    theta = np.array([rng.uniform(-2, 2), rng.uniform(-1.2, 1.2), rng.uniform(-2, 2)])
    rates, step = euler_rates(axes, theta), 1e-6
    for column in range(3):
        both = []
        for sign in (1.0, -1.0):
            q = skeleton.coordinates(theta)
            move(skeleton.tree, q, sign * step * np.eye(3)[column])
            both.append(skeleton.displacements(q, near=theta))
        np.testing.assert_allclose((both[0] - both[1]) / (2.0 * step), rates[:, column], rtol=1e-5, atol=1e-6)


# Forward kinematics.


@settings(max_examples=40, deadline=None)
@given(seeds, st.booleans())
def test_compiled_kinematics_are_the_dissertations_product_of_exponentials(seed, free):
    """Equations 2.3 and 2.4 with matrix exponentials, to 1e-12."""
    rng = np.random.default_rng(seed)
    skeleton = random_skeleton(seed, free=free)
    theta, pose = rng.uniform(-3.0, 3.0, len(skeleton.displacement_names)), random_pose(rng)
    coordinates = skeleton.coordinates(theta, pose)
    expected = marker_positions(skeleton, theta, pose)
    scale = max(1.0, np.abs(expected).max())
    np.testing.assert_allclose(forward(skeleton.tree, coordinates), expected, rtol=0.0, atol=1e-12 * scale)
    poses = segment_poses(skeleton.tree, coordinates[None])[0]
    for index, joint in enumerate(skeleton.joints):
        plain = segment_pose(skeleton, theta, joint.segment, pose)
        np.testing.assert_allclose(poses[index], plain, rtol=0.0, atol=1e-12 * max(1.0, np.abs(plain).max()))


def test_all_kinds_of_joints_are_among_the_random_trees():
    drawn = {joint.kind for seed in range(5) for joint in random_skeleton(seed).joints}
    assert drawn == {*KINDS, JointKind.FREE}


def test_markers_on_the_world_stay_and_count():
    skeleton = two_joints(marker_segments=(WORLD, "hand"), markers=np.array([[1.0, 2.0, 3.0], [0.0, 0.0, 1.0]]))
    positions = forward(skeleton.tree, skeleton.coordinates([0.3, 0.4]))
    np.testing.assert_array_equal(positions[0], [1.0, 2.0, 3.0])
    np.testing.assert_allclose(positions, marker_positions(skeleton, np.array([0.3, 0.4])), atol=1e-15)


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_many_frames_and_sigma_points_are_each_alone(seed):
    rng = np.random.default_rng(seed)
    skeleton = random_skeleton(seed)
    theta = rng.uniform(-2.0, 2.0, (3, 5, len(skeleton.displacement_names)))
    poses = np.array([[random_pose(rng) for _ in range(5)] for _ in range(3)])
    coordinates = skeleton.coordinates(theta, poses)
    many, read = forward(skeleton.tree, coordinates), skeleton.displacements(coordinates)
    roots = skeleton.world_from_root(coordinates)
    assert many.shape == (3, 5, len(skeleton.marker_names), 3)
    for index in np.ndindex(3, 5):
        np.testing.assert_array_equal(many[index], forward(skeleton.tree, coordinates[index]))
        np.testing.assert_array_equal(coordinates[index], skeleton.coordinates(theta[index], poses[index]))
        np.testing.assert_array_equal(read[index], skeleton.displacements(coordinates[index]))
        np.testing.assert_allclose(roots[index], poses[index], atol=1e-12)


def test_no_frames_are_no_markers():
    skeleton = two_joints()
    assert forward(skeleton.tree, np.zeros((0, 2))).shape == (0, 2, 3)


def test_prediction_error_is_the_sum_over_what_was_measured():
    """Equation 2.6 on one frame: two markers off by 3 and 4 cm, one of them then hidden."""
    skeleton = two_joints()
    theta = np.array([[0.2, -0.4]])
    measured = forward(skeleton.tree, skeleton.coordinates(theta)) + [[[0.03, 0, 0], [0, 0, 0.04]]]
    assert prediction_error(skeleton, theta, np.eye(4)[None], measured) == pytest.approx(0.0025)
    measured[0, 1] = np.nan
    assert prediction_error(skeleton, theta, np.eye(4)[None], measured) == pytest.approx(0.0009)


# Small changes of a posture.


@settings(max_examples=60, deadline=None)
@given(seeds)
def test_difference_undoes_move(seed):
    """For steps of up to half a turn, whatever sign the quaternions have."""
    rng = np.random.default_rng(seed)
    skeleton = random_skeleton(seed)
    tree = skeleton.tree
    base = skeleton.coordinates(rng.uniform(-3.0, 3.0, len(skeleton.displacement_names)), random_pose(rng))
    step = rng.uniform(-1.7, 1.7, skeleton.size[1])
    q, found = base.copy(), np.empty(skeleton.size[1])
    move(tree, q, step)
    difference(tree, shuffled_quaternions(skeleton, q, rng), base, found)
    np.testing.assert_allclose(found, step, atol=1e-9)
    again = base.copy()
    move(tree, again, found)
    np.testing.assert_allclose(forward(tree, again), forward(tree, q), atol=1e-9)


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-9, 1e-7])
def test_tiny_steps_keep_their_digits(size):
    skeleton = random_skeleton(2)
    step = np.full(skeleton.size[1], size)
    base = skeleton.coordinates(np.full(len(skeleton.displacement_names), 0.4))
    q, found = base.copy(), np.empty_like(step)
    move(skeleton.tree, q, step)
    difference(skeleton.tree, q, base, found)
    np.testing.assert_allclose(found, step, atol=1e-15)


def test_a_free_roots_tangent_turns_it_in_place():
    """(translation, rotation vector) in the world: turning moves the root's origin nowhere."""
    skeleton = random_skeleton(0, joints=1)
    q = skeleton.coordinates(np.zeros(len(skeleton.displacement_names)), random_pose(np.random.default_rng(0)))
    before = skeleton.world_from_root(q)
    step = np.zeros(skeleton.size[1])
    step[:6] = [0.1, 0.2, 0.3, 0.0, 0.0, np.pi / 2.0]
    move(skeleton.tree, q, step)
    after = skeleton.world_from_root(q)
    np.testing.assert_allclose(after[:3, 3], before[:3, 3] + [0.1, 0.2, 0.3])
    turn = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    np.testing.assert_allclose(after[:3, :3], turn @ before[:3, :3], atol=1e-12)
