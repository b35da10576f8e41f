"""A simulated person as one skeleton that stands on the ground, and the posture in which it takes what is offered.

The posture is the one that the person's own comfort (weights of trunk and arms about the neutral posture) finds
cheapest of all that put the hands on the object: Newton steps on the linearised demand, limits as an active set, from
several postures and for many grasps at once.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import qmc

from handover_ros.arm.hand import hand_frames
from handover_ros.geometry import FloatArray, invert_transform
from handover_ros.planning.personal import HALF_TURN, LEAST_APART
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.sim.person_spec import JOINTS, TORSO_JOINTS
from handover_ros.skeleton.jacobian import WORLD_FRAME, frame_pose, jacobian_of, move_tree
from handover_ros.skeleton.tree import WORLD, Joint, JointKind

TORSO_AXES = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 1], [0, 1, 0], [1, 0, 0]], dtype=float)
YAW, TURNS = TORSO_JOINTS.index("torso_yaw"), slice(3, 6)
GRID_LENGTH, GRID_ANGLE, GRASPS = 0.03, 0.5, 4
STEPS, PASSES, LONGEST_STEP, DAMPING = 30, 6, 0.4, 1e-9
RADIUS = 0.2  # [m/rad] of rotation errors
REACHED = 1e-3  # [m]
STARTS = 6


@dataclass(frozen=True, eq=False)
class Taken:
    """How something is taken: displacements (20,), whether the hands are there, the comfort lost."""

    displacements: FloatArray
    reached: bool
    cost: float

    @property
    def yaw(self) -> float:
        """How far the torso turns about the vertical [deg]."""
        return float(np.rad2deg(abs(self.displacements[YAW])))

    @property
    def rotation(self) -> float:
        """How far the torso turns in all [deg]."""
        return float(np.rad2deg(np.linalg.norm(self.displacements[TURNS])))


class UpperBody:
    """One person; the world is the torso frame while standing upright."""

    def __init__(self, spec):
        free = skeleton_of(spec)
        lumbar = np.array([0.0, 0.0, -spec.lengths.trunk])
        carried = (*TORSO_JOINTS[:5], "torso")
        trunk = tuple(
            Joint(
                name,
                JointKind.PRISMATIC if row < 3 else JointKind.REVOLUTE,
                WORLD if row == 0 else carried[row - 1],
                carried[row],
                (name,),
                TORSO_AXES[row : row + 1],
                lumbar,
            )
            for row, name in enumerate(TORSO_JOINTS)
        )
        limits = ((spec.lower, free.lower), (spec.upper, free.upper))
        lower, upper = (np.concatenate([whole[:6], arms]) for whole, arms in limits)
        self.skeleton = replace(free, joints=(*trunk, *free.joints[1:]), lower=lower, upper=upper)
        columns = [JOINTS.index(name) for name in self.skeleton.displacement_names]
        self.neutral, self.weights = spec.neutral[columns], spec.weights[columns]
        self.hands = hand_frames(self.skeleton)

    def take(self, model, torso_from_object, sides):
        """Return the most comfortable way to take an object with one of ``sides``, or with both if it needs two."""
        best = None
        groups = [tuple(sides)] if model.hands == 2 else [(side,) for side in sides]
        for group in groups:
            grips = grips_of(model, group)
            postures, miss, costs = self.postures(group, [torso_from_object @ grip for grip in grips])
            rank = np.where(miss < REACHED, costs, 1e6 * (1.0 + miss))
            index = int(np.argmin(rank))
            if best is None or rank[index] < best[0]:
                best = rank[index], Taken(postures[index], bool(miss[index] < REACHED), float(costs[index]))
        return best[1]

    def postures(self, sides, targets):
        """Return postures, how far the hands are from targets [(hands, 4, 4)], and costs, of several starts each."""
        lower, upper = self.skeleton.lower, self.skeleton.upper
        spread = qmc.scale(qmc.Halton(len(lower), seed=0).random(STARTS), lower, upper + 1e-12)
        spread[:, :6] *= 0.3
        turned = np.tile(self.neutral, (4, 1))
        turned[:, YAW] = (-0.8, -0.4, 0.4, 0.8)
        starts = np.clip(np.concatenate([self.neutral[None], turned, spread]), lower, upper)
        wanted = np.repeat(np.array(targets), len(starts), axis=0)
        postures = np.tile(starts, (len(targets), 1))
        inverse_weights = 1.0 / self.weights
        for _ in range(STEPS):
            errors, slopes = self._errors(sides, postures, wanted)
            held, goal = np.zeros(postures.shape, dtype=bool), np.tile(self.neutral, (len(postures), 1))
            for _ in range(PASSES):
                matrix = np.where(held[:, None, :], 0.0, slopes)
                gap = errors + (slopes @ (goal - postures)[..., None])[..., 0]
                normal = (matrix * inverse_weights) @ np.swapaxes(matrix, 1, 2) + DAMPING * np.eye(gap.shape[1])
                factors = np.linalg.solve(normal, gap[..., None])
                new = goal - inverse_weights * (np.swapaxes(matrix, 1, 2) @ factors)[..., 0]
                outside = ((new < lower) | (new > upper)) & ~held
                if not outside.any():
                    break
                held |= outside
                goal = np.where(outside, np.clip(new, lower, upper), goal)
            step = np.clip(new, lower, upper) - postures
            longest = np.abs(step).max(axis=1, keepdims=True)
            postures = postures + step * np.minimum(1.0, LONGEST_STEP / np.maximum(longest, 1e-12))
        errors, _ = self._errors(sides, postures, wanted)
        costs = np.square(postures - self.neutral) @ self.weights
        return postures, np.abs(errors).max(axis=1), costs

    def _errors(self, sides, postures, wanted):
        motion = move_tree(self.skeleton, postures)
        errors, slopes = [], []
        for row, side in enumerate(sides):
            pose = frame_pose(self.skeleton, motion, self.hands[side].frame)
            jacobian = jacobian_of(self.skeleton, motion, WORLD_FRAME, self.hands[side].frame)
            turn = Rotation.from_matrix(pose[:, :3, :3] @ np.swapaxes(wanted[:, row, :3, :3], 1, 2)).as_rotvec()
            errors += [pose[:, :3, 3] - wanted[:, row, :3, 3], RADIUS * turn]
            slopes += [jacobian[:, :3], RADIUS * jacobian[:, 3:]]
        return np.concatenate(errors, axis=1), np.concatenate(slopes, axis=1)


def grips_of(model, sides):
    """Return object_from_hands [(hands, 4, 4)]: spread over all regions for one hand, over two regions for two."""
    hands = []
    for side in sides:
        turn = HALF_TURN if side == "left" else np.eye(4)
        poses = []
        for region in model.human_grasps:
            grid = np.concatenate([region.centre()[None], region.grid(GRID_LENGTH, GRID_ANGLE)])
            chosen = np.unique(np.linspace(0, len(grid) - 1, GRASPS).round().astype(int))
            poses += [(region.name, pose @ turn) for pose in grid[chosen]]
        hands.append(poses)
    if len(sides) == 1:
        return [pose[None] for _, pose in hands[0]]
    return [
        np.stack([first, second])
        for name, first in hands[0]
        for other, second in hands[1]
        if name != other and np.linalg.norm((invert_transform(first) @ second)[:3, 3]) > LEAST_APART
    ]
