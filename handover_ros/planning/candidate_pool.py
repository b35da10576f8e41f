"""All poses that a search has looked at: which are best, and which of those the robot can be at."""

from __future__ import annotations

import time

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.planning.choice import grasp_probabilities
from handover_ros.planning.feasible import statistics
from handover_ros.planning.problem import (
    BoolArray,
    Candidate,
    IntArray,
    Problem,
    Robot,
    SearchReport,
    good_at_goal,
    ways_of,
)

# Why poses are refused for the robot's sake.
BEYOND_ARM = "beyond the robot's arm, or its gripper on the person's side"
BEYOND_LIMITS = "out of the robot's reach or limits"
IN_THE_WAY = "the robot would collide there, or cannot pick the object up so"
NEARBY = 0.15  # share of the distance between elites within which the robot's reach is the same, most probably
FAR_FROM_FREE = 0.15  # relative
BATCH = 48  # entries for which the robot is asked together


class CandidatePool:
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
        self._strains = np.empty(0)  # of the entries: how far the robot's arm is stretched at least [m]
        self._known: dict[int, int] = {}  # entry -> robot grasp that reaches it, -1: none does
        self._kinematic: dict[int, int] = {}  # the same, collisions aside

    def add(self, points: FloatArray) -> None:
        """Look at poses (n, 6)."""
        problem, report = self.problem, self.report
        poses = problem.space.transforms(problem.model, points)
        report.poses += len(points)
        kept = problem.space.allowed(problem.model, poses, report.refused)
        points, poses = points[kept], poses[kept]
        ways = ways_of(problem, self._robot, poses)
        table = statistics(problem.taker, problem.grasps, poses, problem.choice.hand_rationality)
        values = problem.objective(table, problem.goal, problem.choice, self._masks)
        feasible = np.isfinite(values)
        report.refused["no grasp in the person's reach"] += int((~feasible).all(axis=1).sum())
        kinds = np.arange(len(self._masks))[:, None]
        strains = np.where(self._kind == kinds, ways[:, None], np.inf).min(axis=2)
        report.refused[BEYOND_ARM] += int((feasible & ~np.isfinite(strains)).any(axis=1).sum())
        values[~np.isfinite(strains)] = np.inf
        self._points += list(points)
        self._poses += list(poses)
        self._tables += list(table)
        self._stretches += list(ways)
        self._values = np.concatenate([self._values, values.ravel()])
        self._strains = np.concatenate([self._strains, strains.ravel()])

    def best(
        self, wanted: int, deadline: float, most_checks: int, apart: float = 0.0, turned: float = 0.0
    ) -> list[int]:
        """Return entries that the robot reaches, the best first, at most one a pose; asks the robot as it goes.

        Any two are more than ``apart`` [m] or ``turned`` [rad] away from each other.
        """
        kinds = len(self._masks)
        points = np.array(self._points)
        left = np.ones((len(points), kinds), dtype=bool)  # entries that may still be taken
        found: list[int] = []
        asked = self.report.robot_checks
        order = self._order(shared=bool(apart))
        for place, entry in enumerate(order):
            pose, kind = divmod(entry, kinds)
            if len(found) == wanted:
                break
            if not left[pose, kind]:
                continue
            if entry not in self._known:
                checks = self.report.robot_checks - asked
                if checks and time.monotonic() > deadline:
                    continue
                if entry not in self._kinematic:
                    if checks >= most_checks:
                        continue
                    self._ask_ahead([each for each in order[place:] if left[divmod(each, kinds)]])
                self._known[entry] = self._reaching(entry)
            if self._known[entry] >= 0:
                found.append(entry)
                left[pose] = False
                if apart:
                    left[_beside(points, points[pose], apart, turned)] = False
            elif apart:  # where the robot cannot be it cannot be nearby either, most probably: look elsewhere first
                left[_beside(points, points[pose], NEARBY * apart, NEARBY * turned), kind] = False
        return sorted(found, key=lambda entry: float(self._values[entry]))

    def _ask_ahead(self, entries: list[int]) -> None:
        """Find out for the first of some entries with which grasp, if any, the robot's arm gets there."""
        waiting = [entry for entry in entries if entry not in self._kinematic][:BATCH]
        kinds = len(self._masks)
        for entry in waiting:
            self._kinematic[entry] = -1
        for attempt in range(self._attempts):
            rows = {entry: self._rows(entry) for entry in waiting if self._kinematic[entry] < 0}
            tried = [(entry, row[attempt]) for entry, row in rows.items() if len(row) > attempt]
            if not tried:
                break
            self.report.robot_checks += len(tried)
            ok = np.ones(len(tried), dtype=bool)
            if self._robot is not None:
                poses = np.stack([self._poses[entry // kinds] for entry, _ in tried])
                ok = self._robot.kinematic(poses, np.array([row for _, row in tried], dtype=np.int64))
            for (entry, row), reached in zip(tried, ok):
                if reached:
                    self._kinematic[entry] = int(row)

    def _rows(self, entry: int) -> IntArray:
        """Return the robot grasps of an entry; the less one stretches the arm the more likely it gets there."""
        pose, kind = divmod(entry, len(self._masks))
        stretches = np.where(self._kind == kind, self._stretches[pose], np.inf)
        rows = np.flatnonzero(np.isfinite(stretches))
        return np.asarray(rows[np.argsort(stretches[rows], kind="stable")])

    def _order(self, shared: bool) -> list[int]:
        """Return the feasible entries, the best first; shared: in turn with those that do not stretch the arm."""
        feasible = np.isfinite(self._values)
        order = np.argsort(self._values, kind="stable")[: int(feasible.sum())]
        if not shared or self._robot is None or not len(order):
            return [int(entry) for entry in order]
        easy = order[self._strains[order] <= np.median(self._strains[order])]
        both = np.empty(2 * len(easy), dtype=np.int64)
        both[::2], both[1::2] = order[: len(easy)], easy
        return list(dict.fromkeys([*both.tolist(), *order.tolist()]))

    def better_than(self, entry: int, wanted: int) -> FloatArray:
        """Return the poses (n, 6) of the best entries that are better than one, which the robot does not reach."""
        order = np.argsort(self._values, kind="stable")[:wanted]
        better = [int(each) for each in order if self._values[each] < self._values[entry]]
        return np.array([self.point(each) for each in better]).reshape(-1, 6)

    def best_is_far_from_free(self, deadline: float, most_checks: int) -> bool:
        """Return whether the best the robot reaches is much dearer than the best of all."""
        if self._robot is None or not np.isfinite(self._values).any():
            return False
        entries = self.best(1, deadline, most_checks)
        least = float(self._values.min())
        return not entries or float(self._values[entries[0]]) > least + FAR_FROM_FREE * abs(least)

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
        """Return the robot grasp with which the robot can be at an entry, free of collisions, -1: it cannot."""
        row = self._kinematic[entry]
        if row < 0:
            self.report.refused[BEYOND_LIMITS] += 1
        elif self._robot is not None:
            self.report.robot_checks += 1
            if not self._robot.reachable(self._poses[entry // len(self._masks)], row):
                self.report.refused[IN_THE_WAY] += 1
                return -1
        return row

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
