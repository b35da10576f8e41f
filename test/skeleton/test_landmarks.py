"""Joint centres and the stick figure."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from random_trees import random_skeleton

from handover_ros.skeleton.landmarks import axes_meet, bones, joint_centres
from handover_ros.skeleton.tree import WORLD, Joint, JointKind, Skeleton

seeds = st.integers(0, 10**6)


def hinge(name, parent, axis, point):
    return Joint(name, JointKind.REVOLUTE, parent, name, (f"{name}_turn",), np.array([axis], float), np.array(point))


@settings(max_examples=40, deadline=None)
@given(seeds, st.floats(-5.0, 5.0))
def test_centres_lie_on_the_axes_wherever_the_axis_point_is(seed, shift):
    skeleton = random_skeleton(seed)
    centres = joint_centres(skeleton)
    for joint, centre in zip(skeleton.joints, centres):
        if joint.kind is JointKind.REVOLUTE:
            np.testing.assert_allclose(np.cross(joint.axes[0], centre - joint.point), 0.0, atol=1e-9)
    points = np.array(
        [j.point + shift * j.axes[0] if j.kind is JointKind.REVOLUTE else j.point for j in skeleton.joints]
    )
    moved = skeleton.with_geometry(skeleton.tree.axis, points, skeleton.markers)
    np.testing.assert_allclose(joint_centres(moved), centres, atol=1e-8)


@settings(max_examples=40, deadline=None)
@given(seeds)
def test_no_other_points_of_two_axes_are_nearer(seed):
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(2, 3))
    first, second = (
        hinge(name, WORLD, axis / np.linalg.norm(axis), rng.normal(size=3)) for name, axis in zip("ab", axes)
    )
    _, distance = axes_meet(first, second)
    s, t = rng.normal(size=(2, 500, 1)) * 3.0
    assert distance <= np.linalg.norm(first.point + s * first.axes[0] - second.point - t * second.axes[0], axis=1).min()


def test_parallel_axes_meet_in_the_middle():
    middle, distance = axes_meet(hinge("a", WORLD, [0, 0, 1], [0.0, 0, 0]), hinge("b", WORLD, [0, 0, 1], [2.0, 0, 5]))
    np.testing.assert_allclose(middle, [1.0, 0.0, 0.0])
    assert distance == 2.0


def test_bones_of_a_chain_lead_from_joint_to_joint_to_the_last_markers():
    joints = (hinge("a", WORLD, [0, 1, 0], [0.0, 3, 0]), hinge("b", "a", [0, 1, 0], [0.0, 7, -1]))
    skeleton = Skeleton(
        "leg",
        joints,
        ("m", "n"),
        ("a", "b"),
        np.array([[0.1, 0.0, -0.5], [0.0, 0.0, -1.5]]),
        np.zeros(2),
        np.ones(2),
    )
    lines = bones(skeleton)
    assert [line[0] for line in lines] == ["a", "b"]
    np.testing.assert_allclose(lines[0][1:], [[0.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    np.testing.assert_allclose(lines[1][1:], [[0.0, 0.0, -1.0], [0.0, 0.0, -1.5]])
