"""The two user studies of section 3.6 with simulated subjects, who take what two programs offer, and their measures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from handover_ros.errors import InfeasibleError
from handover_ros.geometry import FloatArray
from handover_ros.planning.choice import (
    LOG_WEIGHT,
    MEAN,
    MEASURE,
    PLAIN_MEAN,
    ChoiceModel,
    GoalCosts,
    grasp_probabilities,
)
from handover_ros.planning.expected_cost import Situation
from handover_ros.planning.feasible import statistics
from handover_ros.planning.goal_stance import placing_after_moving, placing_from
from handover_ros.planning.objectives import BoolArray
from handover_ros.planning.offers import HandoverTask
from handover_ros.planning.problem import Candidate
from handover_ros.studies.chapter3_cell import EXPECTED, Cell, cell_of
from handover_ros.studies.chapter3_people import Somebody, somebody
from handover_ros.studies.chapter3_settings import Chapter3Settings
from handover_ros.studies.seeds import generator
from handover_ros.studies.units import Found

# Programs of each study, the one that is claimed to be better first: person that is assumed, objective.
METRICS, MODELS = "metrics", "models"
PROGRAMS = {
    METRICS: {"expected_cost": (EXPECTED, "expected_cost"), "maximum_feasibility": (EXPECTED, "maximum_feasibility")},
    MODELS: {"MN": ("MN", "expected_cost"), "GP": ("GP", "expected_cost")},
}
MEASURES = ("OM1", "OM2", "OM3", "OM4")
UNAWARE, AWARE = "unaware", "aware"
PARTS = (UNAWARE, AWARE)


@dataclass(frozen=True, eq=False)
class Trial:
    """What a program offers at a goal.

    Attributes:
        expected: The situation with the person the robot expects, noisy.
        offered: The handover.
        task: The handover's, with the goal.
    """

    expected: Situation
    offered: Candidate
    task: HandoverTask


def user_rows(settings: Chapter3Settings, study: str, number: int, seed: int) -> Found:
    """Return how all subjects of a study take what both programs offer for one goal (table ``users``).

    Args:
        settings: Of the study.
        study: ``metrics``: expected cost against maximum feasibility, goals on a table; ``models``: the robot expects
            MN or GP, goals in a shelf.
        number: Of the goal.
        seed: Of all random numbers; the subjects are the same at every goal.

    Raises:
        InfeasibleError: The object cannot be placed, or there is no handover.
    """
    cell, users = cell_of(settings), settings.user_studies
    furniture = np.array(users.table) if study == METRICS else users.shelf
    goal = cell.goal(cell.task(users.object), f"user study {study}", number, seed, furniture)
    expected = cell.situation(goal.task, EXPECTED)
    count = users.people.metrics if study == METRICS else users.people.models
    people = [somebody(settings, expected.problem.taker, cell.usual, study, each, seed) for each in range(count)]
    placings = [_own_goal(cell, expected, goal.task, person) for person in people]
    rows: list[dict[str, Any]] = []
    for program, (assumed, objective) in PROGRAMS[study].items():
        offered = cell.plan(goal.task, cell.situation(goal.task, assumed), objective)
        if offered is None:
            raise InfeasibleError(f"{users.object} cannot be offered for goal {number}")
        trial = Trial(expected, offered, goal.task)
        for part in PARTS:
            for person, placing in zip(people, placings):
                rng = generator(seed, f"{study} {program} {part} {number}", person.number)
                key = {
                    "study": study,
                    "part": part,
                    "program": program,
                    "goal": number,
                    "kind": goal.kind,
                    "person": person.number,
                }
                rows.append(key | _taken(settings, trial, person, placing, part, rng))
    return {"users": rows}


def _own_goal(cell: Cell, expected: Situation, task: HandoverTask, person: Somebody) -> GoalCosts:
    """Return what each grasp costs a subject at the goal."""
    problem, rationality = expected.problem, cell.settings.rationality
    assert expected.world_from_goal is not None
    torso, goal, grasps = expected.world_from_torso, expected.world_from_goal, problem.grasps
    if cell.settings.moves_to_goal:
        placing = placing_after_moving(torso, goal, person.taker, grasps, problem.model, task.boxes, rationality)
    else:
        placing = placing_from(torso, goal, person.taker, grasps, task.boxes, rationality)
    return GoalCosts(placing.table, problem.goal.regrasp)


def _taken(
    settings: Chapter3Settings,
    trial: Trial,
    person: Somebody,
    goal: GoalCosts,
    part: str,
    rng: np.random.Generator,
) -> dict[str, Any]:
    """Return which region a subject takes, and the measures of that; nothing where they cannot take it at all."""
    problem = trial.expected.problem
    myopia = person.aware_myopia if part == AWARE else 1.0
    model = ChoiceModel("subject", settings.rationality, myopia)
    free = problem.free[trial.offered.robot_grasp]
    pose = trial.offered.torso_from_object[None]
    table = statistics(person.taker, problem.grasps, pose, model.hand_rationality)[0]
    chances = grasp_probabilities(table, goal, model, free)
    drawn = rng.random()
    if not chances.any():
        return {"region": None, "goal_cost": None, **dict.fromkeys(MEASURES), "OM5": None}
    grasp = int(min(np.searchsorted(np.cumsum(chances), drawn * chances.sum()), len(chances) - 1))
    regions = np.array(problem.grasps.grasp_regions)
    at_handover = free & (trial.offered.table[:, MEASURE] > 0.0)
    assert problem.goal.table is not None
    assert goal.table is not None
    measures = goal_measures(problem.goal.table, problem.goal.regrasp, regions == regions[grasp], at_handover)
    return {
        "region": str(regions[grasp]),
        "goal_cost": float(np.asarray(goal.mean)[grasp]),
        **dict(zip(MEASURES, measures)),
        "OM5": float(not goal.table[grasp, MEASURE] > 0.0),
    }


def goal_measures(table: FloatArray, regrasp: float, region: BoolArray, at_handover: BoolArray) -> Sequence[float]:
    """Return OM1 to OM4 (Bestick 2017, eq. 3.8 to 3.11) of a region that was taken, by the robot's model of people.

    Args:
        table: Statistics (grasps, 5) of the feasible sets at the goal, weighed with the rationality of OM1.
        regrasp: What a region costs of which no grasp can be placed.
        region: Which grasps belong to it (grasps,).
        at_handover: Which were feasible at the handover (grasps,).
    """
    found = []
    for grasps in (region & at_handover, region):
        kept = table[grasps & (table[:, MEASURE] > 0.0)]
        if not len(kept):
            found += [regrasp, regrasp]
            continue
        weights = np.exp(kept[:, LOG_WEIGHT] - kept[:, LOG_WEIGHT].max())
        found.append(float(np.average(kept[:, MEAN], weights=weights)))
        found.append(float(np.average(kept[:, PLAIN_MEAN], weights=kept[:, MEASURE])))
    return found
