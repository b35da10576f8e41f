"""What one person finds comfortable, learned from how they take things (Bestick 2017, chapter 4)."""

from handover_ros.preferences.belief import Belief, first_belief
from handover_ros.preferences.prior import Prior, population_prior, typical_prior
from handover_ros.preferences.query import Answer, Query, chosen, posture_answer, region_answer
from handover_ros.preferences.space import PreferenceSpace, arm_space
from handover_ros.preferences.strategies import STRATEGIES, select

__all__ = [
    "STRATEGIES",
    "Answer",
    "Belief",
    "PreferenceSpace",
    "Prior",
    "Query",
    "arm_space",
    "chosen",
    "first_belief",
    "population_prior",
    "posture_answer",
    "region_answer",
    "select",
    "typical_prior",
]
