"""The minimum-jerk reach between two postures."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_ros.ergonomics.reach import check_duration, differentiation, gauss_legendre, minimum_jerk_reach
from handover_ros.errors import BadRequestError

durations = st.floats(0.2, 5.0)


@given(st.floats(-2.0, 2.0), durations)
def test_minimum_jerk_integrals(way, duration):
    """720 d2 / T5 is the least squared jerk from rest to rest; the rates integrate to the way, the jerks to nothing."""
    reach = minimum_jerk_reach(np.zeros(1), np.array([way]), duration, 12)
    assert reach.integral(reach.jerks[:, 0] ** 2) == pytest.approx(720.0 * way**2 / duration**5, rel=1e-9)
    assert reach.integral(reach.rates[:, 0]) == pytest.approx(way)
    assert reach.integral(reach.accelerations[:, 0]) == pytest.approx(0.0, abs=1e-9)
    assert reach.weights.sum() == pytest.approx(duration)


@given(st.integers(0, 10**6), durations)
def test_derivatives_are_those_of_the_path(seed, duration):
    start, end = np.random.default_rng(seed).normal(size=(2, 4))
    reach = minimum_jerk_reach(start, end, duration, 16)
    matrix = differentiation(16) / duration
    scale = 1.0 / min(duration, 1.0) ** 3
    np.testing.assert_allclose(matrix @ reach.displacements, reach.rates, atol=1e-8 * scale)
    np.testing.assert_allclose(matrix @ reach.rates, reach.accelerations, atol=1e-7 * scale)
    np.testing.assert_allclose(matrix @ reach.accelerations, reach.jerks, atol=1e-6 * scale)


def test_differentiation_is_exact_for_polynomials():
    nodes, _ = gauss_legendre(10)
    np.testing.assert_allclose(differentiation(10) @ nodes**9, 9.0 * nodes**8, atol=1e-10)


def test_many_ends_are_each_alone():
    start, ends = np.zeros(3), np.random.default_rng(1).normal(size=(2, 5, 3))
    many = minimum_jerk_reach(start, ends, 1.0, 8)
    assert many.jerks.shape == (2, 5, 8, 3)
    np.testing.assert_array_equal(many.jerks[1, 3], minimum_jerk_reach(start, ends[1, 3], 1.0, 8).jerks)


@pytest.mark.parametrize("duration", [0.0, -1.0, float("nan"), 1e3])
def test_a_duration_that_is_none_is_refused(duration):
    with pytest.raises(BadRequestError, match="duration"):
        check_duration(duration)
