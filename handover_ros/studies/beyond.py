"""The whole loop for one simulated person after the other: calibrate, learn by every strategy, plan, leave out."""

from __future__ import annotations

import contextlib
import math
import tempfile
from collections.abc import Mapping
from pathlib import Path

from handover_ros.cell.belief_store import BeliefStore
from handover_ros.cell.preference_learner import LearnerSettings, PreferenceLearner, point_estimates
from handover_ros.ergonomics.arm_costs import Preference
from handover_ros.errors import HandoverError
from handover_ros.preferences.information import AnswerKind
from handover_ros.sim.person_spec import load_person
from handover_ros.skeleton.tree import Skeleton
from handover_ros.studies.beyond_settings import BeyondSettings
from handover_ros.studies.laboratory import Laboratory, Participant, laboratory
from handover_ros.studies.participants import with_body, with_taste
from handover_ros.studies.seeds import generator
from handover_ros.studies.tables import Rows
from handover_ros.studies.units import Found, Unit

PERSON = "person"
BEST = "active_value"  # whose belief the ablation plans with
# Which skeleton, which preference, which objective; the parts that are left out are anybody's, or the baseline's.
PARTS: Mapping[str, tuple[str, str, str]] = {
    "truth": ("true", "true", "expected_cost"),
    "whole loop": ("calibrated", "learned", "expected_cost"),
    "without calibration": ("anybody's", "learned", "expected_cost"),
    "without learning": ("calibrated", "anybody's", "expected_cost"),
    "without expected cost": ("calibrated", "learned", "minimum_mean"),
    "without any": ("anybody's", "anybody's", "minimum_mean"),
}


def units(settings: BeyondSettings) -> list[Unit]:
    """Return all parts of the study: its persons."""
    return [Unit(PERSON, number) for number in range(settings.people)]


def work(settings: BeyondSettings, unit: Unit, seed: int) -> Found:
    """Return what one person's handovers showed."""
    place = laboratory("lab", settings.rationality)
    rng = generator(seed, "beyond person", unit.number)
    spec = with_taste(with_body(load_person("adult"), rng), rng).spec
    person = place.invite(spec, unit.number)
    best: dict[str, float] = {}
    for name in settings.judged:
        with contextlib.suppress(HandoverError):  # what nobody can hand to this person judges nothing
            best[name] = place.judged(name, person, person.skeleton, person.truth.preference).cost
    if not best:
        return {"courses": [], "parts": []}
    courses: Rows = []
    learned: Preference | None = None
    taught: list[tuple[str, AnswerKind]] = [(strategy, "posture") for strategy in settings.strategies]
    for strategy, answers in [*taught, (BEST, "region")]:
        rows, preference = course(settings, place, person, best, (unit.number, seed), strategy, answers)
        courses += rows
        if (strategy, answers) == (BEST, "posture"):
            learned = preference
    parts: Rows = []
    skeletons: dict[str, Skeleton | None] = {
        "true": person.skeleton,
        "calibrated": person.profile.skeleton,
        "anybody's": None,
    }
    preferences = {"true": person.truth.preference, "learned": learned, "anybody's": None}
    for name, (body, taste, scheme) in PARTS.items():
        total, missed = planned(settings, place, person, best, skeletons[body], preferences[taste], scheme)
        parts.append({"person": unit.number, "condition": name, "cost": total, "missed": missed})
    return {"courses": courses, "parts": parts}


def course(
    settings: BeyondSettings,
    place: Laboratory,
    person: Participant,
    best: Mapping[str, float],
    named: tuple[int, int],
    strategy: str,
    answers: AnswerKind,
) -> tuple[Rows, Preference | None]:
    """Return how one strategy teaches, handover by handover, and the preference that was learned.

    Args:
        settings: Of the study.
        place: Where it happens.
        person: Who is asked.
        best: What planning with the truth costs, by object.
        named: The person's number, and the seed.
        strategy: Chooses from the menus.
        answers: What of a choice is used.
    """
    number, seed = named
    given = LearnerSettings(
        rationality=settings.rationality, particles=settings.particles, answers=answers, seed=number
    )
    rng = generator(seed, f"beyond choices {strategy} {answers}", number)
    rows: Rows = []
    preference: Preference | None = None
    with tempfile.TemporaryDirectory() as folder:
        learner = PreferenceLearner(place.catalogue, place.planner.grippers, BeliefStore(Path(folder)), given)
        learner.activate(person.profile)
        assert learner.person is not None
        for handover in range(settings.handovers + 1):
            paid: float | None = None
            offered = ""
            if handover:
                menu = place.offers(person, settings.asked, settings.per_object, handover)
                chosen = menu[learner.choose(menu, strategy, settings.information_weight).chosen]
                taken, cost = place.taken(person, chosen, f"{handover}", rng)
                paid, offered = (None if math.isnan(cost) else cost), chosen.object_name
                with contextlib.suppress(HandoverError):  # not an answer: the node would say so and go on
                    if taken is not None:
                        learner.add(taken)
            belief = learner.person.belief
            preference = point_estimates(belief)["expected"] if belief.observations else None
            total, _ = planned(settings, place, person, best, person.profile.skeleton, preference, "expected_cost")
            rows.append(
                {
                    "person": number,
                    "strategy": strategy,
                    "answers": answers,
                    "handover": handover,
                    "object": offered,
                    "paid": paid,
                    "planned": total,
                    "counted": belief.observations,
                }
            )
    return rows, preference


def planned(
    settings: BeyondSettings,
    place: Laboratory,
    person: Participant,
    best: Mapping[str, float],
    skeleton: Skeleton | None,
    preference: Preference | None,
    scheme: str,
) -> tuple[float, int]:
    """Return the true cost of all judged handovers over that of planning with the truth, and how many are missed."""
    total, missed = 0.0, 0
    for name in best:
        try:
            cost = place.judged(name, person, skeleton, preference, scheme).cost
        except HandoverError:
            cost = math.nan
        missed += math.isnan(cost)
        total += settings.missed * best[name] if math.isnan(cost) else cost
    return total / sum(best.values()), missed
