"""Chapter 3 in simulation: plans that cost what they say, numbers that follow the settings, claims that follow both."""

import json
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from rich.console import Console

from handover_ros.arm.inverse_kinematics import feasible_sets
from handover_ros.errors import BadModelError
from handover_ros.planning.choice import MEASURE
from handover_ros.planning.obstacles import obstacles_of
from handover_ros.studies import chapter3, registry
from handover_ros.studies.chapter3_cases import configurations
from handover_ros.studies.chapter3_cell import cell_of, shelf_boxes
from handover_ros.studies.chapter3_claims_mismatch import mismatch_claims
from handover_ros.studies.chapter3_claims_objectives import case_claims, metric_claims, region_claim
from handover_ros.studies.chapter3_claims_users import user_claims
from handover_ros.studies.chapter3_conditions import mismatch_rows
from handover_ros.studies.chapter3_settings import PERSONS, Chapter3Settings, load_chapter3_settings
from handover_ros.studies.chapter3_study import CHAPTER3
from handover_ros.studies.chapter3_tables import beside, costs_by_person
from handover_ros.studies.chapter3_users import MEASURES, PARTS, PROGRAMS, goal_measures, user_rows
from handover_ros.studies.study_command import StudyRequest, run_study
from handover_ros.studies.tables import merged, only
from handover_ros.studies.units import Unit
from handover_ros.yaml_file import read_yaml

SEED = 3
QUIET = Console(quiet=True)


def small_settings(**changes):
    full = load_chapter3_settings()
    users = full.user_studies
    return full.model_copy(
        update={
            "searches": 1,
            "case_study": full.case_study.model_copy(update={"people": 2}),
            "metrics": full.metrics.model_copy(update={"objects": ("mug", "plate"), "goals": 2}),
            "mismatch": full.mismatch.model_copy(update={"goals": 2}),
            "user_studies": users.model_copy(
                update={"goals": 2, "people": users.people.model_copy(update={"metrics": 3, "models": 3})}
            ),
            **changes,
        }
    )


@lru_cache(maxsize=1)
def small_tables():
    settings = small_settings()
    return merged(chapter3.work(settings, unit, SEED) for unit in chapter3.units(settings))


# Numbers.


def test_numbers_do_not_depend_on_jobs(monkeypatch, tmp_path):
    few = small_settings(
        metrics=load_chapter3_settings().metrics.model_copy(update={"goals": 2, "objects": ("mug", "glass")})
    )
    monkeypatch.setitem(registry.STUDIES, "chapter3", replace(CHAPTER3, settings=lambda _: few, figures=lambda *_: []))
    found = []
    for jobs in (1, 2):
        folder = tmp_path / str(jobs)
        request = StudyRequest("chapter3", jobs=jobs, seed=SEED, json_file=folder / "out.json", out=folder)
        assert run_study(request, QUIET) == 0
        found.append({path.name: path.read_bytes() for path in folder.glob("*.csv")})
    assert found[0] == found[1]
    assert {f"chapter3_{name}.csv" for name in ("cases", "metrics", "mismatch", "users")} <= set(found[0])
    claims = json.loads((tmp_path / "1" / "out.json").read_text())["claims"]
    assert len({claim["id"] for claim in claims}) == len(claims)
    for claim in claims:
        assert (claim["verdict"] == "needs people") == (not claim["tests"])


def test_all_conditions_are_there():
    settings, tables = small_settings(), small_tables()
    assert len(tables["metrics"]) == 3 * 2 * 2
    assert len(tables["mismatch"]) == len(settings.mismatch.attitudes) * 16 * 2
    assert len(tables["users"]) == 2 * 2 * 2 * 2 * 3
    full = load_chapter3_settings()
    assert full.quickened().mismatch.goals * len(PERSONS) ** 2 == 160
    assert 3 * len(full.metrics.objects) * full.metrics.goals == 60


def test_a_plan_costs_whom_it_is_made_for_what_it_promises():
    for row in small_tables()["mismatch"]:
        if row["assumed"] == row["true"]:
            assert row["cost"] == pytest.approx(row["value"], rel=1e-9)


def test_the_objective_is_what_it_is_judged_by():
    costs = beside(small_tables()["metrics"], "objective", "cost", ("object", "goal"))
    for baseline in ("minimum_mean", "maximum_feasibility"):
        assert costs[baseline].mean() > costs["expected_cost"].mean()


def test_rationality_and_myopia_come_from_the_settings():
    settings = small_settings()
    usual = mismatch_rows(settings, "any", 0, SEED)["mismatch"]
    noisier = mismatch_rows(settings.model_copy(update={"rationality": 2.0}), "any", 0, SEED)["mismatch"]
    alike = settings.model_copy(update={"myopia": settings.myopia.model_copy(update={"far_sighted": 1.0})})
    same = costs_by_person(mismatch_rows(alike, "any", 0, SEED)["mismatch"])
    assert [row["cost"] for row in noisier] != [row["cost"] for row in usual]
    for true in PERSONS:  # nobody is far-sighted: M and G are the same person
        assert same["MN", true] == pytest.approx(same["GN", true])
        assert same["MP", true] == pytest.approx(same["GP", true])


def test_another_seed_has_other_goals_and_the_same_seed_the_same():
    settings = small_settings()
    unit = Unit("mismatch_any", 1)
    assert chapter3.work(settings, unit, 4) == chapter3.work(settings, unit, 4)
    assert chapter3.work(settings, unit, 4) != chapter3.work(settings, unit, 5)


# Measures.


def test_configurations_cost_what_the_planner_expects():
    cell = cell_of(small_settings())
    task = cell.task("mug")
    situation = cell.situation(task, "MN")
    plan = cell.plan(task, situation, "expected_cost")
    ways = configurations(situation, plan)
    assert ways.probabilities.sum() == pytest.approx(1.0)
    assert ways.probabilities @ ways.costs == pytest.approx(plan.value, rel=0.02)


def test_measures_are_means_over_all_postures_of_a_region():
    """OM1 to OM4 (eq. 3.8 to 3.11) against sums over the samples of all feasible sets at the goal."""
    settings = small_settings()
    cell = cell_of(settings)
    goal = cell.goal(cell.task("mug"), "a test", 0, SEED)
    situation = cell.situation(goal.task, "MN")
    problem, torso_from_goal = situation.problem, np.linalg.inv(situation.world_from_torso) @ situation.world_from_goal
    regions = np.array(problem.grasps.grasp_regions)
    region = regions == regions[int(np.argmax(problem.goal.table[:, MEASURE]))]
    some = np.arange(len(region)) % 2 == 0
    found = goal_measures(problem.goal.table, problem.goal.regrasp, region, some)
    side = problem.taker.sides[0]
    boxes = obstacles_of(goal.task.boxes, situation.world_from_torso)
    for grasps, place in ((region & some, 0), (region, 2)):
        hands = np.stack([torso_from_goal @ problem.grasps.hand_poses(int(g))[side] for g in np.flatnonzero(grasps)])
        sets = feasible_sets(problem.taker.arms[side], hands, problem.taker.step)
        free = boxes.free(problem.taker.arms[side].limbs(sets.postures))
        costs, measures = problem.taker.costs[side].evaluate(sets.postures)[free], sets.measures[free]
        noisy = measures * np.exp(-settings.rationality * (costs - costs.min()))
        assert found[place] == pytest.approx(np.average(costs, weights=noisy), rel=1e-6)
        assert found[place + 1] == pytest.approx(np.average(costs, weights=measures), rel=1e-6)


def test_a_region_that_cannot_be_placed_costs_taking_it_anew():
    table = np.array([[0.0, -np.inf, np.inf, np.inf, np.inf], [1.0, 0.0, 1.0, 2.0, 0.5]])
    first, both = np.array([True, False]), np.array([True, True])
    assert list(goal_measures(table, 9.0, first, both)) == [9.0] * 4
    assert list(goal_measures(table, 9.0, both, first)) == [9.0, 9.0, 1.0, 2.0]


def test_people_who_know_the_goal_are_more_careful_with_it():
    """With gamma 0 nobody takes a grasp that cannot be placed if another can."""
    settings = small_settings()
    users = settings.user_studies.model_copy(update={"aware_myopia": (0.0, 0.0)})
    rows = user_rows(settings.model_copy(update={"user_studies": users}), "models", 0, SEED)["users"]
    costs = {part: np.mean([row["goal_cost"] for row in only(rows, part=part)]) for part in PARTS}
    assert costs["aware"] <= costs["unaware"]
    assert all(row["OM5"] in (0.0, 1.0) for row in rows)


def test_a_shelf_is_clear_inside_and_open_to_the_person():
    shelf = load_chapter3_settings().user_studies.shelf
    rng = np.random.default_rng(0)
    half = np.array([shelf.depth, shelf.width, shelf.height]) / 2.0
    inside = rng.uniform(-half, half, (500, 3)) + [0.0, 0.0, half[2]]
    before = inside - [shelf.depth, 0.0, 0.0]
    for points in (inside, before):
        for size, centre in shelf_boxes(shelf):
            assert (np.abs(points - centre) >= size / 2.0 - 1e-12).any(axis=1).all()
    behind = inside[:, 1:]
    size, centre = shelf_boxes(shelf)[-1]
    assert (np.abs(behind - centre[1:]) <= size[1:] / 2.0).all()


# Claims follow the data.


def verdicts(claims):
    return {claim.name: claim.verdict for claim in claims}


def made_up_mismatch(loss):
    """Return rows whose cost exceeds the right assumption's by ``loss(assumed, true)``, with a little scatter."""
    rng = np.random.default_rng(0)
    return [
        {
            "attitude": "any",
            "goal": goal,
            "assumed": assumed,
            "true": true,
            "cost": 2.0 + 0.3 * goal + loss(assumed, true) * (1.0 + 0.1 * rng.random()),
        }
        for goal in range(8)
        for assumed in PERSONS
        for true in PERSONS
    ]


def test_mismatch_claims_follow_the_losses():
    def as_claimed(assumed, true):
        if assumed == true:
            return 0.0
        myopia = {("M", "G"): 0.1, ("G", "M"): 1.0}.get((assumed[0], true[0]), 0.0)
        noise = {("N", "P"): 0.02, ("P", "N"): 0.3}.get((assumed[1], true[1]), 0.0)
        return myopia + noise

    found = verdicts(mismatch_claims(made_up_mismatch(as_claimed), "any"))
    assert set(found.values()) == {"reproduced"}
    opposite = verdicts(mismatch_claims(made_up_mismatch(lambda *pair: -as_claimed(*pair)), "any"))
    assert set(opposite.values()) == {"not reproduced"}


def test_metric_claims_follow_the_costs():
    def made_up(means):
        rng = np.random.default_rng(1)
        return [
            {"object": name, "goal": goal, "kind": "upright", "objective": objective, "cost": mean + 0.2 * rng.random()}
            for objective, mean in means.items()
            for name in ("mug", "plate")
            for goal in range(4)
        ]

    names = ("expected_cost", "minimum_mean", "maximum_feasibility")
    assert set(verdicts(metric_claims(made_up(dict(zip(names, (1.0, 3.0, 5.0)))))).values()) == {"reproduced"}
    worse = verdicts(metric_claims(made_up(dict(zip(names, (5.0, 3.0, 1.0))))))
    assert worse.pop("metrics_anova") == "reproduced"  # they do differ
    assert set(worse.values()) == {"not reproduced"}
    twice = verdicts(metric_claims(made_up(dict(zip(names, (2.0, 3.0, 4.0))))))
    assert twice["metrics_ours_over_mean"] == "reproduced"
    assert twice["metrics_times_minimum_mean"] == "not reproduced"


def test_the_region_claim_follows_the_regions():
    def rows(upright, turned):
        chances = {"upright": upright, "upside_down": turned}
        return [
            {
                "object": "mug",
                "objective": "expected_cost",
                "kind": kind,
                "region": "top" if chance > 0.5 else "handle",
                "top_probability": chance,
            }
            for kind, chance in chances.items()
            for _ in range(6)
        ]

    assert region_claim(rows(0.9, 0.1), [], "mug").verdict == "reproduced"
    assert region_claim(rows(0.1, 0.9), [], "mug").verdict == "not reproduced"


def made_up_users(gain):
    """Return rows of both user studies; the better program is lower by ``gain(study, part, measure)``."""
    rng = np.random.default_rng(2)
    rows = []
    for study, programs in PROGRAMS.items():
        better, _ = programs
        for part in PARTS:
            for program in programs:
                for goal in range(4):
                    for person in range(6):
                        level = 5.0 + 3.0 * goal + 0.1 * rng.normal() - 0.3 * (part == "aware")
                        lowered = {
                            measure: level
                            - (program == better) * gain(study, part, measure) * (1.0 + goal / 4)
                            + 0.01 * rng.normal()
                            for measure in MEASURES
                        }
                        misses = program != better and gain(study, part, "OM5") > rng.random() * 0.9
                        key = {"study": study, "part": part, "program": program, "goal": goal, "person": person}
                        rows.append({**key, "region": "top", **lowered, "OM5": float(misses)})
    return rows


def test_user_claims_follow_the_measures():
    def as_claimed(study, part, measure):
        if study == "models":
            return {"unaware": 0.9, "aware": 0.4 if measure == "OM5" else 0.05}[part]
        return 2.0 if measure in ("OM1", "OM2") else 1.2

    found = verdicts(user_claims(made_up_users(as_claimed)))
    assert {name for name, verdict in found.items() if verdict == "not reproduced"} == set()
    none = verdicts(user_claims(made_up_users(lambda *_: 0.0)))
    for part in PARTS:
        assert none[f"users_metrics_{part}_main"] == "not reproduced"
        assert none[f"users_metrics_{part}_OM1"] == "not reproduced"
        assert none[f"users_models_{part}_OM5"] == "not reproduced"


def test_programs_that_differ_are_not_unchanged():
    found = verdicts(user_claims(made_up_users(lambda study, part, _: 2.0 if part == "aware" else 0.0)))
    assert {found[f"users_models_aware_{measure}"] for measure in MEASURES} == {"not reproduced"}


def test_what_everybody_does_at_one_goal_only_does_not_settle_a_claim():
    rows = made_up_users(lambda *_: 0.0)
    for row in rows:
        if row["goal"] == 0 and row["program"] == "maximum_feasibility":
            row |= {measure: row[measure] + 1.0 for measure in MEASURES}
    found = {claim.name: claim for claim in user_claims(rows)}["users_metrics_unaware_OM1"]
    assert found.comparisons[0].significant  # over subjects
    assert found.verdict == "not reproduced"


def test_trials_in_which_nothing_is_taken_are_left_out():
    rows = made_up_users(lambda *_: 1.0)
    for row in rows[::7]:
        row |= {"region": None, **dict.fromkeys(MEASURES), "OM5": None}
    for claim in user_claims(rows):
        assert "nan" not in claim.ours


def test_what_needs_people_is_never_settled():
    found = [claim for claim in user_claims(small_tables()["users"]) if claim.verdict == "needs people"]
    assert len(found) == 14
    assert all(claim.text.startswith(("Table 3.5", "Table 3.8")) for claim in found)


def test_case_claims_are_settled():
    assert len(case_claims(small_tables()["cases"])) == 6


def test_every_figure_is_drawn(tmp_path):
    figures = CHAPTER3.figures(small_settings(), small_tables(), SEED, tmp_path)
    assert [figure.number for figure in figures] == [
        *(f"3.{number}" for number in range(2, 10)),
        "3.11",
        "3.14",
        "3.16",
    ]
    for figure in figures:
        assert [file.suffix for file in figure.files] == [".png", ".svg"]
        assert all(file.stat().st_size > 5000 for file in figure.files)
    assert json.loads((tmp_path / "chapter3_planning_time.json").read_text())["conditions"] == 32


# Bad input.


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"rationality": -1.0}, "rationality"),
        ({"myopia": {"myopic": 2.0, "far_sighted": 0.5}}, "myopic"),
        ({"goals": {"lower": [1.0, 0.0, 0.0], "upper": [0.0, 0.0, 0.0]}}, "goals"),
        ({"metrics": {"objects": ["mug", "mug"], "goals": 5}}, "objects"),
        ({"mismatch": {"object": "mug", "goals": 1, "attitudes": ["any"]}}, "goals"),
        ({"serches": 3}, "serches"),
    ],
)
def test_settings_that_cannot_be_used_are_refused(tmp_path, change, field):
    content = load_chapter3_settings().model_dump(mode="json") | change
    path = tmp_path / "chapter3.yaml"
    path.write_text(json.dumps(content))
    with pytest.raises(BadModelError, match=field):
        read_yaml(path, Chapter3Settings)
