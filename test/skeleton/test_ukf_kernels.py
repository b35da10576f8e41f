"""The compiled filter is filterpy's unscented Kalman filter, with less to compute."""

from __future__ import annotations

import math

import numpy as np
import pytest
from people import calibration_motion, random_person

from handover_ros.skeleton.dynamics_model import linear_dynamics
from handover_ros.skeleton.templates import blank_skeleton, load_template
from handover_ros.skeleton.tree import Skeleton
from handover_ros.skeleton.ukf_kernels import (
    GATED,
    MISSING,
    RELABELLED,
    SEEN,
    factor_columns,
    judge_markers,
    predict,
    spread_points,
    truncate,
    update,
)
from handover_ros.skeleton.ukf_reference import PlainFilter

NOISE = 0.001


def cabinet() -> Skeleton:
    """Return a drawer with a flap, hung on the world: a prismatic and a revolute joint."""
    names = tuple(f"M{i}" for i in range(6))
    segments = ("world", "drawer", "drawer", "flap", "flap", "flap")
    blank = blank_skeleton(load_template("drawer_cabinet"), names, segments)
    markers = np.random.default_rng(0).normal(size=(6, 3)) * 0.2
    return blank.with_geometry(blank.tree.axis, np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.1]]), markers)


class Compiled:
    """The compiled filter's state, driven step by step."""

    def __init__(self, skeleton: Skeleton, posture: np.ndarray, covariance: np.ndarray, order: int) -> None:
        self.tree, (_, nv) = skeleton.tree, skeleton.size
        count = len(skeleton.marker_names)
        self.q, self.covariance = posture.copy(), covariance.copy()
        self.rates = np.zeros((order - 1, nv))
        self.gain = np.empty((order * nv, nv))
        self.mean, self.measured = np.empty((count, 3)), np.empty((count, 3))
        self.first, self.second = np.empty((count, 3, nv)), np.empty((count, 3, nv))
        self.status = np.empty(count, dtype=np.int64)
        self.variance = np.full(count, NOISE**2)

    def step(self, measured, transition, noise, spectral, gate=math.inf):
        predict(self.tree, self.q, self.rates, self.covariance, transition, noise, spectral)
        assert factor_columns(self.covariance, self.rates.shape[1], self.gain)
        spread_points(self.tree, self.q, self.gain, self.mean, self.first, self.second)
        arguments = (self.mean, self.first, self.second)
        counts = judge_markers(measured, *arguments, self.variance, gate, self.status, self.measured)
        state = (self.tree, self.q, self.rates, self.covariance, self.gain)
        return counts, update(*state, *arguments, self.measured, self.status, self.variance)


@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize("kind", ["person", "cabinet"])
@pytest.mark.parametrize("missing", [0.0, 0.2])
def test_equals_filterpy(order: int, kind: str, missing: float) -> None:
    """Posture, rates and covariance agree over many steps: free and fixed roots, all joints, hidden markers."""
    skeleton = random_person(3) if kind == "person" else cabinet()
    skeleton = skeleton.with_limits(np.full_like(skeleton.lower, -0.5), np.full_like(skeleton.upper, 0.5))
    motion = calibration_motion(random_person(3), 40, 100.0, NOISE, missing, 3) if kind == "person" else None
    rng = np.random.default_rng(4)
    if motion is not None:
        posture, measured = motion.coordinates[0], motion.measured
    else:
        from handover_ros.skeleton.kernels import forward

        displacements = 0.1 * np.cumsum(rng.normal(size=(40, 2)), axis=0) * 0.1
        coordinates = skeleton.coordinates(displacements)
        posture = coordinates[0]
        measured = forward(skeleton.tree, coordinates) + NOISE * rng.normal(size=(40, 6, 3))
        measured[rng.random((40, 6)) < missing] = np.nan
    nv = skeleton.size[1]
    deviations = np.repeat([0.01, 0.5, 2.0][:order], nv)
    covariance = np.diag(deviations**2)
    transition, noise = linear_dynamics(0.01, order)
    spectral = np.full(nv, 20.0)
    ours = Compiled(skeleton, posture, covariance, order)
    plain = PlainFilter(skeleton.tree, posture, covariance, order)
    for frame in measured[1:15]:
        ours.step(frame, transition, noise, spectral)
        plain.predict(transition, noise, spectral)
        plain.update(frame, NOISE**2)
        np.testing.assert_allclose(ours.q, plain.q, atol=1e-7)
        np.testing.assert_allclose(ours.rates, plain.rates, atol=1e-5)
        np.testing.assert_allclose(ours.covariance, plain.filter.P, atol=1e-7)


def test_swapped_labels_are_put_back_and_strangers_not_believed() -> None:
    """Two markers that changed names get them back; one far from everything is left out; a hidden one is missing."""
    skeleton = random_person(5)
    motion = calibration_motion(skeleton, 40, 100.0, NOISE, 0.0, 5)
    nv = skeleton.size[1]
    covariance = np.diag(np.repeat([0.005, 0.1], nv) ** 2)
    filter_ = Compiled(skeleton, motion.coordinates[0], covariance, 2)
    measured = motion.measured[1].copy()
    measured[[9, 14]] = measured[[14, 9]]
    measured[12] += [0.0, 0.0, 0.9]
    measured[20] = np.nan
    (gated, seen), (_, used) = filter_.step(measured, *linear_dynamics(0.01, 2), np.full(nv, 20.0), gate=30.0)
    assert filter_.status[[9, 14]].tolist() == [RELABELLED, RELABELLED]
    assert (filter_.status[12], filter_.status[20]) == (GATED, MISSING)
    assert (filter_.status == SEEN).sum() == seen == len(skeleton.marker_names) - 4
    assert (gated, used) == (1, len(skeleton.marker_names) - 2)
    np.testing.assert_array_equal(filter_.measured[9], motion.measured[1][9])


@pytest.mark.parametrize("value", [-0.5, 0.9, 1.0, 1.3, 4.0])
def test_a_gaussian_is_cut_at_a_limit(value: float) -> None:
    """Mean and variance are those of the truncated normal distribution, and what hangs together moves along."""
    from scipy.stats import truncnorm

    sigma, limit = 0.4, 1.0
    covariance = np.array([[sigma**2, 0.1], [0.1, 0.5]])
    before = covariance.copy()
    shift = np.zeros(2)
    change = truncate(covariance, np.array([1.0]), value, limit, True, shift)
    if limit - value > 3.0 * sigma:
        assert change == 0.0
        return
    exact = truncnorm(-np.inf, (limit - value) / sigma, loc=value, scale=sigma)
    assert value + change == pytest.approx(exact.mean(), abs=2e-2 if value > 3.0 else 1e-9)
    assert value + change < limit
    assert covariance[0, 0] == pytest.approx(exact.var(), rel=0.15 if value > 3.0 else 1e-9)
    assert shift[1] == pytest.approx(change * before[0, 1] / before[0, 0])
    assert np.linalg.eigvalsh(covariance).min() > 0.0
