"""What taking an object costs a person: statistics of the feasible set of every grasp, at many object poses at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from handover_ros.arm.inverse_kinematics import FeasibleSets, feasible_sets, weigh, weigh_quadratic_segments
from handover_ros.arm.model import Arm, Side
from handover_ros.ergonomics.arm_costs import ArmCost, SquaredDistance
from handover_ros.errors import BadRequestError
from handover_ros.geometry import FloatArray
from handover_ros.planning.choice import MEASURE
from handover_ros.planning.grasp_set import GraspSet
from handover_ros.planning.obstacles import BoolArray, IntArray, Obstacles, free_each

STEP = 0.25  # [rad] in configuration space that a sample of a feasible set stands for


@dataclass(frozen=True, eq=False)
class Taker:
    """A person as far as taking things goes.

    Attributes:
        arms: By side.
        costs: What postures of each arm cost, by side.
        step: Density of the samples of feasible sets [rad].
    """

    arms: Mapping[Side, Arm]
    costs: Mapping[Side, ArmCost]
    step: float = STEP

    def __post_init__(self) -> None:
        """Check that every arm has a cost.

        Raises:
            BadRequestError: One has not.
        """
        if set(self.arms) != set(self.costs) or not self.arms:
            raise BadRequestError(f"a person needs a cost for each arm, got {list(self.arms)} and {list(self.costs)}")

    @property
    def sides(self) -> tuple[Side, ...]:
        """The hands."""
        return tuple(self.arms)


def statistics(
    taker: Taker,
    grasps: GraspSet,
    torso_from_object: FloatArray,
    rationality: float,
    obstacles: Obstacles | None = None,
) -> FloatArray:
    """Return the statistics (p, grasps, 5) of the feasible sets of all grasps at object poses (p, 4, 4).

    Columns as in ``choice``: measure, log weight, mean cost under (3.3), mean cost of all alike, least cost. Two hands
    have the product of their sets: measures multiply, costs add.

    Args:
        taker: The person.
        grasps: On the object.
        torso_from_object: Poses in the torso frame.
        rationality: Boltzmann coefficient; infinite: the best only.
        obstacles: What forearm and hand must keep out of, in the torso frame; None: nothing.
    """
    poses = np.asarray(torso_from_object, dtype=float).reshape(-1, 4, 4)
    result: FloatArray | None = None
    for number, side in enumerate(grasps.sides):
        table = _side_statistics(taker, side, poses, grasps.poses[number], rationality, obstacles)
        places = grasps.hands[:, number]
        takes = places >= 0
        if takes.all():
            own = table if np.array_equal(places, np.arange(table.shape[1])) else table[:, places]
        else:
            own = np.tile(NO_HAND, (len(poses), len(grasps), 1))
            own[:, takes] = table[:, places[takes]]
        result = own if result is None else _together(result, own)
    assert result is not None
    return result


def statistics_each(
    taker: Taker,
    grasps: GraspSet,
    torso_from_object: FloatArray,
    rationality: float,
    obstacles: Sequence[Obstacles] = (),
    which: IntArray | None = None,
) -> FloatArray:
    """Return the statistics (grasps, 5) of grasps, each at an object pose of its own (grasps, 4, 4).

    Args:
        taker: The person.
        grasps: On the object.
        torso_from_object: The pose for each grasp, each in the torso frame there.
        rationality: As for ``statistics``.
        obstacles: The same boxes in several torso frames; none: nothing is in the way.
        which: Place in ``obstacles`` of each grasp's (grasps,).
    """
    result: FloatArray | None = None
    for number, side in enumerate(grasps.sides):
        takes = grasps.hands[:, number] >= 0
        own = np.tile(NO_HAND, (len(grasps), 1))
        hands = torso_from_object[takes] @ grasps.poses[number][grasps.hands[takes, number]]
        arm, sets = taker.arms[side], feasible_sets(taker.arms[side], hands, taker.step)
        costs = taker.costs[side].evaluate(sets.postures)
        if obstacles and which is not None and len(costs):
            sample_of = np.repeat(which[takes], np.diff(sets.first))
            sets, costs = _kept(sets, costs, free_each(obstacles, sample_of, arm.limbs(sets.postures)))
        own[takes] = weigh(sets, costs, rationality)
        result = own if result is None else _together(result, own)
    assert result is not None
    return result


def posture_probabilities(
    taker: Taker, side: Side, torso_from_hand: FloatArray, rationality: float
) -> tuple[FloatArray, FloatArray]:
    """Return samples (k, 7) of the feasible set of a hand pose (4, 4), and P(q | g) (k,) of each, as in (3.3).

    Args:
        taker: The person.
        side: Of the hand.
        torso_from_hand: The grip in the torso frame.
        rationality: With which the posture is chosen; infinite: the best only.
    """
    sets = feasible_sets(taker.arms[side], torso_from_hand[None], taker.step)
    costs = taker.costs[side].evaluate(sets.postures)
    if not len(costs):
        return sets.postures, costs
    above = costs - costs.min()
    shares = (above == 0.0).astype(float) if np.isinf(rationality) else sets.measures * np.exp(-rationality * above)
    return sets.postures, shares / shares.sum()


def _kept(sets: FeasibleSets, costs: FloatArray, free: BoolArray) -> tuple[FeasibleSets, FloatArray]:
    """Return feasible sets and the costs of their samples (total,) without those that are not free (total,)."""
    first = np.concatenate([[0], np.cumsum(free)])[sets.first]
    return FeasibleSets(sets.postures[free], sets.measures[free], first), costs[free]


def _side_statistics(
    taker: Taker,
    side: Side,
    torso_from_object: FloatArray,
    object_from_hand: FloatArray,
    rationality: float,
    obstacles: Obstacles | None,
) -> FloatArray:
    """Return the statistics (p, k, 5) of one hand's poses on an object at poses (p, 4, 4)."""
    arm, cost = taker.arms[side], taker.costs[side]
    shape = (len(torso_from_object), len(object_from_hand), 5)
    if isinstance(cost, SquaredDistance) and obstacles is None:
        segments = arm.mirrored(torso_from_object)[:, None] @ arm.segment_poses(object_from_hand)
        wanted = cost.preference
        table = weigh_quadratic_segments(
            arm, segments.reshape(-1, 4, 4), taker.step, wanted.neutral, wanted.weights, rationality
        )
    else:
        hands = torso_from_object[:, None] @ object_from_hand
        table = hand_statistics(taker, side, hands.reshape(-1, 4, 4), rationality, obstacles)
    return table.reshape(shape)


# A hand that takes no part: one way to do so, at no cost.
NO_HAND = np.array([1.0, 0.0, 0.0, 0.0, 0.0])


def _together(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the statistics of two hands that act together."""
    result = first + second
    result[..., MEASURE] = first[..., MEASURE] * second[..., MEASURE]
    return result


def hand_statistics(
    taker: Taker, side: Side, torso_from_hand: FloatArray, rationality: float, obstacles: Obstacles | None = None
) -> FloatArray:
    """Return the statistics (n, 5) of the feasible sets of one hand at poses (n, 4, 4), from samples of them."""
    arm, cost = taker.arms[side], taker.costs[side]
    sets = feasible_sets(arm, torso_from_hand, taker.step)
    costs = cost.evaluate(sets.postures)
    if obstacles is not None and len(sets.postures):
        sets, costs = _kept(sets, costs, obstacles.free(arm.limbs(sets.postures)))
    return weigh(sets, costs, rationality)
