"""What a query tells, by definition; which one each strategy takes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planar_people import neutral_space, random_belief, random_query, weight_space

from handover_ros.errors import BadRequestError, UnknownNameError
from handover_ros.preferences.belief import first_belief
from handover_ros.preferences.information import grid_cells, grid_gain, outlook
from handover_ros.preferences.prior import Prior
from handover_ros.preferences.query import Query, chosen
from handover_ros.preferences.reference import plain_information
from handover_ros.preferences.strategies import STRATEGIES, select

seeds = st.integers(0, 10**6)


@settings(max_examples=30)
@given(seeds, st.booleans())
def test_mutual_information_is_its_definition(seed, by_region):
    rng, belief = np.random.default_rng(seed), random_belief(seed)
    query = random_query(rng)
    found = outlook(belief.people, belief.weights, query, "region" if by_region else "posture")
    exact = plain_information(belief.people, belief.weights.tolist(), query, by_region)
    assert found.information == pytest.approx(exact, abs=1e-9)


@settings(max_examples=20)
@given(seeds, st.sampled_from(["posture", "region"]))
def test_entropy_of_a_grid_with_one_particle_a_cell_is_the_mutual_information(seed, answers):
    rng, belief = np.random.default_rng(seed), random_belief(seed)
    query = random_query(rng)
    information = outlook(belief.people, belief.weights, query, answers).information
    cells = np.arange(len(belief.particles))
    assert grid_gain(belief, query, answers, cells=cells) == pytest.approx(information, abs=1e-8)


@settings(max_examples=20)
@given(seeds)
def test_regions_tell_no_more_than_postures_and_a_coarse_grid_no_more_than_particles(seed):
    rng, belief = np.random.default_rng(seed), random_belief(seed)
    query = random_query(rng)
    posture = outlook(belief.people, belief.weights, query, "posture").information
    region = outlook(belief.people, belief.weights, query, "region").information
    assert -1e-12 <= region <= posture + 1e-9
    assert grid_gain(belief, query, cells=grid_cells(belief, 3)) <= posture + 1e-9


def test_nothing_is_learned_from_a_person_without_choice():
    belief = random_belief(0)
    single = Query(np.zeros((1, 2)), np.ones(1), np.zeros(1), ("only",))
    for answers in ("posture", "region"):
        assert outlook(belief.people, belief.weights, single, answers).information == pytest.approx(0.0, abs=1e-12)


def test_costs_are_expectations_over_the_belief():
    rng, belief = np.random.default_rng(1), random_belief(1)
    query = random_query(rng)
    costs = belief.people.costs(query.configurations)
    found = outlook(belief.people, belief.weights, query)
    assert found.least_cost == pytest.approx(belief.weights @ costs.min(axis=1))
    assert found.least_cost <= found.cost


def menu_of(seed, number=8):
    rng = np.random.default_rng(seed)
    return [random_query(rng) for _ in range(number)]


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_every_strategy_chooses_what_it_values_most(strategy):
    belief, menu = random_belief(2, 200), menu_of(2)
    found = select(belief, menu, strategy)
    assert found.values.shape == found.information.shape == found.cost.shape == (8,)
    assert np.isfinite(found.values).all()
    assert found.chosen == np.argmax(found.values)
    again = select(belief, menu, strategy)
    assert again.chosen == found.chosen


def test_active_learns_and_passive_saves():
    belief, menu = random_belief(3, 500), menu_of(3)
    active, passive = select(belief, menu, "active"), select(belief, menu, "passive")
    assert active.information[active.chosen] == active.information.max()
    least = [outlook(belief.people, belief.weights, query).least_cost for query in menu]
    assert least[passive.chosen] == min(least)


def test_hybrid_lies_between_cost_and_information():
    belief, menu = random_belief(4, 500), menu_of(4)
    only_information, only_cost = (select(belief, menu, "hybrid", information_weight=w) for w in (1.0, 0.0))
    assert only_information.chosen == select(belief, menu, "active").chosen
    assert only_cost.chosen == np.argmin(only_cost.cost)
    half = select(belief, menu, "hybrid", information_weight=0.5)
    np.testing.assert_allclose(half.values, 0.5 * (half.information - half.cost))


def test_random_changes_with_seed_and_answers():
    belief, menu = random_belief(5), menu_of(5)
    assert len({select(belief, menu, "random", seed=seed).chosen for seed in range(20)}) > 3
    later = belief.updated(menu[0], chosen(0))
    chosen_later = {select(replace(later, observations=n), menu, "random").chosen for n in range(20)}
    assert len(chosen_later) > 3


@pytest.mark.parametrize("space", [neutral_space(), weight_space()], ids=["neutral", "weights"])
def test_the_answer_to_an_active_query_narrows_the_belief_down_as_expected(space):
    """The mean fall of entropy over answers is the mutual information."""
    rng = np.random.default_rng(6)
    belief, query = first_belief(Prior(space), 4000), random_query(rng)
    expected = outlook(belief.people, belief.weights, query).information
    falls, truths = [], space.people(rng.uniform(*space.bounds, (60, 2)))
    from handover_ros.preferences.likelihood import choice_probabilities

    for row in choice_probabilities(truths, query):
        falls.append(belief.entropy - belief.updated(query, chosen(int(rng.choice(len(query), p=row)))).entropy)
    assert np.mean(falls) == pytest.approx(expected, abs=3.0 * np.std(falls) / np.sqrt(60) + 0.03)


def test_bad_requests_are_refused():
    belief, menu = random_belief(7), menu_of(7)
    with pytest.raises(UnknownNameError, match="active"):
        select(belief, menu, "clever")
    with pytest.raises(BadRequestError, match="menu"):
        select(belief, [], "active")
    with pytest.raises(BadRequestError, match="information_weight"):
        select(belief, menu, "hybrid", information_weight=1.5)
    with pytest.raises(BadRequestError, match="cells"):
        grid_cells(belief, 0)
