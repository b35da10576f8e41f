"""Loads (at the very first time: compiles) what a belief runs, so that no answer waits for it."""

from __future__ import annotations

import numpy as np

from handover_ros.arm.model import load_arm
from handover_ros.preferences.belief import first_belief
from handover_ros.preferences.menus import information_of_menus
from handover_ros.preferences.prior import Prior
from handover_ros.preferences.query import Query, region_answer
from handover_ros.preferences.space import arm_space
from handover_ros.preferences.strategies import select


def warm_up_preferences() -> None:
    """Take a made-up answer in, and choose a made-up query."""
    arm = load_arm()
    belief = first_belief(Prior(arm_space(arm.limits)), 100)
    postures = arm.limits[0] + np.random.default_rng(0).random((20, 7)) * np.ptp(arm.limits, axis=0)
    query = Query(postures, np.ones(20), np.arange(20) % 2, ("left", "right"))
    belief = belief.updated(query, region_answer(query, "left"))
    for answers in ("posture", "region"):
        select(belief, [query, query], "active", answers)
    information_of_menus(belief.people, belief.weights, postures, np.array([[0, 1]]))
