"""The trials of chapter 2: a subject stands, the robot plans by a scheme, the subject takes the object."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from handover_ros.errors import InfeasibleError
from handover_ros.geometry import FloatArray, transform_from_xyz_rpy
from handover_ros.objects.catalogue import load_catalogue
from handover_ros.objects.scene import Scene, load_scene
from handover_ros.planning import (
    CellSnapshot,
    HandoverPlan,
    HandoverPlanner,
    HandoverRequest,
    PlannerSettings,
    TrackedPerson,
    load_schemes,
)
from handover_ros.robot import RobotModel
from handover_ros.sim.person_kinematics import PersonKinematics
from handover_ros.sim.person_spec import PersonSpec
from handover_ros.skeleton.tracking import SkeletonEstimate
from handover_ros.studies.chapter2_markers import Known, Watched, known, rotation
from handover_ros.studies.chapter2_posture import Taken, Taking, weights_of
from handover_ros.studies.chapter2_settings import Chapter2Settings, TrialSettings
from handover_ros.studies.chapter2_subjects import Condition, subject
from handover_ros.studies.seeds import generator
from handover_ros.studies.tables import Rows

SCHEMES = ("constant", "relative", "personal")
BUDGET = 120.0  # [s] of a search: none is cut short, so that plans do not depend on the machine


@dataclass(frozen=True, eq=False)
class Laboratory:
    """A cell without physics: a robot that plans, and where a person stands."""

    scene: Scene
    planner: HandoverPlanner


@lru_cache(maxsize=2)
def laboratory(scene_name: str) -> Laboratory:
    """Return the cell of a scene."""
    scene = load_scene(scene_name)
    robot, settings = RobotModel.load(scene.robot), PlannerSettings(time_budget=BUDGET)
    return Laboratory(scene, HandoverPlanner(robot, scene, load_catalogue(), load_schemes(), settings))


@dataclass(frozen=True)
class Trial:
    """One trial before anything is offered.

    Attributes:
        scheme: By which it is planned.
        repetition: Its number among those of the scheme.
        order: Its number among all.
    """

    scheme: str
    repetition: int
    order: int


def trials(settings: Chapter2Settings, number: int, seed: int, condition: Condition) -> list[Trial]:
    """Return a subject's trials in the order in which they come: at random, as many of each scheme."""
    kinds = [(scheme, repetition) for scheme in SCHEMES for repetition in range(settings.repetitions)]
    order = generator(seed, f"chapter2 order {condition}", number).permutation(len(kinds))
    return [Trial(kinds[place][0], kinds[place][1], index) for index, place in enumerate(order)]


def run_trials(settings: Chapter2Settings, number: int, seed: int, condition: Condition) -> Rows:
    """Return a row for each trial and taste of a subject in a condition.

    Raises:
        HandoverError: The subject cannot be calibrated.
    """
    person, found = subject(settings, number, seed, condition), known(settings, number, seed, condition)
    rows: Rows = []
    for trial in trials(settings, number, seed, condition):
        rows += _run(settings, number, seed, condition, trial, person, found)
    return rows


def _run(
    settings: Chapter2Settings,
    number: int,
    seed: int,
    condition: Condition,
    trial: Trial,
    person: PersonSpec,
    found: Known,
) -> Rows:
    """Return the rows of one trial; the same feet, noise and offer for all tastes."""
    name = f"chapter2 trial {condition} {trial.scheme} {trial.repetition}"
    rng = generator(seed, name, number)
    place = laboratory(settings.scene)
    kinematics = PersonKinematics(person, _feet(place.scene.person_pose, settings.trial, rng))
    comfortable = _comfortable(person, settings.trial, rng)
    noise = int(rng.integers(2**31))
    watched = Watched(kinematics, found.skeleton, settings.markers, np.random.default_rng(noise))
    before = watched.stand(person.standing)
    plan = offered(place, settings.object, trial.scheme, before, found, person) if before.valid else None
    rows: Rows = []
    for taste, factors in settings.tastes.items():
        row: dict[str, Any] = {
            "subject": number,
            "dominant": person.dominant,
            "condition": condition,
            "taste": taste,
            "scheme": trial.scheme,
            "repetition": trial.repetition,
            "order": trial.order,
            "planned": plan is not None,
        }
        if plan is None:
            rows.append(row | dict.fromkeys(MEASURES))
            continue
        taking = Taking(
            kinematics, place.planner.motion.object_model(settings.object), plan.world_from_object, settings.hold
        )
        taken = taking.cheapest(comfortable, weights_of(kinematics, factors))
        again = Watched(kinematics, found.skeleton, settings.markers, np.random.default_rng(noise))
        stood = again.stand(person.standing)
        row |= dict.fromkeys(MEASURES)
        after = again.reach(person.standing, taken.displacements)
        if after.valid:
            row |= _measured(stood, after, kinematics, person, taken)
        row |= {"taken": taken.reaches(settings.hold), "nominal": plan.nominal}
        row |= {f"offer_{axis}": float(plan.world_from_object[i, 3]) for i, axis in enumerate("xyz")}
        rows.append(row)
    return rows


MEASURES = (
    "rotation_deg",
    "signed_deg",
    "true_deg",
    "lean_deg",
    "cost",
    "miss_mm",
    "taken",
    "nominal",
    "offer_x",
    "offer_y",
    "offer_z",
)


def _feet(usual: FloatArray, given: TrialSettings, rng: np.random.Generator) -> FloatArray:
    """Return where the feet stand (4, 4): about where they should."""
    x, y = given.position * rng.standard_normal(2)
    return usual @ transform_from_xyz_rpy([x, y, 0.0], [0.0, 0.0, given.heading * rng.standard_normal()])


def _comfortable(person: PersonSpec, given: TrialSettings, rng: np.random.Generator) -> FloatArray:
    """Return the posture (20,) that a person finds comfortable in a trial."""
    usual = person.neutral.copy()
    usual[6:] += given.neutral * rng.standard_normal(len(usual) - 6)
    return np.clip(usual, person.lower, person.upper)


def offered(
    place: Laboratory, object_name: str, scheme: str, seen: SkeletonEstimate, found: Known, person: PersonSpec
) -> HandoverPlan | None:
    """Return the planned handover for a person as they are seen; None: there is none that robot and person can do."""
    motion = place.planner.motion
    tracked = TrackedPerson(
        seen.world_from_torso,
        skeleton=found.skeleton,
        displacements=seen.displacements,
        dominant=person.dominant,
        body_mass=person.mass,
    )
    arms = {arm: np.array(motion.robot.arm(arm).home) for arm in motion.robot.arm_names}
    snapshot = CellSnapshot(arms=arms, objects=dict(place.scene.placements), person=tracked)
    try:
        return place.planner.plan(HandoverRequest(object_name, scheme), snapshot)
    except InfeasibleError:
        return None


def _measured(
    before: SkeletonEstimate, after: SkeletonEstimate, kinematics: PersonKinematics, person: PersonSpec, taken: Taken
) -> dict[str, float]:
    """Return what tracking shows, and the truth beside it; towards the dominant side is positive."""
    towards = 1.0 if person.dominant == "left" else -1.0
    turned = rotation(before.world_from_torso, after.world_from_torso)
    true = rotation(kinematics.torso_pose(person.standing[:6]), kinematics.torso_pose(taken.displacements[:6]))
    upright = float(np.clip(before.world_from_torso[:3, 2] @ after.world_from_torso[:3, 2], -1.0, 1.0))
    return {
        "rotation_deg": abs(turned),
        "signed_deg": towards * turned,
        "true_deg": towards * true,
        "lean_deg": float(np.degrees(np.arccos(upright))),
        "cost": taken.cost,
        "miss_mm": 1e3 * taken.position_miss,
    }
