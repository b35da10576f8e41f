"""What a handover is judged by: expected cost (Bestick 2017, eq. 3.6, 3.7) and the two baselines of section 3.5.

A handover is a pose of the object and a robot grasp, which leaves the person some of the grasps. All objectives are to
be minimised, and are evaluated for many poses and many robot grasps at once: the sums factor over the person's grasps,
so that the feasible sets are looked at once for each pose, whatever the robot's grasp.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt

from handover_ros.geometry import FloatArray
from handover_ros.planning.choice import MEAN, MEASURE, PLAIN_MEAN, ChoiceModel, GoalCosts, grasp_probabilities

BoolArray = npt.NDArray[np.bool_]
Objective = Callable[[FloatArray, GoalCosts, ChoiceModel, BoolArray], FloatArray]


def expected_cost(table: FloatArray, goal: GoalCosts, model: ChoiceModel, allowed: BoolArray) -> FloatArray:
    """Return the expected (total) cost (poses, robot grasps), (3.6) without and (3.7) with a goal; inf: infeasible.

    Args:
        table: Statistics at the handover, weighed with ``model.hand_rationality``, shape (poses, grasps, 5).
        goal: What the grasps cost at the goal, weighed with ``model.rationality``.
        model: How the person chooses.
        allowed: Which grasps each robot grasp leaves free, shape (robot grasps, grasps).
    """
    probabilities = grasp_probabilities(table[:, None], goal, model, allowed[None])
    cost = np.where(table[..., MEASURE] > 0.0, table[..., MEAN], 0.0) + goal.mean
    value = np.einsum("prg,pg->pr", probabilities, cost)
    return np.where(probabilities.any(axis=-1), value, np.inf)


def minimum_mean(table: FloatArray, goal: GoalCosts, model: ChoiceModel, allowed: BoolArray) -> FloatArray:
    """Return the mean cost of all feasible configurations, all equally likely, plus that of those at the goal."""
    weights = allowed[None] * table[:, None, :, MEASURE]
    plain = np.where(table[..., MEASURE] > 0.0, table[..., PLAIN_MEAN], 0.0)
    total = weights.sum(axis=-1)
    value = np.divide(
        (weights * plain[:, None]).sum(axis=-1), total, out=np.full(total.shape, np.inf), where=total > 0.0
    )
    if goal.table is None:
        return value
    placing = goal.table[:, MEASURE]
    at_goal = (weights > 0.0) * placing
    later = np.where(placing > 0.0, goal.table[:, PLAIN_MEAN], 0.0)
    count = at_goal.sum(axis=-1)
    mean = np.divide(at_goal @ later, count, out=np.full(count.shape, goal.regrasp), where=count > 0.0)
    return value + mean


def maximum_feasibility(table: FloatArray, goal: GoalCosts, model: ChoiceModel, allowed: BoolArray) -> FloatArray:
    """Return minus the measure of all feasible configurations, at the handover and (of grasps there) at the goal."""
    weights = allowed[None] * table[:, None, :, MEASURE]
    total = weights.sum(axis=-1)
    if goal.table is not None:
        total = total + (weights > 0.0) @ goal.table[:, MEASURE] * (total > 0.0)
    return np.where(total > 0.0, -total, np.inf)


OBJECTIVES: Mapping[str, Objective] = {
    "expected_cost": expected_cost,
    "minimum_mean": minimum_mean,
    "maximum_feasibility": maximum_feasibility,
}
