"""All poses that a search has looked at: which are best, and which of those the robot can be at."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.planning import neighbour_kernels
from handover_ros.planning.choice import grasp_probabilities
from handover_ros.planning.feasible import statistics
from handover_ros.planning.problem import (
    Candidate,
    IntArray,
    Problem,
    Robot,
    SearchReport,
    good_at_goal,
    ways_of,
)

kernels: Any = neighbour_kernels  # numba's functions carry no types

# Why poses are refused for the robot's sake.
BEYOND_ARM = "beyond the robot's arm, its gripper on the person's side, or it cannot pick the object up so"
BEYOND_LIMITS = "out of the robot's reach or limits"
IN_THE_WAY = "the robot would collide there"
NEARBY = 0.15  # share of the distance between elites within which the robot's reach is the same, most probably
FAR_FROM_FREE = 0.15  # relative
LOOKS = 3  # sets of free grasps for which the robot is asked whether a pose is worth a look at all
BATCH = 48  # entries for which the robot is asked together


UNKNOWN, NONE = -2, -1  # instead of a robot grasp: not asked yet, and none gets there


class CandidatePool:
    """Everything looked at so far, one entry for each pose and each different set of grasps left free."""

    def __init__(self, problem: Problem, robot: Robot | None, attempts: int, report: SearchReport) -> None:
        self.problem, self.report = problem, report
        self._robot, self._attempts = robot, attempts
        self._masks, kind = np.unique(problem.free, axis=0, return_inverse=True)
        self._grasps = [np.flatnonzero(kind.reshape(-1) == each) for each in range(len(self._masks))]
        kinds = len(self._masks)
        self._points = np.empty((0, 6))
        self._poses = np.empty((0, 4, 4))
        self._tables: list[FloatArray] = []
        # Of the entries, row by row (pose, kind):
        self._values = np.empty((0, kinds))
        self._strains = np.empty((0, kinds))  # how far the robot's arm is stretched at least [m]
        self._rows = np.empty((0, kinds, attempts), dtype=np.int64)  # robot grasps to be tried, NONE: no more
        self._kinematic = np.empty((0, kinds), dtype=np.int64)  # robot grasp that gets there, collisions aside
        self._known = np.empty((0, kinds), dtype=np.int64)  # robot grasp that gets there

    def add(self, points: FloatArray, doubtful: FloatArray | None = None, most: int = 0) -> None:
        """Look at poses (n, 6), and at the first few, ``most``, of doubtful ones (m, 6) that the robot gets to."""
        if doubtful is not None and len(doubtful):
            points = np.concatenate([points, self._first_reached(doubtful, most)])
        problem, report = self.problem, self.report
        poses = problem.space.transforms(problem.model, points)
        report.poses += len(points)
        kept = problem.space.allowed(problem.model, poses, report.refused)
        points, poses = points[kept], poses[kept]
        rows, strains = self._ways(poses)
        within = np.isfinite(strains).any(axis=1)
        report.refused[BEYOND_ARM] += int((~within).sum())
        points, poses, rows, strains = points[within], poses[within], rows[within], strains[within]
        table = statistics(problem.taker, problem.grasps, poses, problem.choice.hand_rationality)
        values = problem.objective(table, problem.goal, problem.choice, self._masks)
        report.refused["no grasp in the person's reach"] += int((~np.isfinite(values)).all(axis=1).sum())
        values[~np.isfinite(strains)] = np.inf
        unknown = np.full(values.shape, UNKNOWN, dtype=np.int64)
        self._points = np.concatenate([self._points, points])
        self._poses = np.concatenate([self._poses, poses])
        self._tables += list(table)
        self._values = np.concatenate([self._values, values])
        self._strains = np.concatenate([self._strains, strains])
        self._rows = np.concatenate([self._rows, rows])
        self._kinematic = np.concatenate([self._kinematic, unknown])
        self._known = np.concatenate([self._known, unknown])

    def _first_reached(self, points: FloatArray, most: int) -> FloatArray:
        """Return the first few of poses (n, 6) that the robot's arm gets to, by a look at its easiest ways there."""
        if self._robot is None:
            return points[:most]
        found: list[FloatArray] = []
        for start in range(0, len(points), most):
            part = points[start : start + most]
            poses = self.problem.space.transforms(self.problem.model, part)
            rows, strains = self._ways(poses)
            easiest = np.argsort(strains, axis=1, kind="stable")[:, :LOOKS]
            tried = np.take_along_axis(rows[:, :, 0], easiest, axis=1)
            reached = np.zeros(len(part), dtype=bool)
            for look in range(tried.shape[1]):
                asked = np.flatnonzero((tried[:, look] != NONE) & ~reached)
                if len(asked):
                    reached[asked] = self._robot.kinematic(poses[asked], tried[asked, look])
                    self.report.robot_checks += len(asked)
            found.append(part[reached])
            if sum(map(len, found)) >= most:
                break
        return np.concatenate(found)[:most]

    def _ways(self, poses: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return the robot grasps to be tried (n, kinds, attempts), and the least stretch of the arm (n, kinds) [m].

        The less a grasp stretches the arm the more likely it gets there.
        """
        ways = ways_of(self.problem, self._robot, poses)
        rows = np.full((len(poses), len(self._grasps), self._attempts), NONE, dtype=np.int64)
        strains = np.empty((len(poses), len(self._grasps)))
        for kind, grasps in enumerate(self._grasps):
            own = ways[:, grasps]
            order = np.argsort(own, axis=1, kind="stable")[:, : self._attempts]
            stretches = np.take_along_axis(own, order, axis=1)
            rows[:, kind, : order.shape[1]] = np.where(np.isfinite(stretches), grasps[order], NONE)
            strains[:, kind] = stretches[:, 0]
        return rows, strains

    def best(
        self, wanted: int, deadline: float, most_checks: int, apart: float = 0.0, turned: float = 0.0
    ) -> list[int]:
        """Return entries that the robot reaches, the best first, at most one a pose; asks the robot as it goes.

        Any two are more than ``apart`` [m] or ``turned`` [rad] away from each other.
        """
        kinds = len(self._masks)
        left = np.ones(self._values.shape, dtype=bool)  # entries that may still be taken
        flat, known, kinematic = left.ravel(), self._known.ravel(), self._kinematic.ravel()
        found: list[int] = []
        asked = self.report.robot_checks
        order = self._order(shared=bool(apart))
        for place, entry in enumerate(order.tolist()):
            if len(found) == wanted:
                break
            if not flat[entry]:
                continue
            pose, kind = divmod(entry, kinds)
            if known[entry] == UNKNOWN:
                checks = self.report.robot_checks - asked
                if checks and time.monotonic() > deadline:
                    continue
                if kinematic[entry] == UNKNOWN:
                    if checks >= most_checks:
                        continue
                    waiting = order[place:]
                    self._ask_ahead(waiting[flat[waiting] & (kinematic[waiting] == UNKNOWN)][:BATCH])
                known[entry] = self._reaching(entry)
            if known[entry] >= 0:
                found.append(entry)
                left[pose] = False
                if apart:
                    kernels.strike(self._points, self._points[pose], apart, turned, -1, left)
            elif apart:  # where the robot cannot be it cannot be nearby either, most probably: look elsewhere first
                kernels.strike(self._points, self._points[pose], NEARBY * apart, NEARBY * turned, kind, left)
        return sorted(found, key=lambda entry: float(self._values.flat[entry]))

    def _ask_ahead(self, entries: IntArray) -> None:
        """Find out for some entries with which grasp, if any, the robot's arm gets there."""
        poses, kinds = np.divmod(entries, len(self._masks))
        self._kinematic[poses, kinds] = NONE
        for attempt in range(self._attempts):
            rows = self._rows[poses, kinds, attempt]
            tried = (rows != NONE) & (self._kinematic[poses, kinds] == NONE)
            if not tried.any():
                break
            self.report.robot_checks += int(tried.sum())
            ok = np.ones(int(tried.sum()), dtype=bool)
            if self._robot is not None:
                ok = self._robot.kinematic(self._poses[poses[tried]], rows[tried])
            self._kinematic[poses[tried], kinds[tried]] = np.where(ok, rows[tried], NONE)

    def _order(self, shared: bool) -> IntArray:
        """Return the feasible entries, the best first; shared: in turn with those that do not stretch the arm."""
        values, strains = self._values.ravel(), self._strains.ravel()
        order = np.argsort(values, kind="stable")[: int(np.isfinite(values).sum())]
        if not shared or self._robot is None or not len(order):
            return order
        easy = order[strains[order] <= np.median(strains[order])]
        places = np.empty(len(values), dtype=np.int64)  # in turn; those that do not stretch the arm come twice: earlier
        places[order] = np.arange(len(order)) + np.minimum(np.arange(len(order)), len(easy))
        places[easy] = np.minimum(places[easy], 2 * np.arange(len(easy)) + 1)
        return order[np.argsort(places[order], kind="stable")]

    def better_than(self, entry: int, wanted: int) -> FloatArray:
        """Return the poses (n, 6) of the best entries that are better than one, which the robot does not reach."""
        values = self._values.ravel()
        order = np.argsort(values, kind="stable")[:wanted]
        return self._points[order[values[order] < values[entry]] // len(self._masks)]

    def best_is_far_from_free(self, deadline: float, most_checks: int) -> bool:
        """Return whether the best the robot reaches is much dearer than the best of all."""
        if self._robot is None or not np.isfinite(self._values).any():
            return False
        entries = self.best(1, deadline, most_checks)
        least = float(self._values.min())
        return not entries or float(self._values.flat[entries[0]]) > least + FAR_FROM_FREE * abs(least)

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
        """Return the robot grasp with which the robot can be at an entry, free of collisions, NONE: it cannot."""
        first = int(self._kinematic.flat[entry])
        if first == NONE:
            self.report.refused[BEYOND_LIMITS] += 1
        if first == NONE or self._robot is None:
            return first
        pose, kind = divmod(entry, len(self._masks))
        rows = self._rows[pose, kind].tolist()
        for row in rows[rows.index(first) :]:
            if row == NONE:
                break
            self.report.robot_checks += 1
            if self._robot.reachable(self._poses[pose], row):
                return int(row)
        self.report.refused[IN_THE_WAY] += 1
        return NONE

    def point(self, entry: int) -> FloatArray:
        """Return the pose (6,) of an entry."""
        return self._points[entry // len(self._masks)]

    def candidate(self, entry: int) -> Candidate:
        """Return an entry that the robot is known to reach."""
        pose = entry // len(self._masks)
        return Candidate(
            float(self._values.flat[entry]),
            self._points[pose],
            self._poses[pose],
            int(self._known.flat[entry]),
            self._tables[pose],
        )
