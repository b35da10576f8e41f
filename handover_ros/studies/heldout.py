"""Handovers that no strategy learns from: how well a model of the person predicts them (Bestick 2017, section 4.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import logsumexp

from handover_ros.geometry import FloatArray
from handover_ros.preferences.likelihood import choice_probabilities
from handover_ros.preferences.query import Query
from handover_ros.preferences.space import People


@dataclass(frozen=True, eq=False)
class Heldout:
    """Test handovers and what the person did, padded to the largest feasible set.

    Attributes:
        configurations: Shape (tests, k, d) [rad].
        attraction: Log measure of each, -inf where there is none, shape (tests, k).
        seen: Configurations that may have been chosen: one, or those of the region that was seen, shape (tests, k).
    """

    configurations: FloatArray
    attraction: FloatArray
    seen: npt.NDArray[np.bool_]

    def log_likelihood(self, person: People) -> float:
        """Return the mean log likelihood of what was seen, a test, under a model of the person (one row)."""
        costs = np.square(self.configurations - person.neutral[0]) @ person.weights[0]
        exponents = self.attraction - person.rationality[0] * costs
        some = logsumexp(np.where(self.seen, exponents, -np.inf), axis=1)
        return float(np.mean(some - logsumexp(exponents, axis=1)))


def heldout(queries: Sequence[Query], truth: People, rng: np.random.Generator, by_region: bool = False) -> Heldout:
    """Return test handovers as the person (one row) answers them.

    Args:
        queries: The handovers.
        truth: The person.
        rng: Of their choices.
        by_region: Whether only the grasp region is seen.
    """
    most, joints = max(len(query) for query in queries), queries[0].configurations.shape[1]
    configurations = np.zeros((len(queries), most, joints))
    attraction = np.full((len(queries), most), -np.inf)
    seen = np.zeros((len(queries), most), dtype=bool)
    for test, query in enumerate(queries):
        count = len(query)
        configurations[test, :count], attraction[test, :count] = query.configurations, query.attraction
        place = choice(query, truth, rng.random())
        seen[test, :count] = query.region == query.region[place] if by_region else np.arange(count) == place
    return Heldout(configurations, attraction, seen)


def choice(query: Query, person: People, level: float) -> int:
    """Return the configuration that a person (one row) chooses by (4.3), drawn with a number in [0, 1)."""
    levels = np.cumsum(choice_probabilities(person, query)[0])
    return min(int(np.searchsorted(levels / levels[-1], level, side="right")), len(query) - 1)
