"""Which of several queries to make: seven strategies with one interface."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from handover_ros.errors import BadRequestError, UnknownNameError
from handover_ros.geometry import FloatArray
from handover_ros.preferences.belief import Belief
from handover_ros.preferences.decision_value import decision_values
from handover_ros.preferences.information import AnswerKind, Outlook, grid_cells, grid_gain, outlook
from handover_ros.preferences.query import Query


@dataclass(frozen=True, eq=False)
class Situation:
    """What a strategy decides on.

    Attributes:
        belief: What is believed.
        menu: The queries.
        outlooks: What is to be expected of each.
        answers: What of a choice will be seen.
        information_weight: Of the hybrid: 0 only cost, 1 only information.
        rng: For the random one.
    """

    belief: Belief
    menu: Sequence[Query]
    outlooks: Sequence[Outlook]
    answers: AnswerKind
    information_weight: float
    rng: np.random.Generator

    @property
    def information(self) -> FloatArray:
        """Mutual information of each query [nat]."""
        return np.array([each.information for each in self.outlooks])

    @property
    def cost(self) -> FloatArray:
        """Expected cost of each query."""
        return np.array([each.cost for each in self.outlooks])


def _grid(situation: Situation, most_likely: bool) -> FloatArray:
    """Return the expected fall of the grid's entropy of each query."""
    cells = grid_cells(situation.belief)
    return np.array(
        [grid_gain(situation.belief, query, situation.answers, most_likely, cells) for query in situation.menu]
    )


def _hybrid(situation: Situation) -> FloatArray:
    """Return minus the expected cost and information of (1.6), weighted."""
    share = situation.information_weight
    return share * situation.information - (1.0 - share) * situation.cost


# The value of each query (n,); the greatest is chosen.
STRATEGIES: Mapping[str, Callable[[Situation], FloatArray]] = {
    "active": lambda s: s.information,
    "active_value": lambda s: decision_values(s.belief, s.menu, s.answers),
    "active_grid": lambda s: _grid(s, most_likely=True),  # (4.8)
    "active_expected": lambda s: _grid(s, most_likely=False),  # (4.7)
    "passive": lambda s: -np.array([each.least_cost for each in s.outlooks]),  # (4.10), (4.11)
    "random": lambda s: s.rng.random(len(s.menu)),
    "hybrid": _hybrid,
}


@dataclass(frozen=True, eq=False)
class Selection:
    """A chosen query.

    Attributes:
        chosen: Its place in the menu.
        values: What the strategy thought of each (n,).
        information: Expected of each [nat] (n,).
        cost: Expected of each (n,).
    """

    chosen: int
    values: FloatArray
    information: FloatArray
    cost: FloatArray


def select(
    belief: Belief,
    menu: Sequence[Query],
    strategy: str = "active",
    answers: AnswerKind = "posture",
    information_weight: float = 0.5,
    seed: int = 0,
) -> Selection:
    """Return which query of a menu to make next.

    Args:
        belief: What is believed.
        menu: The queries.
        strategy: One of ``STRATEGIES``.
        answers: Whether the configuration will be seen, or only the grasp region.
        information_weight: Of the hybrid (1.6), between 0 (only cost) and 1 (only information).
        seed: Of the random strategy, together with the number of observations.

    Raises:
        UnknownNameError: There is no such strategy.
        BadRequestError: The menu is empty, or the weight is out of range.
    """
    if strategy not in STRATEGIES:
        raise UnknownNameError("strategy", strategy, list(STRATEGIES))
    if not menu:
        raise BadRequestError("menu: is empty; give one handover at least")
    if not 0.0 <= information_weight <= 1.0:
        raise BadRequestError(f"information_weight: must lie between 0 and 1, got {information_weight}")
    people, weights = belief.people, belief.weights
    outlooks = [outlook(people, weights, query, answers) for query in menu]
    rng = np.random.default_rng((seed, belief.observations))
    situation = Situation(belief, menu, outlooks, answers, information_weight, rng)
    values = STRATEGIES[strategy](situation)
    return Selection(int(np.argmax(values)), values, situation.information, situation.cost)
