"""The plain twin of ``feasible``, ``choice`` and ``objectives``: loops over every configuration, as the formulas stand.

For one object pose and one robot grasp. Every grasp is a list of (measure, cost) of its configurations at the handover
and at the goal; nothing is factored, kept in logarithms or vectorised. Tests hold the two together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from handover_ros.planning.choice import ChoiceModel

Configurations = Sequence[tuple[float, float]]  # measure, cost


@dataclass(frozen=True)
class Grasp:
    """One grasp.

    Attributes:
        hand: Configurations to take the object with it.
        goal: Configurations to place the object with it; None: there is no goal.
    """

    hand: Configurations
    goal: Configurations | None = None


def choose(configurations: Configurations, rationality: float) -> list[float]:
    """Return P(q) of each configuration (3.3)."""
    if math.isinf(rationality):
        least = min((cost for _, cost in configurations), default=0.0)
        weights = [measure if cost == least else 0.0 for measure, cost in configurations]
    else:
        weights = [measure * math.exp(-rationality * cost) for measure, cost in configurations]
    total = sum(weights)
    return [weight / total for weight in weights]


def mean_cost(configurations: Configurations, rationality: float) -> float:
    """Return sum P(q) C(q)."""
    return sum(p * cost for p, (_, cost) in zip(choose(configurations, rationality), configurations))


def goal_cost(grasp: Grasp, model: ChoiceModel, regrasp: float) -> float:
    """Return E[C(goal) | g]."""
    if grasp.goal is None:
        return 0.0
    return mean_cost(grasp.goal, model.rationality) if grasp.goal else regrasp


def joint_probabilities(grasps: Sequence[Grasp], model: ChoiceModel, regrasp: float) -> list[list[float]]:
    """Return P(g, q) of every configuration of every grasp at the handover, by the perceived cost (3.5)."""
    later = [goal_cost(grasp, model, regrasp) for grasp in grasps]
    seen = [
        [(measure, model.myopia * cost + (1.0 - model.myopia) * after) for measure, cost in grasp.hand]
        for grasp, after in zip(grasps, later)
    ]
    flat = choose([entry for entries in seen for entry in entries], model.rationality) if any(seen) else []
    result, start = [], 0
    for entries in seen:
        result.append(flat[start : start + len(entries)])
        start += len(entries)
    return result


def expected_cost(grasps: Sequence[Grasp], model: ChoiceModel, regrasp: float = 0.0) -> float:
    """Return the expected total cost (3.7); (3.6) without a goal; inf: nothing is feasible."""
    if not any(grasp.hand for grasp in grasps):
        return math.inf
    total = 0.0
    for grasp, probabilities in zip(grasps, joint_probabilities(grasps, model, regrasp)):
        for probability, (_, cost) in zip(probabilities, grasp.hand):
            total += probability * (cost + goal_cost(grasp, model, regrasp))
    return total


def minimum_mean(grasps: Sequence[Grasp], regrasp: float = 0.0) -> float:
    """Return the mean cost of all configurations, at the handover and at the goal."""
    if not any(grasp.hand for grasp in grasps):
        return math.inf
    now = [entry for grasp in grasps for entry in grasp.hand]
    value = sum(m * c for m, c in now) / sum(m for m, _ in now)
    if grasps[0].goal is None:
        return value
    later = [entry for grasp in grasps if grasp.hand for entry in grasp.goal or ()]
    return value + (sum(m * c for m, c in later) / sum(m for m, _ in later) if later else regrasp)


def maximum_feasibility(grasps: Sequence[Grasp]) -> float:
    """Return minus the measure of all configurations."""
    if not any(grasp.hand for grasp in grasps):
        return math.inf
    return -sum(m for grasp in grasps if grasp.hand for m, _ in [*grasp.hand, *(grasp.goal or ())])
