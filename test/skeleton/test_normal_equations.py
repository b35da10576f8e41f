"""The compiled normal equations: every derivative, and the elimination of the postures, against plain algebra."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import marker_derivatives, mixed_problem, shifted

from handover_ros.skeleton.kernels import ancestors, forward, move
from handover_ros.skeleton.layout import moved, parameter_layout
from handover_ros.skeleton.normal_equations import STEP_DAMPING, cholesky_in_place, robust_loss
from handover_ros.skeleton.postures import frame_equations, frame_losses
from handover_ros.skeleton.prediction_error import NormalEquations
from handover_ros.skeleton.tree import JointKind

STEP = 1e-6
seeds = st.integers(0, 10**6)


@settings(max_examples=40, deadline=None)
@given(seeds, st.booleans())
def test_derivatives_of_markers_equal_central_differences(seed, free):
    """By the tangents of every joint, by tilts and shifts of every axis, shared points, ball centres and markers."""
    problem = mixed_problem(seed, frames=1, free=free)
    tree, layout, q = problem.tree, problem.layout, problem.coordinates[0]
    by_tangent, by_parameter = marker_derivatives(tree, layout, q)
    for column in range(by_tangent.shape[2]):
        both = []
        for sign in (1.0, -1.0):
            near, step = q.copy(), np.zeros(by_tangent.shape[2])
            step[column] = sign * STEP
            move(tree, near, step)
            both.append(forward(tree, near))
        np.testing.assert_allclose(by_tangent[:, :, column], (both[0] - both[1]) / (2 * STEP), rtol=1e-6, atol=3e-8)
    for column in range(layout.count):
        plus, minus = (forward(shifted(tree, layout, column, sign * STEP), q) for sign in (1.0, -1.0))
        np.testing.assert_allclose(by_parameter[:, :, column], (plus - minus) / (2 * STEP), rtol=1e-6, atol=3e-8)


def dense_step(problem, damping, frozen, robust_scale):
    """Return (parameter step, tangent steps (frames, nv), loss) of the damped normal equations, written out in full."""
    tree, layout = problem.tree, problem.layout
    frames, count = len(problem.measured), layout.count
    tangents = problem.skeleton.size[1]
    size = frames * tangents + count
    matrix, vector, loss = np.zeros((size, size)), np.zeros(size), 0.0
    for k in range(frames):
        by_tangent, by_parameter = marker_derivatives(tree, layout, problem.coordinates[k])
        if k == frozen:
            by_tangent[:] = 0.0
        error = forward(tree, problem.coordinates[k]) - problem.measured[k]
        for i in np.flatnonzero(np.isfinite(error[:, 0])):
            jacobian = np.zeros((3, size))
            jacobian[:, k * tangents : (k + 1) * tangents] = by_tangent[i]
            jacobian[:, frames * tangents :] = by_parameter[i]
            squared = float(error[i] @ error[i])
            weight = 1.0 if np.isinf(robust_scale) else 1.0 / (1.0 + squared / robust_scale**2)
            matrix += weight * jacobian.T @ jacobian
            vector += weight * jacobian.T @ error[i]
            loss += squared if np.isinf(robust_scale) else robust_scale**2 * np.log1p(squared / robust_scale**2)
    diagonal = matrix.diagonal().copy()
    extra = damping * diagonal
    extra[: frames * tangents] += STEP_DAMPING
    matrix[np.diag_indices(size)] += extra
    step = -np.linalg.solve(matrix, vector)
    return step[frames * tangents :], step[: frames * tangents].reshape(frames, tangents), loss


@settings(max_examples=25, deadline=None)
@given(seeds, st.booleans(), st.sampled_from([-1, 0, 2]), st.sampled_from([np.inf, 0.05]))
def test_eliminating_the_postures_solves_the_full_system(seed, free, frozen, robust_scale):
    """With damping, missing markers, shared points, all kinds of joints, a held posture and robust weights."""
    damping = 0.03
    problem = mixed_problem(seed, free=free)
    expected, expected_tangents, expected_loss = dense_step(problem, damping, frozen, robust_scale)
    tree, layout = problem.tree, problem.layout
    equations = NormalEquations(problem.skeleton.size[1], problem.measured, layout, frozen, robust_scale)
    matrix, vector, diagonal = equations.build(tree, layout, problem.coordinates, damping)
    matrix[np.diag_indices_from(matrix)] += damping * diagonal
    step = -np.linalg.solve(matrix, vector)
    np.testing.assert_allclose(step, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())
    losses = equations.losses(tree, problem.coordinates)
    assert losses.sum() == pytest.approx(expected_loss, rel=1e-12)
    # The postures: where the frame is not solved again by itself, it moves by its own part of the full step.
    generous = np.full(len(losses), np.inf)
    moved_to, _ = equations.substitute(tree, moved(tree, layout, step), problem.coordinates, step, generous)
    for k, own in enumerate(expected_tangents):
        target = problem.coordinates[k].copy()
        if k != frozen:
            move(tree, target, own)
        np.testing.assert_allclose(forward(tree, moved_to[k]), forward(tree, target), atol=1e-6)


def test_the_random_problems_have_what_they_should_test():
    problems = [mixed_problem(seed) for seed in range(20)]
    kinds = {kind for problem in problems for kind in problem.tree.kind}
    assert kinds == set(JointKind)
    on_one_chain = 0
    for problem in problems:
        columns = problem.layout.point_column
        for chain in ancestors(problem.tree):
            own = columns[chain[chain >= 0]]
            own = own[own >= 0]
            on_one_chain += len(np.unique(own)) < len(own)
    assert on_one_chain > 5
    assert all(np.isnan(problem.measured).any() for problem in problems)


@settings(max_examples=25, deadline=None)
@given(seeds, st.booleans(), st.sampled_from([0.0, 400.0]))
def test_equations_of_a_single_frame_are_those_of_its_postures_block(seed, free, inverse_scale):
    problem = mixed_problem(seed, frames=1, free=free)
    tree, q, observed = problem.tree, problem.coordinates[0], problem.measured[0]
    tangents = problem.skeleton.size[1]
    a, v = np.zeros((tangents, tangents)), np.zeros(tangents)
    loss = frame_equations(tree, ancestors(tree), q, observed, inverse_scale, a, v)
    by_tangent, _ = marker_derivatives(tree, problem.layout, q)
    error = forward(tree, q) - observed
    seen = np.isfinite(error[:, 0])
    squared = (error[seen] ** 2).sum(axis=1)
    weight = 1.0 / (1.0 + inverse_scale * squared)
    expected = np.einsum("ias,i,iat->st", by_tangent[seen], weight, by_tangent[seen])
    np.testing.assert_allclose(np.tril(a), np.tril(expected), atol=1e-12 * max(1.0, np.abs(expected).max()))
    np.testing.assert_allclose(v, np.einsum("ias,i,ia->s", by_tangent[seen], weight, error[seen]), atol=1e-12)
    plain = squared.sum() if inverse_scale == 0.0 else (np.log1p(inverse_scale * squared) / inverse_scale).sum()
    assert loss == pytest.approx(plain, rel=1e-12)
    losses = np.empty(1)
    frame_losses(tree, q[None], observed[None], inverse_scale, losses)
    assert losses[0] == pytest.approx(loss, rel=1e-12)


@pytest.mark.parametrize("inverse_scale", [0.0, 1e4])
def test_weight_of_a_robust_loss_is_its_derivative(inverse_scale):
    """And near zero the loss is the square itself."""
    for squared in (1e-8, 1e-4, 1.0):
        step = 1e-4 * squared
        plus, minus = (robust_loss(squared + sign * step, inverse_scale)[0] for sign in (1.0, -1.0))
        assert (plus - minus) / (2 * step) == pytest.approx(robust_loss(squared, inverse_scale)[1], rel=1e-6)
    assert robust_loss(1e-12, inverse_scale)[0] == pytest.approx(1e-12, rel=1e-6)


def test_cholesky_factor_and_its_refusal():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(7, 7))
    matrix = root @ root.T
    factor = matrix.copy()
    assert cholesky_in_place(factor)
    np.testing.assert_allclose(np.tril(factor), np.linalg.cholesky(matrix), atol=1e-12)
    assert not cholesky_in_place(np.diag([1.0, -1.0]))
    assert not cholesky_in_place(np.array([[1.0, 1.0], [1.0, 1.0]]))
    assert not cholesky_in_place(np.full((2, 2), np.nan))


# Layout.


def test_layout_counts_what_the_gauge_leaves():
    """A revolute joint 4, a prismatic 2, a ball 3, a shared point 3 once, a marker 3; markers on the world none."""
    for seed in range(10):
        problem = mixed_problem(seed)
        tree, layout = problem.tree, problem.layout
        shared = {}
        for j, column in enumerate(layout.point_column):
            shared.setdefault(int(column), []).append(j)
        joints = 0
        for column, members in shared.items():
            alone = len(members) == 1 and tree.kind[members[0]] != JointKind.BALL and layout.point_size[members[0]] == 2
            joints += 0 if column < 0 else 2 if alone else 3
        joints += 2 * int(np.isin(tree.kind, [JointKind.REVOLUTE, JointKind.PRISMATIC]).sum())
        assert layout.count == joints + 3 * int((tree.marker_joint >= 0).sum())


def test_layout_parts_can_be_held():
    problem = mixed_problem(0)
    tree = problem.tree
    every, axes_only = parameter_layout(tree), parameter_layout(tree, markers=False)
    markers_only = parameter_layout(tree, joints=False)
    assert axes_only.count + markers_only.count == every.count
    held = parameter_layout(tree, held=2)
    assert (held.marker_column[:2] == -1).all()
    assert held.count == every.count - 6


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_a_moved_tree_has_unit_axes_and_shared_points(seed):
    rng = np.random.default_rng(seed)
    problem = mixed_problem(seed)
    result = moved(problem.tree, problem.layout, 0.1 * rng.normal(size=problem.layout.count))
    estimated = problem.layout.axis_column >= 0
    np.testing.assert_allclose(np.linalg.norm(result.axis[estimated], axis=1), 1.0)
    columns = problem.layout.point_column
    for column in set(columns[columns >= 0]):
        points = result.point[columns == column]
        np.testing.assert_allclose(points, np.broadcast_to(points[0], points.shape), atol=1e-12)
    np.testing.assert_array_equal(result.marker[problem.layout.marker_column < 0], problem.tree.marker[-1:])
