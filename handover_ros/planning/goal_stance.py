"""Where a person's torso is while they put an object down: the arm alone does not reach a table from everywhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handover_ros.geometry import FloatArray, invert_transform, transform_points
from handover_ros.objects.catalogue import ObjectModel
from handover_ros.planning.choice import LEAST, LOG_WEIGHT, MEAN, MEASURE, PLAIN_MEAN
from handover_ros.planning.facing import object_centre
from handover_ros.planning.feasible import Taker, statistics, statistics_each
from handover_ros.planning.grasp_set import GraspSet
from handover_ros.planning.obstacles import boxes_near, obstacles_of

AHEAD = (0.25, 0.32, 0.40, 0.50)  # [m] from the shoulders to the goal, horizontally
SIDEWAYS = (-0.6, -0.2, 0.2, 0.6)  # [rad] of the goal from straight ahead
STOOP = (0.0, 0.10, 0.20)  # [m] the shoulders come down
STEP_COST, TURN_COST, STOOP_COST = 0.3, 0.1, 5.0  # [1/m], [1/rad], [1/m] against the cost of the arm's posture
TRIED = 3  # stances of a grasp at which what stands around is looked at

Box = tuple[FloatArray, FloatArray]  # lengths (3,) [m], world_from_box (4, 4)


def stances(world_from_torso: FloatArray, place: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return torso frames (n, 4, 4) of a person who stays or turns, steps and stoops, and what that costs (n,).

    Args:
        world_from_torso: Level, where the person stands. Shape (4, 4).
        place: Where to, in the torso frame [m] (3,).
    """
    bearing, distance = float(np.arctan2(place[1], place[0])), float(np.hypot(place[0], place[1]))
    ahead, sideways, stoops = (each.ravel() for each in np.meshgrid(AHEAD, SIDEWAYS, STOOP, indexing="ij"))
    # The first stays where they are.
    turns, steps, stoops = (
        np.append(0.0, each) for each in (bearing - sideways, np.maximum(0.0, distance - ahead), stoops)
    )
    frames = np.tile(np.eye(4), (len(turns), 1, 1))
    frames[:, 0, 0] = frames[:, 1, 1] = np.cos(turns)
    frames[:, 1, 0] = np.sin(turns)
    frames[:, 0, 1] = -frames[:, 1, 0]
    frames[:, :3, 3] = np.stack([steps * np.cos(bearing), steps * np.sin(bearing), -stoops], axis=1)
    return world_from_torso @ frames, STEP_COST * steps + TURN_COST * np.abs(turns) + STOOP_COST * stoops


@dataclass(frozen=True, eq=False)
class Placing:
    """How an object is placed at a goal with each grasp.

    Attributes:
        table: Statistics of the feasible sets (grasps, 5); what legs and back do is added to the costs.
        world_from_torso: Where the torso is with each grasp. Shape (grasps, 4, 4).
    """

    table: FloatArray
    world_from_torso: FloatArray


def placing_from(
    world_from_torso: FloatArray,
    world_from_goal: FloatArray,
    taker: Taker,
    grasps: GraspSet,
    boxes: Sequence[Box],
    rationality: float,
) -> Placing:
    """Return how an object is placed by a person who stays where they are.

    Args:
        world_from_torso: Level. Shape (4, 4).
        world_from_goal: The object's pose at the goal. Shape (4, 4).
        taker: The person.
        grasps: On the object.
        boxes: Of the scene: lengths [m] and world_from_box.
        rationality: Of the choice of the posture there.
    """
    goal, obstacles = invert_transform(world_from_torso) @ world_from_goal, obstacles_of(boxes, world_from_torso)
    table = statistics(taker, grasps, goal, rationality, obstacles)[0]
    return Placing(table, np.tile(world_from_torso, (len(grasps), 1, 1)))


def placing_after_moving(
    world_from_torso: FloatArray,
    world_from_goal: FloatArray,
    taker: Taker,
    grasps: GraspSet,
    model: ObjectModel,
    boxes: Sequence[Box],
    rationality: float,
) -> Placing:
    """Return how an object is placed by a person who turns, steps and stoops as each grasp asks for.

    Args:
        world_from_torso: Level, where the person takes the object. Shape (4, 4).
        world_from_goal: The object's pose at the goal. Shape (4, 4).
        taker: The person.
        grasps: On the object.
        model: The object.
        boxes: Of the scene: lengths [m] and world_from_box.
        rationality: Of the choice of the posture there.
    """
    place = transform_points(invert_transform(world_from_torso) @ world_from_goal, object_centre(model))
    torsos, effort = stances(world_from_torso, place)
    goals = invert_transform(torsos) @ world_from_goal
    free = statistics(taker, grasps, goals, rationality)
    total = free[..., LEAST] + effort[:, None]
    order = np.argsort(total, axis=0, kind="stable")[:TRIED]
    around = obstacles_of(boxes_near(boxes, world_from_goal), np.eye(4))
    chosen, pending = order[0].copy(), np.isfinite(total[order[0], np.arange(len(grasps))])
    table = np.where(pending[:, None], 0.0, free[0])
    table[~pending] = NOT_FEASIBLE
    for row in order:
        if not pending.any():
            break
        asked = np.flatnonzero(pending)
        used, which = np.unique(row[asked], return_inverse=True)
        obstacles = [] if around is None else [around.seen_from(torsos[stance]) for stance in used]
        found = statistics_each(taker, grasps.subset(pending), goals[row[asked]], rationality, obstacles, which)
        can = found[:, MEASURE] > 0.0
        places = asked[can]
        table[places] = _with_effort(found[can], effort[row[places]], rationality)
        chosen[places] = row[places]
        pending[places] = False
    table[pending] = NOT_FEASIBLE
    return Placing(table, torsos[chosen])


# A grasp with which the object cannot be placed.
NOT_FEASIBLE = np.array([0.0, -np.inf, np.inf, np.inf, np.inf])


def _with_effort(table: FloatArray, effort: FloatArray, rationality: float) -> FloatArray:
    """Return statistics (n, 5) with a cost (n,) added to every configuration."""
    result = table.copy()
    result[:, [MEAN, PLAIN_MEAN, LEAST]] += effort[:, None]
    if np.isfinite(rationality):
        result[:, LOG_WEIGHT] -= rationality * effort
    return result
