"""Simulated people of chapter 3 who are not quite as the robot expects."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from handover_ros.arm.model import Arm, Side
from handover_ros.ergonomics.arm_costs import Preference, SquaredDistance
from handover_ros.planning.feasible import Taker
from handover_ros.studies.chapter3_settings import Chapter3Settings
from handover_ros.studies.seeds import generator

LEAST_MARGIN = 0.02  # [rad] of the neutral posture from the joint limits


@dataclass(frozen=True, eq=False)
class Somebody:
    """A simulated person.

    Attributes:
        number: Who.
        taker: Arms and what their postures cost.
        aware_myopia: gamma of eq. 3.5 when they know the goal.
    """

    number: int
    taker: Taker
    aware_myopia: float


def other_preference(settings: Chapter3Settings, usual: Preference, arm: Arm, rng: np.random.Generator) -> Preference:
    """Return a preference that differs from the usual one by the spreads of the user studies."""
    spread = settings.user_studies
    neutral = usual.neutral + spread.neutral_spread * rng.standard_normal(7)
    inside = np.clip(neutral, arm.limits[0] + LEAST_MARGIN, arm.limits[1] - LEAST_MARGIN)
    return Preference(inside, usual.weights * np.exp(spread.weight_spread * rng.standard_normal(7)))


def somebody(
    settings: Chapter3Settings, expected: Taker, usual: Preference, name: str, number: int, seed: int
) -> Somebody:
    """Return a subject of a user study: the same one at every goal.

    Args:
        settings: Of the study.
        expected: The person the robot expects.
        usual: What that person finds comfortable.
        name: Of the user study.
        number: Of the subject.
        seed: Of the study.
    """
    rng = generator(seed, f"people of {name}", number)
    stretched = float(np.exp(settings.user_studies.length_spread * rng.standard_normal()))
    arms: dict[Side, Arm] = {
        side: replace(arm, upper_arm=stretched * arm.upper_arm, forearm=stretched * arm.forearm)
        for side, arm in expected.arms.items()
    }
    own = other_preference(settings, usual, next(iter(arms.values())), rng)
    aware = float(rng.uniform(*settings.user_studies.aware_myopia))
    return Somebody(number, Taker(arms, dict.fromkeys(arms, SquaredDistance(own)), expected.step), aware)
