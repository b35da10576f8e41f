"""Simulated persons with a planar arm, for tests of what is learned from them."""

from dataclasses import replace

import numpy as np

from handover_ros.arm.planar import JOINTS, PlanarArm, random_object
from handover_ros.preferences.belief import first_belief
from handover_ros.preferences.likelihood import choice_probabilities
from handover_ros.preferences.prior import Prior
from handover_ros.preferences.query import Query
from handover_ros.preferences.space import PreferenceSpace

ARM = PlanarArm()
ONES = np.ones((2, 2))


def neutral_space(rationality=(10.0, 10.0)):
    return PreferenceSpace(JOINTS, ARM.limits, ONES, rationality)


def weight_space(neutral=(0.6, 1.2)):
    return PreferenceSpace(JOINTS, np.array([neutral, neutral]), np.array([[0.1, 0.1], [3.0, 3.0]]))


def whole_space():
    return PreferenceSpace(JOINTS, ARM.limits, np.array([[0.1, 0.1], [3.0, 3.0]]))


def random_belief(seed, number=25):
    """Return a belief about the neutral posture whose particles weigh differently."""
    rng = np.random.default_rng(seed)
    belief = first_belief(Prior(neutral_space()), number, seed=seed)
    return replace(belief, log_weights=np.log(rng.dirichlet(np.ones(number))))


def random_query(rng, regions=3):
    q = random_object(ARM, rng)
    return Query(q, rng.uniform(0.5, 2.0, len(q)), rng.integers(regions, size=len(q)), tuple("abc"[:regions]))


def answer_of(people, query, rng):
    """Return the place the first of some people chooses."""
    return int(rng.choice(len(query), p=choice_probabilities(people, query)[0]))
