"""The tests that decide on claims, by scipy; every one says what it tested, in words and numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy import stats

from handover_ros.geometry import FloatArray

LEVEL = 0.05  # below which a difference is not chance
CONFIDENCE = 0.95
ROUNDING = 1e-12  # share of the largest difference, within which all are the same
Direction = Literal["greater", "less"]


@dataclass(frozen=True)
class Comparison:
    """One tested difference.

    Attributes:
        test: Name of the test and its direction.
        effect: The difference, or the quantity that was tested.
        low: Lower end of the effect's 95 % confidence interval.
        high: Upper end.
        statistic: Of the test.
        p: Of what was seen or more, if there were no difference.
        n: Number of persons or things.
    """

    test: str
    effect: float
    low: float
    high: float
    statistic: float
    p: float
    n: int

    @property
    def significant(self) -> bool:
        """Whether the difference is there, in the tested direction."""
        return self.p < LEVEL

    def told(self, unit: str = "") -> str:
        """Return effect, interval and p in a few words."""
        p = "p < 0.001" if self.p < 0.001 else f"p = {self.p:.3f}"
        return f"{self.effect:+.2f}{unit} [{self.low:+.2f}, {self.high:+.2f}], {p}"


def paired(first: npt.ArrayLike, second: npt.ArrayLike, direction: Direction) -> Comparison:
    """Return whether the first values (n,) are greater or less than the second, person by person (paired t-test)."""
    return against(np.asarray(first, dtype=float) - np.asarray(second, dtype=float), 0.0, direction, "paired t-test")


def against(values: npt.ArrayLike, middle: float, direction: Direction, test: str = "t-test") -> Comparison:
    """Return whether the mean of values (n,) is greater or less than a number; the effect is the difference."""
    differences = np.asarray(values, dtype=float) - middle
    differences = differences[np.isfinite(differences)]
    name = f"{test}, {direction}"
    mean, count = float(differences.mean()) if len(differences) else float("nan"), len(differences)
    if count < 2 or np.ptp(differences) <= ROUNDING * np.abs(differences).max():
        # Without any scatter there is no t; all alike in the right direction is certain, anything else is not.
        right = count >= 2 and (mean > 0.0 if direction == "greater" else mean < 0.0)
        return Comparison(name, mean, mean, mean, float("nan"), 0.0 if right else 1.0, count)
    found = stats.ttest_1samp(differences, 0.0, alternative=direction)
    low, high = interval(differences)
    return Comparison(name, mean, low, high, float(found.statistic), float(found.pvalue), count)


def independent(first: npt.ArrayLike, second: npt.ArrayLike, direction: Direction) -> Comparison:
    """Return whether the first values are greater or less than the second (Mann-Whitney U); the effect is of means."""
    a, b = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    found = stats.mannwhitneyu(a, b, alternative=direction)
    difference = stats.ttest_ind(a, b, equal_var=False).confidence_interval(CONFIDENCE)
    effect = float(a.mean() - b.mean())
    return Comparison(
        f"Mann-Whitney U, {direction}",
        effect,
        float(difference.low),
        float(difference.high),
        float(found.statistic),
        float(found.pvalue),
        len(a) + len(b),
    )


def pooled(
    first: npt.ArrayLike, second: npt.ArrayLike, direction: Direction | Literal["two-sided"] = "two-sided"
) -> Comparison:
    """Return whether the first values differ from the second, or how (t-test of two samples of equal variance)."""
    a, b = (values[np.isfinite(values)] for values in (np.asarray(first, float), np.asarray(second, float)))
    if min(len(a), len(b)) < 2 or max(np.ptp(a), np.ptp(b)) == 0.0:
        nan = float("nan")
        return Comparison(f"pooled t-test, {direction}", nan, nan, nan, nan, 1.0, len(a) + len(b))
    found = stats.ttest_ind(a, b, alternative=direction)
    interval_of = stats.ttest_ind(a, b).confidence_interval(CONFIDENCE)
    return Comparison(
        f"pooled t-test, {direction}",
        float(a.mean() - b.mean()),
        float(interval_of.low),
        float(interval_of.high),
        float(found.statistic),
        float(found.pvalue),
        len(a) + len(b),
    )


def alike(first: npt.ArrayLike, second: npt.ArrayLike, margin: float, unit: str) -> list[Comparison]:
    """Return the two one-sided paired t-tests of equivalence: the mean difference is within the margin both ways."""
    differences = np.asarray(first, dtype=float) - np.asarray(second, dtype=float)
    name = f"equivalence within {margin:g} {unit}, paired t-test"
    return [against(differences, margin, "less", name), against(differences, -margin, "greater", name)]


def correlated(first: npt.ArrayLike, second: npt.ArrayLike) -> Comparison:
    """Return whether two quantities (n,) grow together (Spearman); the interval is by Fisher's transformation."""
    a, b = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    found = stats.spearmanr(a, b, alternative="greater")
    rho, half = float(found.statistic), 1.96 * 1.03 / np.sqrt(max(len(a) - 3, 1))
    low, high = np.tanh(np.arctanh(np.clip(rho, -0.999999, 0.999999)) + np.array([-half, half]))
    return Comparison("Spearman correlation, greater", rho, float(low), float(high), rho, float(found.pvalue), len(a))


def interval(values: FloatArray) -> tuple[float, float]:
    """Return the 95 % confidence interval of the mean of values (n,) by Student's t."""
    if len(values) < 2 or np.ptp(values) == 0.0:
        return float(np.mean(values)), float(np.mean(values))
    mean, error = float(np.mean(values)), float(stats.sem(values))
    low, high = stats.t.interval(CONFIDENCE, len(values) - 1, loc=mean, scale=error)
    return float(low), float(high)


def band(curves: FloatArray) -> FloatArray:
    """Return mean, lower and upper end of its 95 % confidence interval (3, k) of curves (n, k)."""
    ends = np.array([interval(column) for column in curves.T])
    return np.array([curves.mean(axis=0), ends[:, 0], ends[:, 1]])
