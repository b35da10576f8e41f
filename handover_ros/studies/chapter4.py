"""Chapter 4, learning ergonomic preferences: its units of work."""

from __future__ import annotations

from handover_ros.studies.arm_courses import arm_course, user_course
from handover_ros.studies.chapter4_settings import Chapter4Settings
from handover_ros.studies.galleries import arm_sets, likelihood_distances, planar_sets
from handover_ros.studies.learning import Course, Row, teach
from handover_ros.studies.planar_courses import artificial_course, planar_course
from handover_ros.studies.units import Found, Unit

LEARNING = ("planar_neutral", "planar_weights", "arm_neutral", "arm_weights")
USERS, ARTIFICIAL, SETS = "user_study", "artificial", "feasible_sets"
USER_STRATEGIES = ("active", "passive")


def units(settings: Chapter4Settings) -> list[Unit]:
    """Return all parts of the study: the feasible sets, then every person of every scenario."""
    people = settings.people
    scenarios = (ARTIFICIAL, *LEARNING, USERS)
    return [Unit(SETS, 0), *(Unit(scenario, person) for scenario in scenarios for person in range(people))]


def course(settings: Chapter4Settings, unit: Unit, seed: int) -> Course:
    """Return the course of a person of a scenario."""
    if unit.scenario == ARTIFICIAL:
        return artificial_course(settings, unit.number, seed)
    if unit.scenario == USERS:
        return user_course(settings, unit.number, seed)
    arm, learned = unit.scenario.split("_")
    make = planar_course if arm == "planar" else arm_course
    return make(settings, "neutral" if learned == "neutral" else "weights", unit.number, seed)


def strategies(settings: Chapter4Settings, scenario: str) -> tuple[str, ...]:
    """Return the strategies that teach in a scenario."""
    if scenario == ARTIFICIAL:
        return ("active",)
    return USER_STRATEGIES if scenario == USERS else settings.strategies


def work(settings: Chapter4Settings, unit: Unit, seed: int) -> Found:
    """Return what one part found."""
    if unit.scenario == SETS:
        return {
            "feasible_sets": [*planar_sets(settings, seed), *arm_sets(settings, seed)],
            "likelihoods": likelihood_distances(settings, seed),
        }
    taught = course(settings, unit, seed)
    rows: list[Row] = []
    for strategy in strategies(settings, unit.scenario):
        rows += teach(taught, strategy)
    return {"learning": rows}
