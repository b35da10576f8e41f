"""How likely an answer is to a query, for every believed person at once (Bestick 2017, eq. 4.3, 4.5)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.preferences import choice_kernels
from handover_ros.preferences.query import Answer, Query
from handover_ros.preferences.space import People
from handover_ros.threads import in_parts

kernels: Any = choice_kernels  # numba's functions carry no types
LEAST_PART = 200_000  # cost evaluations for which another thread pays


def log_likelihood(people: People, query: Query, answer: Answer) -> FloatArray:
    """Return log P(answer | query, person) (n,), up to a constant of the answer.

    A sum over the configurations that may have been chosen: exact for a region, where the dissertation substituted the
    most likely configuration.
    """
    every = _log_sums(people, query.rows, query.attraction)
    return _log_sums_of_answer(people, query, answer) - every


def log_likelihoods(people: People, answered: Iterable[tuple[Query, Answer]]) -> Iterator[FloatArray]:
    """Yield ``log_likelihood`` (n,) of one answer after the other; what a query offers is summed once."""
    offered: dict[int, FloatArray] = {}
    for query, answer in answered:
        if id(query) not in offered:
            offered[id(query)] = _log_sums(people, query.rows, query.attraction)
        yield _log_sums_of_answer(people, query, answer) - offered[id(query)]


def _log_sums_of_answer(people: People, query: Query, answer: Answer) -> FloatArray:
    """Return the log sums (n,) over the configurations that may have been chosen."""
    rows = np.ascontiguousarray(query.rows[:, answer.places])
    return _log_sums(people, rows, query.attraction[answer.places] + np.log(answer.shares))


def _log_sums(people: People, rows: FloatArray, attraction: FloatArray) -> FloatArray:
    """Return log sum_k exp(attraction_k - rationality C_k) (n,) without the costs' constants."""
    slopes = -2.0 * people.weights * people.neutral
    result = np.empty(len(people))

    def part(start: int, end: int) -> None:
        kernels.log_sums(
            rows,
            attraction,
            people.weights[start:end],
            slopes[start:end],
            people.rationality[start:end],
            result[start:end],
        )

    in_parts(len(people), part, max(1, LEAST_PART // len(attraction)))
    return result


@dataclass(frozen=True, eq=False)
class Survey:
    """How believed persons would answer a query.

    Attributes:
        predicted: Probability of each configuration under the belief, shape (k,).
        entropy: Of each person's choice among configurations [nat], shape (n,).
        mean_cost: Each person's expected cost, shape (n,).
        least_cost: Each person's least cost, shape (n,).
    """

    predicted: FloatArray
    entropy: FloatArray
    mean_cost: FloatArray
    least_cost: FloatArray


def survey(people: People, weights: FloatArray, query: Query) -> Survey:
    """Return how persons with weights (n,) would answer a query."""
    slopes = -2.0 * people.weights * people.neutral
    constants = np.einsum("nd,nd->n", people.weights, np.square(people.neutral))
    table = np.empty((len(people), 3))

    def part(start: int, end: int) -> FloatArray:
        predicted = np.zeros(len(query))
        kernels.survey(
            query.rows,
            query.attraction,
            people.weights[start:end],
            slopes[start:end],
            constants[start:end],
            people.rationality[start:end],
            weights[start:end],
            predicted,
            table[start:end],
        )
        return predicted

    parts = in_parts(len(people), part, max(1, LEAST_PART // len(query)))
    return Survey(np.sum(parts, axis=0), table[:, 0], table[:, 1], table[:, 2])


def region_probabilities(people: People, query: Query) -> FloatArray:
    """Return with which probability each person takes the object in each region (n, regions)."""
    slopes = -2.0 * people.weights * people.neutral
    result = np.empty((len(people), len(query.regions)))

    def part(start: int, end: int) -> None:
        kernels.group_probabilities(
            query.rows,
            query.attraction,
            query.region,
            people.weights[start:end],
            slopes[start:end],
            people.rationality[start:end],
            result[start:end],
        )

    in_parts(len(people), part, max(1, LEAST_PART // len(query)))
    return result


def choice_probabilities(people: People, query: Query) -> FloatArray:
    """Return P(q | query, person) (n, k) of every configuration: the plain form of (4.3)."""
    exponents = query.attraction - people.rationality[:, None] * people.costs(query.configurations)
    shares = np.exp(exponents - exponents.max(axis=1, keepdims=True))
    return np.asarray(shares / shares.sum(axis=1, keepdims=True))
