"""Inverse kinematics of a redundant arm: several distinct solutions within the joint limits, best first."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from handover_ros.errors import BadRequestError
from handover_ros.geometry import FloatArray
from handover_ros.robot import closed_form_kernels, kinematics_kernels
from handover_ros.robot.model import RobotModel
from handover_ros.threads import in_parts

kernels: Any = kinematics_kernels  # numba's functions carry no types
closed_form: Any = closed_form_kernels

POSE_TOLERANCE = 1e-6  # norm of position [m] and rotation [rad] error
ITERATIONS = 60
SEPARATION = 0.2  # [rad] in some joint between two solutions that count as distinct
LIBRARY_SIZE = 8000  # random configurations whose poses are known
NEAR_STARTS = 60  # of them, nearest to the target, tried in order
ROTATION_LENGTH = 0.3  # [m] that one radian weighs in "nearest"
REACH_SLACK = 0.02  # of the greatest distance found among the library's configurations
DIRECTION_BINS = 10  # of the cosine between the gripper's axis and the line from the shoulder
LEAST_PART = 64  # poses for which another thread pays
QUICK_ITERATIONS = 12  # of ``quick``: whoever gets there is there by then
QUICK_LIBRARY = 2000  # of the library's configurations that ``quick`` chooses its start from
FIRST_JOINTS = 16  # displacements of the first joint at which ``quick`` looks
LIMIT_WEIGHT = 0.3  # weight of the distance from the middle of the limits against closeness to the preferred posture


class InverseKinematics:
    """Finds joint displacements that put an arm's gripper at a pose.

    Numerical, from many starts: the arm's preferred postures and those of a fixed library of random configurations
    whose gripper poses are nearest to the target. Deterministic for a seed.

    Attributes:
        arm: The arm's model.
    """

    def __init__(self, robot: RobotModel, arm: str, seed: int = 0) -> None:
        self.arm = robot.arm(arm)
        axes, points, tip = robot.chain(arm)
        self._chain = tuple(np.ascontiguousarray(part) for part in (axes, points, tip))
        self._lower, self._upper = self.arm.planning_lower, self.arm.planning_upper
        rng = np.random.default_rng(seed)
        self._library = rng.uniform(self._lower, self._upper, size=(LIBRARY_SIZE, len(self._lower)))
        self._library_poses = kernels.forward_many(*self._chain, self._library)
        self._library_places = np.ascontiguousarray(self._library_poses[:, :3, 3])
        self._library_turns = np.ascontiguousarray(self._library_poses[:, :3, :3].reshape(-1, 9))
        # The last joint but one lies on the axis of the last, so it stands still in the gripper frame: the wrist.
        self._home = np.ascontiguousarray(self.arm.home[None])
        self._places = closed_form.wrist_and_shoulder(*self._chain[:2])
        ends = self._lower[0], self._upper[0]
        self._firsts = np.linspace(*ends, 2 * FIRST_JOINTS + 1)[1::2].copy()
        self._shoulder = points[0]
        self._wrist = (np.linalg.inv(tip) @ np.append(points[-2], 1.0))[:3]
        distances = self._wrist_distances(self._library_poses)
        wrists = self._library_poses[:, :3, :3] @ self._wrist + self._library_poses[:, :3, 3] - self._shoulder
        outward = np.einsum("ni,ni->n", wrists, self._library_poses[:, :3, 2]) / np.maximum(distances, 1e-9)
        self._farthest = np.zeros(DIRECTION_BINS)
        np.maximum.at(self._farthest, _direction_bin(outward), (1.0 + REACH_SLACK) * distances)
        self._wrist_range = (1.0 - REACH_SLACK) * distances.min(), (1.0 + REACH_SLACK) * distances.max()

    def solve(
        self, world_from_gripper: FloatArray, preferred: npt.ArrayLike | None = None, wanted: int = 8
    ) -> FloatArray:
        """Return up to ``wanted`` distinct solutions, shape (m, n) [rad], sorted by ``posture_cost``; m = 0: none.

        Args:
            world_from_gripper: Gripper pose. Shape (4, 4).
            preferred: Posture to stay close to [rad] (n,); left out: home.
            wanted: Largest number of solutions.

        Raises:
            BadRequestError: The pose is not a finite rigid transform.
        """
        target = _checked_pose(world_from_gripper)
        posture = self.arm.home if preferred is None else np.asarray(preferred, dtype=float)
        if not self.within_arm_length(target):
            return np.empty((0, len(posture)))
        nearest = self._nearest(target)
        starts = np.vstack([posture[None], self.arm.home[None], self._library[nearest]])
        solutions = kernels.search(
            *self._chain, self._lower, self._upper, target, starts, wanted, SEPARATION, ITERATIONS, POSE_TOLERANCE
        )
        return solutions[np.argsort(self.posture_cost(solutions, posture), kind="stable")]

    def quick(self, world_from_gripper: FloatArray) -> FloatArray:
        """Return a solution, shape (1, n) [rad], or none, (0, n), from few starts only: for many poses in a row.

        One or two poses in a hundred that ``solve`` reaches are taken to be out of reach.

        Raises:
            BadRequestError: The pose is not a finite rigid transform.
        """
        found, solutions = self.quick_solutions(_checked_pose(world_from_gripper)[None])
        return solutions[found]

    def quick_many(self, world_from_gripper: FloatArray) -> npt.NDArray[np.bool_]:
        """Return whether ``quick`` finds a solution (m,) for gripper poses (m, 4, 4), taken to be rigid."""
        return self.quick_solutions(world_from_gripper)[0]

    def quick_solutions(self, world_from_gripper: FloatArray) -> tuple[npt.NDArray[np.bool_], FloatArray]:
        """Return whether ``quick`` finds a solution (m,), and those (m, n) [rad], for rigid gripper poses (m, 4, 4)."""
        poses = np.ascontiguousarray(world_from_gripper)
        found, solutions = np.zeros(len(poses), dtype=np.bool_), np.zeros((len(poses), len(self._lower)))
        in_parts(len(poses), lambda start, end: self._quick_part(poses, found, solutions, start, end), LEAST_PART)
        return found, solutions

    def _quick_part(
        self, poses: FloatArray, found: npt.NDArray[np.bool_], solutions: FloatArray, start: int, end: int
    ) -> None:
        """Fill the answers of ``quick_solutions`` from ``start`` to before ``end``."""
        limits, settings = (self._lower, self._upper), (QUICK_ITERATIONS, POSE_TOLERANCE)
        answers = found[start:end], solutions[start:end]
        home = self._home[0]
        if self._places is not None:
            closed_form.solve_many(
                *self._chain, *limits, self._places, poses[start:end], home, self._firsts, *settings, *answers
            )
            return
        library = (each[:QUICK_LIBRARY] for each in (self._library, self._library_places, self._library_turns))
        kernels.solve_many(
            *self._chain, *limits, poses[start:end], home, *library, ROTATION_LENGTH, *settings, *answers
        )

    def gripper_pose(self, displacements: FloatArray) -> FloatArray:
        """Return ``world_from_gripper`` (4, 4); the compiled twin of ``RobotModel.gripper_pose``."""
        return np.asarray(
            kernels.forward(*self._chain, np.ascontiguousarray(displacements), np.empty((6, len(self._lower))))
        )

    def within_arm_length(self, world_from_gripper: FloatArray) -> bool:
        """Return whether the wrist is no farther from the shoulder, and no nearer, than the arm can bring it."""
        distance = float(self._wrist_distances(np.asarray(world_from_gripper)))
        return bool(self._wrist_range[0] <= distance <= self._wrist_range[1])

    def stretches(self, world_from_object: FloatArray, object_from_gripper: FloatArray) -> FloatArray:
        """Return how far grasps stretch the arm, shoulder to wrist [m], shape (n, r); inf: farther than it can be.

        A stretched arm points its gripper away from the shoulder only: how far it can be depends on the direction.

        Args:
            world_from_object: Shape (n, 4, 4).
            object_from_gripper: Shape (r, 4, 4).
        """
        rotations = world_from_object[:, :3, :3].reshape(-1, 3)
        in_object = object_from_gripper[:, :3, :3] @ self._wrist + object_from_gripper[:, :3, 3]
        wrists = (rotations @ in_object.T).reshape(-1, 3, len(in_object))
        wrists += (world_from_object[:, :3, 3] - self._shoulder)[:, :, None]
        axes = (rotations @ object_from_gripper[:, :3, 2].T).reshape(wrists.shape)
        distances = np.sqrt(np.square(wrists).sum(axis=1))
        outward = (wrists * axes).sum(axis=1) / np.maximum(distances, 1e-9)
        farthest = self._farthest[_direction_bin(outward)]
        return np.where((distances >= self._wrist_range[0]) & (distances <= farthest), distances, np.inf)

    def _wrist_distances(self, poses: FloatArray) -> FloatArray:
        """Return the distance [m] of the wrist from the shoulder at gripper poses (..., 4, 4)."""
        return np.asarray(
            np.linalg.norm(poses[..., :3, :3] @ self._wrist + poses[..., :3, 3] - self._shoulder, axis=-1)
        )

    def follow(self, world_from_gripper: FloatArray, start: npt.ArrayLike) -> FloatArray | None:
        """Return the solution (n,) reached from ``start`` [rad] (n,), or None: one step of a Cartesian motion."""
        target = _checked_pose(world_from_gripper)
        solution, error = kernels.descend(
            *self._chain, self._lower, self._upper, target, np.array(start, dtype=float), ITERATIONS, POSE_TOLERANCE
        )
        return np.asarray(solution) if error < POSE_TOLERANCE else None

    def posture_cost(self, displacements: FloatArray, preferred: FloatArray) -> FloatArray:
        """Return the cost (m,) of postures (m, n): distance to ``preferred`` and to the middle of the limits.

        Distances are fractions of half a joint's range.
        """
        half_range = (self._upper - self._lower) / 2.0
        middle = (self._upper + self._lower) / 2.0
        near = np.mean(((displacements - preferred) / half_range) ** 2, axis=-1)
        centred = np.mean(((displacements - middle) / half_range) ** 4, axis=-1)
        return np.asarray(near + LIMIT_WEIGHT * centred)

    def _nearest(self, target: FloatArray) -> npt.NDArray[np.int64]:
        """Return the places in the library of the gripper poses nearest to a target."""
        distance = self._distances(target)
        nearest = np.argpartition(distance, NEAR_STARTS)[:NEAR_STARTS]
        return np.asarray(nearest[np.argsort(distance[nearest], kind="stable")])

    def _distances(self, target: FloatArray, count: int = LIBRARY_SIZE) -> FloatArray:
        """Return the squared distances [m2] of the library's first gripper poses from a target, turns counted in."""
        offsets = self._library_places[:count] - target[:3, 3]
        # |R1 - R2|^2 = 2 |angle|^2 for small angles.
        turned = self._library_turns[:count] @ target[:3, :3].ravel()
        return np.asarray(np.einsum("ij,ij->i", offsets, offsets) + ROTATION_LENGTH**2 * (3.0 - turned))


def _direction_bin(outward: FloatArray) -> npt.NDArray[np.int64]:
    """Return the bin of a cosine."""
    return np.asarray(np.clip((outward + 1.0) * (DIRECTION_BINS / 2.0), 0, DIRECTION_BINS - 1).astype(np.int64))


def _checked_pose(pose: FloatArray) -> FloatArray:
    """Return a pose as a contiguous array after checking it."""
    target = np.ascontiguousarray(pose, dtype=float)
    if target.shape != (4, 4) or not np.all(np.isfinite(target)):
        raise BadRequestError("a gripper pose must be a finite 4x4 transform")
    if np.max(np.abs(target[:3, :3] @ target[:3, :3].T - np.eye(3))) > 1e-4 or np.linalg.det(target[:3, :3]) < 0:
        raise BadRequestError("a gripper pose must have a rotation matrix (orthonormal, determinant 1)")
    return target
