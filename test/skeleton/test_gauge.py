"""What markers cannot tell: moving the zero posture, the zero frame or an axis' sign changes no predicted marker."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import mixed_problem
from random_trees import random_pose
from scipy.spatial.transform import Rotation

from handover_ros.skeleton.gauge import (
    gauge_directions,
    mean_posture,
    with_root_frame,
    with_signs,
    with_zero_at,
    within_a_turn,
)
from handover_ros.skeleton.kernels import forward
from handover_ros.skeleton.layout import parameter_layout
from handover_ros.skeleton.normal_equations import STEP_DAMPING
from handover_ros.skeleton.prediction_error import NormalEquations
from handover_ros.skeleton.tree import JointKind

seeds = st.integers(0, 10**6)


@settings(max_examples=40, deadline=None)
@given(seeds, st.booleans())
def test_another_zero_posture_predicts_the_same_markers(seed, free):
    problem = mixed_problem(seed, free=free)
    tree, coordinates = problem.tree, problem.coordinates
    changed, moved_to = with_zero_at(tree, coordinates, coordinates[1])
    np.testing.assert_allclose(forward(changed, moved_to), forward(tree, coordinates), atol=1e-9)
    assert_zero_posture(tree, moved_to[1])
    np.testing.assert_allclose(np.linalg.norm(changed.axis, axis=1), np.linalg.norm(tree.axis, axis=1))


def assert_zero_posture(tree, posture):
    """Check that every joint except a free root is at zero."""
    for kind, start in zip(tree.kind, tree.coordinate):
        if kind == JointKind.BALL:
            np.testing.assert_allclose(np.abs(posture[start : start + 4]), [0.0, 0.0, 0.0, 1.0], atol=1e-9)
        elif kind != JointKind.FREE:
            assert abs(posture[start]) < 1e-12


@settings(max_examples=40, deadline=None)
@given(seeds)
def test_another_root_frame_predicts_the_same_markers(seed):
    """On a free root: the zero frame is the root's own, so it may be chosen freely, balls' axes apart."""
    problem = mixed_problem(seed)
    zero_from_new = random_pose(np.random.default_rng(seed))
    stays = problem.tree.marker_joint >= 0  # a marker on the world has no place in the root's frame
    changed, moved_to = with_root_frame(problem.tree, problem.coordinates, zero_from_new)
    before, after = forward(problem.tree, problem.coordinates), forward(changed, moved_to)
    np.testing.assert_allclose(after[:, stays], before[:, stays], atol=1e-9)
    origin = moved_to[:, :3]
    expected = problem.skeleton.world_from_root(problem.coordinates) @ np.append(zero_from_new[:3, 3], 1.0)
    np.testing.assert_allclose(origin, expected[:, :3], atol=1e-9)


@settings(max_examples=40, deadline=None)
@given(seeds, st.booleans())
def test_axes_turned_round_predict_the_same_markers(seed, free):
    problem = mixed_problem(seed, free=free)
    directions = np.random.default_rng(seed).normal(size=problem.tree.axis.shape)
    changed, moved_to = with_signs(problem.tree, problem.coordinates, directions)
    np.testing.assert_allclose(forward(changed, moved_to), forward(problem.tree, problem.coordinates), atol=1e-9)
    single = np.isin(problem.tree.kind, [JointKind.REVOLUTE, JointKind.PRISMATIC])
    assert ((changed.axis * directions).sum(axis=1)[single] >= 0.0).all()


def test_full_turns_are_taken_off():
    problem = mixed_problem(4)
    coordinates = problem.coordinates.copy()
    revolute = problem.tree.coordinate[problem.tree.kind == JointKind.REVOLUTE]
    coordinates[:, revolute] += 2.0 * np.pi * np.arange(-1, 3)[:, None]
    taken = within_a_turn(problem.tree, coordinates)
    np.testing.assert_allclose(taken, problem.coordinates, atol=1e-9)


def test_mean_posture_lies_in_the_middle():
    """Of two postures: half of the way for every joint, also for a ball whose quaternions have opposite signs."""
    problem = mixed_problem(6)
    pair = problem.coordinates[:2].copy()
    assert (problem.tree.kind == JointKind.BALL).any()
    for kind, start in zip(problem.tree.kind, problem.tree.coordinate):
        if kind == JointKind.BALL:
            pair[1, start : start + 4] *= -1.0
    mean = mean_posture(problem.tree, pair)
    np.testing.assert_array_equal(mean[:7], pair[0, :7])
    for kind, start in zip(problem.tree.kind, problem.tree.coordinate):
        if kind == JointKind.BALL:
            first, second, middle = (Rotation.from_quat(q[start : start + 4]) for q in (*pair, mean))
            assert (middle * first.inv()).magnitude() == pytest.approx((second * middle.inv()).magnitude(), abs=1e-9)
        elif kind != JointKind.FREE:
            assert mean[start] == pytest.approx(pair[:, start].mean())


@settings(max_examples=25, deadline=None)
@given(seeds, st.booleans())
def test_gauge_directions_are_the_null_space_of_the_reduced_equations(seed, free):
    """Moving the zero of a joint changes no marker to first order once the postures may follow.

    What is left is what the equations charge for the following itself: the joint's own displacement by one, and every
    ball joint further out by at most two, since its quaternion is written in the turned zero frame.
    """
    frames = 8
    problem = mixed_problem(seed, frames=frames, free=free, missing=0.0)
    layout = parameter_layout(problem.tree)
    equations = NormalEquations(problem.skeleton.size[1], problem.measured, layout, -1, np.inf)
    matrix, _, _ = equations.build(problem.tree, layout, problem.coordinates, 0.0)
    directions = gauge_directions(problem.tree, layout)
    assert directions.shape == (layout.count, problem.skeleton.size[1])
    balls = int((problem.tree.kind == JointKind.BALL).sum())
    following = frames * STEP_DAMPING * (1.0 + 4.0 * balls)
    assert change(matrix, directions).max() <= 1.001 * following
    others = np.random.default_rng(seed).normal(size=directions.shape)
    others *= np.linalg.norm(directions, axis=0) / np.linalg.norm(others, axis=0)
    assert change(matrix, others)[np.linalg.norm(directions, axis=0) > 1e-9].min() > 100.0 * following


def change(matrix, directions):
    """Return the squared change of all markers (directions,) by parameter changes (count, directions)."""
    return np.einsum("cd,cb,bd->d", directions, matrix, directions)
