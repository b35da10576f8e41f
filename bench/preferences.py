"""Preferences: updating a belief and choosing a query at full size; information of many pairs against plain code."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import combinations

import numpy as np
from scipy.special import logsumexp

from handover_ros.arm.model import load_arm
from handover_ros.preferences.belief import Belief, first_belief
from handover_ros.preferences.likelihood import log_likelihood
from handover_ros.preferences.menus import information_of_menus
from handover_ros.preferences.prior import Prior
from handover_ros.preferences.query import Answer, Query, chosen
from handover_ros.preferences.reference import plain_information
from handover_ros.preferences.space import arm_space
from handover_ros.preferences.strategies import select

PARTICLES, CONFIGURATIONS, MENU = 10_000, 500, 8
ITEMS, SAMPLES = 100, 100  # as APReL's exhaustive query, 30 s


def measure(seed: int, quick: bool) -> dict[str, float]:
    """Return the metrics; prints how long the plain enumeration took."""
    arm = load_arm()
    rng = np.random.default_rng(seed)
    belief = first_belief(Prior(arm_space(arm.limits)), PARTICLES, seed=seed)

    def query() -> Query:
        postures = rng.uniform(*arm.limits, (CONFIGURATIONS, 7))
        return Query(postures, np.ones(CONFIGURATIONS), np.arange(CONFIGURATIONS) % 4, ("a", "b", "c", "d"))

    menu = [query() for _ in range(MENU)]
    answer = chosen(0)
    rounds = 10 if quick else 40
    return {
        "belief_update_ms": 1e3 * _median(lambda: reweighted(belief, menu[0], answer), rounds),
        "belief_update_with_moves_ms": 1e3 * _median(lambda: belief.updated(menu[0], answer), 1 if quick else 3),
        "query_select_ms": 1e3 * _median(lambda: select(belief, menu, "active"), rounds),
        **pairs(seed, 30 if quick else ITEMS, rounds),
    }


def reweighted(belief: Belief, query: Query, answer: Answer) -> tuple[np.ndarray, float]:
    """Return normalised log weights after an answer (4.5), and how many particles are effective."""
    log_weights = belief.log_weights + log_likelihood(belief.people, query, answer)
    log_weights -= logsumexp(log_weights)
    return log_weights, float(np.exp(-logsumexp(2.0 * log_weights)))


def pairs(seed: int, items: int, rounds: int) -> dict[str, float]:
    """Return how much faster the best of all pairs of items is found than by plain enumeration; the same must win."""
    arm = load_arm()
    rng = np.random.default_rng(seed)
    belief = first_belief(Prior(arm_space(arm.limits)), SAMPLES, seed=seed)
    people, weights = belief.people, belief.weights
    postures = rng.uniform(*arm.limits, (items, 7))
    menus = np.array(list(combinations(range(items), 2)))
    ours = _median(lambda: information_of_menus(people, weights, postures, menus), 3 * rounds)
    found = information_of_menus(people, weights, postures, menus)
    queries = [Query(postures[menu], np.ones(2), np.zeros(2), ("any",)) for menu in menus]
    given = weights.tolist()
    began = time.perf_counter()
    plain = [plain_information(people, given, query) for query in queries]
    seconds = time.perf_counter() - began
    assert int(np.argmax(plain)) == int(np.argmax(found)), "the two choose differently"
    assert np.allclose(plain, found, rtol=0.0, atol=1e-9), "the two differ"
    print(f"  {len(menus)} pairs, {SAMPLES} samples: plain {seconds:.1f} s, ours {1e3 * ours:.2f} ms")
    return {"mutual_information_ms": 1e3 * ours, "mutual_information_speedup": seconds / ours}


def _median(work: Callable[[], object], rounds: int) -> float:
    """Return the median wall time [s] after one round to warm up."""
    work()
    seconds = []
    for _ in range(rounds):
        began = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - began)
    return float(np.median(seconds))
