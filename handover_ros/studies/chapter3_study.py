"""Chapter 3 as a study: its claims and figures."""

from __future__ import annotations

import json
import time
from pathlib import Path

from handover_ros.files import write_whole
from handover_ros.geometry import transform_from_xyz_rpy
from handover_ros.objects.catalogue import load_object
from handover_ros.studies import chapter3
from handover_ros.studies.chapter3_cases import WITH, WITHOUT
from handover_ros.studies.chapter3_charts import (
    draw_infeasible,
    draw_measures,
    draw_metrics,
    draw_mismatch,
    draw_one_assumption,
)
from handover_ros.studies.chapter3_claims_mismatch import mismatch_claims
from handover_ros.studies.chapter3_claims_objectives import case_claims, metric_claims, region_claim
from handover_ros.studies.chapter3_claims_users import user_claims
from handover_ros.studies.chapter3_conditions import mismatch_rows
from handover_ros.studies.chapter3_pictures import draw_case
from handover_ros.studies.chapter3_settings import PERSONS, Chapter3Settings, load_chapter3_settings
from handover_ros.studies.chapter3_users import METRICS, MODELS
from handover_ros.studies.claims import Claim
from handover_ros.studies.study import Figure, Study
from handover_ros.studies.tables import Rows

BARS = "Bars: 95 % confidence of the mean, differences between {} taken out."
CAPTIONS = {
    "3.2": "Case study without goal: what each objective offers, how it is taken, and what all ways to take it cost.",
    "3.3": "Case study with a goal: the likeliest way to take what each objective offers, to place it with the same "
    "grasp, and what each grasp costs at handover and goal (larger: more probable; cross: cannot be placed).",
    "3.4": f"Expected total cost by objective for each goal, over all objects. {BARS.format('objects')}",
    "3.5": f"Expected total cost by objective for each object, over all goals. {BARS.format('goals')}",
    "3.6": f"What a myopic, noisy person pays, by whom the robot expects. {BARS.format('goals')}",
    "3.7": f"What each true person pays, by whom the robot expects. {BARS.format('goals')}",
    "3.8": f"The same for myopia alone. {BARS.format('goals')}",
    "3.9": f"The same for noise alone. {BARS.format('goals')}",
    "3.11": "Simulated user study of objectives (tables 3.3 and 3.4; figures 3.11 and 3.12): estimated costs at the "
    "goal. " + BARS.format("subjects"),
    "3.14": "Simulated user study of models, goals in a shelf (tables 3.6 and 3.7; figures 3.14 and 3.15). "
    + BARS.format("subjects"),
    "3.16": f"Grasps with which the object cannot be placed in the shelf (OM5). {BARS.format('subjects')}",
}
TIMED_GOALS = 2


def settings(quick: bool) -> Chapter3Settings:
    """Return the settings, quick or in full."""
    loaded = load_chapter3_settings()
    return loaded.quickened() if quick else loaded


def claims(given: Chapter3Settings, tables: dict[str, Rows]) -> list[Claim]:
    """Return the claims."""
    metrics, mismatch = tables["metrics"], tables["mismatch"]
    found = [*case_claims(tables["cases"]), *metric_claims(metrics)]
    if given.mismatch.object in given.metrics.objects:
        found.append(region_claim(metrics, mismatch, given.mismatch.object))
    for attitude in given.mismatch.attitudes:
        found += mismatch_claims(mismatch, attitude)
    return [*found, *user_claims(tables["users"])]


def figures(given: Chapter3Settings, tables: dict[str, Rows], seed: int, folder: Path) -> list[Figure]:
    """Draw all figures, and write down how long planning takes."""
    case, mismatch, users = given.case_study, tables["mismatch"], tables["users"]
    model, goal = load_object(case.object), transform_from_xyz_rpy(case.goal.xyz, case.goal.rpy)
    files = {
        "3.2": draw_case(folder, tables, model, WITHOUT, goal, "figure_3_2_case_without_goal"),
        "3.3": draw_case(folder, tables, model, WITH, goal, "figure_3_3_case_with_goal"),
        "3.4": draw_metrics(folder, tables["metrics"], "goal", "figure_3_4_goals"),
        "3.5": draw_metrics(folder, tables["metrics"], "object", "figure_3_5_objects"),
        "3.6": draw_mismatch(folder, mismatch, ("MN",), "figure_3_6_myopic_noisy"),
        "3.7": draw_mismatch(folder, mismatch, PERSONS, "figure_3_7_mismatch"),
        "3.8": draw_one_assumption(folder, mismatch, 0, "figure_3_8_myopia"),
        "3.9": draw_one_assumption(folder, mismatch, 1, "figure_3_9_noise"),
        "3.11": draw_measures(folder, users, METRICS, "figure_3_11_objectives"),
        "3.14": draw_measures(folder, users, MODELS, "figure_3_14_models"),
        "3.16": draw_infeasible(folder, users, "figure_3_16_infeasible"),
    }
    write_planning_time(given, seed, folder)
    return [Figure(number, CAPTIONS[number], tuple(files[number])) for number in CAPTIONS]


def write_planning_time(given: Chapter3Settings, seed: int, folder: Path) -> None:
    """Plan some conditions of the mismatch study once more and write how long that took: no table holds times."""
    goals = min(TIMED_GOALS, given.mismatch.goals)
    began = time.perf_counter()
    conditions = sum(
        len(mismatch_rows(given, given.mismatch.attitudes[0], goal, seed)["mismatch"]) for goal in range(goals)
    )
    seconds = time.perf_counter() - began
    document = {"conditions": conditions, "seconds": seconds, "seconds_for_160": 160.0 * seconds / conditions}
    write_whole(folder / "chapter3_planning_time.json", json.dumps(document, indent=2) + "\n")


def notes(given: Chapter3Settings) -> list[str]:
    """Return what was simulated."""
    users, myopia = given.user_studies, given.myopia
    reach = "as far as its arm reaches without collision" if given.robot_reach else "wherever its grasp is (no reach)"
    moves = "turns, steps and stoops to place" if given.moves_to_goal else "stands still"
    return [
        f"A simulated person chooses by eq. 3.3 to 3.5: rationality {given.rationality:g} (perfect: always the best), "
        f"gamma {myopia.myopic:g} when myopic, {myopia.far_sighted:g} when global; cost (3.2) of seven joints; the "
        f"person {moves}. A grasp with which the object cannot be placed costs {given.regrasp:g} times the greatest "
        "mean cost at the goal.",
        f"The robot offers {reach}; each plan is the best of {given.searches} searches of the online optimiser. "
        "Objects are offered in any attitude, as in the dissertation; in the mismatch study also upright only.",
        "Costs have other weights than the dissertation's, so that levels cannot be compared, only differences and "
        "ratios within a study. Goals are random: the dissertation does not print its own.",
        f"Mismatch study: {given.mismatch.goals} goals, that is {16 * given.mismatch.goals} conditions for each way to "
        "offer the object (dissertation: 10 goals, 160 conditions). A wrong assumption costs much at few goals. "
        "`chapter3_planning_time.json` tells how long 160 conditions take on this machine.",
        f"Case studies: {given.case_study.people} persons; pictures show the first. Great configurations have at least "
        "half the weight of the best one, bad ones less than a hundredth.",
        "Decided after a first look at results of seed 1, so that another seed is the fairer test: 30 goals instead of "
        "10 for the full mismatch study, tests of the user studies over goals as well as over subjects, and tests of "
        "equivalence for table 3.7.",
        f"The simulated user studies ({users.people.metrics} and {users.people.models} subjects, as many as lived "
        "through the dissertation's) differ from living ones: subjects follow the model of choice exactly, with arm "
        f"lengths ({users.length_spread:g} log), neutral postures ({users.neutral_spread:g} rad) and weights "
        f"({users.weight_spread:g} log) unknown to the robot; who does not know the goal has gamma 1, who knows it has "
        f"one between {users.aware_myopia[0]:g} and {users.aware_myopia[1]:g}, which is assumed, not measured. Nobody "
        "learns, tires or answers a questionnaire, and order of trials does not matter.",
        "OM1 to OM4 judge the region that was taken with the robot's model of people, as the dissertation did; OM5 "
        "looks at the subject's own grasp. Where no grasp of a region can be placed OM1 to OM4 are the cost of taking "
        "the object anew. OM1 to OM4 share their model, so that Cronbach's alpha here says little about people.",
    ]


CHAPTER3 = Study(
    name="chapter3",
    title="Chapter 3: planning handovers for what people choose",
    settings=settings,
    units=chapter3.units,
    work=chapter3.work,
    claims=claims,
    figures=figures,
    notes=notes,
)
