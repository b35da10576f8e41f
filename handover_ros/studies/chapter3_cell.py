"""The cell of chapter 3, without its physics: what may be planned in it, for whom, and what that costs somebody."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from handover_ros.ergonomics.arm_costs import Preference
from handover_ros.errors import BadModelError, InfeasibleError
from handover_ros.geometry import FloatArray, transform_from_xyz_rpy, transform_points
from handover_ros.objects.catalogue import ObjectModel, load_catalogue
from handover_ros.objects.scene import load_scene
from handover_ros.planning import CellSnapshot, HandoverPlanner, HandoverRequest, TrackedPerson, load_schemes
from handover_ros.planning.expected_cost import ExpectedCostScheme, RobotBeforeTorso, Situation
from handover_ros.planning.facing import object_corners
from handover_ros.planning.feasible import statistics
from handover_ros.planning.goal_stance import Box
from handover_ros.planning.handover import Search
from handover_ros.planning.objectives import OBJECTIVES, expected_cost
from handover_ros.planning.offers import HandoverTask
from handover_ros.planning.optimiser import SearchSettings, search
from handover_ros.planning.problem import Candidate
from handover_ros.robot import RobotModel
from handover_ros.studies.chapter3_settings import Attitude, Chapter3Settings, ShelfSettings
from handover_ros.studies.seeds import generator

KINDS = {"upright": 0.0, "upside_down": np.pi, "side": np.pi / 2.0}  # roll of the object at a goal [rad]
MOST_GOALS = 500  # tried until the object can be placed at one
EXPECTED = "MN"  # person for whom objectives and goals are looked at


@dataclass(frozen=True, eq=False)
class Goal:
    """Where an object is to be brought.

    Attributes:
        number: Which one.
        kind: A name of ``KINDS``.
        task: The handover, with this goal.
    """

    number: int
    kind: str
    task: HandoverTask


class Cell:
    """Robot, scene and a person who stands there."""

    def __init__(self, settings: Chapter3Settings, attitude: Attitude = "any") -> None:
        self.settings = settings
        catalogue = load_catalogue()
        if attitude == "any":
            catalogue = {name: replace(model, keep_upright=False) for name, model in catalogue.items()}
        scene = load_scene(settings.scene)
        self.planner = HandoverPlanner(RobotModel.load(scene.robot), scene, catalogue, load_schemes())
        base = self.planner.schemes["expected_cost"]
        if not isinstance(base, ExpectedCostScheme):
            raise BadModelError("config/schemes/expected_cost.yaml: must be a scheme of kind expected_cost")
        changes = {
            "rationality": settings.rationality,
            "regrasp": settings.regrasp,
            "moves_to_goal": settings.moves_to_goal,
        }
        self.scheme = replace(base, content=base.content.model_copy(update=changes))
        given = base.content.preference
        self.usual = Preference(np.array(given.neutral), np.array(given.weights))  # of whom the robot expects
        self.world_from_torso = scene.person_pose @ transform_from_xyz_rpy([0.0, 0.0, settings.shoulders])

    def task(self, name: str) -> HandoverTask:
        """Return the handover of an object, without a goal, by the first arm that can pick it up.

        Raises:
            UnknownNameError: There is no such object.
            InfeasibleError: No arm can pick it up.
        """
        robot = self.planner.motion.robot
        arms = {arm: np.array(robot.arm(arm).home) for arm in robot.arm_names}
        placements = dict(self.planner.motion.scene.placements)
        snapshot = CellSnapshot(arms, placements, TrackedPerson(self.world_from_torso, dominant="right"))
        model, looked = self.planner.motion.object_model(name), Search(np.inf)
        for arm in robot.arm_names:
            _, ready, picking = self.planner.picking(arm, name, snapshot, looked)
            if picking is not None and len(picking.grasps) and any(picking[row] for row in range(len(picking.grasps))):
                return self.planner.task(HandoverRequest(name), model, picking, ready, looked)
        raise InfeasibleError(f"no arm of the robot can pick up {name} in scene {self.settings.scene}")

    def situation(self, task: HandoverTask, person: str) -> Situation:
        """Return what is to be decided for a person called MN, MP, GN or GP.

        Raises:
            InfeasibleError: The object cannot be placed at the goal.
        """
        found = self.scheme.situation(replace(task, person_model=person))
        return replace(found, problem=replace(found.problem, choice=self.settings.choice(person)))

    def plan(self, task: HandoverTask, situation: Situation, objective: str) -> Candidate | None:
        """Return the best handover by an objective; None: there is none. No search is cut short by time."""
        robot = None
        if self.settings.robot_reach and task.robot is not None:
            robot = RobotBeforeTorso(task.robot, situation.world_from_torso)
        problem = replace(situation.problem, objective=OBJECTIVES[objective])
        found = [
            candidate
            for number in range(self.settings.searches)
            for candidate in search(problem, robot, settings=SearchSettings(seed=number), wanted=1).candidates
        ]
        return min(found, key=lambda candidate: candidate.value, default=None)

    def goal(
        self, task: HandoverTask, name: str, number: int, seed: int, furniture: FloatArray | ShelfSettings | None = None
    ) -> Goal:
        """Return a random goal at which the object can be placed.

        Args:
            task: The handover without a goal.
            name: Of the experiment; experiments have goals of their own.
            number: Of the goal, by which its kind changes.
            seed: Of the study.
            furniture: Lengths (3,) [m] of a table top, or a shelf, at the goal; None: nothing.

        Raises:
            InfeasibleError: Hardly any place will do.
        """
        rng = generator(seed, f"goals of {name}", number)
        kind = list(KINDS)[number % len(KINDS)]
        where = self.settings.goals
        for _ in range(MOST_GOALS):
            place = rng.uniform(where.lower, where.upper)
            turned = transform_from_xyz_rpy(place, [KINDS[kind], 0.0, rng.uniform(-np.pi, np.pi)])
            boxes = task.boxes + self._furniture(task.model, turned, furniture)
            tried = replace(task, world_from_goal=self.world_from_torso @ turned, boxes=boxes)
            try:
                self.situation(tried, EXPECTED)
            except InfeasibleError:
                continue
            return Goal(number, kind, tried)
        raise InfeasibleError(
            f"{task.model.name} can be placed at none of {MOST_GOALS} goals; see goals in chapter3.yaml"
        )

    def _furniture(
        self, model: ObjectModel, torso_from_goal: FloatArray, furniture: FloatArray | ShelfSettings | None
    ) -> tuple[Box, ...]:
        """Return the boxes of a table or shelf on which an object stands at a goal, in the world."""
        if furniture is None:
            return ()
        corners = transform_points(torso_from_goal, object_corners(model))
        middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        floor = np.array([middle[0], middle[1], corners[:, 2].min()])
        parts = shelf_boxes(furniture) if isinstance(furniture, ShelfSettings) else [table_box(furniture)]
        return tuple(
            (size, self.world_from_torso @ transform_from_xyz_rpy((floor + centre).tolist())) for size, centre in parts
        )


def table_box(lengths: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return lengths (3,) and centre (3,) [m] of a table top, from the middle of its upper side."""
    return np.asarray(lengths, dtype=float), np.array([0.0, 0.0, -0.5 * float(lengths[2])])


def shelf_boxes(shelf: ShelfSettings) -> list[tuple[FloatArray, FloatArray]]:
    """Return lengths (3,) and centres (3,) [m] of the boards of a shelf, from the middle of its floor; open to -x."""
    depth, width, height, board = shelf.depth, shelf.width, shelf.height, shelf.thickness
    level = np.array([depth, width + 2.0 * board, board])
    side = np.array([depth, board, height])
    return [
        (level, np.array([0.0, 0.0, -0.5 * board])),
        (level, np.array([0.0, 0.0, height + 0.5 * board])),
        (side, np.array([0.0, 0.5 * (width + board), 0.5 * height])),
        (side, np.array([0.0, -0.5 * (width + board), 0.5 * height])),
        (
            np.array([board, width + 2.0 * board, height + 2.0 * board]),
            np.array([0.5 * (depth + board), 0.0, 0.5 * height]),
        ),
    ]


def true_cost(situation: Situation, candidate: Candidate) -> float:
    """Return the expected total cost (3.7) of a handover to the person of a situation; inf: they cannot take it."""
    problem, table = situation.problem, table_for(situation, candidate)
    free = problem.free[candidate.robot_grasp]
    return float(expected_cost(table[None], problem.goal, problem.choice, free[None])[0, 0])


def table_for(situation: Situation, candidate: Candidate) -> FloatArray:
    """Return the statistics (grasps, 5) of a handover for the person of a situation, whoever it was planned for."""
    problem = situation.problem
    pose = candidate.torso_from_object[None]
    return np.asarray(statistics(problem.taker, problem.grasps, pose, problem.choice.hand_rationality)[0])


@lru_cache(maxsize=4)
def _cell(document: str, attitude: Attitude) -> Cell:
    """Return a cell of settings as JSON."""
    return Cell(Chapter3Settings.model_validate_json(document), attitude)


def cell_of(settings: Chapter3Settings, attitude: Attitude = "any") -> Cell:
    """Return the cell of the settings, made once a process."""
    return _cell(settings.model_dump_json(), attitude)


def region_shares(regions: Sequence[str], probabilities: FloatArray) -> dict[str, float]:
    """Return the probability of each region from those of its grasps (grasps,), in the order of the grasps."""
    shares: dict[str, float] = {}
    for region, probability in zip(regions, probabilities):
        shares[region] = shares.get(region, 0.0) + float(probability)
    return shares
