"""Tests and intervals: right where the answer is known, and calm where there is no scatter."""

import numpy as np
import pytest

from handover_ros.studies.statistics import against, band, correlated, independent, interval, paired


def test_a_difference_is_found_in_its_direction_only():
    rng = np.random.default_rng(0)
    first = rng.normal(size=50)
    second = first - 0.5 + 0.1 * rng.normal(size=50)
    assert paired(first, second, "greater").significant
    assert not paired(first, second, "less").significant
    assert paired(first, second, "greater").effect == pytest.approx(0.5, abs=0.05)
    assert independent(second, first, "less").significant
    assert correlated(first, second).significant
    assert not correlated(first, -second).significant


def test_chance_is_significant_as_often_as_it_should_be():
    rng = np.random.default_rng(1)
    rate = np.mean([paired(rng.normal(size=20), rng.normal(size=20), "greater").significant for _ in range(1000)])
    assert rate == pytest.approx(0.05, abs=0.025)


def test_without_scatter_the_sign_decides():
    assert against(np.full(5, 0.2), 0.0, "greater").significant
    assert not against(np.full(5, 0.2), 0.0, "less").significant
    assert not against(np.zeros(5), 0.0, "greater").significant
    assert not against(np.array([1.0]), 0.0, "greater").significant


def test_intervals_hold_the_truth_as_often_as_they_say():
    rng = np.random.default_rng(2)
    ends = np.array([interval(rng.normal(size=12)) for _ in range(1000)])
    assert np.mean((ends[:, 0] < 0.0) & (ends[:, 1] > 0.0)) == pytest.approx(0.95, abs=0.03)
    mean, low, high = band(rng.normal(size=(30, 4)))
    assert ((low < mean) & (mean < high)).all()
