"""Compiled kinematics of one serial arm of revolute joints: the inner loop of inverse kinematics.

The plain twin is ``RobotModel.gripper_pose`` and ``RobotModel.jacobian`` (pinocchio); a test holds them together.
An arm is a product of exponentials: joint axes (n, 3) and points on them (n, 3) in the world at zero displacements,
and ``world_from_gripper`` (4, 4) there.
"""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from handover_ros.geometry import FloatArray

IntArray = npt.NDArray[np.int64]

SMALL_ANGLE = 1e-9
LIMIT_SLACK = 1e-9
MAXIMUM_STEP = 0.5  # [rad] a joint moves in one iteration at most
STALL_PROGRESS = 0.999
STALLED_ITERATIONS = 4
DAMPING_SHARE = 0.05
LEAST_DAMPING = 1e-9
LEAST_PIVOT = 1e-18  # of Cholesky's diagonal: rounding can make it negative


@numba.njit(cache=True, nogil=True)
def forward(
    axes: FloatArray, points: FloatArray, tip: FloatArray, displacements: FloatArray, jacobian: FloatArray
) -> FloatArray:
    """Return ``world_from_gripper`` (4, 4) and fill ``jacobian`` (6, n): linear over angular velocity, world axes."""
    count = axes.shape[0]
    rotation = np.eye(3)
    position = np.zeros(3)
    origins = np.empty((count, 3))
    for i in range(count):
        for r in range(3):
            direction = 0.0
            origin = position[r]
            for c in range(3):
                direction += rotation[r, c] * axes[i, c]
                origin += rotation[r, c] * points[i, c]
            jacobian[3 + r, i] = direction
            origins[i, r] = origin
        x, y, z = jacobian[3, i], jacobian[4, i], jacobian[5, i]
        cosine, sine = np.cos(displacements[i]), np.sin(displacements[i])
        rest = 1.0 - cosine
        for c in range(3):
            a, b, d = rotation[0, c], rotation[1, c], rotation[2, c]
            along = rest * (x * a + y * b + z * d)
            rotation[0, c] = cosine * a + sine * (y * d - z * b) + along * x
            rotation[1, c] = cosine * b + sine * (z * a - x * d) + along * y
            rotation[2, c] = cosine * d + sine * (x * b - y * a) + along * z
        # The joint's own origin stays where it is: p = o - R r.
        for r in range(3):
            shift = 0.0
            for c in range(3):
                shift += rotation[r, c] * points[i, c]
            position[r] = origins[i, r] - shift
    pose = np.eye(4)
    for r in range(3):
        pose[r, 3] = position[r]
        for c in range(3):
            pose[r, 3] += rotation[r, c] * tip[c, 3]
            entry = 0.0
            for k in range(3):
                entry += rotation[r, k] * tip[k, c]
            pose[r, c] = entry
    for i in range(count):
        a, b, c0 = pose[0, 3] - origins[i, 0], pose[1, 3] - origins[i, 1], pose[2, 3] - origins[i, 2]
        jacobian[0, i] = jacobian[4, i] * c0 - jacobian[5, i] * b
        jacobian[1, i] = jacobian[5, i] * a - jacobian[3, i] * c0
        jacobian[2, i] = jacobian[3, i] * b - jacobian[4, i] * a
    return pose


@numba.njit(cache=True, nogil=True)
def pose_error(target: FloatArray, pose: FloatArray, error: FloatArray) -> None:
    """Fill ``error`` (6,) with the displacement [m, rad] from ``pose`` to ``target``, in world axes."""
    relative = np.empty((3, 3))
    for r in range(3):
        error[r] = target[r, 3] - pose[r, 3]
        for c in range(3):
            entry = 0.0
            for k in range(3):
                entry += target[r, k] * pose[c, k]
            relative[r, c] = entry
    x = 0.5 * (relative[2, 1] - relative[1, 2])
    y = 0.5 * (relative[0, 2] - relative[2, 0])
    z = 0.5 * (relative[1, 0] - relative[0, 1])
    sine = np.sqrt(x * x + y * y + z * z)
    cosine = 0.5 * (relative[0, 0] + relative[1, 1] + relative[2, 2] - 1.0)
    angle = np.arctan2(sine, cosine)
    if sine > SMALL_ANGLE:
        scale = angle / sine
        error[3], error[4], error[5] = x * scale, y * scale, z * scale
    elif cosine > 0.0:
        error[3], error[4], error[5] = x, y, z
    else:
        # Half a turn: the axis is a column of R + 1.
        best = 0
        for c in range(1, 3):
            if relative[c, c] > relative[best, best]:
                best = c
        norm = np.sqrt(max(2.0 * (relative[best, best] + 1.0), SMALL_ANGLE))
        for r in range(3):
            error[3 + r] = np.pi * (relative[r, best] + (1.0 if r == best else 0.0)) / norm


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _damped_step(
    jacobian: FloatArray,
    free: FloatArray,
    damping: float,
    error: FloatArray,
    normal: FloatArray,
    solved: FloatArray,
    step: FloatArray,
) -> None:
    """Set ``step`` (n,) to J^T (J J^T + damping)^-1 error with the columns of joints that are not free left out.

    ``normal`` (6, 6) and ``solved`` (6,) are workspaces. By Cholesky: for six rows much quicker than LAPACK's call.
    """
    count = len(step)
    for r in range(6):
        for c in range(r + 1):
            entry = damping if r == c else 0.0
            for i in range(count):
                entry += free[i] * jacobian[r, i] * jacobian[c, i]
            for k in range(c):
                entry -= normal[r, k] * normal[c, k]
            normal[r, c] = np.sqrt(max(entry, LEAST_PIVOT)) if r == c else entry / normal[c, c]
    for r in range(6):
        entry = error[r]
        for k in range(r):
            entry -= normal[r, k] * solved[k]
        solved[r] = entry / normal[r, r]
    for r in range(5, -1, -1):
        entry = solved[r]
        for k in range(r + 1, 6):
            entry -= normal[k, r] * solved[k]
        solved[r] = entry / normal[r, r]
    for i in range(count):
        entry = 0.0
        for r in range(6):
            entry += jacobian[r, i] * solved[r]
        step[i] = free[i] * entry


@numba.njit(cache=True, nogil=True)
def descend(
    axes: FloatArray,
    points: FloatArray,
    tip: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    target: FloatArray,
    start: FloatArray,
    iterations: int,
    tolerance: float,
) -> tuple[FloatArray, float]:
    """Return displacements (n,) near ``start`` that reach ``target``, and the remaining error (norm of m and rad).

    Levenberg-Marquardt with the damping of T. Sugihara, "Solvability-unconcerned inverse kinematics by the
    Levenberg-Marquardt method", IEEE T-RO 27(5), 2011: proportional to |e|^2, plus a small constant. Joints that would
    leave their limits are held there and the step is solved again for the others.
    """
    count = axes.shape[0]
    displacements = np.minimum(np.maximum(start, lower), upper)
    jacobian = np.empty((6, count))
    error, normal, solved = np.empty(6), np.empty((6, 6)), np.empty(6)
    free, step = np.ones(count), np.empty(count)
    pose_error(target, forward(axes, points, tip, displacements, jacobian), error)
    size = np.sqrt(np.sum(error * error))
    slow = 0
    for _ in range(iterations):
        if size < tolerance:
            break
        damping = DAMPING_SHARE * size * size + LEAST_DAMPING
        free[:] = 1.0
        for _attempt in range(3):
            _damped_step(jacobian, free, damping, error, normal, solved, step)
            changed = False
            for i in range(count):
                if free[i] == 0.0:
                    continue
                out_low = displacements[i] <= lower[i] + LIMIT_SLACK and step[i] < 0.0
                out_high = displacements[i] >= upper[i] - LIMIT_SLACK and step[i] > 0.0
                if out_low or out_high:
                    free[i] = 0.0
                    changed = True
            if not changed:
                break
        largest = np.max(np.abs(step))
        if largest > MAXIMUM_STEP:
            step *= MAXIMUM_STEP / largest
        displacements = np.minimum(np.maximum(displacements + step, lower), upper)
        pose_error(target, forward(axes, points, tip, displacements, jacobian), error)
        updated = np.sqrt(np.sum(error * error))
        slow = slow + 1 if updated > STALL_PROGRESS * size else 0
        size = updated
        if slow >= STALLED_ITERATIONS:
            break
    return displacements, size


@numba.njit(cache=True, nogil=True)
def search(
    axes: FloatArray,
    points: FloatArray,
    tip: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    target: FloatArray,
    starts: FloatArray,
    wanted: int,
    separation: float,
    iterations: int,
    tolerance: float,
) -> FloatArray:
    """Return up to ``wanted`` solutions (m, n), any two of them ``separation`` [rad] apart in some joint.

    The starts (s, n) are tried in order until enough solutions are found.
    """
    count = axes.shape[0]
    found = np.empty((wanted, count))
    number = 0
    for s in range(starts.shape[0]):
        solution, size = descend(axes, points, tip, lower, upper, target, starts[s], iterations, tolerance)
        if size >= tolerance:
            continue
        fresh = True
        for k in range(number):
            if np.max(np.abs(found[k] - solution)) < separation:
                fresh = False
                break
        if fresh:
            found[number] = solution
            number += 1
            if number == wanted:
                break
    return found[:number].copy()


@numba.njit(cache=True, nogil=True)
def solve_many(
    axes: FloatArray,
    points: FloatArray,
    tip: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    targets: FloatArray,
    home: FloatArray,
    library: FloatArray,
    places: FloatArray,
    turns: FloatArray,
    rotation_length: float,
    iterations: int,
    tolerance: float,
    found: npt.NDArray[np.bool_],
    solutions: FloatArray,
) -> None:
    """Fill ``found`` (m,) with whether targets (m, 4, 4) are reached, and ``solutions`` (m, n) [rad] with how.

    From two starts: home (n,) and the nearest of a library (s, n), whose gripper poses are ``places`` (s, 3) and
    ``turns`` (s, 9).
    """
    for index in range(len(targets)):
        target = targets[index]
        solution, size = descend(axes, points, tip, lower, upper, target, home, iterations, tolerance)
        if size >= tolerance:
            nearest, least = 0, np.inf
            for row in range(len(places)):
                distance = 0.0
                for i in range(3):
                    offset = places[row, i] - target[i, 3]
                    distance += offset * offset
                    for j in range(3):
                        distance -= rotation_length * rotation_length * turns[row, 3 * i + j] * target[i, j]
                if distance < least:
                    nearest, least = row, distance
            solution, size = descend(axes, points, tip, lower, upper, target, library[nearest], iterations, tolerance)
        found[index] = size < tolerance
        solutions[index] = solution


@numba.njit(cache=True, nogil=True)
def forward_many(axes: FloatArray, points: FloatArray, tip: FloatArray, displacements: FloatArray) -> FloatArray:
    """Return ``world_from_gripper`` (m, 4, 4) of many displacements (m, n)."""
    poses = np.empty((displacements.shape[0], 4, 4))
    jacobian = np.empty((6, axes.shape[0]))
    for k in range(displacements.shape[0]):
        poses[k] = forward(axes, points, tip, displacements[k], jacobian)
    return poses
