"""Courses with the planar arm of two joints (Bestick 2017, section 4.5): random objects, and two artificial sets."""

from __future__ import annotations

from typing import Literal

import numpy as np

from handover_ros.arm.planar import JOINTS, PlanarArm, random_object
from handover_ros.geometry import FloatArray
from handover_ros.preferences.query import Query
from handover_ros.preferences.space import PreferenceSpace
from handover_ros.studies.chapter4_settings import Chapter4Settings
from handover_ros.studies.heldout import heldout
from handover_ros.studies.learning import Course
from handover_ros.studies.seeds import anybody, generator

Learned = Literal["neutral", "weights"]
ARM = PlanarArm()


def planar_query(postures: FloatArray, name: str = "") -> Query:
    """Return the query that a feasible set (k, 2) [rad] is: all configurations count the same, as in (4.3)."""
    return Query(postures, np.ones(len(postures)), np.zeros(len(postures), dtype=np.int64), ("object",), name)


def planar_space(settings: Chapter4Settings, learned: Learned) -> PreferenceSpace:
    """Return what is learned of a person with a planar arm; neutral postures lie within the limits."""
    planar, known = settings.planar, (settings.rationality, settings.rationality)
    if learned == "neutral":
        return PreferenceSpace(JOINTS, ARM.limits, np.array([planar.known_weights] * 2), known)
    bounds = np.tile(np.array(planar.weight_bounds)[:, None], 2)
    return PreferenceSpace(JOINTS, np.array([planar.known_neutral] * 2), bounds, known)


def planar_course(settings: Chapter4Settings, learned: Learned, person: int, seed: int) -> Course:
    """Return one person's course: a random truth, a random menu, random objects to test with (figure 4.2)."""
    scenario = f"planar_{learned}"
    rng = generator(seed, scenario, person)
    space = planar_space(settings, learned)
    truth = anybody(space, rng)
    menu = tuple(planar_query(random_object(ARM, rng), f"object {place}") for place in range(settings.menu))
    tests = [planar_query(random_object(ARM, rng)) for _ in range(settings.planar.test_objects)]
    return Course(
        scenario=scenario,
        person=person,
        space=space,
        truth=truth,
        menu=menu,
        tests=heldout(tests, space.people(truth[None]), rng),
        levels=rng.random(settings.planar.queries),
        particles=settings.particles,
        seed=int(rng.integers(2**31)),
        information_weight=settings.information_weight,
    )


def artificial_course(settings: Chapter4Settings, person: int, seed: int) -> Course:
    """Return one person's course with the two artificial feasible sets (figures 4.3 and 4.4).

    Each set has two parts: side by side, or one above the other; what is chosen tells on which side q* lies.
    """
    made = settings.artificial
    rng = generator(seed, "artificial", person)
    known = (settings.rationality, settings.rationality)
    bounds = np.tile(np.array(made.bounds)[:, None], 2)
    space = PreferenceSpace(JOINTS, bounds, np.array([settings.planar.known_weights] * 2), known)
    along = np.linspace(-0.5, 0.5, 21) * made.length
    part = np.column_stack([np.full_like(along, made.apart), along])
    side_by_side = np.concatenate([part, part * [-1.0, 1.0]])
    menu = (planar_query(side_by_side, "side by side"), planar_query(side_by_side[:, ::-1], "one above the other"))
    return Course(
        scenario="artificial",
        person=person,
        space=space,
        truth=anybody(space, rng),
        menu=menu,
        tests=None,
        levels=rng.random(made.queries),
        particles=settings.particles,
        seed=int(rng.integers(2**31)),
    )
