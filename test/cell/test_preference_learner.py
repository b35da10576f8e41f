"""Learning about the active person: what is stored, what is refused, what survives."""

from dataclasses import replace

import numpy as np
import pytest
from profiles import report_of

from handover_ros.arm.model import arm_of
from handover_ros.cell.belief_store import BeliefStore
from handover_ros.cell.preference_learner import (
    LearnerSettings,
    OfferedHandover,
    PreferenceLearner,
    TakenHandover,
    point_estimates,
)
from handover_ros.cell.store import StoreError
from handover_ros.ergonomics.arm_costs import Preference
from handover_ros.errors import BadModelError, BadRequestError, UnknownNameError
from handover_ros.geometry import transform_from_xyz_rpy
from handover_ros.objects.catalogue import load_catalogue
from handover_ros.preferences.likelihood import choice_probabilities
from handover_ros.preferences.space import arm_space
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.sim.person_spec import load_person
from handover_ros.skeleton.profile import Profile

CATALOGUE = load_catalogue()
SETTINGS = LearnerSettings(particles=400)
TORSO = transform_from_xyz_rpy(np.array([1.0, 0.5, 1.4]), np.array([0.0, 0.0, 2.0]))


def profile_named(name):
    skeleton = skeleton_of(load_person("adult"))
    return Profile(name, name.title(), "2026-01-01T00:00:00Z", "simulated", "upper_body", skeleton, report_of(skeleton))


def learner_in(folder, settings=SETTINGS, name="anna"):
    learner = PreferenceLearner(CATALOGUE, {}, BeliefStore(folder), settings)
    learner.activate(profile_named(name))
    return learner


def offered(name="mug", x=0.45, y=-0.2, yaw=0.5):
    pose = transform_from_xyz_rpy(np.array([x, y, -0.2]), np.array([0.0, 0.0, yaw]))
    return OfferedHandover(name, TORSO @ pose, TORSO)


def taken(learner, number, offer=None, seed=0, **more):
    """Return how a person with a known preference takes an offer."""
    offer = offer or offered(yaw=0.7 * number)
    query = learner.query(offer, "right")
    space = arm_space(arm_of(profile_named("x").skeleton, "right").limits)
    truth = space.people(space.coordinates(np.array([0.5, 0.3, 0.1, 1.5, 0.3, 0.0, 0.0]), np.ones(7), 10.0)[None])
    place = np.random.default_rng((seed, number)).choice(len(query), p=choice_probabilities(truth, query)[0])
    posture = query.configurations[place]
    return TakenHandover(f"h{number}", offer, "right", query.regions[query.region[place]], posture, **more)


def test_answers_survive_a_new_start(tmp_path):
    learner = learner_in(tmp_path)
    for number in range(3):
        assert learner.add(taken(learner, number))
    again = learner_in(tmp_path)
    assert again.person.belief.observations == 3
    np.testing.assert_array_equal(again.person.belief.particles, learner.person.belief.particles)
    assert again.surprise == learner.surprise


def test_an_answer_counts_once(tmp_path):
    learner = learner_in(tmp_path)
    first = taken(learner, 0)
    assert learner.add(first)
    before = learner.person
    assert not learner.add(first)
    assert learner.person is before
    assert not learner_in(tmp_path).add(first)


def test_people_are_kept_apart(tmp_path):
    learner = learner_in(tmp_path)
    learner.add(taken(learner, 0))
    learner.activate(profile_named("bert"))
    assert learner.person.belief.observations == 0
    with pytest.raises(BadRequestError, match="the active person is 'bert'"):
        learner.add(taken(learner, 1), "anna")
    learner.activate(None)
    with pytest.raises(BadRequestError, match="no profile is active"):
        learner.active()
    learner.activate(profile_named("anna"))
    assert learner.person.belief.observations == 1


def test_what_cannot_be_stored_is_not_taken_in(tmp_path, monkeypatch):
    learner = learner_in(tmp_path)
    learner.add(taken(learner, 0))
    before, stored = learner.person, BeliefStore(tmp_path).path("anna").read_bytes()

    def full(path, person):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("handover_ros.cell.belief_store.write_belief", full)
    with pytest.raises(StoreError, match="No space left"):
        learner.add(taken(learner, 1))
    assert learner.person is before
    assert BeliefStore(tmp_path).path("anna").read_bytes() == stored


def test_a_damaged_belief_is_kept_and_said(tmp_path):
    learner = learner_in(tmp_path)
    learner.add(taken(learner, 0))
    path = BeliefStore(tmp_path).path("anna")
    path.write_bytes(path.read_bytes()[:1000])
    again = learner_in(tmp_path)
    assert "cut short" in again.problem
    for act in (lambda: again.add(taken(again, 1)), again.save):
        with pytest.raises(BadModelError, match="reset_belief"):
            act()
    assert len(path.read_bytes()) == 1000
    again.reset()
    assert path.with_name("anna.npz.aside-1").stat().st_size == 1000
    assert again.add(taken(again, 1))
    assert learner_in(tmp_path).person.belief.observations == 1
    again.reset()
    assert path.with_name("anna.npz.aside-1").stat().st_size == 1000
    assert path.with_name("anna.npz.aside-2").exists()


def test_load_goes_back_to_what_is_stored(tmp_path):
    learner = learner_in(tmp_path)
    with pytest.raises(BadRequestError, match="nothing is stored"):
        learner.load()
    learner.add(taken(learner, 0))
    learner.person = replace(learner.person, handover_ids=())
    learner.load()
    assert learner.person.handover_ids == ("h0",)


def test_a_belief_about_other_things_is_not_mixed(tmp_path):
    learner = learner_in(tmp_path)
    learner.add(taken(learner, 0))
    other = learner_in(tmp_path, replace(SETTINGS, learn=("neutral",)))
    assert "now neutral_shoulder_flexion" in other.problem


@pytest.mark.parametrize(
    ("change", "kind", "message"),
    [
        ({"posture": np.full(7, 3.0)}, BadRequestError, "not an answer to this offer"),
        ({"posture": np.full(7, np.nan)}, BadRequestError, "finite"),
        ({"posture": None, "region": ""}, BadRequestError, "neither posture nor region"),
        ({"posture": None, "region": "handle bar"}, BadRequestError, "not on offer"),
        ({"handover_id": ""}, BadRequestError, "handover_id"),
        ({"hand": "third"}, UnknownNameError, "hand"),
        ({"offered": offered("anvil")}, UnknownNameError, "anvil"),
        ({"offered": offered(x=3.0)}, BadRequestError, "feasible set is empty"),
        ({"offered": offered("box")}, BadRequestError, "two hands"),
        ({"covariance": -np.eye(7)}, BadRequestError, "positive semidefinite"),
    ],
)
def test_what_is_no_answer_is_refused_and_nothing_changes(tmp_path, change, kind, message):
    learner = learner_in(tmp_path)
    learner.add(taken(learner, 0))
    before, stored = learner.person, BeliefStore(tmp_path).path("anna").read_bytes()
    with pytest.raises(kind, match=message):
        learner.add(replace(taken(learner, 1), **change))
    assert learner.person is before
    assert BeliefStore(tmp_path).path("anna").read_bytes() == stored


def test_region_answers_need_no_posture(tmp_path):
    learner = learner_in(tmp_path, replace(SETTINGS, answers="region"))
    first = learner.person.belief.entropy
    assert learner.add(replace(taken(learner, 0), posture=None))
    assert learner.person.belief.entropy < first


def test_a_menu_is_chosen_from_and_what_cannot_be_taken_is_said(tmp_path):
    learner = learner_in(tmp_path)
    menu = [offered(x=3.0), offered(), offered("u_lock"), offered(yaw=2.0)]
    for strategy in ("active", "passive", "random", "hybrid"):
        found = learner.choose(menu, strategy)
        assert found.chosen != 0
        assert np.isnan(found.information[0])
        assert np.isfinite(found.cost[1:]).all()
    assert found.information[1:].min() >= 0.0
    with pytest.raises(BadRequestError, match="can take none of 1"):
        learner.choose(menu[:1], "active")
    with pytest.raises(BadRequestError, match="is empty"):
        learner.choose([], "active")
    with pytest.raises(UnknownNameError):
        learner.choose([offered("anvil")], "active")


def test_others_tell_of_the_next_person(tmp_path):
    for name in ("anna", "bert"):
        learner = learner_in(tmp_path, SETTINGS, name)
        for number in range(4):
            learner.add(taken(learner, number, seed=len(name)))
    even = learner_in(tmp_path, SETTINGS, "carla").person.belief
    known = learner_in(tmp_path, replace(SETTINGS, prior="population"), "carla").person.belief
    assert even.prior.population is None
    assert known.prior.population is not None
    assert known.entropy < even.entropy


def test_a_typical_belief_is_about_what_is_usual_and_wide(tmp_path):
    """So that a few answers of somebody usual do not make plans worse than none."""
    usual = Preference()
    beliefs = {}
    for prior in ("even", "typical"):
        learner = learner_in(tmp_path / prior, replace(SETTINGS, prior=prior))
        before = learner.person.belief
        for number in range(3):
            learner.add(taken(learner, number))
        beliefs[prior] = before, learner.person.belief
    first = point_estimates(beliefs["typical"][0])["mean"]
    np.testing.assert_allclose(first.neutral, usual.neutral, atol=0.25)
    assert beliefs["typical"][0].entropy < beliefs["even"][0].entropy
    nobody = learner_in(tmp_path / "nobody", replace(SETTINGS, prior="population")).person.belief
    np.testing.assert_array_equal(nobody.particles, beliefs["typical"][0].particles)
    means = {prior: point_estimates(after)["mean"].neutral for prior, (_, after) in beliefs.items()}
    apart = {prior: np.abs(mean - usual.neutral).sum() for prior, mean in means.items()}
    assert apart["typical"] < apart["even"]


def test_the_expected_preference_has_the_mean_cost(tmp_path):
    """Up to a constant, for every posture."""
    learner = learner_in(tmp_path)
    for number in range(2):
        learner.add(taken(learner, number))
    belief = learner.person.belief
    estimates = point_estimates(belief)
    postures = np.random.default_rng(0).uniform(*learner.arms["right"].limits, (50, 7))
    mean_costs = belief.weights @ belief.people.costs(postures)
    expected = estimates["expected"]
    costs = np.square(postures - expected.neutral) @ expected.weights
    np.testing.assert_allclose(costs - costs[0], mean_costs - mean_costs[0], atol=1e-9)


def test_learning_about_a_person_without_arms_is_refused(tmp_path):
    learner = learner_in(tmp_path)
    skeleton = replace(profile_named("legs").skeleton, hands=())
    with pytest.raises(BadModelError, match="no arm can be used"):
        learner.activate(replace(profile_named("legs"), skeleton=skeleton))
    assert learner.person is None
