"""Compiled choices against their definition."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from planar_people import neutral_space, random_query, whole_space
from scipy.special import logsumexp

from handover_ros.errors import BadRequestError
from handover_ros.preferences.choice_kernels import costs_of, exp_below_one, greatest, least
from handover_ros.preferences.likelihood import (
    choice_probabilities,
    log_likelihood,
    log_likelihoods,
    region_probabilities,
    survey,
)
from handover_ros.preferences.query import Query, chosen, posture_answer, region_answer
from handover_ros.preferences.reference import plain_choice, plain_likelihood

seeds = st.integers(0, 10**6)


@given(st.floats(-708.0, 0.0))
def test_exponential_is_exact_to_the_last_bits(x):
    assert exp_below_one(x) == pytest.approx(np.exp(x), rel=1e-15)


@pytest.mark.parametrize("x", [-708.5, -1e4, -np.inf])
def test_exponential_of_very_negative_numbers_is_zero(x):
    assert exp_below_one(x) == 0.0


@pytest.mark.parametrize("joints", range(1, 10))
@pytest.mark.parametrize("count", [1, 3, 8, 30])
def test_costs_extremes_and_sums_of_any_size_are_their_definitions(joints, count):
    rng = np.random.default_rng(joints)
    rows, squares, slopes = rng.normal(size=(joints, count)), rng.random(joints), rng.normal(size=joints)
    costs = np.empty(count)
    costs_of(rows, squares, slopes, 0.5, costs)
    np.testing.assert_allclose(costs, 0.5 + squares @ np.square(rows) + slopes @ rows, atol=1e-12)
    assert greatest(costs) == costs.max()
    assert least(costs) == costs.min()


@given(seeds)
def test_every_form_of_the_choice_agrees(seed):
    rng = np.random.default_rng(seed)
    query, space = random_query(rng), whole_space()
    people = space.people(space.spread(7, rng))
    choice = choice_probabilities(people, query)
    for person in range(7):
        np.testing.assert_allclose(choice[person], plain_choice(people, person, query), rtol=1e-9, atol=1e-300)
    place = int(rng.integers(len(query)))
    answer = posture_answer(query, query.configurations[place] + 0.01)
    for each in (chosen(place), region_answer(query, query.regions[query.region[place]]), answer):
        np.testing.assert_allclose(
            np.exp(log_likelihood(people, query, each)), plain_likelihood(people, query, each), rtol=1e-9
        )


@given(seeds)
def test_likelihoods_of_many_answers_are_those_of_each(seed):
    rng = np.random.default_rng(seed)
    menu, space = [random_query(rng) for _ in range(2)], whole_space()
    people = space.people(space.spread(7, rng))
    answered = [(query, chosen(int(rng.integers(len(query))))) for query in (menu[0], menu[1], menu[0], menu[0])]
    together = list(log_likelihoods(people, answered))
    np.testing.assert_array_equal(together, [log_likelihood(people, query, answer) for query, answer in answered])


@given(seeds)
def test_likelihood_of_a_region_is_the_marginal_of_its_configurations(seed):
    rng = np.random.default_rng(seed)
    query, space = random_query(rng), whole_space()
    people = space.people(space.spread(9, rng))
    for region in {query.regions[each] for each in query.region}:
        places = np.flatnonzero(query.region == query.regions.index(region))
        one_by_one = logsumexp([log_likelihood(people, query, chosen(place)) for place in places], axis=0)
        np.testing.assert_allclose(log_likelihood(people, query, region_answer(query, region)), one_by_one, atol=1e-9)


@given(seeds)
def test_survey_is_entropy_mean_and_least_cost(seed):
    rng = np.random.default_rng(seed)
    query, space = random_query(rng), whole_space()
    people = space.people(space.spread(11, rng))
    weights = rng.dirichlet(np.ones(11))
    found, choice, costs = (
        survey(people, weights, query),
        choice_probabilities(people, query),
        people.costs(query.configurations),
    )
    logs = np.log(np.where(choice > 0.0, choice, 1.0))
    np.testing.assert_allclose(found.predicted, weights @ choice, atol=1e-12)
    np.testing.assert_allclose(found.entropy, -(choice * logs).sum(axis=1), atol=1e-9)
    np.testing.assert_allclose(found.mean_cost, (choice * costs).sum(axis=1), rtol=1e-9)
    np.testing.assert_allclose(found.least_cost, costs.min(axis=1), rtol=1e-9, atol=1e-12)
    regions = np.stack([choice[:, query.region == number].sum(axis=1) for number in range(3)], axis=1)
    np.testing.assert_allclose(region_probabilities(people, query), regions, atol=1e-12)


def test_many_people_are_the_same_as_one_by_one():
    """Also where the work is shared among threads."""
    rng = np.random.default_rng(0)
    query, space = random_query(rng), neutral_space()
    people = space.people(space.spread(40_000, rng))
    some = space.people(space.spread(40_000, np.random.default_rng(0)))
    assert len(people) == len(some) == 40_000
    together = log_likelihood(people, query, chosen(1))
    choice = choice_probabilities(people, query)[:, 1]
    np.testing.assert_allclose(together, np.log(choice), atol=1e-9)


def test_a_certain_posture_is_the_nearest_configuration():
    q = np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 0.5]])
    answer = posture_answer(Query(q, np.ones(3), np.zeros(3), ("all",)), [1.02, 0.97])
    assert answer.places.tolist() == [1]


def test_an_uncertain_posture_may_be_several_configurations():
    q = np.array([[0.0, 0.0], [0.3, 0.0], [2.0, 0.5]])
    query = Query(q, np.ones(3), np.array([0, 1, 1]), ("left", "right"))
    answer = posture_answer(query, [0.1, 0.0], 0.04 * np.eye(2))
    assert answer.places.tolist() == [0, 1]
    assert answer.shares[0] > answer.shares[1] > 0.0
    assert posture_answer(query, [0.1, 0.0], 0.04 * np.eye(2), "right").places.tolist() == [1]


@pytest.mark.parametrize(
    ("posture", "covariance", "region", "message"),
    [
        ([5.0, 5.0], None, "", "not an answer to this offer"),
        ([np.nan, 0.0], None, "", "finite displacements"),
        ([0.0], None, "", "needs 2 finite"),
        ([0.0, 0.0], -np.eye(2), "", "positive semidefinite"),
        ([0.0, 0.0], np.full((2, 2), np.nan), "", "positive semidefinite"),
        ([0.0, 0.0], None, "middle", "not on offer"),
    ],
)
def test_answers_that_cannot_be_are_refused(posture, covariance, region, message):
    query = Query(np.zeros((2, 2)), np.ones(2), np.array([0, 1]), ("left", "right"))
    with pytest.raises(BadRequestError, match=message):
        posture_answer(query, posture, covariance, region)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.zeros((0, 2)), np.ones(0), np.zeros(0), ("a",)), "feasible set is empty"),
        ((np.full((1, 2), np.nan), np.ones(1), np.zeros(1), ("a",)), "must be finite"),
        ((np.zeros((1, 2)), np.zeros(1), np.zeros(1), ("a",)), "positive"),
        ((np.zeros((1, 2)), np.ones(2), np.zeros(1), ("a",)), "as many measures"),
        ((np.zeros((1, 2)), np.ones(1), np.ones(1), ("a",)), "region numbers"),
    ],
)
def test_feasible_sets_that_cannot_be_are_refused(arguments, message):
    with pytest.raises(BadRequestError, match=message):
        Query(*arguments)
