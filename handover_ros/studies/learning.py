"""One simulated person taught by one strategy: select, answer, update, and measure (Bestick 2017, section 4.4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.preferences.belief import Belief, first_belief
from handover_ros.preferences.information import AnswerKind
from handover_ros.preferences.likelihood import choice_probabilities
from handover_ros.preferences.prior import Prior
from handover_ros.preferences.query import Query, chosen, region_answer
from handover_ros.preferences.space import People, PreferenceSpace
from handover_ros.preferences.strategies import select
from handover_ros.studies import feasible_shape
from handover_ros.studies.heldout import Heldout, choice

Row = dict[str, float | int | str | None]


@dataclass(frozen=True, eq=False)
class Course:
    """What a person is to be taught with; the same for every strategy.

    Attributes:
        scenario: Its name.
        person: Number of the simulated person.
        space: What is learned of them.
        truth: What they prefer, in the space's coordinates (p,).
        menu: The queries.
        tests: Handovers not learned from; None: there are none.
        levels: Numbers in [0, 1) that decide the person's choices, one an answer, shape (queries,).
        particles: Of the belief.
        seed: Of the belief.
        answers: What of a choice is seen.
        information_weight: Of the hybrid strategy.
    """

    scenario: str
    person: int
    space: PreferenceSpace
    truth: FloatArray
    menu: tuple[Query, ...]
    tests: Heldout | None
    levels: FloatArray
    particles: int
    seed: int
    answers: AnswerKind = "posture"
    information_weight: float = 0.5

    @property
    def objects(self) -> tuple[str, ...]:
        """What each query offers."""
        return tuple(query.name for query in self.menu)

    @property
    def true_person(self) -> People:
        """The person, one row."""
        return self.space.people(self.truth[None])


def teach(course: Course, strategy: str) -> list[Row]:
    """Return the measures before any answer (iteration 0) and after each.

    Before any answer every point is as likely as any other: the middle of the bounds then stands for the mode.
    """
    belief = first_belief(Prior(course.space), course.particles, seed=course.seed)
    middle = course.space.bounds.mean(axis=0)
    start: Row = {"scenario": course.scenario, "person": course.person, "strategy": strategy}
    rows = [start | {"iteration": 0} | accuracy(course, belief, middle) | dict.fromkeys(OF_QUERIES)]
    for iteration, level in enumerate(course.levels, 1):
        selection = select(belief, course.menu, strategy, course.answers, course.information_weight, seed=course.seed)
        query = course.menu[selection.chosen]
        place = choice(query, course.true_person, level)
        answer = chosen(place)
        if course.answers == "region":
            answer = region_answer(query, query.regions[query.region[place]])
        belief = belief.updated(query, answer)
        asked = of_query(course, selection.chosen) | {
            "answer": place,
            "information": float(selection.information[selection.chosen]),
        }
        rows.append(start | {"iteration": iteration} | accuracy(course, belief, belief.mode) | asked)
    return rows


def accuracy(course: Course, belief: Belief, mode: FloatArray) -> Row:
    """Return what is measured of a belief: log P(lambda*), distance of the mode, test log likelihood.

    Density and distance are those of the learned coordinates: [rad] of neutral postures, logarithms of weights.
    """
    model = course.space.people(mode[None])
    return {
        "log_density": float(belief.log_density(course.truth[None])[0]),
        "distance": float(np.linalg.norm(mode - course.truth)),
        "test_log_likelihood": course.tests.log_likelihood(model) if course.tests else None,
        "entropy": belief.entropy,
        "effective_particles": belief.effective_particles,
    }


OF_QUERIES = ("place", "object", "true_cost", "spread", "parts", "nearest", "answer", "information")


def of_query(course: Course, place: int) -> Row:
    """Return what is measured of a chosen query: E[C_ergo(q_H)] in truth, and the shape of the feasible set."""
    query, person = course.menu[place], course.true_person
    expected = choice_probabilities(person, query)[0] @ person.costs(query.configurations)[0]
    return {
        "place": place,
        "object": course.objects[place],
        "true_cost": float(expected),
        "spread": feasible_shape.spread(query.configurations),
        "parts": feasible_shape.parts(query.configurations),
        "nearest": feasible_shape.nearest(query.configurations, person.neutral[0]),
    }
