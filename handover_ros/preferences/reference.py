"""Plain forms of what the compiled ones compute, for tests: definitions, written out."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.preferences.query import Answer, Query
from handover_ros.preferences.space import People


def plain_choice(people: People, person: int, query: Query) -> list[float]:
    """Return P(q | query, person) of every configuration, eq. 4.3."""
    shares = []
    for q, measure in zip(query.configurations.tolist(), query.measures.tolist()):
        cost = 0.0
        for value, neutral, weight in zip(q, people.neutral[person], people.weights[person]):
            cost += weight * (value - neutral) ** 2
        shares.append(measure * math.exp(-people.rationality[person] * cost))
    total = sum(shares)
    return [share / total for share in shares]


def plain_likelihood(people: People, query: Query, answer: Answer) -> FloatArray:
    """Return P(answer | query, person) (n,)."""
    found = []
    for person in range(len(people)):
        choice = plain_choice(people, person, query)
        found.append(sum(choice[place] * share for place, share in zip(answer.places, answer.shares)))
    return np.array(found)


def plain_decision_value(
    people: People, weights: Sequence[float], menu: Sequence[Query], place: int, by_region: bool = False
) -> float:
    """Return how much less the best query of each name costs on average once a query of the menu is answered."""
    persons = range(len(people))
    costs = []  # of each query, of each person
    for query in menu:
        every = people.costs(query.configurations)
        costs.append([sum(p * c for p, c in zip(plain_choice(people, n, query), every[n])) for n in persons])

    def least(shares: Sequence[float]) -> float:
        means = [sum(share * cost for share, cost in zip(shares, each)) for each in costs]
        names = {query.name for query in menu}
        return sum(min(m for m, query in zip(means, menu) if query.name == name) for name in names) / len(names)

    asked = menu[place]
    kinds = asked.region.tolist() if by_region else list(range(len(asked)))
    chosen = [plain_choice(people, n, asked) for n in persons]
    after = 0.0
    for answer in set(kinds):
        joint = [weights[n] * sum(p for p, kind in zip(chosen[n], kinds) if kind == answer) for n in persons]
        if sum(joint) > 0.0:
            after += sum(joint) * least([share / sum(joint) for share in joint])
    return least(weights) - after


def plain_information(people: People, weights: Sequence[float], query: Query, by_region: bool = False) -> float:
    """Return the mutual information [nat]: sum over persons and answers of P(l, a) log(P(l, a) / (P(l) P(a)))."""
    table = []
    for person in range(len(people)):
        choice = plain_choice(people, person, query)
        if by_region:
            regions = [0.0] * len(query.regions)
            for place, probability in zip(query.region.tolist(), choice):
                regions[place] += probability
            choice = regions
        table.append(choice)
    total = 0.0
    for answer in range(len(table[0])):
        predicted = sum(weight * row[answer] for weight, row in zip(weights, table))
        for weight, row in zip(weights, table):
            joint = weight * row[answer]
            if joint > 0.0:
                total += joint * math.log(joint / (weight * predicted))
    return total


def plain_posterior(people: People, log_prior: FloatArray, answered: Sequence[tuple[Query, Answer]]) -> FloatArray:
    """Return the posterior probabilities (n,) of persons on a grid by Bayes' rule (4.4)."""
    log = np.array(log_prior, dtype=float)
    for query, answer in answered:
        log = log + np.log(plain_likelihood(people, query, answer))
    share = np.exp(log - log.max())
    return np.asarray(share / share.sum())
