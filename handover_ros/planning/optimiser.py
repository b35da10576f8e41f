"""The optimiser of a handover: which robot grasp, and at which pose the object is offered (Bestick 2017, section 3.4).

Two modes over the same objective. ``exhaustive`` looks at every pose of a grid, as the dissertation did: the oracle.
``search`` is for a robot that waits: it starts from poses that a comfortable hand suggests and from an even spread,
then closes in around the best ones, and asks the robot about its reach only from the best candidate on. It can be
stopped at any time and then has its best so far.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from handover_ros.geometry import FloatArray, invert_transform
from handover_ros.planning.candidate_pool import CandidatePool
from handover_ros.planning.choice import MEAN, MEASURE
from handover_ros.planning.feasible import statistics
from handover_ros.planning.problem import Problem, Robot, SearchReport, good_at_goal

BESIDE_THE_WAY = 0.3  # of the scatter
CHUNK = 2000  # poses looked at together in the exhaustive mode


@dataclass(frozen=True)
class SearchSettings:
    """How the online mode searches.

    Attributes:
        spread: Poses of the first, even spread.
        screened: Poses from which these are chosen when there is a goal.
        screened_again: The same when the best that was found is poor,
        spread_again: and the poses of that spread.
        elites: Best candidates around which the next poses lie, in each round.
        children: Poses around all of them in one round.
        tried: Times as many are drawn, in case the robot does not reach them.
        lengths: Scatter of each round's positions [m].
        angles: Scatter of its angles [rad]; as many.
        checks: How often the robot is asked in one round, about.
        attempts: Robot grasps tried for one pose.
        seed: Of the scatter.
    """

    spread: int = 128
    screened: int = 1024
    screened_again: int = 16384
    spread_again: int = 512
    elites: tuple[int, ...] = (8, 6, 4, 3, 2, 2)
    children: int = 44
    tried: int = 2
    lengths: tuple[float, ...] = (0.10, 0.05, 0.025, 0.012, 0.006, 0.003)
    angles: tuple[float, ...] = (0.5, 0.25, 0.12, 0.06, 0.03, 0.015)
    checks: int = 64
    attempts: int = 2
    seed: int = 0


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
    pool = CandidatePool(problem, robot, settings.attempts, report)
    rng = np.random.default_rng(settings.seed)
    spread = spread_for_goal(problem, settings)
    half = settings.spread // 2
    pool.add(np.concatenate([suggested(problem), spread[:half]]), spread[half:], half)
    close_in(pool, settings, rng, deadline)
    if pool.best_is_far_from_free(deadline, settings.checks) and time.monotonic() < deadline:
        close_in(pool, settings, rng, deadline)  # the robot's reach has many edges: look along them once more
    if pool.best_is_poor(deadline, settings.checks) and time.monotonic() < deadline:
        # Good poses are rare: where the grasps that would tempt the person are just out of reach.
        pool.add(np.empty((0, 6)), spread_for_goal(problem, settings, settings.screened_again), settings.spread_again)
        close_in(pool, settings, rng, deadline)
    report.stopped = time.monotonic() > deadline
    entries = pool.best(wanted, deadline, 2 * settings.checks)
    report.candidates = [pool.candidate(entry) for entry in entries]
    report.seconds = time.monotonic() - started
    return report


def close_in(pool: CandidatePool, settings: SearchSettings, rng: np.random.Generator, deadline: float) -> None:
    """Look around the best candidates that the robot reaches, ever nearer to them."""
    space, model = pool.problem.space, pool.problem.model
    for number, (length, angle) in enumerate(zip(settings.lengths, settings.angles, strict=True)):
        if time.monotonic() > deadline:
            return
        elites = pool.best(settings.elites[number], deadline, settings.checks, 2.0 * length, 2.0 * angle)
        if elites:
            scatter = np.array([length, length, length, angle, angle, angle])
            lured, around = _children(pool, elites, scatter, settings, rng)
            pool.add(space.clip(model, lured), space.clip(model, around), settings.children - len(lured))
        else:
            pool.add(space.spread(model, 2 * settings.spread, settings.seed + 1 + number))


def _children(
    pool: CandidatePool, elites: list[int], scatter: FloatArray, settings: SearchSettings, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return poses (n, 6) on the way from the elites to poses that are better still, and (m, 6) scattered around them.

    The better ones the robot does not reach: the best that it reaches lies at the edge of its reach, between the two.
    """
    parents = np.stack([pool.point(entry) for entry in elites])
    lures = pool.better_than(elites[0], len(elites) + 1)
    number = settings.children // 2 if len(lures) else 0
    starts = parents[np.arange(number) % len(parents)]
    way = lures[rng.integers(len(lures), size=number)] - starts if number else starts
    way[:, 3:] = (way[:, 3:] + np.pi) % (2.0 * np.pi) - np.pi
    lured = starts + rng.uniform(size=(number, 1)) * way + BESIDE_THE_WAY * scatter * rng.normal(size=starts.shape)
    starts = parents[np.arange(settings.tried * (settings.children - number)) % len(parents)]
    return lured, starts + scatter * rng.normal(size=starts.shape)


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
    pool = CandidatePool(problem, robot, attempts, report)
    points = problem.space.grid(problem.model, spacing, angle)
    for start in range(0, len(points), CHUNK):
        pool.add(points[start : start + CHUNK])
    report.candidates = [pool.candidate(entry) for entry in pool.best(1, np.inf, 10**9)]
    report.seconds = time.monotonic() - started
    return report


def spread_for_goal(problem: Problem, settings: SearchSettings, screened: int = 0) -> FloatArray:
    """Return poses (n, 6) spread over the space; with a goal, ordered by how good its best grasps may be there.

    A grasp that is bad at the goal costs so much that a good offer leaves the person others: a look at the few grasps
    that are best there tells which poses are worth a look at all grasps.

    Args:
        problem: What is to be decided.
        settings: How to search.
        screened: Number of poses with a goal; 0: as the settings say.
    """
    space, model = problem.space, problem.model
    if problem.goal.table is None:
        return space.spread(model, settings.spread, settings.seed)
    later, kept = np.asarray(problem.goal.mean), good_at_goal(problem)
    points = space.spread(model, screened or settings.screened, settings.seed)
    poses = space.transforms(model, points)
    allowed = space.allowed(model, poses)
    points, poses = points[allowed], poses[allowed]
    few = problem.grasps.subset(kept)
    table = statistics(problem.taker, few, poses, problem.choice.hand_rationality)
    bound = (np.where(table[..., MEASURE] > 0.0, table[..., MEAN], np.inf) + later[kept]).min(axis=1)
    return points[np.argsort(bound, kind="stable")[: int(np.isfinite(bound).sum())]]


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
