"""Answers of someone who answers as believed are not surprising; those of someone who has changed are."""

import numpy as np
from planar_people import answer_of, neutral_space, random_query

from handover_ros.preferences.belief import first_belief
from handover_ros.preferences.prior import Prior
from handover_ros.preferences.query import chosen
from handover_ros.preferences.surprise import ANSWERS, has_changed, unlikeliness


def chances(truths, seed, particles=1000):
    """Return the unlikeliness of the answers of a person whose neutral posture goes through ``truths``."""
    rng, space = np.random.default_rng(seed), neutral_space()
    belief, found = first_belief(Prior(space), particles, seed=seed), []
    for truth in truths:
        query = random_query(rng)
        answer = chosen(answer_of(space.people(np.array([truth])), query, rng))
        found.append(unlikeliness(belief, query, answer))
        belief = belief.updated(query, answer)
    return found


def test_unlikeliness_is_a_p_value():
    """Over people drawn from the belief itself, below p at most with probability p."""
    space = neutral_space()
    found = np.concatenate([chances([np.random.default_rng(n).uniform(*space.bounds)] * 3, n, 400) for n in range(120)])
    for level in (0.05, 0.2, 0.5):
        assert (found <= level).mean() <= level + 3.0 * np.sqrt(level * (1 - level) / len(found))
    assert (found <= 0.5).mean() > 0.3


def test_a_change_is_found_and_constancy_is_not_called_change():
    alarms = 0
    for seed in range(8):
        steady = chances([(0.7, 1.4)] * 20, seed)
        alarms += any(has_changed(steady[:end]) for end in range(1, 21))
    assert alarms <= 1
    found = 0
    for seed in range(8):
        changed = chances([(0.2, 1.9)] * 15 + [(1.4, 0.4)] * 10, seed)
        found += any(has_changed(changed[:end]) for end in range(16, 26))
    assert found >= 7


def test_few_answers_are_no_evidence_of_change():
    assert not has_changed([1e-9] * (ANSWERS - 1))
    assert has_changed([1e-3] * ANSWERS)
