"""How a person chooses a grasp: noisy and short-sighted (Bestick 2017, section 3.4).

A person at a handover sees grasps g, each with a set of arm configurations to take it, and chooses by the perceived
cost (3.5), gamma C(hand) + (1 - gamma) C(goal). The configuration at the goal is chosen there, by (3.3) again; at the
handover the person foresees its mean. So

    P(g, q) ~ exp(-rationality (gamma C(q) + (1 - gamma) E[C(goal) | g])),
    P(q_goal | g) ~ exp(-rationality C(q_goal)).

Sums over configurations are integrals over the feasible sets: each sample counts with its measure.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from handover_ros.errors import BadRequestError, UnknownNameError
from handover_ros.geometry import FloatArray

# Columns of the tables of ``arm.inverse_kinematics.weigh``.
MEASURE, LOG_WEIGHT, MEAN, PLAIN_MEAN, LEAST = range(5)


@dataclass(frozen=True)
class ChoiceModel:
    """What is assumed of a person's choices.

    Attributes:
        name: For people, e.g. ``MN``.
        rationality: Boltzmann coefficient, lambda of (3.3) [1/cost]; 0: chooses blindly, infinite: always the best.
        myopia: gamma of (3.5): weight of the cost at the handover; 1: the goal is ignored, 0.5: a global optimiser.
    """

    name: str
    rationality: float
    myopia: float

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            BadRequestError: One is out of range.
        """
        if not self.rationality >= 0.0:
            raise BadRequestError(f"rationality: must be 0 or more (infinite: always the best), got {self.rationality}")
        if not 0.0 <= self.myopia <= 1.0:
            raise BadRequestError(f"myopia: must lie between 0 and 1, got {self.myopia}")

    @property
    def is_perfect(self) -> bool:
        """Whether the person always chooses what they perceive as best."""
        return bool(np.isinf(self.rationality))

    @property
    def hand_rationality(self) -> float:
        """With which a configuration at the handover is chosen, given the grasp: rationality times myopia."""
        return 0.0 if self.myopia == 0.0 else self.rationality * self.myopia


def person_model(name: str, rationality: float = 10.0) -> ChoiceModel:
    """Return one of the four persons of section 3.5: MN, MP, GN, GP (myopic or global, noisy or perfect).

    Raises:
        UnknownNameError: There is no such person.
    """
    models = {
        "MN": ChoiceModel("MN", rationality, 1.0),
        "MP": ChoiceModel("MP", np.inf, 1.0),
        "GN": ChoiceModel("GN", rationality, 0.5),
        "GP": ChoiceModel("GP", np.inf, 0.5),
    }
    if name not in models:
        raise UnknownNameError("person model", name, list(models))
    return models[name]


@dataclass(frozen=True, eq=False)
class GoalCosts:
    """What each grasp costs at the goal.

    Attributes:
        table: Statistics of each grasp's feasible set there, at the person's rationality, shape (grasps, 5); None:
            there is no goal.
        regrasp: Cost of a grasp with which the object cannot be placed: the person has to take it anew.
    """

    table: FloatArray | None = None
    regrasp: float = 0.0

    @property
    def mean(self) -> FloatArray | float:
        """E[C(goal) | g] of each grasp (grasps,); 0 without a goal."""
        if self.table is None:
            return 0.0
        return np.where(self.table[:, MEASURE] > 0.0, self.table[:, MEAN], self.regrasp)


def perceived(table: FloatArray, goal: GoalCosts, model: ChoiceModel) -> FloatArray:
    """Return log P(g) (..., grasps) up to a constant, or minus the perceived cost of a perfect person.

    Args:
        table: Statistics of each grasp's feasible set at the handover, weighed with ``model.hand_rationality``, shape
            (..., grasps, 5).
        goal: What the grasps cost at the goal.
        model: Of the person.
    """
    feasible = table[..., MEASURE] > 0.0
    ahead = (1.0 - model.myopia) * goal.mean
    if model.is_perfect:
        now = model.myopia * np.where(feasible, table[..., LEAST], 0.0)
        return np.where(feasible, -(now + ahead), -np.inf)
    return np.where(feasible, table[..., LOG_WEIGHT] - model.rationality * ahead, -np.inf)


def grasp_probabilities(
    table: FloatArray, goal: GoalCosts, model: ChoiceModel, allowed: npt.NDArray[np.bool_] | None = None
) -> FloatArray:
    """Return P(g) (..., grasps); all zero where no grasp is feasible.

    Args:
        table: As for ``perceived``.
        goal: What the grasps cost at the goal.
        model: Of the person.
        allowed: Which grasps nothing blocks, broadcast against (..., grasps); None: all.
    """
    attraction = perceived(table, goal, model)
    if allowed is not None:
        attraction = np.where(allowed, attraction, -np.inf)
    best = attraction.max(axis=-1, keepdims=True)
    above = attraction - np.where(np.isfinite(best), best, 0.0)
    if model.is_perfect:  # of equally good grasps each in proportion to its ways of being the best
        least = np.isfinite(attraction) & (above >= -TIE * np.maximum(1.0, np.abs(best)))
        share = np.where(least, np.exp(np.where(least, _tie_weight(table, model), 0.0)), 0.0)
    else:
        share = np.exp(above)
    total = share.sum(axis=-1, keepdims=True)
    return np.asarray(np.divide(share, total, out=np.zeros_like(share), where=total > 0.0))


TIE = 1e-12  # relative difference of perceived costs that a perfect person does not notice


def _tie_weight(table: FloatArray, model: ChoiceModel) -> FloatArray:
    """Return the log measure of the best configurations of each grasp."""
    if model.hand_rationality == 0.0:
        return np.log(np.maximum(table[..., MEASURE], 1e-300))
    return np.where(np.isfinite(table[..., LOG_WEIGHT]), table[..., LOG_WEIGHT], 0.0)
