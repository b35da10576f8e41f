"""The simulated person's most comfortable posture for given hand poses: closed-form arms, searched trunk and swivel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handover_ros.geometry import FloatArray, invert_transform
from handover_ros.sim.person_kinematics import PersonKinematics
from handover_ros.sim.person_spec import ARM_SLICE

# A posture keeps this far from the ends of its range [rad], so that small corrections stay within.
LIMIT_MARGIN = 0.04
COARSE_SWIVELS = np.linspace(-0.8, 2.2, 9)
FINE_SWIVELS = np.linspace(-1.1, 2.6, 32)
REFINE_SPREADS = (0.22, 0.10, 0.05, 0.02)


@dataclass(frozen=True, eq=False)
class Posture:
    """A posture that puts hands where they should be.

    Attributes:
        displacements: All joints, shape (20,); the arms not asked for are as they were.
        torso_offset: Part of the torso coordinates the person adds to where it stands, shape (6,).
        swivels: Swivel angle [rad] of each arm asked for.
        cost: Discomfort.
    """

    displacements: FloatArray
    torso_offset: FloatArray
    swivels: dict[str, float]
    cost: float


def _offsets(x: list[float], y: list[float], z: list[float], yaw: list[float], pitch: list[float]) -> FloatArray:
    """Return the trunk offsets (k, 6) of a grid, read-only."""
    mesh = np.meshgrid(x, y, z, yaw, pitch, [0.0], indexing="ij")
    grid = np.stack([values.ravel() for values in mesh], axis=1)
    grid.setflags(write=False)
    return grid


# Trunk offsets to try, from what is done at once to what is done when nothing else helps: upright or leaning, bending
# the knees, squatting, moving the feet as well.
LEANING = _offsets([0.0], [0.0], [0.0], [-0.9, -0.45, 0.0, 0.45, 0.9], [0.0, 0.22, 0.45])
BENDING = _offsets([0.0], [0.0], [0.0, -0.11], [-1.2, -0.6, 0.0, 0.6, 1.2], [0.25, 0.65])
STEPPING = _offsets([-0.3, 0.0, 0.3], [-0.3, 0.0, 0.3], [0.0, -0.11], [-1.2, -0.6, 0.0, 0.6, 1.2], [0.05, 0.5])
SQUATTING = _offsets([0.0], [0.0], [-0.22], [-1.2, -0.6, 0.0, 0.6, 1.2], [0.15, 0.5])
STAGES = (LEANING, BENDING, SQUATTING, STEPPING)
MOVES = np.zeros((45, 6))
MOVES[:, 3:] = _offsets([0.0], [0.0], [-1.0, -0.5, 0.0, 0.5, 1.0], [-1.0, 0.0, 1.0], [-0.5, 0.0, 0.5])[:, 2:5]


class PostureFinder:
    """Finds comfortable postures of one person.

    Args:
        kinematics: The person's geometry.
    """

    def __init__(self, kinematics: PersonKinematics) -> None:
        self.kinematics = kinematics
        person = kinematics.person
        self._lower, self._upper = person.lower, person.upper
        self._neutral, self._weights = person.neutral, person.weights

    def torso_cost(self, offsets: FloatArray) -> FloatArray:
        """Return the discomfort (k,) of trunk offsets (k, 6); infinite beyond the limits."""
        cost = (offsets**2) @ self._weights[:6]
        outside = np.any((offsets < self._lower[:6]) | (offsets > self._upper[:6]), axis=-1)
        return np.where(outside, np.inf, cost)

    def arm_costs(
        self, hand: str, torsos: FloatArray, world_from_hand: FloatArray, swivels: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the least discomfort of an arm for each torso and hand pose, and its swivel.

        Args:
            hand: ``right`` or ``left``.
            torsos: Torso coordinates, shape (k, 6).
            world_from_hand: Grip poses, shape (n, 4, 4).
            swivels: Swivel angles to try [rad], shape (m,).

        Returns:
            Costs (k, n), infinite where no posture is within the limits, and swivels (k, n) [rad].
        """
        torso_from_world = invert_transform(self.kinematics.torso_pose(torsos))
        poses = (torso_from_world[:, None] @ world_from_hand[None]).reshape(-1, 4, 4)
        arms = self.kinematics.inverse(hand, poses, swivels)
        cost = self._arm_cost(hand, arms)
        best = np.argmin(cost, axis=1)
        shape = (len(torsos), len(world_from_hand))
        return cost[np.arange(len(best)), best].reshape(shape), swivels[best].reshape(shape)

    def _arm_cost(self, hand: str, arms: FloatArray) -> FloatArray:
        """Return the discomfort of arm postures (..., 7); infinite beyond the limits or NaN."""
        part = ARM_SLICE[hand]
        # Comparisons with NaN are false, so that unreachable poses count as outside.
        lower, upper = self._lower[part] + LIMIT_MARGIN, self._upper[part] - LIMIT_MARGIN
        inside = ((arms >= lower) & (arms <= upper)).all(axis=-1)
        return np.where(inside, ((arms - self._neutral[part]) ** 2) @ self._weights[part], np.inf)

    def best(self, start: FloatArray, base: FloatArray, targets: dict[str, FloatArray]) -> Posture | None:
        """Return the most comfortable posture with the hands at their targets, or None when there is none.

        Args:
            start: Displacements (20,) whose other joints are kept.
            base: Torso coordinates (6,) where the person stands.
            targets: Hand to world_from_hand (4, 4).
        """
        for offsets in STAGES:
            cost = self._total_cost(offsets, base, targets, COARSE_SWIVELS)
            if np.isfinite(cost).any():
                return self.refine(start, base, targets, offsets[np.argmin(cost)])
        return None

    def refine(
        self, start: FloatArray, base: FloatArray, targets: dict[str, FloatArray], offset: FloatArray
    ) -> Posture | None:
        """Return the best posture near a trunk offset (6,), or None; arguments as in ``best``."""
        best_offset, best_cost = offset, np.inf
        # Upright is tried too: most reaches do not need the trunk.
        offsets = np.concatenate([np.zeros((1, 6)), offset + REFINE_SPREADS[0] * MOVES])
        for spread in REFINE_SPREADS[1:]:
            cost = self._total_cost(offsets, base, targets, FINE_SWIVELS)
            index = int(np.argmin(cost))
            if cost[index] < best_cost:
                best_offset, best_cost = offsets[index], float(cost[index])
            offsets = best_offset + spread * MOVES
        if not np.isfinite(best_cost):
            return None
        displacements = start.copy()
        displacements[:6] = base + best_offset
        swivels = {}
        for hand, target in targets.items():
            _, swivel = self.arm_costs(hand, displacements[None, :6], target[None], FINE_SWIVELS)
            swivels[hand] = float(swivel[0, 0])
            torso_from_hand = invert_transform(self.kinematics.torso_pose(displacements[:6])) @ target
            arm = self.kinematics.inverse(hand, torso_from_hand[None], swivel[0])[0, 0]
            displacements[ARM_SLICE[hand]] = arm
        return Posture(displacements, best_offset, swivels, best_cost)

    def _total_cost(
        self, offsets: FloatArray, base: FloatArray, targets: dict[str, FloatArray], swivels: FloatArray
    ) -> FloatArray:
        """Return the discomfort (k,) of trunk offsets (k, 6) with the best arms."""
        cost = self.torso_cost(offsets)
        for hand, target in targets.items():
            cost = cost + self.arm_costs(hand, base + offsets, target[None], swivels)[0][:, 0]
        return cost

    def follow(self, hand: str, torsos: FloatArray, world_from_hand: FloatArray, swivels: FloatArray) -> FloatArray:
        """Return arm postures along a path of hand poses, near wanted swivel angles.

        Args:
            hand: ``right`` or ``left``.
            torsos: Torso coordinates along the path, shape (k, 6).
            world_from_hand: Grip poses along the path, shape (k, 4, 4).
            swivels: Wanted swivel angles [rad], shape (k,).

        Returns:
            Displacements (k, 7), within the limits; NaN where no posture is.
        """
        turns = np.concatenate([[0.0], *([t, -t] for t in np.linspace(0.1, 1.4, 12))])
        torso_from_hand = invert_transform(self.kinematics.torso_pose(torsos)) @ world_from_hand
        arms = self.kinematics.inverse(hand, torso_from_hand, swivels[:, None] + turns)
        inside = self._arm_cost(hand, arms) < np.inf
        # The first that fits is the one nearest to the wanted swivel.
        first = np.argmax(inside, axis=1)
        rows = np.arange(len(arms))
        return np.where(inside[rows, first][:, None], arms[rows, first], np.nan)
