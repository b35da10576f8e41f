"""A predicted choice in words."""

from __future__ import annotations

import numpy as np

from handover_ros.planning.types import PredictedChoice, PredictedGrasp

TOLD = 3  # grasps that are named
MODELS = {
    "MN": "short-sighted and noisy",
    "MP": "short-sighted and always right",
    "GN": "far-sighted and noisy",
    "GP": "far-sighted and always right",
}


def explain(predicted: PredictedChoice) -> str:
    """Return sentences: who would grasp where with what probability, and what it costs now and at the goal."""
    regions: dict[str, float] = {}
    for grasp in predicted.grasps:
        regions[grasp.region] = regions.get(grasp.region, 0.0) + grasp.probability
    ranked = sorted(regions, key=lambda region: -regions[region])
    told = []
    for region in ranked[:TOLD]:
        likely = max((g for g in predicted.grasps if g.region == region), key=lambda grasp: grasp.probability)
        told.append(f"{region} with {regions[region]:.0%} ({_hands(likely)}; {_costs(likely)})")
    rest = sum(regions[region] for region in ranked[TOLD:])
    others = f", others {rest:.0%}" if rest >= 0.005 else ""
    later = predicted.goal_cost
    parts = "" if np.isnan(later) else f", {predicted.hand_cost:.2f} now and {later:.2f} at the goal"
    stuck = ""
    if predicted.goal_infeasible >= 0.005:
        stuck = f" With {predicted.goal_infeasible:.0%} the object must be taken anew before it can be placed."
    return (
        f"A person who is {MODELS.get(predicted.person_model, predicted.person_model)} takes it by {', '.join(told)}"
        f"{others}. Expected {predicted.cost_name} cost {predicted.expected_cost:.2f}{parts}.{stuck} The gripper "
        f"blocks {predicted.blocked} grasps, {predicted.infeasible} are out of the person's reach or limits."
    )


def _hands(grasp: PredictedGrasp) -> str:
    """Return which hands."""
    return " and ".join(grasp.hands) + (" hands" if len(grasp.hands) > 1 else " hand")


def _costs(grasp: PredictedGrasp) -> str:
    """Return what a grasp costs."""
    now = f"cost {grasp.hand_cost:.2f}"
    return now if np.isnan(grasp.goal_cost) else f"{now} now, {grasp.goal_cost:.2f} at the goal"
