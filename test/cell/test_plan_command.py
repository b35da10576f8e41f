"""handover plan: one plan without a graph, told, judged against others, drawn and written; bad input in one line."""

from __future__ import annotations

import io
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from people import random_person
from profiles import profile_of
from rich.console import Console

from handover_ros import cli
from handover_ros.cell import plan_command
from handover_ros.cell.plan_command import OTHERS, Comparison, PlanRequest, joint_places, run_plan
from handover_ros.cell.store import ProfileStore
from handover_ros.errors import BadRequestError, HandoverError, InfeasibleError, UnknownNameError
from handover_ros.objects import load_scene
from handover_ros.robot import RobotModel

METRICS = {
    "expected_cost", "hand_cost", "goal_cost", "planning_s", "candidates", "goal_infeasible", "most_probable", "grasps",
}  # fmt: skip


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    """A plan of the mug with the scene's goal: folder, JSON, what was printed."""
    out = tmp_path_factory.mktemp("plan")
    console = Console(width=120, record=True, file=io.StringIO())
    assert run_plan(PlanRequest("mug", json_file=out / "n.json", out=out), console) == 0
    return out, json.loads((out / "n.json").read_text()), console.export_text()


def test_the_numbers_are_promised_ones(planned):
    out, document, _ = planned
    metrics = document["metrics"]
    assert set(document) >= {"command", "ok", "seed", "versions", "metrics", "claims", "files", "problems"}
    assert (document["command"], document["ok"], document["seed"]) == ("plan", True, 0)
    assert set(metrics) == METRICS | {f"cost_{name}" for name in OTHERS} | {
        f"cost_over_{name}" for name in OTHERS if name != "expected_cost"
    }
    assert document == json.loads((out / "plan.json").read_text())
    assert document["files"] == [str(out / "plan.png")]
    assert (out / "plan.png").read_bytes().startswith(b"\x89PNG")


def test_the_costs_add_up_and_ours_is_the_least(planned):
    _, document, _ = planned
    metrics = document["metrics"]
    assert metrics["expected_cost"] == pytest.approx(metrics["hand_cost"] + metrics["goal_cost"])
    assert metrics["expected_cost"] == pytest.approx(metrics["cost_expected_cost"])
    assert 0.0 < metrics["most_probable"] <= 1.0
    for name in OTHERS[1:]:
        cost, ratio = metrics[f"cost_{name}"], metrics[f"cost_over_{name}"]
        assert (cost is None) == (ratio is None) == (name in document["problems"])
        if cost is not None:
            assert ratio == pytest.approx(metrics["expected_cost"] / cost)
            assert ratio <= 1.05, "the scheme that minimises this cost"


def test_what_is_told(planned):
    _, document, text = planned
    for words in ("takes it by", "Likely grasps", "cost at the goal", "robot: ", "What the others would give", *OTHERS):
        assert words in text
    assert document["explanation"] in text
    assert all(f"{name}: {problem}" in text for name, problem in document["problems"].items())
    assert f"{document['metrics']['expected_cost']:.2f}" in text


def test_a_scheme_that_fails_is_told_and_one_without_a_model_is_judged(monkeypatch, tmp_path: Path):
    """Scheme relative knows nothing of choices and is judged all the same; another one finds nothing."""
    whole = Comparison.compared

    def compared(self, scheme):
        if scheme == "constant":
            raise InfeasibleError("too far away")
        return whole(self, scheme)

    monkeypatch.setattr(Comparison, "compared", compared)
    monkeypatch.setattr(plan_command, "OTHERS", ("constant",))
    console = Console(width=100, record=True, file=io.StringIO())
    request = PlanRequest("box", "relative", person_model="GP", no_goal=True, out=tmp_path)
    assert run_plan(request, console) == 0
    text, document = console.export_text(), json.loads((tmp_path / "plan.json").read_text())
    assert "constant: too far away" in text
    assert "far-sighted and always right" in text
    assert document["problems"] == {"constant": "too far away"}
    metrics = document["metrics"]
    assert metrics["cost_constant"] is metrics["cost_over_constant"] is metrics["goal_cost"] is None
    assert metrics["expected_cost"] == pytest.approx(metrics["hand_cost"])
    assert "at the goal" not in text.split("What the others")[0].split("Likely grasps")[1]


def test_a_profile_is_the_person(monkeypatch, tmp_path: Path):
    monkeypatch.setenv("HANDOVER_PROFILES", str(tmp_path))
    profile = replace(profile_of("anna"), skeleton=random_person(7))
    ProfileStore().save(profile)
    person = Comparison(PlanRequest("box", profile="anna")).cell.person
    assert (person.profile, person.skeleton.name) == ("anna", profile.skeleton.name)
    known = Comparison(PlanRequest("box")).cell.person
    assert (known.profile, known.skeleton, known.dominant) == ("", None, None)
    np.testing.assert_allclose(known.world_from_torso, person.world_from_torso)


def test_the_goal_is_the_scenes_the_given_one_or_none():
    scene = load_scene("lab")
    np.testing.assert_allclose(Comparison(PlanRequest("mug")).goal, scene.goals["mug"])
    assert Comparison(PlanRequest("mug", no_goal=True)).goal is None
    given = Comparison(PlanRequest("mug", goal=(1.0, -0.2, 0.9, 0.0, 0.0, math.pi / 2.0))).goal
    np.testing.assert_allclose(given[:3, 3], [1.0, -0.2, 0.9])
    np.testing.assert_allclose(given[:3, 0], [0.0, 1.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    ("change", "kind", "words"),
    [
        ({"object_name": "cup"}, UnknownNameError, "unknown object 'cup'; known: box, glass"),
        ({"scheme": "best"}, UnknownNameError, "unknown scheme 'best'; known: constant"),
        ({"person": "giant"}, UnknownNameError, "giant"),
        ({"person_model": "XX"}, UnknownNameError, "unknown person model 'XX'; known: GN, GP, MN, MP"),
        ({"profile": "nobody"}, UnknownNameError, "unknown profile 'nobody'"),
        ({"arm": "middle"}, UnknownNameError, "unknown arm 'middle'; known: left, right"),
        ({"scene": "moon"}, UnknownNameError, "unknown scene 'moon'"),
        ({"robot": "dog"}, UnknownNameError, "unknown robot 'dog'"),
        ({"goal": (math.nan, 0.0, 0.0, 0.0, 0.0, 0.0)}, BadRequestError, "--goal: needs six finite numbers"),
        ({"goal": (1.0, 0.0, 0.9, 0.0, 0.0, 90.0)}, BadRequestError, "--goal: roll pitch yaw are radians"),
        ({"goal": (1.0, 0.0, math.inf, 0.0, 0.0, 0.0)}, BadRequestError, "--goal: needs six finite numbers"),
        ({"goal": (1.0, 0.5, 0.9, 0.0, 0.0, 0.0), "no_goal": True}, BadRequestError, "exclude each other"),
        ({"budget": math.nan}, BadRequestError, "time_budget"),
        ({"goal": (-2.0, 0.0, 5.0, 0.0, 0.0, 0.0)}, InfeasibleError, "cannot be placed at the goal"),
        ({"arm": "right"}, InfeasibleError, "cannot pick up mug with the right arm: no grasp fits"),
    ],
)
def test_bad_input_is_one_error_and_leaves_nothing(change, kind, words, monkeypatch, tmp_path: Path):
    monkeypatch.setenv("HANDOVER_PROFILES", str(tmp_path / "store"))
    request = replace(PlanRequest("mug", out=tmp_path / "out"), **change)
    with pytest.raises(HandoverError) as caught:
        run_plan(request, Console(file=io.StringIO()))
    assert isinstance(caught.value, kind)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("plan",), "OBJECT"),
        (("plan", "mug", "--goal", "1", "2"), "6 arguments"),
        (("plan", "mug", "--goal", "1", "2", "x", "0", "0", "0"), "'--goal'"),
        (("plan", "mug", "--seed", "-1"), "--seed"),
        (("plan", "cup"), "unknown object 'cup'"),
        (("objects", "cup"), "unknown object 'cup'"),
    ],
)
def test_bad_arguments_exit_with_two_and_one_line(arguments, words, capsys):
    status = cli.guarded(lambda: cli.app(list(arguments), standalone_mode=False, prog_name="./handover"))
    assert status == cli.EXIT_BAD_INPUT
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert words in error


def test_the_command_line_gives_the_request(monkeypatch):
    """Negative numbers of a goal too."""
    seen = []
    monkeypatch.setattr(plan_command, "run_plan", lambda request, _: seen.append(request) or 0)
    goal = ["1.2", "-0.5", "0.9", "0", "-1.57", "0"]
    line = ["plan", "mug", "--goal", *goal, "--person-model", "GN", "--budget", "3", "--arm", "left", "--seed", "4"]
    assert cli.guarded(lambda: cli.app(line, standalone_mode=False)) == 0
    expected = PlanRequest("mug", person_model="GN", goal=tuple(map(float, goal)), arm="left", budget=3.0, seed=4)
    assert seen == [expected]


def test_the_joints_lie_along_the_arm():
    """Neighbours stay as far apart as at zero, and the last is near the gripper."""
    robot = RobotModel.load()
    arm = robot.arm("left")
    places, zero = joint_places(robot, "left", arm.home), joint_places(robot, "left", np.zeros(7))
    lengths = [np.linalg.norm(np.diff(each, axis=0), axis=1) for each in (places, zero)]
    np.testing.assert_allclose(*lengths, atol=1e-9)
    assert np.linalg.norm(places[-1] - robot.gripper_pose("left", arm.home)[:3, 3]) < 0.45
