"""The simulated conditions of section 3.5: three objectives over objects and goals, and whom the robot expects."""

from __future__ import annotations

from typing import Any

import numpy as np

from handover_ros.errors import InfeasibleError
from handover_ros.planning.choice import MEASURE, grasp_probabilities
from handover_ros.planning.expected_cost import Situation
from handover_ros.planning.objectives import OBJECTIVES
from handover_ros.planning.problem import Candidate
from handover_ros.studies.chapter3_cell import EXPECTED, cell_of, region_shares, table_for, true_cost
from handover_ros.studies.chapter3_settings import PERSONS, Attitude, Chapter3Settings
from handover_ros.studies.units import Found

TOP = "top"  # region by which an object is taken from above


def metric_rows(settings: Chapter3Settings, object_name: str, number: int, seed: int) -> Found:
    """Return what each objective's handover of an object to a goal costs who chooses as expected (table ``metrics``).

    Args:
        settings: Of the study.
        object_name: The object.
        number: Of the goal; the same number is the same kind of goal for all objects.
        seed: Of the study.

    Raises:
        InfeasibleError: The object cannot be placed, or there is no handover.
    """
    cell = cell_of(settings)
    goal = cell.goal(cell.task(object_name), "metrics", number, seed)
    situation = cell.situation(goal.task, EXPECTED)
    rows: list[dict[str, Any]] = []
    for objective in OBJECTIVES:
        candidate = cell.plan(goal.task, situation, objective)
        if candidate is None:
            raise InfeasibleError(f"{object_name} cannot be offered for goal {number}")
        rows.append(
            {
                "object": object_name,
                "goal": number,
                "kind": goal.kind,
                "objective": objective,
                "cost": true_cost(situation, candidate),
                **_grasped(situation, candidate),
            }
        )
    return {"metrics": rows}


def mismatch_rows(settings: Chapter3Settings, attitude: Attitude, number: int, seed: int) -> Found:
    """Return what handovers planned for each assumed person cost each true one, at one goal (table ``mismatch``).

    Args:
        settings: Of the study.
        attitude: How the object may be offered.
        number: Of the goal; the same goals for both attitudes.
        seed: Of the study.

    Raises:
        InfeasibleError: The object cannot be placed, or there is no handover.
    """
    cell = cell_of(settings, attitude)
    name = settings.mismatch.object
    goal = cell.goal(cell.task(name), "mismatch", number, seed)
    people = {person: cell.situation(goal.task, person) for person in PERSONS}
    rows: list[dict[str, Any]] = []
    for assumed in PERSONS:
        candidate = cell.plan(goal.task, people[assumed], "expected_cost")
        if candidate is None:
            raise InfeasibleError(f"{name} cannot be offered for goal {number}")
        rows += [
            {
                "attitude": attitude,
                "goal": number,
                "kind": goal.kind,
                "assumed": assumed,
                "true": person,
                "cost": true_cost(people[person], candidate),
                "value": candidate.value,
                **_grasped(people[person], candidate),
            }
            for person in PERSONS
        ]
    return {"mismatch": rows}


def _grasped(situation: Situation, candidate: Candidate) -> dict[str, Any]:
    """Return the likeliest region, its probability, that of the top, and of grasps that cannot be placed."""
    problem = situation.problem
    allowed = problem.free[candidate.robot_grasp]
    table = table_for(situation, candidate)
    chances = grasp_probabilities(table, problem.goal, problem.choice, allowed)
    shares = region_shares(problem.grasps.grasp_regions, chances)
    region = max(shares, key=lambda name: shares[name])
    placed = np.ones(len(chances), dtype=bool) if problem.goal.table is None else problem.goal.table[:, MEASURE] > 0.0
    return {
        "region": region,
        "region_probability": shares[region],
        "top_probability": shares.get(TOP, 0.0),
        "goal_infeasible": float(chances[~placed].sum()),
    }
