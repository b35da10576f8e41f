"""Paths of the simulated person's hands, planned once and then followed: to the object, to its goal, away from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handover_ros.geometry import FloatArray, transform_from_xyz_rpy
from handover_ros.sim.person_motion import blend_poses
from handover_ros.sim.person_posture import Posture, PostureFinder
from handover_ros.sim.person_reach import APPROACH
from handover_ros.sim.person_spec import ARM_SLICE

RETREAT_TO_BODY = 0.14
NEAREST_TO_BODY = 0.34
LIFT = 0.12
RELEASE_HEIGHT = 0.003
TURNS = (0.0, 0.4, -0.4, 0.8, -0.8, 1.2, -1.2, 1.6, -1.6, 2.2, -2.2, np.pi)
NEARER = (0.0, 0.1, 0.2, 0.3)


@dataclass(frozen=True, eq=False)
class Carrying:
    """How an object is brought to its goal.

    Attributes:
        world_from_goal: Where it will be put, shape (4, 4).
        points: Postures of the way to above the goal, shape (k, 20), torso as offset.
        lowering: Postures from there down, shape (m, 20).
        length: Way of the object to above the goal [m].
    """

    world_from_goal: FloatArray
    points: FloatArray
    lowering: FloatArray
    length: float


def raised(pose: FloatArray, height: float) -> FloatArray:
    """Return a pose (4, 4) moved up by a height [m]."""
    result = pose.copy()
    result[2, 3] += height
    return result


def backed_off(world_from_hand: FloatArray, distance: float) -> FloatArray:
    """Return a hand pose (4, 4) moved back out of the grasp, against the palm normal, by a distance [m]."""
    result = world_from_hand.copy()
    result[:3, 3] -= distance * world_from_hand[:3, 2]
    return result


def command_of(posture: Posture) -> FloatArray:
    """Return a posture as it is commanded, shape (20,): the torso as offset from where the person stands."""
    command = posture.displacements.copy()
    command[:6] = posture.torso_offset
    return command


class PathPlanner:
    """Plans one person's hand paths.

    Args:
        finder: Finds the person's postures.
    """

    def __init__(self, finder: PostureFinder) -> None:
        self._finder = finder
        self._kinematics = finder.kinematics

    def approach(self, posture: Posture, base: FloatArray, targets: dict[str, FloatArray]) -> FloatArray:
        """Return the commands (3, 20) from before the grasp to the grasp, along the palm normals.

        Args:
            posture: Posture at the grasp.
            base: Torso coordinates where the person stands, shape (6,).
            targets: Hand to world_from_hand (4, 4) at the grasp.
        """
        torsos = np.tile(base + posture.torso_offset, (3, 1))
        commands = np.tile(command_of(posture), (3, 1))
        for hand, target in targets.items():
            poses = np.stack([backed_off(target, share * APPROACH) for share in (1.0, 0.5, 0.0)])
            swivels = np.full(3, posture.swivels[hand])
            commands[:, ARM_SLICE[hand]] = _filled(self._finder.follow(hand, torsos, poses, swivels))
        return commands

    def retreat(self, command: FloatArray, base: FloatArray, hands: dict[str, FloatArray]) -> FloatArray:
        """Return the commands (k, 20) from hands (4, 4) at an object out of the grasp and up, the torso at rest."""
        commands = np.tile(command, (7, 1))
        torsos = np.tile(base + command[:6], (7, 1))
        for hand, pose in hands.items():
            back = backed_off(pose, APPROACH)
            path = blend_poses([pose, back, raised(back, LIFT)], [3, 3])
            swivel = self._kinematics.swivel(hand, command[ARM_SLICE[hand]])
            arms = self._finder.follow(hand, torsos, path, np.full(7, swivel))
            arms[0] = command[ARM_SLICE[hand]]
            commands[:, ARM_SLICE[hand]] = _filled(arms)
        return commands

    def carry(
        self,
        command: FloatArray,
        base: FloatArray,
        world_from_object: FloatArray,
        world_from_goal: FloatArray,
        object_from_hand: dict[str, FloatArray],
    ) -> Carrying | None:
        """Plan to bring a held object back to the body, over its goal and down.

        When the goal cannot be reached as it is, the object is turned about the vertical, then put nearer.

        Args:
            command: Present command, shape (20,), torso as offset.
            base: Torso coordinates where the person stands, shape (6,).
            world_from_object: Where the object is, shape (4, 4).
            world_from_goal: Where it should go, shape (4, 4).
            object_from_hand: How each hand holds it, each (4, 4).

        Returns:
            The plan, or None when no place near the goal can be reached.
        """
        found = self._reachable_goal(command, base, world_from_goal, object_from_hand)
        if found is None:
            return None
        goal, posture = found
        above = raised(goal, LIFT)
        keys = [world_from_object, self._near_body(world_from_object, base, above[2, 3]), above]
        path = blend_poses(keys, [4, 9])
        share = np.concatenate([np.zeros(4), np.linspace(0.0, 1.0, 10)])[:, None]
        share = share * share * (3.0 - 2.0 * share)
        torso = command[:6] + share * (posture.torso_offset - command[:6])
        points = np.tile(command, (len(path), 1))
        points[:, :6] = torso
        down = blend_poses([above, raised(goal, RELEASE_HEIGHT)], [4])
        lowering = np.tile(command_of(posture), (len(down), 1))
        for hand, grip in object_from_hand.items():
            part = ARM_SLICE[hand]
            present = self._kinematics.swivel(hand, command[part])
            swivels = present + share[:, 0] * (posture.swivels[hand] - present)
            arms = self._finder.follow(hand, base + torso, path @ grip, swivels)
            arms[0] = command[part]
            goal_torsos = np.tile(base + posture.torso_offset, (len(down), 1))
            at_goal = np.full(len(down), posture.swivels[hand])
            lowering[:, part] = _filled(self._finder.follow(hand, goal_torsos, down @ grip, at_goal))
            arms[-1] = lowering[0, part]
            points[:, part] = _filled(arms)
        length = float(np.linalg.norm(np.diff(path[:, :3, 3], axis=0), axis=1).sum())
        return Carrying(goal, points, lowering, length)

    def _reachable_goal(
        self,
        command: FloatArray,
        base: FloatArray,
        world_from_goal: FloatArray,
        object_from_hand: dict[str, FloatArray],
    ) -> tuple[FloatArray, Posture] | None:
        """Return the reachable pose nearest to a goal and the posture there, or None."""
        feet = self._kinematics.torso_pose(base)[:3, 3]
        towards = feet - world_from_goal[:3, 3]
        towards[2] = 0.0
        towards /= np.linalg.norm(towards) + 1e-9
        for nearer in NEARER:
            for turn in TURNS:
                goal = world_from_goal.copy()
                goal[:3, :3] = transform_from_xyz_rpy((0, 0, 0), (0, 0, turn))[:3, :3] @ goal[:3, :3]
                goal[:3, 3] += nearer * towards
                targets = {hand: raised(goal, RELEASE_HEIGHT) @ grip for hand, grip in object_from_hand.items()}
                posture = self._finder.best(command, base, targets)
                if posture is not None:
                    return goal, posture
        return None

    def _near_body(self, world_from_object: FloatArray, base: FloatArray, height: float) -> FloatArray:
        """Return a pose (4, 4) between an object and the body, not below a height [m]."""
        towards = self._kinematics.torso_pose(base)[:3, 3] - world_from_object[:3, 3]
        towards[2] = 0.0
        distance = float(np.linalg.norm(towards))
        result = world_from_object.copy()
        if distance > NEAREST_TO_BODY:
            result[:3, 3] += towards / distance * min(RETREAT_TO_BODY, distance - NEAREST_TO_BODY)
        result[2, 3] = max(result[2, 3] + 0.03, height)
        return result


def _filled(arms: FloatArray) -> FloatArray:
    """Return postures (k, 7) with the NaN rows interpolated between the others; the nearest one beyond the ends."""
    good = np.flatnonzero(np.isfinite(arms).all(axis=1))
    if len(good) == len(arms):
        return arms
    if len(good) == 0:
        raise ValueError("no posture along the path is within the limits")
    index = np.arange(len(arms))
    return np.stack([np.interp(index, good, arms[good, joint]) for joint in range(arms.shape[1])], axis=1)
