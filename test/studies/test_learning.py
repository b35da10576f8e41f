"""What is measured while a simulated person is taught, against its definition."""

import numpy as np
import pytest
from small_study import small_settings

from handover_ros.preferences.belief import first_belief
from handover_ros.preferences.likelihood import choice_probabilities, log_likelihood
from handover_ros.preferences.prior import Prior
from handover_ros.preferences.query import chosen, region_answer
from handover_ros.studies.arm_courses import user_course
from handover_ros.studies.galleries import grid
from handover_ros.studies.heldout import choice, heldout
from handover_ros.studies.learning import teach
from handover_ros.studies.planar_courses import artificial_course, planar_course

SETTINGS = small_settings(particles=2000)


@pytest.mark.parametrize("learned", ["neutral", "weights"])
def test_density_at_the_truth_is_that_of_bayes_rule_on_a_grid(learned):
    course = planar_course(SETTINGS, learned, 0, 1)
    points = grid(course.space)
    people = course.space.people(points)
    log, at_truth = np.zeros(len(points)), 0.0
    cell = np.prod(np.diff(course.space.bounds, axis=0)) / len(points)
    for row in teach(course, "active")[1:]:
        query, answer = course.menu[row["place"]], chosen(row["answer"])
        log += log_likelihood(people, query, answer)
        at_truth += log_likelihood(course.true_person, query, answer)[0]
        exact = at_truth - np.log(np.exp(log).sum() * cell)
        assert row["log_density"] == pytest.approx(exact, abs=0.25)


def test_measures_of_a_query_are_their_definitions():
    course = planar_course(SETTINGS, "neutral", 1, 1)
    truth = course.true_person
    for row in teach(course, "random")[1:]:
        q = course.menu[row["place"]].configurations
        cost = np.square(q - truth.neutral[0]) @ truth.weights[0]
        shares = np.exp(-truth.rationality[0] * (cost - cost.min()))
        assert row["true_cost"] == pytest.approx(shares @ cost / shares.sum())
        assert row["nearest"] == pytest.approx(np.linalg.norm(q - truth.neutral[0], axis=1).min())
        assert row["spread"] == pytest.approx(np.sqrt(np.trace(np.cov(q.T, bias=True))))
        assert row["object"] == course.objects[row["place"]]


def test_test_log_likelihood_is_the_mean_over_tests():
    course = planar_course(SETTINGS, "neutral", 2, 1)
    rng = np.random.default_rng(0)
    truth, model = course.true_person, course.space.people(np.array([[0.3, 0.2]]))
    found = heldout(course.menu, truth, rng)
    expected = []
    for query, seen in zip(course.menu, found.seen):
        expected.append(log_likelihood(model, query, chosen(int(np.flatnonzero(seen)[0])))[0])
    assert found.log_likelihood(model) == pytest.approx(np.mean(expected))


def test_of_regions_all_configurations_count():
    course = user_course(SETTINGS, 0, 1)
    truth = course.true_person
    model = course.space.people(course.space.bounds.mean(axis=0)[None])
    found = heldout(course.menu, truth, np.random.default_rng(0), by_region=True)
    expected = []
    for query, seen in zip(course.menu, found.seen):
        region = query.regions[query.region[int(np.flatnonzero(seen)[0])]]
        expected.append(log_likelihood(model, query, region_answer(query, region))[0])
    assert found.log_likelihood(model) == pytest.approx(np.mean(expected))


def test_choices_follow_the_persons_probabilities():
    course = planar_course(SETTINGS, "neutral", 0, 2)
    query, person = course.menu[0], course.true_person
    levels = (np.arange(20_000) + 0.5) / 20_000
    counts = np.bincount([choice(query, person, level) for level in levels], minlength=len(query))
    np.testing.assert_allclose(counts / 20_000, choice_probabilities(person, query)[0], atol=1e-4)
    assert choice(query, person, 1.0 - 1e-17) < len(query)


def test_first_row_is_the_belief_before_any_answer():
    course = planar_course(SETTINGS, "neutral", 0, 1)
    first = teach(course, "passive")[0]
    assert first["iteration"] == 0
    assert first["true_cost"] is None
    prior = Prior(course.space).log_density(course.truth[None])[0]
    assert first["log_density"] == pytest.approx(prior)
    assert first["entropy"] == pytest.approx(first_belief(Prior(course.space), 10).entropy)


def test_same_person_and_seed_give_the_same_numbers_and_others_do_not():
    one, again = (teach(planar_course(SETTINGS, "weights", 3, 5), "active") for _ in range(2))
    assert one == again
    assert teach(planar_course(SETTINGS, "weights", 4, 5), "active") != one
    assert teach(planar_course(SETTINGS, "weights", 3, 6), "active") != one


def test_the_parts_of_artificial_sets_lie_along_different_axes():
    menu = artificial_course(SETTINGS, 0, 1).menu
    widest = [np.ptp(query.configurations, axis=0).argmax() for query in menu]
    assert widest == [0, 1]


def test_an_offer_of_the_user_study_lets_the_person_choose():
    course = user_course(SETTINGS, 0, 1)
    assert [name for name in course.objects] == ["handlebars"] * 2 + ["u_lock"] * 2
    for query in course.menu:
        assert len(set(query.region.tolist())) == len(query.regions) == 2
