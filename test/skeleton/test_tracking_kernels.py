"""One compiled call a frame does what its parts do, and reads the estimate out as the skeleton itself would."""

import math

import numpy as np
import pytest
from people import calibration_motion, drawer_cabinet, random_person, sweeps
from scipy.stats import chi2

from handover_ros.mocap.frames import MarkerStatus
from handover_ros.skeleton.dynamics_model import decays, linear_dynamics
from handover_ros.skeleton.kernels import forward
from handover_ros.skeleton.limit_kernels import displacement_table, limit_table
from handover_ros.skeleton.tracking_kernels import COVARIANCE, POSE, estimate_size, step
from handover_ros.skeleton.ukf_reference import PlainFilter

ELAPSED, NOISE, MEMORY = 0.01, 0.001, (0.5, 0.25)


class Filter:
    """The state of a filter that one call a frame moves on."""

    def __init__(self, motion, order):
        self.skeleton = motion.skeleton
        nv = self.skeleton.size[1]
        self.q, self.rates = motion.coordinates[0].copy(), np.zeros((order - 1, nv))
        self.covariance = np.diag(np.repeat([0.01, 0.5, 2.0][:order], nv) ** 2)
        self.spectral, self.decay = np.full(nv, 50.0), decays(order, *MEMORY)
        self.tables = (limit_table(self.skeleton, 0.0), displacement_table(self.skeleton, self.skeleton.middle))
        self.out = np.empty(estimate_size(len(self.skeleton.marker_names), len(self.skeleton.lower)))

    def step(self, observed, source=None, fade=1.0, gate=math.inf, limited=False):
        source = np.zeros(len(observed), dtype=np.uint8) if source is None else source
        state = (self.q, self.rates, self.covariance, self.spectral, self.decay)
        options = (ELAPSED, fade, gate, 3, 0.12, 100.0 * self.spectral, limited)
        return step(self.skeleton.tree, *self.tables, *state, observed, source, NOISE, *options, self.out)

    def read(self):
        """Return what was read out, by name."""
        n, markers = len(self.skeleton.lower), len(self.skeleton.marker_names)
        sizes = (3 * markers, n, n, n * n, POSE, COVARIANCE, 6)
        parts = np.split(self.out, np.cumsum(sizes)[:-1])
        shapes = ((markers, 3), (n,), (n,), (n, n), (4, 4), (6, 6), (6,))
        names = ("markers", "displacements", "velocities", "covariance", "pose", "pose_covariance", "pose_velocity")
        return {name: part.reshape(shape) for name, part, shape in zip(names, parts, shapes)}


def motion_of(kind, missing=0.1):
    if kind == "person":
        return calibration_motion(random_person(2), 1200, 100.0, NOISE, missing, 2)
    return sweeps(drawer_cabinet(1), 900, 100.0, NOISE, 1)


@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize("kind", ["person", "cabinet"])
def test_a_frame_is_filterpys(kind, order):
    """Without gate and limits: prediction with fading rates and correction by the markers that are there."""
    motion = motion_of(kind)
    ours = Filter(motion, order)
    plain = PlainFilter(motion.skeleton.tree, ours.q, ours.covariance, order)
    transition, noise = linear_dynamics(ELAPSED, order, *MEMORY)
    for observed in motion.measured[1:12]:
        used, squared, distance, gated, seen, relabelled = ours.step(observed)
        plain.predict(transition, noise, ours.spectral)
        plain.update(observed, NOISE**2)
        there = np.isfinite(observed[:, 0])
        assert (used, gated, seen, relabelled) == (there.sum(), 0, there.sum(), 0)
        np.testing.assert_allclose(ours.q, plain.q, atol=1e-9)
        np.testing.assert_allclose(ours.rates, plain.rates, atol=1e-6)
        np.testing.assert_allclose(ours.covariance, plain.filter.P, atol=1e-8)
        apart = forward(motion.skeleton.tree, ours.q) - observed
        assert distance == pytest.approx(np.nansum(apart**2), rel=1e-9)
        innovation, system = plain.filter.y, plain.filter.S
        assert squared == pytest.approx(innovation @ np.linalg.solve(system, innovation), rel=1e-6)


@pytest.mark.parametrize("kind", ["person", "cabinet"])
def test_what_is_read_out_is_what_the_skeleton_says(kind):
    motion = motion_of(kind)
    skeleton, ours = motion.skeleton, Filter(motion, 3)
    for observed in motion.measured[1:20]:
        ours.step(observed, limited=True)
    read, nv = ours.read(), skeleton.size[1]
    displacements = skeleton.displacements(ours.q)
    mapping = skeleton.displacement_mapping(displacements)
    np.testing.assert_allclose(read["displacements"], displacements, atol=1e-12)
    np.testing.assert_allclose(read["velocities"], mapping @ ours.rates[0], atol=1e-9)
    np.testing.assert_allclose(read["covariance"], mapping @ ours.covariance[:nv, :nv] @ mapping.T, atol=1e-12)
    np.testing.assert_allclose(read["markers"], forward(skeleton.tree, ours.q), atol=1e-14)
    np.testing.assert_allclose(read["pose"], skeleton.world_from_root(ours.q), atol=1e-14)
    if skeleton.is_free:
        np.testing.assert_array_equal(read["pose_covariance"], ours.covariance[:6, :6])
        np.testing.assert_array_equal(read["pose_velocity"], ours.rates[0, :6])
    else:
        assert not read["pose_covariance"].any()
        assert not read["pose_velocity"].any()


def test_a_bridged_marker_says_less_than_a_measured_one():
    motion = motion_of("person", missing=0.0)
    source = np.full(len(motion.skeleton.marker_names), MarkerStatus.BRIDGED, dtype=np.uint8)
    measured, bridged = Filter(motion, 3), Filter(motion, 3)
    measured.step(motion.measured[1])
    bridged.step(motion.measured[1], source)
    ratio = np.diag(bridged.read()["covariance"]) / np.diag(measured.read()["covariance"])
    assert ratio.min() > 1.2
    assert ratio.max() > 4.0


def test_a_sudden_motion_is_allowed_for():
    """A whole arm that jumps is followed in the same frame; one marker that jumps is not believed."""
    motion = motion_of("person", missing=0.0)
    skeleton = motion.skeleton
    ours = Filter(motion, 3)
    for observed in motion.measured[1:20]:
        ours.step(observed, gate=30.0)
    lone = Filter(motion, 3)
    for name in ("q", "rates", "covariance"):
        setattr(lone, name, getattr(ours, name).copy())
    displaced = skeleton.displacements(ours.q)
    displaced[[0, 7]] += 0.06  # in a hundredth of a second
    jumped = forward(skeleton.tree, skeleton.coordinates(displaced, skeleton.world_from_root(ours.q)))
    *_, gated, seen, _ = ours.step(jumped, gate=30.0)
    assert (gated, seen) == (0, len(jumped))
    np.testing.assert_allclose(ours.read()["displacements"], displaced, atol=0.03)
    stray = motion.measured[20].copy()
    stray[10] += 0.3
    used, *_, gated, seen, _ = lone.step(stray, gate=30.0)
    assert (used, gated, seen) == (len(stray) - 1, 1, len(stray) - 1)


def test_while_nothing_is_seen_a_motion_fades_and_certainty_with_it():
    motion = motion_of("person", missing=0.0)
    going, fading = Filter(motion, 3), Filter(motion, 3)
    for each in (going, fading):
        each.rates[:] = 0.5
    nothing = np.full_like(motion.measured[0], np.nan)
    for _ in range(20):
        assert going.step(nothing)[0] == fading.step(nothing, fade=0.9)[0] == 0
    assert (np.abs(fading.rates[0]) < 0.3 * np.abs(going.rates[0])).all()
    np.testing.assert_allclose(fading.covariance, going.covariance, rtol=1e-9, atol=1e-12)
    assert (np.diag(going.covariance)[: going.rates.shape[1]] > 0.01**2).all()


def test_a_covariance_that_is_none_is_reported():
    motion = motion_of("cabinet")
    broken = Filter(motion, 2)
    broken.covariance[0, 0] = -1.0
    assert broken.step(motion.measured[1])[0] == -1


def test_errors_and_innovations_are_as_large_as_it_says():
    """Over many motions drawn from the very dynamics: both chi-squared sums lie within their 99.9 % bands."""
    runs, frames, order = 40, 40, 3
    motion = motion_of("cabinet", missing=0.0)
    skeleton, (_, nv) = motion.skeleton, motion.skeleton.size
    transition, noise = (np.kron(each, np.eye(nv)) for each in linear_dynamics(ELAPSED, order, *MEMORY))
    errors, innovations, measured_numbers = 0.0, 0.0, 0
    rng = np.random.default_rng(0)
    for _ in range(runs):
        ours = Filter(motion, order)
        root = np.linalg.cholesky(noise * np.tile(ours.spectral, order))
        state = np.concatenate([ours.q, ours.rates.ravel()]) + np.linalg.cholesky(ours.covariance) @ rng.normal(size=6)
        for _ in range(frames):
            state = transition @ state + root @ rng.normal(size=order * nv)
            markers = forward(skeleton.tree, state[:nv])
            observed = markers + NOISE * rng.normal(size=markers.shape)
            observed[rng.random(len(markers)) < 0.3] = np.nan
            used, squared, *_ = ours.step(observed)
            innovations, measured_numbers = innovations + squared, measured_numbers + 3 * used
        error = state - np.concatenate([ours.q, ours.rates.ravel()])
        errors += error @ np.linalg.solve(ours.covariance, error)
    low, high = chi2.ppf([0.0005, 0.9995], runs * order * nv)
    assert low < errors < high
    low, high = chi2.ppf([0.0005, 0.9995], measured_numbers)
    assert low < innovations < high
