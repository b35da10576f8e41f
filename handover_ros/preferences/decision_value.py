"""What an answer is worth for the next plans: the value of information (Howard 1966), which goes past chapter 4.

Information about a preference is not an end. A joint whose neutral displacement costs little may be learned for long
without any plan becoming better. Here the queries of a menu stand for what can be planned: after an answer, the one of
each kind with the least expected cost would be made. How much less that is, on average over the answers, than with what
is known now, is the value of the query.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.preferences.belief import Belief, systematic
from handover_ros.preferences.information import AnswerKind, answer_probabilities
from handover_ros.preferences.likelihood import survey
from handover_ros.preferences.query import Query

PERSONS = 400  # of the belief that are asked
ANSWERS = 100  # of a query that are drawn when it has more


def decision_values(
    belief: Belief,
    menu: Sequence[Query],
    answers: AnswerKind = "posture",
    persons: int = PERSONS,
    drawn: int = ANSWERS,
    seed: int = 0,
) -> FloatArray:
    """Return how much each query's answer would lower the expected cost of the next plans, shape (m,), 0 or more.

    Args:
        belief: What is believed.
        menu: The queries; those of the same name are ways to do the same handover, of which one will be planned.
        answers: What of a choice will be seen.
        persons: Of the belief, drawn by weight; with as many particles or less all are taken.
        drawn: Answers of a query, drawn by probability; with as many or less all are taken.
        seed: Of the draws.
    """
    rng = np.random.default_rng((seed, belief.observations))
    people, weights = belief.people, belief.weights
    if persons < len(weights):
        kept = systematic(weights, rng, persons)
        people = belief.prior.space.people(belief.particles[kept])
        weights = np.full(persons, 1.0 / persons)
    costs = np.column_stack([survey(people, weights, query).mean_cost for query in menu])  # (persons, m)
    names = [query.name for query in menu]
    kinds = [np.array([place for place, name in enumerate(names) if name == kind]) for kind in dict.fromkeys(names)]
    values = np.empty(len(menu))
    for place, query in enumerate(menu):
        joint = weights[:, None] * answer_probabilities(people, query, answers)  # (persons, answers)
        chances = joint.sum(axis=0)
        if drawn < len(chances):
            seen, counts = np.unique(systematic(chances, rng, drawn), return_counts=True)
            joint = joint[:, seen] * (counts / drawn / chances[seen])
        chances = joint.sum(axis=0)
        joint, chances = joint[:, chances > 0.0], chances[chances > 0.0]
        after = joint.T @ costs  # chance of the answer times expected cost of each plan then: (answers, m)
        # What is known now is the mean over the same answers, so that drawing them does not look like a gain or a loss.
        values[place] = _least(after.sum(axis=0), kinds) - _least(after, kinds).sum()
    return values


def _least(costs: FloatArray, kinds: Sequence[np.ndarray]) -> FloatArray:
    """Return the least cost of each kind, the mean over kinds, of costs (..., m)."""
    return np.asarray(np.mean([costs[..., kind].min(axis=-1) for kind in kinds], axis=0))
