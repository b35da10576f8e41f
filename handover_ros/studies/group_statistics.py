"""Tests of several groups at once, by scipy: analysis of variance, Tukey's comparisons of pairs, Cronbach's alpha."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from scipy import stats

from handover_ros.geometry import FloatArray
from handover_ros.studies.statistics import CONFIDENCE, LEVEL, Comparison, Direction

NAN = float("nan")
HIGH_ALPHA = 0.7  # from which items are commonly said to measure one thing: J. C. Nunnally, Psychometric Theory, 1978


def anova(groups: Mapping[str, FloatArray], test: str = "one-way ANOVA") -> Comparison:
    """Return whether the means of groups differ; the effect is eta squared, the share of variance they explain."""
    values = [np.asarray(each, dtype=float)[np.isfinite(each)] for each in groups.values()]
    count = sum(map(len, values))
    name = f"{test}, F({len(values) - 1}, {count - len(values)})"
    every = np.concatenate(values)
    within = sum(float(np.square(each - each.mean()).sum()) for each in values if len(each))
    total = float(np.square(every - every.mean()).sum()) if count else 0.0
    if count <= len(values) or min(map(len, values)) == 0 or total == 0.0:
        return Comparison(name, NAN, NAN, NAN, NAN, 1.0, count)
    if within <= 1e-12 * total:  # no scatter at all within groups that differ
        return Comparison(name, 1.0, NAN, NAN, NAN, 0.0, count)
    found = stats.f_oneway(*values)
    return Comparison(name, 1.0 - within / total, NAN, NAN, float(found.statistic), float(found.pvalue), count)


def tukey(
    groups: Mapping[str, FloatArray], pairs: Mapping[tuple[str, str], Direction]
) -> dict[tuple[str, str], Comparison]:
    """Return for pairs of groups whether the first is greater or less, by Tukey's HSD over all groups.

    Its p is of two sides; a difference in the other direction has p = 1.

    Args:
        groups: Values of each.
        pairs: Which are asked for, and the direction.
    """
    names = list(groups)
    values = [np.asarray(each, dtype=float)[np.isfinite(each)] for each in groups.values()]
    count = sum(map(len, values))
    with np.errstate(divide="ignore", invalid="ignore"):  # without any scatter p is 0 or not a number
        found = stats.tukey_hsd(*values)
        ends = found.confidence_interval(CONFIDENCE)
    result = {}
    for (first, second), direction in pairs.items():
        row, column = names.index(first), names.index(second)
        effect, p = float(found.statistic[row, column]), float(found.pvalue[row, column])
        right = effect > 0.0 if direction == "greater" else effect < 0.0
        result[first, second] = Comparison(
            f"Tukey HSD, {direction}",
            effect,
            float(ends.low[row, column]),
            float(ends.high[row, column]),
            effect,
            p if right and np.isfinite(p) else 1.0,
            count,
        )
    return result


def cronbach(items: FloatArray, least: float = HIGH_ALPHA) -> Comparison:
    """Return whether Cronbach's alpha of items (cases, k) is greater than a number; by Feldt's F-test and interval.

    Cases with an item that is not measured are left out.

    L. S. Feldt, The approximate sampling distribution of Kuder-Richardson reliability coefficient twenty, 1965.
    """
    table = np.asarray(items, dtype=float)
    table = table[np.isfinite(table).all(axis=1)]
    cases, number = table.shape
    name = f"Feldt's test of Cronbach's alpha, greater than {least:g}"
    total = float(table.sum(axis=1).var(ddof=1)) if cases > 1 else 0.0
    if cases < 3 or number < 2 or total == 0.0:
        return Comparison(name, NAN, NAN, NAN, NAN, 1.0, cases)
    alpha = number / (number - 1) * (1.0 - float(table.var(axis=0, ddof=1).sum()) / total)
    first, second = cases - 1, (cases - 1) * (number - 1)
    if alpha >= 1.0:
        return Comparison(name, 1.0, 1.0, 1.0, NAN, 0.0, cases)
    tail = (1.0 - CONFIDENCE) / 2.0
    low = 1.0 - (1.0 - alpha) * float(stats.f.ppf(1.0 - tail, first, second))
    high = 1.0 - (1.0 - alpha) * float(stats.f.ppf(tail, first, second))
    ratio = (1.0 - least) / (1.0 - alpha)
    return Comparison(name, alpha, low, high, ratio, float(stats.f.sf(ratio, first, second)), cases)


def more_than_chance(successes: int, trials: int, what: str) -> Comparison:
    """Return whether more results are significant than by chance (binomial test); the effect is their share."""
    found = stats.binomtest(successes, trials, LEVEL, alternative="greater")
    ends = stats.binomtest(successes, trials).proportion_ci(CONFIDENCE)
    return Comparison(
        f"binomial test of {what} against {LEVEL:g}, greater",
        successes / trials,
        float(ends.low),
        float(ends.high),
        float(successes),
        float(found.pvalue),
        trials,
    )


def mean_of(values: npt.ArrayLike) -> float:
    """Return the mean of what was measured; NaN: nothing was."""
    array = np.asarray(values, dtype=float)
    array = array[np.isfinite(array)]
    return float(array.mean()) if len(array) else NAN


def told_f(found: Comparison) -> str:
    """Return an analysis of variance in a few words."""
    p = "p < 0.0001" if found.p < 1e-4 else f"p = {found.p:.4f}"
    return f"{found.test.split(', ', 1)[1]} = {found.statistic:.2f}, {p}, eta squared {found.effect:.2f}"
