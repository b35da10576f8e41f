"""The optimiser of a handover: which robot grasp, and at which pose the object is offered (Bestick 2017, section 3.4).

Two modes over the same objective. ``exhaustive`` looks at every pose of a grid, as the dissertation did: the oracle.
``search`` is for a robot that waits: it starts from poses that a comfortable hand suggests and from an even spread,
then closes in around the best ones, and asks the robot about its reach only from the best candidate on. It can be
stopped at any time and then has its best so far.
"""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from handover_ros.geometry import FloatArray, invert_transform
from handover_ros.objects.catalogue import ObjectModel
from handover_ros.planning.choice import MEAN, MEASURE, ChoiceModel, GoalCosts, grasp_probabilities
from handover_ros.planning.feasible import Taker, statistics
from handover_ros.planning.grasp_set import GraspSet
from handover_ros.planning.objectives import Objective
from handover_ros.planning.pose_space import PoseSpace

BoolArray = npt.NDArray[np.bool_]


class Robot(Protocol):
    """The arm that is to offer the object, as the search asks it; object poses are in the torso frame."""

    def stretches(self, torso_from_object: FloatArray) -> FloatArray:
        """Return how far its grasps stretch it [m] at poses (n, 4, 4), shape (n, robot grasps); inf: too far. Cheap."""

    def reachable(self, torso_from_object: FloatArray, robot_grasp: int) -> bool:
        """Return whether it can be at a pose (4, 4) with a grasp, free of collisions: dear."""


FROM_PERSON = 0.5  # cosine between gripper and the person's reach above which the robot would come from their side
GOOD_GRASPS = 8  # the best at the goal, by which a search for a goal starts,
GOOD_SHARE = 0.5  # if they are in the better half of the range of costs there
NEARBY = 0.15  # share of the distance between elites within which the robot's reach is the same, most probably
LEAST_CHECKS = 4  # the robot is asked even when the time has run out
CHUNK = 2000  # poses looked at together in the exhaustive mode


@dataclass(frozen=True, eq=False)
class Problem:
    """What is to be decided, and what is known.

    Attributes:
        model: The object.
        grasps: Of the person.
        object_from_gripper: Robot grasps, shape (r, 4, 4).
        free: Which grasps each robot grasp leaves to the person, shape (r, grasps).
        taker: The person's arms and what they find comfortable.
        choice: How they choose.
        goal: What each grasp costs at the goal.
        objective: To be minimised.
        space: Poses to choose from.
        comfortable: torso_from_hand (4, 4) of a comfortable hand of each side of ``grasps``, in that order.
    """

    model: ObjectModel
    grasps: GraspSet
    object_from_gripper: FloatArray
    free: BoolArray
    taker: Taker
    choice: ChoiceModel
    goal: GoalCosts
    objective: Objective
    space: PoseSpace
    comfortable: tuple[FloatArray, ...]


@dataclass(frozen=True, eq=False)
class Candidate:
    """A robot grasp and a pose of the object.

    Attributes:
        value: Of the objective.
        point: The pose's numbers, see ``PoseSpace``. Shape (6,).
        torso_from_object: Shape (4, 4).
        robot_grasp: Row of ``Problem.object_from_gripper``.
        table: Statistics of every grasp there, shape (grasps, 5).
    """

    value: float
    point: FloatArray
    torso_from_object: FloatArray
    robot_grasp: int
    table: FloatArray


@dataclass(frozen=True)
class SearchSettings:
    """How the online mode searches.

    Attributes:
        spread: Poses of the first, even spread.
        screened: Poses from which these are chosen when there is a goal.
        screened_again: The same when the best that was found is poor.
        elites: Best candidates around which the next poses lie.
        children: Poses around all of them in one round.
        lengths: Scatter of each round's positions [m].
        angles: Scatter of its angles [rad]; as many.
        checks: How often the robot is asked in one round, about.
        attempts: Robot grasps tried for one pose.
        seed: Of the scatter.
    """

    spread: int = 128
    screened: int = 1024
    screened_again: int = 16384
    elites: int = 5
    children: int = 60
    lengths: tuple[float, ...] = (0.10, 0.05, 0.025, 0.012, 0.006)
    angles: tuple[float, ...] = (0.5, 0.25, 0.12, 0.06, 0.03)
    checks: int = 20
    attempts: int = 2
    seed: int = 0


@dataclass
class SearchReport:
    """What a search found and looked at.

    Attributes:
        candidates: Feasible ones, the best first.
        poses: Number of poses looked at.
        refused: Why others were not taken, in counts.
        robot_checks: How often the robot was asked.
        seconds: Wall time.
        stopped: Whether the time ran out.
    """

    candidates: list[Candidate] = field(default_factory=list)
    poses: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    robot_checks: int = 0
    seconds: float = 0.0
    stopped: bool = False


class Pool:
    """Everything looked at so far, one entry for each pose and each different set of grasps left free."""

    def __init__(self, problem: Problem, robot: Robot | None, attempts: int, report: SearchReport) -> None:
        self.problem, self.report = problem, report
        self._robot, self._attempts = robot, attempts
        self._masks, self._kind = np.unique(problem.free, axis=0, return_inverse=True)
        self._kind = np.asarray(self._kind).reshape(-1)
        self._points: list[FloatArray] = []
        self._poses: list[FloatArray] = []
        self._tables: list[FloatArray] = []
        self._stretches: list[FloatArray] = []
        self._values = np.empty(0)  # of the entries, row by row (pose, kind)
        self._known: dict[int, int] = {}  # entry -> robot grasp that reaches it, -1: none does

    def add(self, points: FloatArray) -> None:
        """Look at poses (n, 6)."""
        problem, report = self.problem, self.report
        poses = problem.space.transforms(problem.model, points)
        report.poses += len(points)
        kept = problem.space.allowed(problem.model, poses, report.refused)
        points, poses = points[kept], poses[kept]
        axes = np.einsum("nj,rj->nr", poses[:, 0, :3], problem.object_from_gripper[:, :3, 2])
        front = axes <= FROM_PERSON  # the gripper's axis along the person's reach, which is forward
        stretches = np.zeros(front.shape) if self._robot is None else self._robot.stretches(poses)
        near = np.isfinite(stretches)
        table = statistics(problem.taker, problem.grasps, poses, problem.choice.hand_rationality)
        values = problem.objective(table, problem.goal, problem.choice, self._masks)
        feasible = np.isfinite(values)
        report.refused["no grasp in the person's reach"] += int((~feasible).all(axis=1).sum())
        for ways, reason in ((front, "robot's gripper on the person's side"), (front & near, "beyond the robot's arm")):
            possible = np.stack([ways[:, self._kind == kind].any(axis=1) for kind in range(len(self._masks))], axis=1)
            report.refused[reason] += int((np.isfinite(values) & ~possible).sum())
            values[~possible] = np.inf
        self._points += list(points)
        self._poses += list(poses)
        self._tables += list(table)
        self._stretches += list(np.where(front, stretches, np.inf))
        self._values = np.concatenate([self._values, values.ravel()])

    def best(
        self, wanted: int, deadline: float, most_checks: int, apart: float = 0.0, turned: float = 0.0
    ) -> list[int]:
        """Return entries that the robot reaches, the best first, at most one a pose; asks the robot as it goes.

        Any two are more than ``apart`` [m] or ``turned`` [rad] away from each other.
        """
        kinds = len(self._masks)
        order = np.argsort(self._values, kind="stable")
        points = np.array(self._points)
        left = np.ones((len(points), kinds), dtype=bool)  # entries that may still be taken
        found: list[int] = []
        checks = 0
        for entry in order[: int(np.isfinite(self._values).sum())].tolist():
            pose, kind = divmod(entry, kinds)
            if len(found) == wanted:
                break
            if not left[pose, kind]:
                continue
            if entry not in self._known:
                if checks >= most_checks or (checks >= LEAST_CHECKS and time.monotonic() > deadline):
                    continue
                before = self.report.robot_checks
                self._known[entry] = self._reaching(entry)
                checks += self.report.robot_checks - before
            if self._known[entry] >= 0:
                found.append(entry)
                left[pose] = False
                if apart:
                    left[_beside(points, points[pose], apart, turned)] = False
            elif apart:  # where the robot cannot be it cannot be nearby either, most probably: look elsewhere first
                left[_beside(points, points[pose], NEARBY * apart, NEARBY * turned), kind] = False
        return found

    def best_is_poor(self, deadline: float, most_checks: int) -> bool:
        """Return whether at the best pose the person will probably take a grasp that is bad at the goal."""
        problem, good = self.problem, good_at_goal(self.problem)
        if problem.goal.table is None or good.all():
            return False
        entries = self.best(1, deadline, most_checks)
        if not entries:
            return True
        chosen = self.candidate(entries[0])
        allowed = problem.free[chosen.robot_grasp]
        likely = grasp_probabilities(chosen.table, problem.goal, problem.choice, allowed)
        return bool(likely[good].sum() < 0.5)

    def _reaching(self, entry: int) -> int:
        """Return a robot grasp with which the robot can be at an entry, -1: none of those tried."""
        pose, kind = divmod(entry, len(self._masks))
        stretches = np.where(self._kind == kind, self._stretches[pose], np.inf)
        rows = np.flatnonzero(np.isfinite(stretches))
        if self._robot is None:
            return int(rows[0])
        # The less it is stretched the more likely the arm gets there.
        for row in rows[np.argsort(stretches[rows], kind="stable")[: self._attempts]]:
            self.report.robot_checks += 1
            if self._robot.reachable(self._poses[pose], int(row)):
                return int(row)
        self.report.refused["out of the robot's reach or in collision"] += 1
        return -1

    def point(self, entry: int) -> FloatArray:
        """Return the pose (6,) of an entry."""
        return self._points[entry // len(self._masks)]

    def candidate(self, entry: int) -> Candidate:
        """Return an entry that the robot is known to reach."""
        pose = entry // len(self._masks)
        return Candidate(
            float(self._values[entry]), self._points[pose], self._poses[pose], self._known[entry], self._tables[pose]
        )


def _beside(points: FloatArray, point: FloatArray, apart: float, turned: float) -> BoolArray:
    """Return which poses (n, 6) are within a distance [m] and turn [rad] of another (6,)."""
    steps = np.abs(points - point)
    turns = np.minimum(steps[:, 3:], 2.0 * np.pi - steps[:, 3:])
    return np.asarray((steps[:, :3].max(axis=1) <= apart) & (turns.max(axis=1) <= turned))


def search(
    problem: Problem,
    robot: Robot | None = None,
    budget: float = np.inf,
    settings: SearchSettings | None = None,
    wanted: int = 4,
) -> SearchReport:
    """Return the best candidates found online, at most ``wanted``.

    Args:
        problem: What is to be decided.
        robot: The arm that is to offer the object; None: it can be anywhere.
        budget: Wall time [s] after which the best so far is returned.
        settings: How to search.
        wanted: Number of candidates, in case the robot's way to the first is blocked.
    """
    settings = settings or SearchSettings()
    started = time.monotonic()
    deadline = started + budget
    report = SearchReport()
    pool = Pool(problem, robot, settings.attempts, report)
    rng = np.random.default_rng(settings.seed)
    pool.add(np.concatenate([suggested(problem), spread_for_goal(problem, settings)]))
    close_in(pool, settings, rng, deadline)
    if pool.best_is_poor(deadline, settings.checks) and time.monotonic() < deadline:
        # Good poses are rare: where the grasps that would tempt the person are just out of reach.
        pool.add(spread_for_goal(problem, replace(settings, screened=settings.screened_again, spread=10**9)))
        close_in(pool, settings, rng, deadline)
    report.stopped = time.monotonic() > deadline
    entries = pool.best(wanted, deadline, 4 * settings.checks)
    report.candidates = [pool.candidate(entry) for entry in entries]
    report.seconds = time.monotonic() - started
    return report


def close_in(pool: Pool, settings: SearchSettings, rng: np.random.Generator, deadline: float) -> None:
    """Look around the best candidates that the robot reaches, ever nearer to them."""
    space, model = pool.problem.space, pool.problem.model
    for number, (length, angle) in enumerate(zip(settings.lengths, settings.angles, strict=True)):
        if time.monotonic() > deadline:
            return
        elites = pool.best(settings.elites, deadline, settings.checks, 2.0 * length, 2.0 * angle)
        if elites:
            centres = np.stack([pool.point(entry) for entry in elites])
            scatter = np.array([length, length, length, angle, angle, angle])
            parents = centres[np.arange(settings.children) % len(centres)]
            children = space.clip(model, parents + scatter * rng.normal(size=parents.shape))
        else:
            children = space.spread(model, 2 * settings.spread, settings.seed + 1 + number)
        pool.add(children)


def exhaustive(
    problem: Problem, robot: Robot | None = None, spacing: float = 0.1, angle: float = 0.55, attempts: int = 3
) -> SearchReport:
    """Return the best candidate of a regular grid of poses, found by looking at every one of them: the oracle.

    Args:
        problem: What is to be decided.
        robot: As for ``search``.
        spacing: Between neighbouring positions [m].
        angle: Between neighbouring directions [rad].
        attempts: Robot grasps tried for one pose.
    """
    started = time.monotonic()
    report = SearchReport()
    pool = Pool(problem, robot, attempts, report)
    points = problem.space.grid(problem.model, spacing, angle)
    for start in range(0, len(points), CHUNK):
        pool.add(points[start : start + CHUNK])
    report.candidates = [pool.candidate(entry) for entry in pool.best(1, np.inf, 10**9)]
    report.seconds = time.monotonic() - started
    return report


def good_at_goal(problem: Problem) -> BoolArray:
    """Return which few grasps are best at the goal (grasps,)."""
    later = np.broadcast_to(problem.goal.mean, (len(problem.grasps),))
    good = np.zeros(len(later), dtype=bool)
    good[np.argsort(later, kind="stable")[:GOOD_GRASPS]] = True
    return good & (later <= later.min() + GOOD_SHARE * (later.max() - later.min()) + 1e-12)


def spread_for_goal(problem: Problem, settings: SearchSettings) -> FloatArray:
    """Return poses (n, 6) spread over the space; with a goal, those of many more at which its best grasps are good.

    A grasp that is bad at the goal costs so much that a good offer leaves the person others: a look at the few grasps
    that are best there tells which poses are worth a look at all grasps.
    """
    space, model = problem.space, problem.model
    if problem.goal.table is None:
        return space.spread(model, settings.spread, settings.seed)
    later, kept = np.asarray(problem.goal.mean), good_at_goal(problem)
    points = space.spread(model, settings.screened, settings.seed)
    poses = space.transforms(model, points)
    allowed = space.allowed(model, poses)
    points, poses = points[allowed], poses[allowed]
    few = problem.grasps.subset(kept)
    table = statistics(problem.taker, few, poses, problem.choice.hand_rationality)
    bound = (np.where(table[..., MEASURE] > 0.0, table[..., MEAN], np.inf) + later[kept]).min(axis=1)
    best = np.argsort(bound, kind="stable")[: settings.spread]
    return points[best[np.isfinite(bound[best])]]


def suggested(problem: Problem) -> FloatArray:
    """Return the poses (n, 6) that put each grasp into a comfortable hand, turned upright where the object must be."""
    model, space, grasps = problem.model, problem.space, problem.grasps
    found = []
    for number, hand in enumerate(problem.comfortable):
        poses = hand @ invert_transform(grasps.poses[number])
        points = space.points_of(model, poses)
        # Turned upright about the hand, so that the hand stays.
        turned = space.transforms(model, points)
        offsets = hand[:3, 3] - (np.einsum("nij,nj->ni", turned[:, :3, :3], grasps.poses[number][:, :3, 3]))
        points[:, :3] += offsets - turned[:, :3, 3]
        found.append(space.clip(model, points))
    return np.concatenate(found)
