"""Tests of groups: the same as scipy's own answers, and calm where there is nothing to tell."""

import numpy as np
import pytest
from scipy import stats

from handover_ros.studies.group_statistics import anova, cronbach, more_than_chance, told_f, tukey


def groups(seed=0, apart=1.0):
    rng = np.random.default_rng(seed)
    return {name: place * apart + rng.normal(size=20) for place, name in enumerate(("low", "middle", "high"))}


def test_anova_is_that_of_scipy():
    values = groups()
    found, own = anova(values), stats.f_oneway(*values.values())
    assert (found.statistic, found.p) == pytest.approx((own.statistic, own.pvalue))
    assert found.n == 60
    assert told_f(found).startswith("F(2, 57) = ")
    # Eta squared and F tell the same.
    assert found.statistic == pytest.approx(found.effect / (1.0 - found.effect) * 57 / 2)


def test_tukey_is_that_of_scipy_in_its_direction():
    values = groups()
    own = stats.tukey_hsd(*values.values())
    found = tukey(values, {("high", "low"): "greater", ("low", "high"): "greater"})
    assert found["high", "low"].p == pytest.approx(own.pvalue[2, 0])
    assert found["high", "low"].effect == pytest.approx(values["high"].mean() - values["low"].mean())
    assert found["high", "low"].low < found["high", "low"].effect < found["high", "low"].high
    assert not found["low", "high"].significant


def test_groups_that_are_alike_differ_as_often_as_they_should():
    rate = np.mean([anova(groups(seed, 0.0)).significant for seed in range(400)])
    assert rate == pytest.approx(0.05, abs=0.03)


def test_what_is_not_measured_is_left_out():
    values = groups()
    holes = {name: np.append(each, np.nan) for name, each in values.items()}
    assert anova(holes) == anova(values)
    items = np.random.default_rng(1).normal(size=(30, 1)) + 0.3 * np.random.default_rng(2).normal(size=(30, 4))
    assert cronbach(np.vstack([items, np.full(4, np.nan)])) == cronbach(items)


def test_groups_without_scatter_do_not_fail():
    assert not anova({"a": np.ones(4), "b": np.ones(4)}).significant
    assert anova({"a": np.ones(4), "b": np.zeros(4)}).significant
    assert not anova({"a": np.array([1.0]), "b": np.array([2.0])}).significant
    same = tukey({"a": np.ones(3), "b": np.ones(3)}, {("a", "b"): "greater"})
    assert not same["a", "b"].significant


def test_cronbach_is_by_its_formula_and_its_interval_holds_the_truth():
    rng = np.random.default_rng(3)
    items = rng.normal(size=(200, 1)) + rng.normal(size=(200, 4))
    covariance = np.cov(items.T)
    assert cronbach(items).effect == pytest.approx(4 / 3 * (1.0 - np.trace(covariance) / covariance.sum()))
    truth = 4 * 0.5 / (1 + 3 * 0.5)  # of items that correlate by a half: Spearman and Brown
    found = [cronbach(rng.normal(size=(40, 1)) + rng.normal(size=(40, 4))) for _ in range(400)]
    assert np.mean([each.low < truth < each.high for each in found]) == pytest.approx(0.95, abs=0.03)


def test_cronbach_of_one_thing_is_high_and_of_many_is_not():
    rng = np.random.default_rng(4)
    assert cronbach(np.tile(rng.normal(size=(30, 1)), 4)).significant
    assert not cronbach(rng.normal(size=(30, 4))).significant
    assert not cronbach(np.ones((30, 4))).significant


def test_more_than_chance_is_a_binomial_test():
    assert more_than_chance(7, 10, "goals").p == pytest.approx(stats.binomtest(7, 10, 0.05, "greater").pvalue)
    assert not more_than_chance(0, 10, "goals").significant
