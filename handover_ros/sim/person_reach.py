"""How the simulated person decides with which hand and where to take an object: comfort, with noise.

The perceived cost of a grasp is ``myopia * cost at the handover + (1 - myopia) * cost at the goal``; the choice among
the regions is a Boltzmann choice with the person's rationality (Bestick 2017, eq. 3.3).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from handover_ros.geometry import FloatArray
from handover_ros.sim.person_posture import (
    BENDING,
    COARSE_SWIVELS,
    LEANING,
    SQUATTING,
    STAGES,
    STEPPING,
    Posture,
    PostureFinder,
)
from handover_ros.sim.person_spec import HANDS

GRID_LENGTH, GRID_ANGLE = 0.06, 0.5
GRASPS_PER_REGION = 9
APPROACH = 0.11
MIN_HAND_DISTANCE = 0.15
# A hand as a capsule from the wrist to the finger tips (hand frame), a gripper as one behind its finger tips [m].
HAND_SEGMENT = np.array([[-0.08, 0.0, -0.035], [0.06, 0.0, -0.02]])
GRIPPER_SEGMENT = np.array([[0.0, 0.0, -0.01], [0.0, 0.0, -0.20]])
HAND_AND_GRIPPER_RADIUS = 0.030 + 0.036
HAND_IN_TABLE = 0.005
OVERLAP_COST = 12.0
NO_GOAL_COST = 30.0
HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])


class Region(Protocol):
    """What is needed of a Task Space Region."""

    @property
    def name(self) -> str:
        """What an operator calls it."""

    def grid(self, step_length: float, step_angle: float) -> FloatArray:
        """Return poses object_from_hand (n, 4, 4)."""


class Takeable(Protocol):
    """What is needed of an object of the catalogue."""

    @property
    def name(self) -> str:
        """Name in the catalogue."""

    @property
    def hands(self) -> int:
        """Hands needed: 1 or 2."""

    @property
    def human_grasps(self) -> tuple[Region, ...]:
        """Where a hand can hold it, written for the right hand."""


@dataclass(frozen=True, eq=False)
class HandGrasp:
    """A hand on an object: region and object_from_hand (4, 4) as that hand holds it."""

    hand: str
    region: str
    object_from_hand: FloatArray


@dataclass(frozen=True, eq=False)
class Taking:
    """A decision how to take an object: one grasp a hand, and the posture at the handover."""

    object_name: str
    grasps: tuple[HandGrasp, ...]
    posture: Posture
    cost: float


@dataclass(frozen=True, eq=False)
class _Grasps:
    """Candidate grasps of one hand: names (n,), poses (n, 4, 4) in the object."""

    names: list[str]
    poses: FloatArray


def hand_grasps(model: Takeable, hand: str) -> _Grasps:
    """Return evenly spread grasps of all human regions for one hand."""
    names, poses = [], []
    for region in model.human_grasps:
        grid = region.grid(GRID_LENGTH, GRID_ANGLE)
        if len(grid) > GRASPS_PER_REGION:
            grid = grid[np.unique(np.linspace(0, len(grid) - 1, GRASPS_PER_REGION).round().astype(int))]
        names += [region.name] * len(grid)
        poses.append(grid if hand == "right" else grid @ HALF_TURN)
    return _Grasps(names, np.concatenate(poses))


def clearance(world_from_hand: FloatArray, world_from_gripper: FloatArray) -> FloatArray:
    """Return the distance [m] (n,) between the surfaces of hands (n, 4, 4) and a gripper; negative: they overlap."""
    share = np.linspace(0.0, 1.0, 5)[:, None]
    points = HAND_SEGMENT[0] + share * (HAND_SEGMENT[1] - HAND_SEGMENT[0])
    points = np.einsum("nij,pj->npi", world_from_hand[:, :3, :3], points) + world_from_hand[:, None, :3, 3]
    start, end = GRIPPER_SEGMENT @ world_from_gripper[:3, :3].T + world_from_gripper[:3, 3]
    axis = end - start
    along = np.clip((points - start) @ axis / (axis @ axis), 0.0, 1.0)
    return np.linalg.norm(points - start - along[..., None] * axis, axis=-1).min(axis=1) - HAND_AND_GRIPPER_RADIUS


def below_surface(world_from_hand: FloatArray, height: float) -> npt.NDArray[np.bool_]:
    """Return which hands (n, 4, 4) would reach into a table whose surface is at a height [m]."""
    lowest = world_from_hand[:, 2, 3] + np.min(world_from_hand[:, 2, :3] @ HAND_SEGMENT.T, axis=1)
    return lowest < height - HAND_IN_TABLE


class GraspChooser:
    """Chooses grasps for one person.

    Args:
        finder: Finds the person's postures.
    """

    def __init__(self, finder: PostureFinder) -> None:
        self._finder = finder
        self._comfort = finder.kinematics.person.comfort
        self._dominant = finder.kinematics.person.dominant
        self._grasps: dict[str, dict[str, _Grasps]] = {}

    def choose(
        self,
        model: Takeable,
        world_from_object: FloatArray,
        world_from_goal: FloatArray | None,
        world_from_grippers: list[FloatArray],
        start: FloatArray,
        base: FloatArray,
        rng: np.random.Generator | None = None,
    ) -> Taking | None:
        """Decide how to take an object.

        Args:
            model: The object.
            world_from_object: Where it is offered, shape (4, 4).
            world_from_goal: Where it shall go, shape (4, 4), or None.
            world_from_grippers: Robot grippers that hold it, each (4, 4): the hands keep clear of them.
            start: Present displacements, shape (20,).
            base: Torso coordinates where the person stands, shape (6,).
            rng: Source of the noise of the choice; None: the best grasp.

        Returns:
            The decision, or None when the object cannot be reached.
        """
        grasps = self._grasps.setdefault(model.name, {hand: hand_grasps(model, hand) for hand in HANDS})
        goal_cost = self._goal_cost(grasps, model.hands, world_from_goal, base)
        combine = self._single if model.hands == 1 else self._pairs
        for offsets in STAGES:
            handover = self._costs(grasps, world_from_object, offsets, base)
            for hand in HANDS:
                handover[hand] += self._overlap_cost(world_from_object @ grasps[hand].poses, world_from_grippers)
            perceived = combine(grasps, handover, goal_cost, self._finder.torso_cost(offsets))
            if perceived:
                break
        order = self._order(perceived, rng)
        for key in order:
            cost, chosen, torso_index = perceived[key]
            targets = {hand: world_from_object @ grasps[hand].poses[i] for hand, i in chosen.items()}
            posture = self._finder.refine(start, base, targets, offsets[torso_index])
            if posture is not None:
                taken = tuple(HandGrasp(h, grasps[h].names[i], grasps[h].poses[i]) for h, i in chosen.items())
                return Taking(model.name, taken, posture, cost)
        return None

    def _costs(
        self, grasps: dict[str, _Grasps], world_from_object: FloatArray, offsets: FloatArray, base: FloatArray
    ) -> dict[str, FloatArray]:
        """Return the arm costs (k, n) of each hand for trunk offsets (k, 6) and all its grasps."""
        torsos = base + offsets
        return {
            hand: self._finder.arm_costs(hand, torsos, world_from_object @ grasps[hand].poses, COARSE_SWIVELS)[0]
            for hand in HANDS
        }

    def _goal_cost(
        self, grasps: dict[str, _Grasps], hands: int, world_from_goal: FloatArray | None, base: FloatArray
    ) -> dict[str, FloatArray] | FloatArray | None:
        """Return the cost at the goal of each grasp (n,) by hand, or of each pair (n, n); None without a goal.

        A grasp with which the goal cannot be reached costs much, not everything: taking comes first.
        """
        if world_from_goal is None:
            return None
        for offsets in (np.concatenate([LEANING, BENDING, SQUATTING]), STEPPING):
            arms = self._costs(grasps, world_from_goal, offsets, base)
            for hand in HANDS:
                arms[hand][:, below_surface(world_from_goal @ grasps[hand].poses, world_from_goal[2, 3])] = np.inf
            torso = self._finder.torso_cost(offsets)
            if hands == 1:
                single = {hand: (cost + torso[:, None]).min(axis=0) for hand, cost in arms.items()}
                if any(np.isfinite(cost).any() for cost in single.values()):
                    break
            else:
                pairs = (arms["right"][:, :, None] + arms["left"][:, None] + torso[:, None, None]).min(axis=0)
                if np.isfinite(pairs).any():
                    break
        if hands == 1:
            return {hand: np.minimum(cost, NO_GOAL_COST) for hand, cost in single.items()}
        return np.minimum(pairs, NO_GOAL_COST)

    @staticmethod
    def _overlap_cost(world_from_hand: FloatArray, grippers: list[FloatArray]) -> FloatArray:
        """Return the cost (n,) of hands that meet a gripper at the grasp or on the way to it."""
        cost = np.zeros(len(world_from_hand))
        for gripper in grippers:
            for back in (0.0, 0.5 * APPROACH):
                moved = world_from_hand.copy()
                moved[:, :3, 3] -= back * moved[:, :3, 2]
                cost = np.maximum(cost, OVERLAP_COST * (clearance(moved, gripper) < 0.0))
        return cost

    def _single(
        self,
        grasps: dict[str, _Grasps],
        handover: dict[str, FloatArray],
        goal: dict[str, FloatArray] | FloatArray | None,
        torso_cost: FloatArray,
    ) -> dict[tuple[str, ...], tuple[float, dict[str, int], int]]:
        """Return the best grasp of each hand and region: perceived cost, grasp index, trunk offset index."""
        gamma = self._comfort.myopia
        result: dict[tuple[str, ...], tuple[float, dict[str, int], int]] = {}
        for hand in HANDS:
            at_handover = handover[hand] + torso_cost[:, None]
            torso_index = np.argmin(at_handover, axis=0)
            cost = at_handover.min(axis=0)
            if isinstance(goal, dict):
                cost = gamma * cost + (1.0 - gamma) * goal[hand]
            cost = cost + (0.0 if hand == self._dominant else self._comfort.other_hand)
            for index, region in enumerate(grasps[hand].names):
                key = (hand, region)
                if np.isfinite(cost[index]) and (key not in result or cost[index] < result[key][0]):
                    result[key] = (float(cost[index]), {hand: index}, int(torso_index[index]))
        return result

    def _pairs(
        self,
        grasps: dict[str, _Grasps],
        handover: dict[str, FloatArray],
        goal: dict[str, FloatArray] | FloatArray | None,
        torso_cost: FloatArray,
    ) -> dict[tuple[str, ...], tuple[float, dict[str, int], int]]:
        """Return the best grasps of both hands in two regions, as ``_single``."""
        gamma = self._comfort.myopia
        together = handover["right"][:, :, None] + handover["left"][:, None, :] + torso_cost[:, None, None]
        torso_index = np.argmin(together, axis=0)
        cost = together.min(axis=0)
        if isinstance(goal, np.ndarray):
            cost = gamma * cost + (1.0 - gamma) * goal
        places = {hand: grasps[hand].poses[:, :3, 3] for hand in HANDS}
        apart = np.linalg.norm(places["right"][:, None] - places["left"][None], axis=-1)
        cost[apart < MIN_HAND_DISTANCE] = np.inf
        names = {hand: np.array(grasps[hand].names) for hand in HANDS}
        cost[names["right"][:, None] == names["left"][None]] = np.inf
        result: dict[tuple[str, ...], tuple[float, dict[str, int], int]] = {}
        for right, left in np.argwhere(np.isfinite(cost)):
            key = (grasps["right"].names[right], grasps["left"].names[left])
            if key not in result or cost[right, left] < result[key][0]:
                chosen = {"right": int(right), "left": int(left)}
                result[key] = (float(cost[right, left]), chosen, int(torso_index[right, left]))
        return result

    def _order(self, perceived: dict, rng: np.random.Generator | None) -> list[tuple[str, ...]]:
        """Return the options in the order they are tried: by perceived cost, the first one drawn with noise."""
        keys = sorted(perceived, key=lambda key: perceived[key][0])
        rationality = self._comfort.rationality
        if rng is None or rationality is None or len(keys) < 2:
            return keys
        cost = np.array([perceived[key][0] for key in keys])
        weight = np.exp(-rationality * (cost - cost[0]))
        first = int(rng.choice(len(keys), p=weight / weight.sum()))
        return [keys[first], *keys[:first], *keys[first + 1 :]]
