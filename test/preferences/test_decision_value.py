"""What an answer is worth for the next plans."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planar_people import random_belief, random_query

from handover_ros.preferences.decision_value import decision_values
from handover_ros.preferences.query import Query
from handover_ros.preferences.reference import plain_decision_value

seeds = st.integers(0, 10_000)


def menu_of(seed: int, count: int = 5) -> list[Query]:
    rng = np.random.default_rng(seed)
    found = [random_query(rng) for _ in range(count)]
    return [
        Query(query.configurations, query.measures, query.region, query.regions, ("mug", "plate")[place % 2])
        for place, query in enumerate(found)
    ]


@settings(max_examples=30)
@given(seeds, st.sampled_from(["posture", "region"]))
def test_it_is_its_definition(seed, answers):
    belief, menu = random_belief(seed), menu_of(seed)
    found = decision_values(belief, menu, answers, persons=10**6, drawn=10**6)
    weights = belief.weights.tolist()
    for place, value in enumerate(found):
        plain = plain_decision_value(belief.people, weights, menu, place, answers == "region")
        assert value == pytest.approx(plain, abs=1e-9)
        assert value >= -1e-12


@settings(max_examples=20)
@given(seeds)
def test_drawing_persons_and_answers_never_makes_an_answer_harmful(seed):
    belief, menu = random_belief(seed), menu_of(seed)
    assert (decision_values(belief, menu, persons=12, drawn=4, seed=seed) >= -1e-12).all()


def test_more_draws_come_nearer():
    belief, menu = random_belief(3), menu_of(3)
    exact = decision_values(belief, menu, persons=10**6, drawn=10**6)
    errors = [
        np.mean([np.abs(decision_values(belief, menu, persons=p, drawn=d, seed=s) - exact).max() for s in range(30)])
        for p, d in ((6, 3), (20, 30))
    ]
    assert errors[1] < 0.5 * errors[0]


def test_nothing_is_worth_knowing_when_there_is_one_plan_or_one_person():
    belief, menu = random_belief(1), menu_of(1)
    alone = [replace(query, name=str(place)) for place, query in enumerate(menu)]
    np.testing.assert_allclose(decision_values(belief, alone), 0.0, atol=1e-12)
    sure = replace(belief, particles=np.tile(belief.particles[:1], (len(belief.particles), 1)))
    np.testing.assert_allclose(decision_values(sure, menu), 0.0, atol=1e-12)


def test_region_answers_are_worth_no_more_than_postures():
    for seed in range(10):
        belief, menu = random_belief(seed), menu_of(seed)
        whole, part = (decision_values(belief, menu, each, 10**6, 10**6) for each in ("posture", "region"))
        assert (part <= whole + 1e-9).all()
