"""The case studies of section 3.5: one object for one person, without and with a goal, by each objective."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from handover_ros.arm.inverse_kinematics import best_postures, feasible_sets
from handover_ros.arm.model import Side
from handover_ros.errors import InfeasibleError
from handover_ros.geometry import FloatArray, invert_transform, transform_from_xyz_rpy
from handover_ros.planning.choice import LEAST, MEAN, MEASURE, PLAIN_MEAN, grasp_probabilities
from handover_ros.planning.expected_cost import Situation
from handover_ros.planning.objectives import OBJECTIVES
from handover_ros.planning.offers import HandoverTask
from handover_ros.planning.problem import Candidate, IntArray
from handover_ros.studies.chapter3_cell import EXPECTED, Cell, cell_of, table_for, true_cost
from handover_ros.studies.chapter3_people import other_preference
from handover_ros.studies.chapter3_settings import Chapter3Settings
from handover_ros.studies.seeds import generator
from handover_ros.studies.units import Found

WITH, WITHOUT = "with", "without"  # a goal
GREAT, IGNORED = 0.5, 0.01  # weights of (3.3), over that of the best configuration, of great ones and of bad ones
BIN, BINS = 0.25, 40  # of the histograms of costs; the last bin holds all that is beyond
DRAWN = 30  # configurations in the pictures
AXES = ("x", "y", "z")
POINTS = ("shoulder", "elbow", "wrist", "grip")
Rows = list[dict[str, Any]]


@dataclass(frozen=True, eq=False)
class Configurations:
    """All ways to take an object that is offered.

    Attributes:
        grasps: Place of each one's grasp (k,).
        postures: Displacements [rad] (k, 7).
        measures: What each stands for [rad] (k,).
        costs: (k,).
        probabilities: P(q) of (3.3), sum 1 (k,).
    """

    grasps: IntArray
    postures: FloatArray
    measures: FloatArray
    costs: FloatArray
    probabilities: FloatArray


def case_rows(settings: Chapter3Settings, person: int, seed: int) -> Found:
    """Return what one person is offered (``cases``); of the first also what the pictures show.

    Args:
        settings: Of the study.
        person: The first is as the robot expects, the others are not; the robot knows what each finds comfortable.
        seed: Of the study.

    Raises:
        InfeasibleError: The first person cannot be offered the object.
    """
    cell = cell_of(settings)
    task = _task(settings, cell, person, seed)
    goal = settings.case_study.goal
    world_from_goal = cell.world_from_torso @ transform_from_xyz_rpy(goal.xyz, goal.rpy)
    found: Found = {"cases": []}
    if person == 0:
        found |= {"case_histograms": [], "case_limbs": [], "case_grasps": [], "case_poses": []}
    for name, asked in ((WITHOUT, task), (WITH, replace(task, world_from_goal=world_from_goal))):
        try:
            situation = cell.situation(asked, EXPECTED)
        except InfeasibleError:
            if person == 0:
                raise
            continue  # this person cannot place it there
        plans = {objective: cell.plan(asked, situation, objective) for objective in OBJECTIVES}
        offered = {objective: plan for objective, plan in plans.items() if plan is not None}
        if len(offered) < len(plans):
            continue
        ways = {objective: configurations(situation, plan) for objective, plan in offered.items()}
        best = min(float(each.costs.min()) for each in ways.values())
        for objective, plan in offered.items():
            key = {"person": person, "goal": name, "objective": objective}
            found["cases"].append(key | _summary(situation, plan) | _kinds(ways[objective], best, settings.rationality))
            if person == 0:
                found["case_histograms"] += [key | row for row in _histogram(ways[objective])]
                found["case_limbs"] += [key | row for row in _limbs(situation, plan, ways[objective])]
                found["case_grasps"] += [key | row for row in _grasps(situation, plan)]
                found["case_poses"].append(key | _poses(situation, plan))
    return found


def configurations(situation: Situation, plan: Candidate) -> Configurations:
    """Return all ways in which the person can take what is offered, by the hand that takes it."""
    problem = situation.problem
    side = problem.taker.sides[0]
    open_grasps = np.flatnonzero(problem.free[plan.robot_grasp] & (plan.table[:, MEASURE] > 0.0))
    hands = np.stack([plan.torso_from_object @ problem.grasps.hand_poses(int(each))[side] for each in open_grasps])
    sets = feasible_sets(problem.taker.arms[side], hands, problem.taker.step)
    costs = problem.taker.costs[side].evaluate(sets.postures)
    chances = grasp_probabilities(plan.table, problem.goal, problem.choice, problem.free[plan.robot_grasp])[open_grasps]
    owner = np.repeat(np.arange(len(open_grasps)), np.diff(sets.first))
    weights = sets.measures * np.exp(-problem.choice.hand_rationality * (costs - costs.min()))
    total = np.bincount(owner, weights, len(open_grasps))
    within = np.divide(weights, total[owner], out=np.zeros_like(weights), where=total[owner] > 0.0)
    likely = chances[owner] * within
    return Configurations(open_grasps[owner], sets.postures, sets.measures, costs, likely / likely.sum())


def _task(settings: Chapter3Settings, cell: Cell, person: int, seed: int) -> HandoverTask:
    """Return the handover to one person."""
    task = cell.task(settings.case_study.object)
    if person == 0:
        return task
    known = task.tracked_person("study")
    taker = cell.scheme.taker(task.model, known)
    rng = generator(seed, "people of the case study", person)
    preference = other_preference(settings, cell.usual, taker.arms[taker.sides[0]], rng)
    return replace(task, person=replace(known, preference=preference))


def _summary(situation: Situation, plan: Candidate) -> dict[str, float]:
    """Return expected, least and mean cost of an offer, at the handover and at the goal."""
    problem = situation.problem
    free, table = problem.free[plan.robot_grasp], table_for(situation, plan)
    chances = grasp_probabilities(table, problem.goal, problem.choice, free)
    can = free & (table[:, MEASURE] > 0.0)
    later = np.broadcast_to(np.asarray(problem.goal.mean, dtype=float), chances.shape)
    return {
        "expected_cost": true_cost(situation, plan),
        "hand_cost": float(chances[can] @ table[can, MEAN]),
        "goal_cost": float(chances @ later),
        "least_hand_cost": float(table[can, LEAST].min()),
        "mean_hand_cost": float(np.average(table[can, PLAIN_MEAN], weights=table[can, MEASURE])),
        "measure": float(table[can, MEASURE].sum()),
    }


def _kinds(ways: Configurations, best: float, rationality: float) -> dict[str, float]:
    """Return how many great, fairly good and bad configurations there are [rad], and how probable they are.

    They are told apart by their weight exp(-rationality C) over that of the best configuration of any objective.
    """
    weights = np.exp(-rationality * (ways.costs - best))
    great, bad = weights >= GREAT, weights < IGNORED
    found = {}
    for name, kind in (("great", great), ("fair", ~great & ~bad), ("bad", bad)):
        found[f"{name}_measure"] = float(ways.measures[kind].sum())
        found[f"{name}_probability"] = float(ways.probabilities[kind].sum())
    return found


def _histogram(ways: Configurations) -> Rows:
    """Return how many configurations [rad] and how much probability lie in each bin of cost."""
    bins = np.minimum((ways.costs / BIN).astype(int), BINS - 1)
    measures, chances = (np.bincount(bins, each, BINS) for each in (ways.measures, ways.probabilities))
    return [
        {"cost_from": BIN * place, "measure": float(measures[place]), "probability": float(chances[place])}
        for place in range(BINS)
    ]


def _limbs(situation: Situation, plan: Candidate, ways: Configurations) -> Rows:
    """Return arms (torso frame, [m]): likeliest, riskiest, some of all, and the one at the goal with the likeliest."""
    problem = situation.problem
    side = problem.taker.sides[0]
    arm = problem.taker.arms[side]
    limbs = arm.limbs(ways.postures)
    likely = int(np.argmax(ways.probabilities / ways.measures))
    risky = int(np.argmax(ways.probabilities * ways.costs))
    spread = np.unique(np.linspace(0, len(limbs) - 1, min(DRAWN, len(limbs))).astype(int))
    rows = [
        {"picture": "likely", "probability": float(ways.probabilities[likely]), **_points(limbs[likely])},
        {"picture": "risky", "probability": float(ways.probabilities[risky]), **_points(limbs[risky])},
    ]
    rows += [
        {"picture": "all", "probability": float(ways.probabilities[each]), **_points(limbs[each])} for each in spread
    ]
    placed = _placed(situation, plan, side, int(ways.grasps[likely]))
    return rows if placed is None else [*rows, {"picture": "goal", "probability": None, **_points(placed)}]


def _placed(situation: Situation, plan: Candidate, side: Side, grasp: int) -> FloatArray | None:
    """Return the arm (4, 3) [m] of least cost that places the object with a grasp, in the torso frame, if any does."""
    problem, goal = situation.problem, situation.world_from_goal
    if goal is None or problem.goal.table is None or not problem.goal.table[grasp, MEASURE] > 0.0:
        return None
    cost = getattr(problem.taker.costs[side], "preference", None)
    there = invert_transform(situation.world_from_torso) @ goal @ problem.grasps.hand_poses(grasp)[side]
    if cost is None:
        return None
    arm = problem.taker.arms[side]
    postures, costs = best_postures(arm, there[None], cost.neutral, cost.weights)
    return np.asarray(arm.limbs(postures)[0]) if np.isfinite(costs[0]) else None


def _points(limb: FloatArray) -> dict[str, float]:
    """Return the columns of shoulder, elbow, wrist and grip (4, 3) [m]."""
    return {
        f"{point}_{axis}": float(limb[row, place])
        for row, point in enumerate(POINTS)
        for place, axis in enumerate(AXES)
    }


def _grasps(situation: Situation, plan: Candidate) -> Rows:
    """Return what each grasp that can be taken costs, and how probable it is."""
    problem = situation.problem
    free = problem.free[plan.robot_grasp]
    chances = grasp_probabilities(plan.table, problem.goal, problem.choice, free)
    table = problem.goal.table
    return [
        {
            "grasp": int(grasp),
            "region": problem.grasps.region(int(grasp)),
            "probability": float(chances[grasp]),
            "hand_cost": float(plan.table[grasp, MEAN]),
            "goal_cost": None if table is None or not table[grasp, MEASURE] > 0.0 else float(table[grasp, MEAN]),
        }
        for grasp in np.flatnonzero(free & (plan.table[:, MEASURE] > 0.0))
    ]


def _poses(situation: Situation, plan: Candidate) -> dict[str, Any]:
    """Return the upper rows of torso_from_object and torso_from_gripper, row by row."""
    gripper = plan.torso_from_object @ situation.problem.object_from_gripper[plan.robot_grasp]
    return {
        f"{name}_{row}{column}": float(pose[row, column])
        for name, pose in (("object", plan.torso_from_object), ("gripper", gripper))
        for row in range(3)
        for column in range(4)
    }
