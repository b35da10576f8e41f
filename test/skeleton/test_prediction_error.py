"""Prediction error minimisation: it finds the minimum, from far away, whatever the threads."""

import os

import numpy as np
import pytest
from problems import chain_problem, mixed_problem
from scipy.optimize import least_squares

from handover_ros.skeleton import prediction_error
from handover_ros.skeleton.gauge import within_a_turn
from handover_ros.skeleton.kernels import forward
from handover_ros.skeleton.layout import moved, parameter_layout
from handover_ros.skeleton.postures import solve_postures
from handover_ros.skeleton.prediction_error import FitSettings, minimise

TIGHT = FitSettings(tolerance=1e-10, iterations=200)


@pytest.mark.parametrize("seed", range(24))
def test_from_a_bad_start_it_finds_the_minimum_found_from_the_truth(seed):
    """Ten axes, ten frames, axes off by 0.05 rad, points by 20 mm, postures from zero (true ones within 1 rad)."""
    problem = chain_problem(seed)
    from_truth = minimise(problem.truth, problem.layout, problem.true_coordinates, problem.measured, TIGHT)
    postures, _ = solve_postures(problem.tree, problem.coordinates, problem.measured)
    found = minimise(problem.tree, problem.layout, postures, problem.measured, TIGHT)
    assert found.converged
    assert found.loss <= from_truth.loss * (1.0 + 1e-6)
    sigma = np.sqrt(found.loss / (problem.measured.size - problem.layout.count - problem.coordinates.size))
    assert 0.0007 < sigma < 0.0013
    np.testing.assert_allclose(np.abs((found.tree.axis * from_truth.tree.axis).sum(axis=1)), 1.0, atol=1e-8)


@pytest.mark.parametrize("seed", range(4))
def test_agrees_with_scipy_on_a_small_problem(seed):
    problem = chain_problem(seed, joints=3, frames=5)
    tree, layout = problem.tree, problem.layout
    frames, joints = problem.coordinates.shape

    def residuals(unknowns):
        theta = unknowns[layout.count :].reshape(frames, joints)
        return (forward(moved(tree, layout, unknowns[: layout.count]), theta) - problem.measured).ravel()

    postures, _ = solve_postures(tree, problem.coordinates, problem.measured)
    start = np.concatenate([np.zeros(layout.count), postures.ravel()])
    other = least_squares(residuals, start, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    found = minimise(tree, layout, postures, problem.measured, TIGHT)
    assert found.loss == pytest.approx(2.0 * other.cost, rel=1e-7)
    best = moved(tree, layout, other.x[: layout.count])
    np.testing.assert_allclose(found.tree.axis, best.axis, atol=1e-5)
    np.testing.assert_allclose(found.coordinates, other.x[layout.count :].reshape(frames, joints), atol=1e-4)


def test_postures_of_known_trees_are_found_from_zero():
    """Three markers on every link of the true chain: postures within a radian are found frame by frame."""
    for seed in range(10):
        problem = chain_problem(seed, noise=0.0)
        found, losses = solve_postures(problem.truth, problem.coordinates, problem.measured)
        assert losses.max() < 1e-12
        np.testing.assert_allclose(within_a_turn(problem.truth, found), problem.true_coordinates, atol=1e-5)


def test_loss_never_grows_and_is_that_of_the_result():
    problem = mixed_problem(11, frames=12, noise=0.02)
    start = moved(problem.tree, problem.layout, 0.02 * np.random.default_rng(0).normal(size=problem.layout.count))
    fit = minimise(start, problem.layout, problem.coordinates, problem.measured, frozen=3)
    assert (np.diff(fit.losses) <= 0.0).all()
    assert fit.losses[-1] == fit.loss
    assert np.nansum(fit.residuals(problem.measured) ** 2) == pytest.approx(fit.loss, rel=1e-9)
    np.testing.assert_array_equal(fit.coordinates[3], problem.coordinates[3])


def test_what_is_not_estimated_stays():
    problem = mixed_problem(2, frames=8)
    fit = minimise(problem.tree, parameter_layout(problem.tree, joints=False), problem.coordinates, problem.measured)
    np.testing.assert_array_equal(fit.tree.axis, problem.tree.axis)
    np.testing.assert_array_equal(fit.tree.point, problem.tree.point)
    fit = minimise(problem.tree, parameter_layout(problem.tree, markers=False), problem.coordinates, problem.measured)
    np.testing.assert_array_equal(fit.tree.marker, problem.tree.marker)
    nothing = parameter_layout(problem.tree, joints=False, markers=False)
    fit = minimise(problem.tree, nothing, problem.coordinates, problem.measured)
    assert fit.loss < np.nansum((forward(problem.tree, problem.coordinates) - problem.measured) ** 2)


def test_perfect_data_give_a_loss_of_zero():
    problem = chain_problem(0, joints=4, frames=12, noise=0.0)
    postures, _ = solve_postures(problem.tree, problem.coordinates, problem.measured)
    fit = minimise(problem.tree, problem.layout, postures, problem.measured, TIGHT)
    assert fit.loss < 1e-15
    np.testing.assert_allclose(fit.tree.axis, problem.truth.axis, atol=1e-6)


def test_a_robust_loss_ignores_one_marker_that_jumped():
    problem = chain_problem(3, joints=4, frames=30, noise=0.0005)
    measured = problem.measured.copy()
    measured[::6, 4] += [0.4, 0.0, 0.1]
    postures, _ = solve_postures(problem.tree, problem.coordinates, measured, 0.01)
    angle = {}
    for scale in (0.01, np.inf):
        fit = minimise(problem.tree, problem.layout, postures, measured, FitSettings(robust_scale=scale))
        cosine = np.abs((fit.tree.axis * problem.truth.axis).sum(axis=1)).clip(0.0, 1.0)
        angle[scale] = np.degrees(np.arccos(cosine)).max()
    assert angle[0.01] < 1.0
    assert angle[np.inf] > 3.0 * angle[0.01]


def test_a_frame_without_markers_stays_where_it_was():
    problem = chain_problem(1, joints=3, frames=12)
    measured = problem.measured.copy()
    measured[5] = np.nan
    start = problem.true_coordinates.copy()
    fit = minimise(problem.tree, problem.layout, start, measured)
    np.testing.assert_allclose(fit.coordinates[5], start[5], atol=1e-6)
    assert np.isfinite(fit.loss)


@pytest.mark.parametrize("threads", [1, 3])
def test_the_result_does_not_depend_on_the_number_of_threads(monkeypatch, threads):
    problem = mixed_problem(5, frames=200, noise=0.01)
    start = moved(problem.tree, problem.layout, 0.02 * np.random.default_rng(0).normal(size=problem.layout.count))
    expected = minimise(start, problem.layout, problem.coordinates, problem.measured, frozen=0)
    monkeypatch.setattr(prediction_error.os, "cpu_count", lambda: threads)
    assert os.cpu_count() == threads
    other = minimise(start, problem.layout, problem.coordinates, problem.measured, frozen=0)
    assert other.loss == expected.loss
    np.testing.assert_array_equal(other.tree.axis, expected.tree.axis)
    np.testing.assert_array_equal(other.coordinates, expected.coordinates)
