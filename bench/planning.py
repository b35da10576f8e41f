"""Planning: how long an expected-cost plan takes, and what it costs against exhaustive search over a grid of poses."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from handover_ros.errors import InfeasibleError
from handover_ros.geometry import transform_from_xyz_rpy
from handover_ros.objects.catalogue import load_catalogue
from handover_ros.objects.scene import load_scene
from handover_ros.planning import CellSnapshot, HandoverPlanner, HandoverRequest, TrackedPerson, load_schemes
from handover_ros.planning.expected_cost import ExpectedCostScheme, RobotBeforeTorso
from handover_ros.planning.handover import Search
from handover_ros.planning.objectives import OBJECTIVES, expected_cost
from handover_ros.planning.offers import HandoverTask
from handover_ros.planning.optimiser import exhaustive, search
from handover_ros.robot import RobotModel

OBJECTS = ("mug", "glass", "pitcher", "plate")
GOALS = 20
SHOULDERS = 1.40  # [m]
# Grids of the exhaustive search: x, y, z [m]; turn (and lean and spin of the plate) [rad].
GRIDS = {True: (0.10, 0.55), False: (0.15, 0.9)}
UPSIDE_DOWN = 0.15  # share of the goals


def measure(seed: int, quick: bool) -> dict[str, float]:
    """Return the metrics; prints the size of the exhaustive search."""
    scene, catalogue, schemes = load_scene("lab"), load_catalogue(), load_schemes()
    planner = HandoverPlanner(RobotModel.load(), scene, catalogue, schemes)
    started = time.perf_counter()
    planner.warm_up()
    warm_up = time.perf_counter() - started
    scheme = schemes["expected_cost"]
    assert isinstance(scheme, ExpectedCostScheme)
    rng = np.random.default_rng(seed)
    seconds, ratios, oracle_seconds, checks = [], [], [], []
    for name in OBJECTS:
        sizes: set[tuple[int, ...]] = set()
        for _ in range(4 if quick else GOALS):
            task = _task(planner, name, rng, scheme)
            planned = time.perf_counter()
            try:
                offers = scheme.offers(task)
            except InfeasibleError:
                offers = []
            seconds.append(time.perf_counter() - planned)
            situation = scheme.situation(task)
            assert task.robot is not None
            robot = RobotBeforeTorso(task.robot, situation.world_from_torso)
            spacing, angle = GRIDS[situation.problem.model.keep_upright]
            oracle = exhaustive(situation.problem, robot, spacing, angle)
            oracle_seconds.append(oracle.seconds)
            checks.append(oracle.robot_checks)
            sizes.add((oracle.poses, len(situation.problem.object_from_gripper), len(situation.problem.grasps)))
            if not oracle.candidates:
                continue  # nothing to be compared with
            ours = offers[0].predicted.expected_cost if offers and offers[0].predicted else np.inf
            ratios.append(ours / oracle.candidates[0].value)
        for poses, robot_grasps, grasps in sizes:
            print(f"  {name}: exhaustive over {poses} poses x {robot_grasps} robot grasps x {grasps} human grasps")
        print(f"  {name}: ratios {np.round(sorted(ratios)[-3:], 3).tolist()}, {1e3 * float(np.median(seconds)):.0f} ms")
    return {
        "plan_median_ms": 1e3 * float(np.median(seconds)),
        "plan_p95_ms": 1e3 * float(np.percentile(seconds, 95)),
        "plan_cost_over_exhaustive_max": float(np.max(ratios)),
        "plan_cost_over_exhaustive_mean": float(np.mean(ratios)),
        "plan_exhaustive_s": float(np.median(oracle_seconds)),
        "plan_compared": float(len(ratios)),
        "plan_warm_up_s": warm_up,
        **study(seed, 2 if quick else 5),
    }


def study(seed: int, goals: int = 5) -> dict[str, float]:
    """Return how the objectives compare in the conditions of Bestick 2017, section 3.5: 4 objects x 5 goals.

    Each objective chooses freely (the robot reaches everywhere); what it chose is judged by the expected total cost.
    """
    scene, catalogue, schemes = load_scene("lab"), load_catalogue(), load_schemes()
    planner = HandoverPlanner(RobotModel.load(), scene, catalogue, schemes)
    scheme = schemes["expected_cost"]
    assert isinstance(scheme, ExpectedCostScheme)
    rng = np.random.default_rng(seed)
    costs: dict[str, list[float]] = {name: [] for name in OBJECTIVES}
    for name in OBJECTS:
        for _ in range(goals):
            problem = scheme.situation(_task(planner, name, rng, scheme)).problem
            for objective in OBJECTIVES:
                chosen = search(replace(problem, objective=OBJECTIVES[objective])).candidates[0]
                allowed = problem.free[chosen.robot_grasp][None]
                cost = expected_cost(chosen.table[None], problem.goal, problem.choice, allowed)[0, 0]
                costs[objective].append(float(cost))
    means = {objective: float(np.mean(values)) for objective, values in costs.items()}
    return {
        "study_expected_cost": means["expected_cost"],
        "study_minimum_mean_over_expected": means["minimum_mean"] / means["expected_cost"],
        "study_maximum_feasibility_over_expected": means["maximum_feasibility"] / means["expected_cost"],
    }


def _task(planner: HandoverPlanner, name: str, rng: np.random.Generator, scheme: ExpectedCostScheme) -> HandoverTask:
    """Return a task with a random goal at which the object can be placed."""
    scene = planner.motion.scene
    torso = scene.person_pose @ transform_from_xyz_rpy([0.0, 0.0, SHOULDERS])
    arms = {arm: np.array(planner.motion.robot.arm(arm).home) for arm in planner.motion.robot.arm_names}
    snapshot = CellSnapshot(arms, dict(scene.placements), TrackedPerson(torso))
    model = planner.motion.object_model(name)
    request = HandoverRequest(name, "expected_cost")
    search = Search(time.monotonic() + 3600.0)
    arm = "left" if name in ("mug", "glass") else "right"
    _, ready, picking = planner.picking(arm, name, snapshot, search)
    assert picking is not None
    while True:
        turned = np.pi if rng.random() < UPSIDE_DOWN else 0.0
        place = rng.uniform([0.25, -0.45, -0.45], [0.60, 0.25, -0.05])
        goal = torso @ transform_from_xyz_rpy(place, [turned, 0.0, rng.uniform(-np.pi, np.pi)])
        task = planner.task(replace(request, world_from_goal=goal), model, picking, ready, search)
        try:
            scheme.situation(task)
        except InfeasibleError:
            continue
        return task
