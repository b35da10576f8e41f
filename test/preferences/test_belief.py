"""The particles are the posterior: against Bayes' rule on a grid, and calibrated over many simulated people."""

import numpy as np
import pytest
from planar_people import ARM, answer_of, neutral_space, random_query, weight_space, whole_space
from scipy.stats import chisquare

from handover_ros.errors import BadRequestError
from handover_ros.preferences import belief as belief_module
from handover_ros.preferences.belief import bounded, first_belief, systematic, unbounded
from handover_ros.preferences.likelihood import choice_probabilities
from handover_ros.preferences.prior import Normal, Prior, population_prior
from handover_ros.preferences.query import chosen, region_answer
from handover_ros.preferences.reference import plain_posterior
from handover_ros.preferences.space import PreferenceSpace


def grid(space, cells):
    """Return the middles of a grid's cells over a space of two coordinates, and the volume of one."""
    axes = [low + (np.arange(cells) + 0.5) * (high - low) / cells for low, high in space.bounds.T]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2), np.prod(
        np.ptp(space.bounds, axis=0)
    ) / cells**2


def learned(space, number, seed, label="posture", **more):
    """Return a belief after some answers of a random person, the answers, and the person's coordinates."""
    rng = np.random.default_rng(seed)
    truth = space.spread(16, rng)[rng.integers(16)][None]
    belief, answered = first_belief(Prior(space), seed=seed, **more), []
    for _ in range(number):
        query = random_query(rng)
        place = answer_of(space.people(truth), query, rng)
        answer = chosen(place) if label == "posture" else region_answer(query, query.regions[query.region[place]])
        belief = belief.updated(query, answer)
        answered.append((query, answer))
    return belief, answered, truth


@pytest.mark.parametrize("label", ["posture", "region"])
@pytest.mark.parametrize("space", [neutral_space(), weight_space()], ids=["neutral", "weights"])
@pytest.mark.parametrize("number", [1, 3, 6])
def test_posterior_is_that_of_brute_force(space, number, label):
    """Total variation over a grid of 8 by 8 cells is at most 0.05 with 10,000 particles."""
    belief, answered, _ = learned(space, number, 10 * number, label, particles=10_000)
    points, volume = grid(space, 80)
    exact = plain_posterior(space.people(points), np.zeros(len(points)), answered)
    ranges = space.bounds.T
    coarse = np.histogram2d(*points.T, bins=8, range=ranges, weights=exact)[0]
    found = np.histogram2d(*belief.particles.T, bins=8, range=ranges, weights=belief.weights)[0]
    assert 0.5 * np.abs(coarse - found).sum() <= 0.05
    entropy = -(exact * np.log(np.maximum(exact, 1e-300) / volume)).sum()
    assert belief.entropy == pytest.approx(entropy, abs=0.12)
    likely = exact > 0.1 * exact.max()
    np.testing.assert_allclose(belief.log_density(points[likely]), np.log(exact[likely] / volume), atol=0.15)


def test_a_learned_rationality_is_averaged_over():
    """The neutral posture's posterior is the grid's, summed over the rationality."""
    space = neutral_space((2.0, 50.0))
    belief, answered, _ = learned(space, 3, 5, particles=10_000)
    points, _ = grid(neutral_space(), 64)
    low, high = space.bounds[:, 2]
    levels = low + (np.arange(40) + 0.5) * (high - low) / 40
    every = np.column_stack([np.repeat(points, len(levels), axis=0), np.tile(levels, len(points))])
    exact = plain_posterior_fast(space, every, answered).reshape(len(points), len(levels)).sum(axis=1)
    ranges = space.bounds.T[:2]
    coarse = np.histogram2d(*points.T, bins=8, range=ranges, weights=exact)[0]
    found = np.histogram2d(*belief.particles[:, :2].T, bins=8, range=ranges, weights=belief.weights)[0]
    assert 0.5 * np.abs(coarse - found).sum() <= 0.05


def plain_posterior_fast(space, points, answered):
    people = space.people(points)
    log = sum(
        np.log(np.maximum(choice_probabilities(people, query)[:, answer.places[0]], 1e-300))
        for query, answer in answered
    )
    share = np.exp(log - log.max())
    return share / share.sum()


@pytest.mark.parametrize("label", ["posture", "region"])
def test_simulation_based_calibration(label):
    """The rank of the truth among posterior draws is uniform (Talts et al. 2018), both for q* and w, 240 people."""
    space, people, draws = whole_space(), 240, 31
    ranks = np.empty((people, 4), dtype=int)
    for number in range(people):
        rng = np.random.default_rng((7, number))
        lower, upper = space.bounds
        truth = rng.uniform(lower, upper)[None]
        belief = first_belief(Prior(space), particles=500, seed=number)
        for _ in range(4):
            query = random_query(rng)
            place = answer_of(space.people(truth), query, rng)
            answer = chosen(place) if label == "posture" else region_answer(query, query.regions[query.region[place]])
            belief = belief.updated(query, answer)
        drawn = belief.particles[rng.choice(len(belief.particles), draws, p=belief.weights)]
        ranks[number] = (drawn < truth).sum(axis=0)
    for column in range(4):
        counts = np.histogram(ranks[:, column], bins=8, range=(0, draws + 1))[0]
        assert chisquare(counts).pvalue > 0.01, (space.names[column], counts)


def test_answers_narrow_the_belief_down():
    belief, _, truth = learned(neutral_space(), 12, 3, particles=2000)
    assert np.linalg.norm(belief.mean - truth) < 0.35
    assert belief.entropy < first_belief(Prior(neutral_space()), 2000).entropy - 2.0


def test_particles_do_not_collapse():
    """After many answers nearly all particles still differ, and half of them at least count."""
    belief, _, _ = learned(whole_space(), 25, 4, particles=1000)
    assert len(np.unique(belief.particles, axis=0)) > 900
    assert belief.effective_particles >= 0.5 * 1000


def test_same_seed_same_belief():
    first, _, _ = learned(neutral_space(), 3, 8, particles=500)
    second, _, _ = learned(neutral_space(), 3, 8, particles=500)
    np.testing.assert_array_equal(first.particles, second.particles)
    np.testing.assert_array_equal(first.log_weights, second.log_weights)


def test_old_answers_are_stood_for_by_the_belief_itself(monkeypatch):
    """With only a few answers remembered, mean and spread stay what they are with all of them."""
    whole, answered, _ = learned(neutral_space(), 24, 6, particles=4000)
    monkeypatch.setattr(belief_module, "MOST_REMEMBERED", 8)
    short = first_belief(Prior(neutral_space()), 4000)
    for query, answer in answered:
        short = short.updated(query, answer)
    assert len(short.history) <= 8
    assert short.summary is not None
    deviation = np.sqrt(np.diag(whole.covariance))
    assert (np.abs(short.mean - whole.mean) < 0.6 * deviation).all()
    np.testing.assert_allclose(np.sqrt(np.diag(short.covariance)), deviation, rtol=0.35)


def test_ten_thousand_random_observations_leave_a_finite_belief():
    """Answers that nobody of this kind would give: no NaN, no collapse, memory bounded."""
    rng, space = np.random.default_rng(0), neutral_space()
    queries = [random_query(rng) for _ in range(40)]
    belief = first_belief(Prior(space), 100)
    for number in range(10_000):
        query = queries[number % 40]
        belief = belief.updated(query, chosen(int(rng.integers(len(query)))))
    assert belief.observations == 10_000
    assert len(belief.history) <= belief_module.MOST_REMEMBERED
    for array in (belief.particles, belief.log_weights, belief.fit, belief.mode):
        assert np.isfinite(array).all()
    assert np.isfinite([belief.entropy, belief.log_evidence]).all()
    assert belief.effective_particles >= 40
    assert len(np.unique(belief.particles, axis=0)) > 50


def change_of_mind(retention):
    """Return how far the mean is from the neutral posture that a person has had for 15 answers, after 25 of another."""
    rng, space = np.random.default_rng(2), neutral_space()
    before, after = np.array([[0.2, 1.9]]), np.array([[1.3, 0.5]])
    belief = first_belief(Prior(space), 1000, retention)
    for number in range(40):
        query = random_query(rng)
        people = space.people(before if number < 25 else after)
        belief = belief.updated(query, chosen(answer_of(people, query, rng)))
    return np.linalg.norm(belief.mean - after[0])


def test_forgetting_follows_a_person_who_changes():
    assert change_of_mind(0.8) < 0.3
    assert change_of_mind(1.0) > 2.0 * change_of_mind(0.8)


def test_forgetting_weighs_answers_by_their_age():
    """The posterior is prior times the likelihoods, each to the power of retention to its age."""
    space = neutral_space()
    belief, answered, _ = learned(space, 4, 12, particles=10_000, retention=0.7)
    points, _ = grid(space, 80)
    log = sum(
        0.7**age * np.log(choice_probabilities(space.people(points), query)[:, answer.places[0]])
        for age, (query, answer) in enumerate(reversed(answered))
    )
    exact = np.exp(log - log.max())
    exact /= exact.sum()
    coarse = np.histogram2d(*points.T, bins=8, range=space.bounds.T, weights=exact)[0]
    found = np.histogram2d(*belief.particles.T, bins=8, range=space.bounds.T, weights=belief.weights)[0]
    assert 0.5 * np.abs(coarse - found).sum() <= 0.05


def test_a_population_tells_of_the_next_person():
    """People alike: after the same three answers the belief that starts from others is nearer."""
    space, rng = neutral_space(), np.random.default_rng(1)
    centre = np.array([0.7, 1.4])
    others = []
    for number in range(8):
        truth = (centre + 0.1 * rng.standard_normal(2))[None]
        belief = first_belief(Prior(space), 500, seed=number)
        for _ in range(8):
            query = random_query(rng)
            belief = belief.updated(query, chosen(answer_of(space.people(truth), query, rng)))
        others.append((belief.particles, belief.log_weights))
    prior = population_prior(space, others)
    deviation = np.sqrt(np.diag(prior.population.covariance))
    assert (np.abs(prior.population.mean - centre) < 0.6 * deviation).all()
    assert (deviation < 0.5 * np.ptp(space.bounds, axis=0) / np.sqrt(12.0)).all()  # half of what an even prior has
    truth, distance = (centre + 0.1 * rng.standard_normal(2))[None], {}
    for name, start in (("nobody", Prior(space)), ("others", prior)):
        again = np.random.default_rng(3)
        belief = first_belief(start, 2000)
        for _ in range(2):
            query = random_query(again)
            belief = belief.updated(query, chosen(answer_of(space.people(truth), query, again)))
        distance[name] = np.linalg.norm(belief.mean - truth)
    assert distance["others"] < 0.7 * distance["nobody"]


def test_prior_of_a_population_is_a_density():
    space = neutral_space()
    prior = Prior(space, Normal(np.array([2.5, 2.5]), 0.3 * np.eye(2)))
    points, volume = grid(space, 200)
    assert np.exp(prior.log_density(points)).sum() * volume == pytest.approx(1.0, abs=0.05)
    drawn = prior.sample(3000, np.random.default_rng(0))
    assert (drawn <= space.bounds[1]).all()
    assert np.isneginf(prior.log_density(space.bounds[1][None] + 0.1)).all()


def test_resampling_keeps_proportions():
    weights = np.array([0.5, 0.25, 0.25, 0.0])
    counts = np.bincount(systematic(np.tile(weights / 100, 100), np.random.default_rng(0)) % 4, minlength=4)
    assert (np.abs(counts - [200, 100, 100, 0]) <= 1).all()


def test_coordinates_without_bounds_and_back():
    bounds = np.array([[0.0, -1.0], [1.0, 3.0]])
    points = np.random.default_rng(0).uniform(*bounds, (500, 2))
    free, there = unbounded(points, bounds)
    again, back = bounded(free, bounds)
    np.testing.assert_allclose(again, points, atol=1e-9)
    np.testing.assert_allclose(back, there, atol=1e-9)
    small = 1e-6
    slope = (bounded(free + [small, 0.0], bounds)[0] - again)[:, 0] / small
    slope *= (bounded(free + [0.0, small], bounds)[0] - again)[:, 1] / small
    np.testing.assert_allclose(np.log(slope), there + np.log(4.0), atol=1e-3)
    far = bounded(np.array([[1e6, -1e6]]), bounds)[0]
    assert ((far >= bounds[0]) & (far <= bounds[1])).all()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: first_belief(Prior(neutral_space()), 1), "particles"),
        (lambda: first_belief(Prior(neutral_space()), 10, 0.0), "retention"),
        (lambda: PreferenceSpace(("a",), np.zeros((2, 1)), np.ones((2, 1))), "nothing is to be learned"),
        (lambda: PreferenceSpace(("a",), np.zeros((2, 1)), np.array([[0.1], [1.0]]), (1.0, 2.0)), "only their product"),
        (lambda: PreferenceSpace(("a",), np.array([[1.0], [0.0]]), np.ones((2, 1))), "lower before upper"),
        (lambda: PreferenceSpace(("a",), np.zeros((2, 1)), np.zeros((2, 1))), "must be positive"),
        (lambda: PreferenceSpace(("a",), np.zeros((2, 1)), np.ones((2, 1)), (0.0, 1.0)), "rationality_bounds"),
        (lambda: population_prior(neutral_space(), []), "one person at least"),
        (lambda: population_prior(neutral_space(), [(np.zeros((3, 5)), np.zeros(3))]), "not \\(n, 2\\)"),
    ],
)
def test_impossible_beliefs_are_refused(make, message):
    with pytest.raises(BadRequestError, match=message):
        make()


def test_the_arm_s_limits_hold():
    assert (neutral_space().bounds == ARM.limits).all()
