"""The whole loop as a study: what it does for a person, and what follows from its tables."""

import numpy as np
import pytest

from handover_ros.sim.person_spec import ARM_JOINTS, load_person
from handover_ros.studies import beyond
from handover_ros.studies.beyond_settings import load_beyond_settings
from handover_ros.studies.beyond_study import BEYOND, claims, curve, part
from handover_ros.studies.participants import with_body, with_taste
from handover_ros.studies.units import Unit

SETTINGS = load_beyond_settings().quickened()
SMALL = SETTINGS.model_copy(
    update={"handovers": 1, "per_object": 2, "asked": ("mug",), "judged": ("mug",), "particles": 100}
)


@pytest.fixture(scope="module")
def found():
    return beyond.work(SMALL, Unit(beyond.PERSON, 1), 1)


def test_a_persons_loop_is_whole_and_the_same_again(found):
    courses, parts = found["courses"], found["parts"]
    assert [row["condition"] for row in parts] == list(beyond.PARTS)
    assert parts[0]["cost"] == pytest.approx(1.0, abs=0.02)  # the truth against itself
    assert all(np.isfinite(row["cost"]) and row["cost"] > 0.5 for row in parts)
    taught = {(row["strategy"], row["answers"]) for row in courses}
    assert taught == {*((name, "posture") for name in SMALL.strategies), (beyond.BEST, "region")}
    first = [row for row in courses if row["handover"] == 0]
    assert len({row["planned"] for row in first}) == 1, "before any answer all plan alike"
    asked = [row for row in courses if row["handover"] == 1]
    assert all(row["object"] == "mug" for row in asked)
    assert sum(row["counted"] for row in asked) >= len(asked) - 1
    assert beyond.work(SMALL, Unit(beyond.PERSON, 1), 1) == found


def made_up(loop=1.05, without=1.3, people=8):
    rng = np.random.default_rng(0)
    parts = [
        {"person": person, "condition": name, "cost": (loop if name == "whole loop" else without) + 0.01 * rng.random(),
         "missed": 0}
        for person in range(people)
        for name in beyond.PARTS
    ]  # fmt: skip
    level = {"active_value": 1.05, "active": 1.1, "hybrid": 1.15, "passive": 1.3, "random": 1.3}
    courses = [
        {"person": person, "strategy": name, "answers": answers, "handover": step, "object": "mug",
         "paid": None if not step else (0.9 if name.startswith("active") else 0.5) + 0.01 * rng.random(),
         "planned": 1.5 if not step else level[name] + (0.1 if answers == "region" else 0.0) + 0.01 * rng.random(),
         "counted": step}
        for person in range(people)
        for name, answers in [*((name, "posture") for name in SETTINGS.strategies), (beyond.BEST, "region")]
        for step in range(3)
    ]  # fmt: skip
    return {"parts": parts, "courses": courses}


def test_answers_follow_from_the_tables():
    assert {claim.verdict for claim in claims(SETTINGS, made_up())} == {"reproduced"}
    worse = {claim.name: claim.verdict for claim in claims(SETTINGS, made_up(loop=1.4))}
    assert worse["loop_without_learning"] == "not reproduced"
    assert worse["hybrid_cost"] == "reproduced"
    tables = made_up()
    assert part(tables["parts"], "truth").shape == (8,)
    assert np.isnan(curve(tables["courses"], "paid", "active")[:, 0]).all()


def test_figures_are_drawn(tmp_path):
    figures = BEYOND.figures(SETTINGS, made_up(), 1, tmp_path)
    assert all(file.stat().st_size > 5000 for figure in figures for file in figure.files if file.suffix == ".png")
    assert [figure.number for figure in figures] == ["B.1", "B.2", "B.3", "B.4"]


def test_participants_differ_within_reason():
    body = load_person("adult")
    people = [with_taste(with_body(body, np.random.default_rng(n)), np.random.default_rng(n)) for n in range(6)]
    lengths = [person.spec.lengths.upper_arm for person in people]
    assert np.std(lengths) > 0.005
    for person in people:
        for joint in ARM_JOINTS:
            (low, high), (lowest, highest) = (getattr(each.limits.right, joint) for each in (person.spec, body))
            assert lowest <= low < high <= highest
