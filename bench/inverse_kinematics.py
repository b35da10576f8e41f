"""Inverse kinematics of the arm: the best posture of a hand pose, against EAIK and ssik on the same arm and poses.

Half of the poses are those of random postures within the limits, half are random in the reach. Ours gives the posture
of least cost (3.2), among all there are. EAIK solves arms of six joints: one of the seven is locked at 32 or 2,048
values across its limits; which one is chosen on the very poses it is judged by, the one that misses fewest. ssik gives
the arcs of the self-motion that are within the limits. Times are CPU times of one thread: of the peers the time until
their answers can be read, without checking limits and choosing, which ours contains.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from handover_ros.arm.inverse_kinematics import LEAST_CHUNK, best_postures
from handover_ros.arm.model import AXES, Arm, load_arm
from handover_ros.geometry import FloatArray

ROUNDS = 5
FEW, MANY = 32, 2048  # values of the locked joint
LOCKABLE = (0, 1, 2, 4, 5, 6)  # with the elbow locked the distance of shoulder and wrist is: no solutions
NEUTRAL = np.array([0.45, 0.2, 0.25, 1.35, 0.3, 0.0, 0.0])  # [rad] as in config/people/adult.yaml
WEIGHTS = np.array([1.0, 1.2, 0.7, 0.6, 0.35, 0.6, 1.0])
CLOSED = 1e-6  # [m] and of a rotation matrix: a peer's posture that misses the pose by more is none
GRID, ZOOMS = 65, 5  # of the search for the least cost along ssik's arcs


def hand_poses(arm: Arm, count: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return torso_from_hand (count, 4, 4) of postures within the limits, and as many random ones in the reach."""
    rng = np.random.default_rng([seed, 1])
    possible = arm.hand_pose(rng.uniform(*arm.limits, size=(count, 7)))
    anywhere = np.tile(np.eye(4), (count, 1, 1))
    anywhere[:, :3, :3] = Rotation.random(count, random_state=rng).as_matrix()
    direction = rng.normal(size=(count, 3))
    distance = (arm.upper_arm + arm.forearm) * np.cbrt(rng.random(count)) / np.linalg.norm(direction, axis=1)
    anywhere[:, :3, 3] = arm.right_shoulder + distance[:, None] * direction  # the wrist
    return possible, anywhere @ arm.segment_from_hand


def offsets(arm: Arm) -> FloatArray:
    """Return the arm's product-of-exponentials offsets (8, 3) [m] between its axes ``AXES``, zero posture."""
    between = np.zeros((8, 3))
    between[0], between[3, 2], between[4, 2] = arm.right_shoulder, -arm.upper_arm, -arm.forearm
    return between


def costs_of(postures: FloatArray) -> FloatArray:
    """Return sum w (q - q*)^2 (k,) of postures (k, 7)."""
    return np.asarray(((postures - NEUTRAL) ** 2) @ WEIGHTS)


def least_cost(arm: Arm, pose: FloatArray, postures: FloatArray) -> float:
    """Return the least cost of a peer's postures (k, 7) that are within the limits and put the hand at the pose."""
    middle = arm.limits.mean(axis=0)
    postures = postures - 2.0 * np.pi * np.round((postures - middle) / (2.0 * np.pi))
    costs = np.where(arm.within_limits(postures), costs_of(postures), np.inf)
    for index in np.argsort(costs):
        if not np.isfinite(costs[index]):
            break
        if np.abs(arm.hand_pose(postures[index]) - pose).max() < CLOSED:
            return float(costs[index])
    return np.inf


class LockedArm:
    """EAIK with one joint at each of many values.

    Args:
        eaik: The module of its product-of-exponentials robots.
        arm: A right arm.
        joint: Which is locked.
        count: At how many values, in the middles of equal parts of its range.
    """

    def __init__(self, eaik: Any, arm: Arm, joint: int, count: int) -> None:
        low, high = arm.limits[:, joint]
        values = low + (np.arange(count) + 0.5) / count * (high - low)
        self.robots = [eaik.HPRobot(AXES, offsets(arm), [(joint, float(value))]) for value in values]
        self.arm, self.joint = arm, joint
        if not self.robots[0].hasKnownDecomposition():
            raise SystemExit(f"EAIK cannot solve the arm with joint {joint} locked")

    def solve(self, segment_pose: FloatArray) -> list[tuple[Any, Any]]:
        """Return postures and which of them are only nearest, of each value, as EAIK gives them."""
        answers = [robot.IK(segment_pose) for robot in self.robots]
        return [(answer.Q, answer.is_LS) for answer in answers]

    def least_costs(self, poses: FloatArray) -> FloatArray:
        """Return the least cost (n,) at hand poses (n, 4, 4); inf: not found."""
        result = np.full(len(poses), np.inf)
        for index, (pose, segment_pose) in enumerate(zip(poses, self.arm.segment_poses(poses))):
            rows = [q for many, nearest in self.solve(segment_pose) for q, flag in zip(many, nearest) if not flag]
            if rows:
                result[index] = least_cost(self.arm, pose, np.array(rows))
        return result


class SelfMotions:
    """ssik's charts of the self-motion within the limits.

    Args:
        ssik: The module.
        arm: A right arm.
    """

    def __init__(self, ssik: Any, arm: Arm) -> None:
        self.manipulator = ssik.Manipulator.from_axes(AXES, offsets(arm), limits=arm.limits.T)
        self.arm = arm

    def solve(self, segment_pose: FloatArray) -> list[tuple[Any, tuple[tuple[float, float], ...]]]:
        """Return its charts and their arcs within the limits."""
        return [(chart, chart.in_limits()) for chart in self.manipulator.self_motion(segment_pose)]

    def least_costs(self, poses: FloatArray) -> FloatArray:
        """Return the least cost (n,) at hand poses (n, 4, 4); inf: not found."""
        result = np.full(len(poses), np.inf)
        for index, (pose, segment_pose) in enumerate(zip(poses, self.arm.segment_poses(poses))):
            for chart, arcs in self.solve(segment_pose):
                for start, end in arcs:
                    result[index] = min(result[index], self._along(chart, start, end, pose))
        return result

    def _along(self, chart: Any, start: float, end: float, pose: FloatArray) -> float:
        """Return the least cost along an arc: a grid, then ever finer ones about the best."""
        best, low, high = np.inf, start, end
        middle = self.arm.limits.mean(axis=0)
        for _ in range(ZOOMS):
            places = np.linspace(low, high, GRID)
            postures = chart.q(places)
            postures = postures - 2.0 * np.pi * np.round((postures - middle) / (2.0 * np.pi))
            costs = np.where(self.arm.within_limits(postures), costs_of(postures), np.inf)
            best = min(best, least_cost(self.arm, pose, postures))
            around = int(np.argmin(costs))
            low, high = places[max(around - 1, 0)], places[min(around + 1, GRID - 1)]
        return best


def microseconds(work: Callable[[], object], poses: int) -> float:
    """Return the CPU time of a piece of work for each of its poses [us]."""
    begun = time.process_time()
    work()
    return 1e6 * (time.process_time() - begun) / poses


def in_one_thread(arm: Arm, poses: FloatArray, repeats: int) -> None:
    """Find the best postures, few at a time, so that no other thread takes part."""
    for _ in range(repeats):
        for first in range(0, len(poses), LEAST_CHUNK):
            best_postures(arm, poses[first : first + LEAST_CHUNK], NEUTRAL, WEIGHTS)


def measure(seed: int, quick: bool, eaik: ModuleType | None, ssik: ModuleType | None) -> dict[str, float]:
    """Return the metrics of the arm's inverse kinematics; NaN: the peer is not there."""
    arm = load_arm("adult", "right")
    possible, anywhere = hand_poses(arm, 60 if quick else 300, seed)
    poses = np.concatenate([possible, anywhere])
    begun = time.perf_counter()
    postures, costs = best_postures(arm, poses, NEUTRAL, WEIGHTS)
    metrics = {"ik_warm_up_s": time.perf_counter() - begun}
    found = np.isfinite(costs)
    metrics["ik_share_feasible"] = float(found.mean())
    metrics["ik_fk_error"] = float(np.abs(arm.hand_pose(postures[found]) - poses[found]).max())
    locked = locked_arm(eaik, arm, poses) if eaik is not None else None
    motions = SelfMotions(ssik, arm) if ssik is not None else None
    segments = arm.segment_poses(poses)
    timed: dict[str, list[float]] = {"ours": [], "feasible": [], "eaik": [], "ssik": []}
    for _ in range(ROUNDS):
        timed["ours"].append(microseconds(lambda: in_one_thread(arm, poses, 20), 20 * len(poses)))
        timed["feasible"].append(microseconds(lambda: in_one_thread(arm, possible, 20), 20 * len(possible)))
        if locked is not None:
            solve = locked.solve
            timed["eaik"].append(microseconds(lambda solve=solve: [solve(each) for each in segments], len(poses)))
    if motions is not None:
        follow = motions.solve
        timed["ssik"].append(microseconds(lambda: [follow(each) for each in segments], len(poses)))
    metrics["ik_us_per_pose"] = min(timed["ours"])
    metrics["ik_us_per_pose_feasible"] = min(timed["feasible"])
    metrics["eaik32_us_per_pose"] = min(timed["eaik"], default=np.nan)
    metrics["ik_speed_over_eaik32"] = metrics["eaik32_us_per_pose"] / metrics["ik_us_per_pose"]
    metrics["ssik_us_per_pose"] = min(timed["ssik"], default=np.nan)
    return {**metrics, **compared(arm, poses, costs, locked, eaik, motions)}


def locked_arm(eaik: Any, arm: Arm, poses: FloatArray) -> LockedArm:
    """Return EAIK's arm with that joint locked at 32 values with which it finds most poses."""
    arms = [LockedArm(eaik, arm, joint, FEW) for joint in LOCKABLE]
    return max(arms, key=lambda each: int(np.isfinite(each.least_costs(poses)).sum()))


def compared(
    arm: Arm, poses: FloatArray, costs: FloatArray, locked: LockedArm | None, eaik: Any, motions: SelfMotions | None
) -> dict[str, float]:
    """Return who misses which poses, and our cost over that of the better peer on the poses that all find."""
    theirs = {}
    if locked is not None:
        theirs["eaik32"] = locked.least_costs(poses)
        theirs["eaik2048"] = LockedArm(eaik, arm, locked.joint, MANY).least_costs(poses)
    if motions is not None:
        theirs["ssik"] = motions.least_costs(poses)
    ours = np.isfinite(costs)
    metrics = {}
    for name in ("eaik32", "eaik2048", "ssik"):
        answers = theirs.get(name)
        metrics[f"{name}_poses_missed"] = (
            np.nan if answers is None else float(np.count_nonzero(ours & ~np.isfinite(answers)))
        )
    metrics["ik_poses_missed"] = metrics["ik_cost_over_best_peer"] = np.nan
    if theirs:
        table = np.array(list(theirs.values()))
        metrics["ik_poses_missed"] = float(np.count_nonzero(~ours & np.isfinite(table).any(axis=0)))
        complete = [values for name, values in theirs.items() if name != "eaik32"]
        all_find = ours & np.isfinite(complete).all(axis=0)
        metrics["ik_cost_over_best_peer"] = float(costs[all_find].mean() / np.min(complete, axis=0)[all_find].mean())
    return metrics
