"""What a query is expected to tell: mutual information of preference and answer, or the fall of a grid's entropy.

With weighted particles the mutual information is exact: H(E[P(answer)]) - E[H(P(answer))], no posterior is needed. The
dissertation's grid entropy (4.6, with the minus sign it lacks) counts particles in cells; with one particle a cell, its
full expectation (4.7) is the mutual information.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.sparse import csr_array

from handover_ros.errors import BadRequestError
from handover_ros.geometry import FloatArray
from handover_ros.preferences.belief import Belief
from handover_ros.preferences.likelihood import choice_probabilities, region_probabilities, survey
from handover_ros.preferences.query import IntArray, Query
from handover_ros.preferences.space import People

AnswerKind = Literal["posture", "region"]
CELLS = 10  # of a grid in each direction
LEAST_SHARE = 1e-12  # of an answer that is worth a posterior


def entropy(probabilities: FloatArray) -> FloatArray:
    """Return -sum p log p [nat] over the last axis."""
    logs = np.log(np.where(probabilities > 0.0, probabilities, 1.0))
    return np.asarray(-(probabilities * logs).sum(axis=-1))


@dataclass(frozen=True)
class Outlook:
    """What is to be expected of a query.

    Attributes:
        information: Mutual information of preference and answer [nat].
        cost: Expected cost of the configuration that will be taken.
        least_cost: Expected cost of the best one (4.10).
    """

    information: float
    cost: float
    least_cost: float


def outlook(people: People, weights: FloatArray, query: Query, answers: AnswerKind = "posture") -> Outlook:
    """Return what is to be expected of a query.

    Args:
        people: Believed persons.
        weights: Of each, sum 1, shape (n,).
        query: The offer.
        answers: Whether the configuration will be seen, or only the grasp region.
    """
    found = survey(people, weights, query)
    if answers == "region":
        probabilities = region_probabilities(people, query)
        information = entropy(weights @ probabilities) - weights @ entropy(probabilities)
    else:
        information = entropy(found.predicted) - weights @ found.entropy
    # Rounding may leave a little below zero where nothing can be learned.
    return Outlook(max(0.0, float(information)), float(weights @ found.mean_cost), float(weights @ found.least_cost))


def answer_probabilities(people: People, query: Query, answers: AnswerKind) -> FloatArray:
    """Return the probabilities (n, answers) of every answer."""
    return choice_probabilities(people, query) if answers == "posture" else region_probabilities(people, query)


def grid_cells(belief: Belief, cells: int = CELLS) -> IntArray:
    """Return the cell (n,) of each particle in a grid over the bounds, only occupied cells numbered."""
    if cells < 1:
        raise BadRequestError(f"cells: must be 1 or more, got {cells}")
    lower, upper = belief.prior.space.bounds
    places = np.clip((cells * (belief.particles - lower) / (upper - lower)).astype(np.int64), 0, cells - 1)
    return np.asarray(np.unique(places, axis=0, return_inverse=True)[1].reshape(-1))


def grid_gain(
    belief: Belief,
    query: Query,
    answers: AnswerKind = "posture",
    most_likely: bool = False,
    cells: IntArray | None = None,
) -> float:
    """Return the expected fall of the grid's entropy [nat]: (4.7), or (4.8) with each person's most likely answer.

    Args:
        belief: The belief.
        query: The offer.
        answers: What of the choice will be seen.
        most_likely: Whether each person's most likely answer stands for all of their answers (4.8).
        cells: Cell of each particle (n,); default: ``grid_cells``.
    """
    cell = grid_cells(belief) if cells is None else cells
    weights = belief.weights
    probabilities = answer_probabilities(belief.people, query, answers)
    counted = probabilities
    if most_likely:
        counted = np.zeros_like(probabilities)
        counted[np.arange(len(weights)), probabilities.argmax(axis=1)] = 1.0
    shares = weights @ counted
    kept = shares > LEAST_SHARE
    posteriors = (probabilities[:, kept] * weights[:, None]).T
    posteriors /= posteriors.sum(axis=1, keepdims=True)
    count = len(weights)
    to_cells = csr_array((np.ones(count), (cell, np.arange(count))), shape=(int(cell.max()) + 1, count))
    before = entropy(np.asarray(to_cells @ weights))
    after = entropy(np.asarray((to_cells @ posteriors.T).T))
    return float(before - shares[kept] @ after / shares[kept].sum())
