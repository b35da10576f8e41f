"""Collision-free joint paths: straight if that is free, else RRT-Connect with shortcuts; straight lines of the gripper.

RRT-Connect: J. Kuffner, S. LaValle, "RRT-Connect: an efficient approach to single-query path planning", ICRA 2000.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from handover_ros.geometry import FloatArray
from handover_ros.robot.inverse_kinematics import InverseKinematics

#: Tells whether displacements (n,) [rad] are usable.
Validity = Callable[[FloatArray], bool]

LARGEST_JUMP = 0.4  # [rad] a joint may change between neighbours of a Cartesian line; more is another branch


@dataclass(frozen=True)
class PathSettings:
    """How a joint path is searched.

    Attributes:
        resolution: Largest joint change between two checked configurations [rad].
        extension: Longest new edge of the trees [rad].
        iterations: Samples tried; the limit that keeps the result independent of the machine's speed.
        shortcuts: Shortcuts tried on a found path.
    """

    resolution: float = 0.04
    extension: float = 0.6
    iterations: int = 2000
    shortcuts: int = 60


def segment_is_free(valid: Validity, start: FloatArray, end: FloatArray, resolution: float) -> bool:
    """Return whether the straight joint line is valid everywhere but at ``start``, checked at ``resolution`` [rad].

    The middle is checked first, where a collision is most likely.
    """
    count = max(1, int(np.ceil(np.max(np.abs(end - start)) / resolution)))
    fractions = np.arange(1, count + 1) / count
    return all(valid(start + fraction * (end - start)) for fraction in fractions[_bisection_order(count)])


def plan_path(
    valid: Validity,
    start: FloatArray,
    goal: FloatArray,
    limits: tuple[FloatArray, FloatArray],
    rng: np.random.Generator,
    deadline: float,
    settings: PathSettings | None = None,
) -> FloatArray | None:
    """Return a valid piecewise straight joint path (k, n) from ``start`` to ``goal`` [rad], or None.

    Args:
        valid: Which displacements may be used; must hold at ``start``.
        start: Displacements (n,) at the start.
        goal: Displacements (n,) at the end.
        limits: Lower and upper position limits (n,).
        rng: Source of the samples.
        deadline: Time of ``time.monotonic`` [s] at which the search gives up.
        settings: How to search.
    """
    how = settings or PathSettings()
    if not valid(goal):
        return None
    if segment_is_free(valid, start, goal, how.resolution):
        return np.stack([start, goal])
    path = _connect(valid, start, goal, limits, rng, deadline, how)
    return None if path is None else shorten(valid, path, rng, deadline, how)


def shorten(
    valid: Validity, path: FloatArray, rng: np.random.Generator, deadline: float, settings: PathSettings
) -> FloatArray:
    """Return a path with the same ends and no longer than ``path`` (k, n): random shortcuts between its points."""
    points = list(path)
    for _ in range(settings.shortcuts):
        if len(points) <= 2 or time.monotonic() > deadline:
            break
        i, j = sorted(rng.choice(len(points) - 1, size=2, replace=False))
        first = points[i] + rng.uniform() * (points[i + 1] - points[i]) if i > 0 else points[0]
        last = points[j] + rng.uniform() * (points[j + 1] - points[j]) if j < len(points) - 2 else points[-1]
        between = [*points[i + 1 : j + 1]]
        old = np.sum(np.linalg.norm(np.diff([first, *between, last], axis=0), axis=1))
        if np.linalg.norm(last - first) > 0.98 * old or not segment_is_free(valid, first, last, settings.resolution):
            continue
        head = points[: i + 1] if i > 0 else []
        tail = points[j + 1 :] if j < len(points) - 2 else []
        points = _without_repeats([*head, first, last, *tail])
    return np.stack(points)


def straight_line(
    inverse_kinematics: InverseKinematics,
    valid: Validity,
    start: FloatArray,
    world_from_start: FloatArray,
    world_from_goal: FloatArray,
    step: float = 0.02,
) -> FloatArray | None:
    """Return joint displacements (k, n) that move the gripper straight from one pose to another, or None.

    Positions are interpolated linearly, rotations about one axis. Each point continues the one before it.

    Args:
        inverse_kinematics: Of the arm.
        valid: Which displacements may be used.
        start: Displacements (n,) [rad] at ``world_from_start``.
        world_from_start: First gripper pose. Shape (4, 4).
        world_from_goal: Last gripper pose. Shape (4, 4).
        step: Distance between neighbours [m]; rotations count 0.3 m a radian.
    """
    turn = Rotation.from_matrix(world_from_start[:3, :3].T @ world_from_goal[:3, :3]).as_rotvec()
    length = float(np.linalg.norm(world_from_goal[:3, 3] - world_from_start[:3, 3]) + 0.3 * np.linalg.norm(turn))
    points = [np.asarray(start, dtype=float)]
    for fraction in np.linspace(0.0, 1.0, max(2, int(np.ceil(length / step)) + 1))[1:]:
        pose = np.array(world_from_start)
        pose[:3, :3] = world_from_start[:3, :3] @ Rotation.from_rotvec(fraction * turn).as_matrix()
        pose[:3, 3] += fraction * (world_from_goal[:3, 3] - world_from_start[:3, 3])
        solution = inverse_kinematics.follow(pose, points[-1])
        if solution is None or np.max(np.abs(solution - points[-1])) > LARGEST_JUMP or not valid(solution):
            return None
        points.append(solution)
    return np.stack(points)


def _bisection_order(count: int) -> list[int]:
    """Return 0 ... count-1 with the last first (the end is checked at once), then middles of ever smaller parts."""
    order, parts = [count - 1], [(0, count - 1)]
    while parts:
        remaining = []
        for low, high in parts:
            if low < high:
                middle = (low + high) // 2
                order.append(middle)
                remaining += [(low, middle), (middle + 1, high)]
        parts = remaining
    return order


def _without_repeats(points: list[FloatArray]) -> list[FloatArray]:
    """Return the points without neighbours that coincide."""
    kept = [points[0]]
    for point in points[1:]:
        if np.max(np.abs(point - kept[-1])) > 1e-9:
            kept.append(point)
    return kept


class _Tree:
    """Tree of configurations, grown from one end of the path."""

    def __init__(self, root: FloatArray, capacity: int) -> None:
        self.nodes = np.empty((capacity, len(root)))
        self.nodes[0] = root
        self.parents = [-1]

    def nearest(self, target: FloatArray) -> int:
        return int(np.argmin(np.sum((self.nodes[: len(self.parents)] - target) ** 2, axis=1)))

    def add(self, node: FloatArray, parent: int) -> int:
        self.nodes[len(self.parents)] = node
        self.parents.append(parent)
        return len(self.parents) - 1

    def full(self) -> bool:
        return len(self.parents) >= len(self.nodes)

    def branch(self, node: int) -> list[FloatArray]:
        """Return the nodes from ``node`` back to the root."""
        points = []
        while node >= 0:
            points.append(self.nodes[node])
            node = self.parents[node]
        return points


def _connect(
    valid: Validity,
    start: FloatArray,
    goal: FloatArray,
    limits: tuple[FloatArray, FloatArray],
    rng: np.random.Generator,
    deadline: float,
    how: PathSettings,
) -> FloatArray | None:
    """Grow a tree from each end until they meet; return the path (k, n) or None."""
    capacity = 20 * how.iterations
    trees = (_Tree(start, capacity), _Tree(goal, capacity))
    for iteration in range(how.iterations):
        if time.monotonic() > deadline or trees[0].full() or trees[1].full():
            return None
        growing, other = trees if iteration % 2 == 0 else trees[::-1]
        sample = rng.uniform(*limits)
        reached = _extend(growing, growing.nearest(sample), sample, valid, how)
        if reached is None:
            continue
        target = growing.nodes[reached]
        node: int | None = other.nearest(target)
        while node is not None and np.max(np.abs(other.nodes[node] - target)) > 1e-9 and not other.full():
            node = _extend(other, node, target, valid, how)
        if node is None or other.full():
            continue
        ours, theirs = growing.branch(reached), other.branch(node)
        first, second = (ours, theirs) if growing is trees[0] else (theirs, ours)
        return np.stack(_without_repeats([*first[::-1], *second]))
    return None


def _extend(tree: _Tree, node: int, target: FloatArray, valid: Validity, how: PathSettings) -> int | None:
    """Add one edge from ``node`` towards ``target``; return the new node or None."""
    origin = tree.nodes[node]
    offset = target - origin
    length = float(np.linalg.norm(offset))
    if length < 1e-12:
        return None
    end = target if length <= how.extension else origin + offset * (how.extension / length)
    return tree.add(end, node) if segment_is_free(valid, origin, end, how.resolution) else None
