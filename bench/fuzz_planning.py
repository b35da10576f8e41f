"""Planning requests that make no sense, by the thousand: ``python -m bench.fuzz_planning COUNT [SEED]``.

Each must be answered. An answer is a plan without a number that is not finite, or an error a person can act on,
within the time budget.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from dataclasses import dataclass, field, fields, is_dataclass, replace

import numpy as np

from handover_ros.errors import HandoverError
from handover_ros.geometry import FloatArray, transform_from_xyz_rpy
from handover_ros.objects.catalogue import ObjectModel, load_catalogue
from handover_ros.objects.scene import load_scene
from handover_ros.planning import CellSnapshot, HandoverPlanner, HandoverRequest, TrackedPerson, load_schemes
from handover_ros.robot import RobotModel

MAY_BE_NAN = {"goal_cost", "opening", "cost"}  # what says by NaN that there is none
PATIENCE = 3.0  # [s] beyond the time budget: the motion that was begun is finished


@dataclass
class FuzzReport:
    """What came back.

    Attributes:
        plans: Requests that were planned.
        refusals: Errors by kind.
        crashes: Anything else that was raised.
        not_finite: Plans with a number that is not finite.
        late: Largest time beyond the budget [s].
    """

    plans: int = 0
    refusals: Counter[str] = field(default_factory=Counter)
    crashes: list[str] = field(default_factory=list)
    not_finite: list[str] = field(default_factory=list)
    late: float = 0.0


def fuzz(count: int, seed: int, progress: int = 0) -> FuzzReport:
    """Return what a planner answers to ``count`` requests; prints a line every ``progress`` requests (0: none)."""
    scene = load_scene("lab")
    planner = HandoverPlanner(RobotModel.load(), scene, _catalogue(), load_schemes())
    planner.warm_up()
    rng = np.random.default_rng(seed)
    report = FuzzReport()
    for number in range(count):
        budget = float(rng.choice([0.0, 1e-6, 0.05, 0.2]))
        started = time.monotonic()
        try:
            plan = planner.plan(_request(rng, budget, planner, scene.person_pose), _snapshot(rng, planner))
            report.plans += 1
            if problem := not_finite(plan):
                report.not_finite.append(problem)
        except HandoverError as error:
            report.refusals[type(error).__name__] += 1
            if not str(error):
                report.crashes.append(f"{type(error).__name__} without a word")
        except Exception as error:
            report.crashes.append(f"request {number}: {type(error).__name__}: {error}")
        limit = budget or planner.motion.settings.time_budget
        report.late = max(report.late, time.monotonic() - started - limit)
        if progress and (number + 1) % progress == 0:
            print(f"{number + 1}: {report.plans} plans, {sum(report.refusals.values())} refused", flush=True)
    return report


def not_finite(value: object, name: str = "plan") -> str:
    """Return the name of the first number in a plan that is not finite; empty: all are."""
    if isinstance(value, np.ndarray):
        return "" if np.isfinite(value).all() else name
    if isinstance(value, float):
        return "" if np.isfinite(value) or name.rsplit(".", 1)[-1] in MAY_BE_NAN else name
    if is_dataclass(value) and not isinstance(value, ObjectModel):
        parts = [(f"{name}.{each.name}", getattr(value, each.name)) for each in fields(value)]
    elif isinstance(value, dict):
        parts = [(f"{name}[{key}]", each) for key, each in value.items()]
    elif isinstance(value, tuple | list):
        parts = [(f"{name}[{index}]", each) for index, each in enumerate(value)]
    else:
        return ""
    return next((found for where, each in parts if (found := not_finite(each, where))), "")


def _catalogue() -> dict[str, ObjectModel]:
    """Return the objects, and some that make no sense."""
    catalogue = load_catalogue()
    mug = catalogue["mug"]
    return {
        **catalogue,
        "ungraspable": replace(mug, name="ungraspable", robot_grasps=()),
        "untakeable": replace(mug, name="untakeable", human_grasps=mug.human_grasps[5:6]),
        "for_two_hands": replace(mug, name="for_two_hands", hands=2),
    }


def _request(
    rng: np.random.Generator, budget: float, planner: HandoverPlanner, world_from_person: FloatArray
) -> HandoverRequest:
    """Return a request, sound or not."""
    names = [*planner.motion.catalogue, "telephone", ""]
    schemes = [*planner.schemes, *["expected_cost"] * 4, "telepathic", ""]
    goal = None
    if rng.random() < 0.7:
        place = rng.uniform([-1.0, -1.5, 0.0], [2.0, 1.5, 2.0]) if rng.random() < 0.5 else [0.4, -0.2, 1.1]
        goal = world_from_person @ transform_from_xyz_rpy(place, rng.uniform(-np.pi, np.pi, 3))
        if rng.random() < 0.1:
            goal[rng.integers(4), rng.integers(4)] = rng.choice([np.nan, np.inf, 1e300])
    return HandoverRequest(
        object_name=str(rng.choice(names)),
        scheme=str(rng.choice(schemes)),
        arm=str(rng.choice(["", "", "left", "right", "third"])),
        time_budget=float(rng.choice([budget] * 20 + [np.nan, -1.0])),
        world_from_goal=goal,
        person_model=str(rng.choice(["", "MN", "MP", "GN", "GP", "XX"])),
    )


def _snapshot(rng: np.random.Generator, planner: HandoverPlanner) -> CellSnapshot:
    """Return a cell, sound or not."""
    robot, scene = planner.motion.robot, planner.motion.scene
    arms = {arm: np.array(robot.arm(arm).home) for arm in robot.arm_names}
    if rng.random() < 0.05:
        arms[robot.arm_names[0]] = arms[robot.arm_names[0]] + rng.choice([np.nan, 10.0])
    objects = dict(scene.placements)
    for name in ("ungraspable", "untakeable", "for_two_hands"):
        objects[name] = scene.placements["mug"]
    person = None
    if rng.random() < 0.9:
        where = rng.uniform([-0.6, -0.8, 0.8], [0.6, 0.8, 1.8]) if rng.random() < 0.4 else [0.0, 0.0, 1.4]
        torso = scene.person_pose @ transform_from_xyz_rpy(where, rng.normal(size=3) * rng.choice([0.0, 0.3, 3.0]))
        person = TrackedPerson(torso, dominant=[None, "left", "right"][rng.integers(3)])
    return CellSnapshot(arms, objects, person)


def main() -> int:
    """Run and print; status 1 when something was not answered as it should."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    report = fuzz(count, int(sys.argv[2]) if len(sys.argv) > 2 else 1, progress=max(1, count // 20))
    print(f"{count} requests: {report.plans} plans, refusals {dict(report.refusals)}")
    print(f"crashes {len(report.crashes)} {report.crashes[:5]}, not finite {report.not_finite[:5]}")
    print(f"at most {report.late:.2f} s beyond the budget")
    return 1 if report.crashes or report.not_finite or report.late > PATIENCE else 0


if __name__ == "__main__":
    sys.exit(main())
