"""Pictures of plans: written, not blank, and true to what was predicted."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from lab_cell import CATALOGUE, SCENE, torso

from handover_ros.arm.model import load_arm
from handover_ros.geometry import invert_transform, make_transform, transform_points
from handover_ros.objects.drawing import GROUND
from handover_ros.planning.facing import object_centre
from handover_ros.planning.goal_stance import stances
from handover_ros.planning.plan_picture import ShownPlan, Surroundings, draw_plans, goal_torso, region_probabilities
from handover_ros.planning.types import PredictedChoice, PredictedGrasp

MODEL = CATALOGUE["mug"]
PERSON, GOAL = torso(), SCENE.goals["mug"]
OFFERED = PERSON @ make_transform(np.diag([-1.0, -1.0, 1.0]), [0.45, -0.15, -0.35])
STANCE = 17  # one of those a person can take at a goal


def stance_frames():
    placed = transform_points(invert_transform(PERSON) @ GOAL, object_centre(MODEL))
    return stances(PERSON, placed)[0]


def limbs_of(world_from_torso, posture):
    return transform_points(world_from_torso, load_arm("adult", "right").limbs(np.array(posture)))


def grasp(region, probability, goal_cost=0.6, **fields):
    posture = [0.5, 0.2, 0.2, 1.3, 0.2, 0.0, 0.0]
    given = {
        "region": region,
        "probability": probability,
        "hands": {"right": OFFERED @ MODEL.human_grasps[0].centre()},
        "limbs": {"right": limbs_of(PERSON, posture)},
        "hand_cost": 0.3,
        "goal_cost": goal_cost,
        "goal_limbs": {"right": limbs_of(stance_frames()[STANCE], posture)} if np.isfinite(goal_cost) else {},
    }
    return PredictedGrasp(**{**given, **fields})


def predicted(*grasps):
    return PredictedChoice("MN", "squared_distance", 0.9, grasps, 3, 4, 0.0)


def shown(choice, title="Expected cost"):
    gripper = OFFERED @ make_transform(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, 0.08])
    arm = np.array([[0.1, 0.3, 1.2], [0.5, 0.3, 1.3], OFFERED[:3, 3] + [0.0, 0.0, 0.2]])
    return ShownPlan(title, choice, OFFERED, gripper, 0.05, arm)


def around(goal=GOAL):
    return Surroundings(MODEL, PERSON, goal, [SCENE.box("goal_table")] if goal is not None else [])


CHOICE = predicted(grasp("handle_thumb_up", 0.7), grasp("top", 0.2, float("nan")), grasp("body_thumb_up", 0.1))


def columns(path: Path):
    """Which share of the pixels of the two columns is not ground, white or black ink."""
    image = matplotlib.image.imread(path)[..., :3]
    ground = np.array([int(GROUND[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    other = (np.abs(image - ground).max(axis=2) > 0.02) & (image.min(axis=2) < 0.97)
    edges = np.round(np.array([0.0, 0.31, 0.62, 1.0]) * image.shape[1]).astype(int)
    return image.shape, [other[120:, start:end].mean() for start, end in pairwise(edges)]


def test_every_plan_has_a_row_and_every_column_shows_something(tmp_path: Path):
    one = draw_plans(tmp_path / "one.png", [shown(CHOICE)], around(), "mug")
    two = draw_plans(tmp_path / "two.png", [shown(CHOICE, name) for name in "ab"], around(), "mug")
    (height, width, _), shares = columns(one)
    (taller, same, _), _ = columns(two)
    assert (width, same) == (1600, 1600)
    assert taller - height == pytest.approx(410, abs=2)
    assert min(shares[:2]) > 0.05
    assert shares[2] > 0.01
    assert two.stat().st_size < 400_000


@pytest.mark.parametrize(
    "choice",
    [
        predicted(grasp("handle_thumb_up", 1.0)),
        predicted(*(grasp(f"region_{number}", 1 / 12) for number in range(12))),
        predicted(grasp("top", 0.9, float("nan")), grasp("bottom", 0.1, float("nan"))),
        predicted(grasp("top", 0.9), grasp("bottom", 0.1, limbs={}, goal_limbs={})),
    ],
    ids=["one grasp", "more than there are lines and colours", "none can be placed", "one without postures"],
)
def test_any_choice_can_be_drawn(choice, tmp_path: Path):
    _, shares = columns(draw_plans(tmp_path / "plan.png", [shown(choice)], around(), "mug"))
    assert min(shares) > 0.005


def test_two_hands_and_a_left_one_are_drawn(tmp_path: Path):
    right = grasp("left_end and right_end", 1.0)
    mirrored = load_arm("adult", "left").limbs(np.array([0.5, 0.2, 0.2, 1.3, 0.2, 0.0, 0.0]))
    left = transform_points(PERSON, mirrored)
    both = replace(right, hands={**right.hands, "left": OFFERED}, limbs={**right.limbs, "left": left}, goal_limbs={})
    only = replace(right, hands={"left": OFFERED}, limbs={"left": left}, goal_limbs={})
    pictures = [
        draw_plans(tmp_path / f"{index}.png", [shown(predicted(each))], around(None), "box").read_bytes()
        for index, each in enumerate((right, both, only))
    ]
    assert len(set(pictures)) == 3


def test_regions_sum_their_grasps():
    choice = predicted(grasp("top", 0.4), grasp("handle", 0.35), grasp("handle", 0.25))
    assert region_probabilities(choice) == pytest.approx({"handle": 0.6, "top": 0.4})
    assert list(region_probabilities(choice)) == ["handle", "top"]


def test_the_torso_at_the_goal_is_the_stance_the_shoulder_belongs_to():
    np.testing.assert_allclose(goal_torso(CHOICE.grasps[0], around()), stance_frames()[STANCE], atol=1e-9)
    np.testing.assert_allclose(goal_torso(CHOICE.grasps[1], around()), PERSON, atol=1e-9)
