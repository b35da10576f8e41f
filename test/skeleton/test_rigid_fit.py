"""The weighted rigid fit: exact without noise, right covariance with it, robust to outliers, honest about lines."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from handover_ros.geometry import make_transform, transform_points
from handover_ros.skeleton.rigid_fit import determinant, fit_rigid_body, kabsch

TEMPLATE = np.array(
    [
        [0.10, 0.06, -0.04],
        [0.10, -0.07, -0.06],
        [0.10, 0.07, -0.22],
        [0.11, -0.06, -0.24],
        [-0.10, 0.07, -0.03],
        [-0.10, -0.06, -0.05],
        [-0.10, 0.06, -0.24],
        [-0.10, -0.08, -0.20],
    ]
)
SEED = st.integers(0, 2**32 - 1)
ALL = np.ones(8, dtype=bool)


def random_pose(rng: np.random.Generator) -> np.ndarray:
    return make_transform(Rotation.random(random_state=rng).as_matrix(), rng.uniform(-3.0, 3.0, 3))


@given(seed=SEED, seen=st.sets(st.integers(0, 7), min_size=3))
@settings(max_examples=100, deadline=None)
def test_without_noise_any_three_markers_give_the_exact_pose(seed: int, seen: set[int]) -> None:
    rng = np.random.default_rng(seed)
    pose = random_pose(rng)
    measured = transform_points(pose, TEMPLATE)
    usable = np.zeros(8, dtype=bool)
    usable[list(seen)] = True
    measured[~usable] = np.nan
    fit = fit_rigid_body(TEMPLATE, measured, rng.uniform(0.1, 1.0, 8), 0.001, usable)
    assert fit is not None
    np.testing.assert_allclose(fit.target_from_body, pose, atol=1e-9)
    assert fit.residual_rms < 1e-9
    assert np.linalg.det(fit.target_from_body[:3, :3]) > 0.0


def test_two_markers_or_a_line_fix_no_pose() -> None:
    usable = np.zeros(8, dtype=bool)
    usable[:2] = True
    assert fit_rigid_body(TEMPLATE, TEMPLATE, np.ones(8), 0.001, usable) is None
    line = np.linspace(0.0, 1.0, 8)[:, None] * np.array([0.3, 0.2, 0.1])
    assert fit_rigid_body(line, line, np.ones(8), 0.001, ALL) is None


def test_a_flat_body_is_not_mirrored() -> None:
    flat = TEMPLATE * [1.0, 1.0, 0.0]
    rng = np.random.default_rng(0)
    for _ in range(50):
        pose = random_pose(rng)
        rotation, _, _ = kabsch(flat, transform_points(pose, flat) + rng.normal(size=(8, 3)) * 1e-4, np.ones(8))
        assert determinant(rotation) > 0.999
        assert np.abs(rotation - pose[:3, :3]).max() < 0.01


@given(seed=SEED)
@settings(max_examples=20, deadline=None)
def test_the_heavier_marker_counts_more(seed: int) -> None:
    rng = np.random.default_rng(seed)
    measured = TEMPLATE + rng.normal(size=(8, 3)) * 0.003
    weights = np.ones(8)
    weights[0] = 1e6
    rotation, translation, _ = kabsch(TEMPLATE, measured, weights)
    assert np.linalg.norm(rotation @ TEMPLATE[0] + translation - measured[0]) < 1e-6


@given(seed=SEED)
@settings(max_examples=5, deadline=None)
def test_the_covariance_is_that_of_a_thousand_fits(seed: int) -> None:
    """Unequal weights, missing markers: the mean squared whitened error of 6 numbers is 6, each of them about 1."""
    rng = np.random.default_rng(seed)
    pose, noise = random_pose(rng), 0.002
    weights = np.array([1.0, 1.0, 0.3, 1.0, 0.1, 1.0, 1.0, 0.5])
    usable = ALL.copy()
    usable[rng.integers(0, 8)] = False
    truth = transform_points(pose, TEMPLATE)
    whitened, consistency = [], []
    for _ in range(1000):
        measured = truth + rng.normal(size=(8, 3)) * (noise / np.sqrt(weights))[:, None]
        fit = fit_rigid_body(TEMPLATE, measured, weights, noise, usable)
        assert fit is not None
        turn = Rotation.from_matrix(fit.target_from_body[:3, :3] @ pose[:3, :3].T).as_rotvec()
        error = np.concatenate([fit.target_from_body[:3, 3] - pose[:3, 3], turn])
        whitened.append(np.linalg.solve(np.linalg.cholesky(fit.covariance), error))
        consistency.append(fit.consistency)
    covariance = np.cov(np.array(whitened).T)
    np.testing.assert_allclose(covariance, np.eye(6), atol=0.25)
    assert abs(np.mean(consistency) - 1.0) < 0.05


def test_noise_beyond_what_was_stated_widens_the_covariance() -> None:
    rng = np.random.default_rng(1)
    errors, sigmas = [], []
    for _ in range(500):
        fit = fit_rigid_body(TEMPLATE, TEMPLATE + rng.normal(size=(8, 3)) * 0.006, np.ones(8), 0.002, ALL)
        assert fit is not None
        errors.append(fit.target_from_body[0, 3])
        sigmas.append(np.sqrt(fit.covariance[0, 0]))
    assert 0.6 < np.mean(sigmas) / np.std(errors) < 1.1


@given(seed=SEED, culprit=st.integers(0, 7), distance=st.floats(0.03, 0.5))
@settings(max_examples=60, deadline=None)
def test_one_marker_far_off_hardly_moves_the_pose(seed: int, culprit: int, distance: float) -> None:
    rng = np.random.default_rng(seed)
    measured = TEMPLATE + rng.normal(size=(8, 3)) * 0.0005
    direction = rng.normal(size=3)
    measured[culprit] += distance * direction / np.linalg.norm(direction)
    fit = fit_rigid_body(TEMPLATE, measured, np.ones(8), 0.001, ALL)
    assert fit is not None
    moved = transform_points(fit.target_from_body, np.zeros((1, 3)))
    assert np.linalg.norm(moved) < 0.005
    assert fit.weights[culprit] < 0.2
