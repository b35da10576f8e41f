"""Compiled starts for the inverse kinematics of a seven-joint arm, in closed form but for a small offset of the wrist.

With the first joint held, an arm like Baxter's has six left: axes 2 and 3 meet in the shoulder, axes 6 and 7 in the
wrist, and axis 5 passes the wrist at a small distance (1 cm). Were that distance zero, the six would follow one by one:
joint 4 from the distance of wrist and shoulder, 3 and 2 from the wrist's place, 5, 6 and 7 from the gripper's turn
(subproblems 3 and 2 of Murray, Li and Sastry, A Mathematical Introduction to Robotic Manipulation, 1994, section 3.3).
So a few values of joint 1 tell all postures there are, nearly, and ``kinematics_kernels.descend`` makes the best of
them exact. Whatever is returned has been checked by forward kinematics; the plain twin is a search from many starts.

The chain is given as in ``kinematics_kernels``.
"""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from handover_ros.geometry import FloatArray
from handover_ros.robot.kinematics_kernels import descend

JOINTS = 7
MEETING = 1e-6  # [m] by which axes that meet may miss each other
SQUARE = 1e-9  # cosine of a right angle
LARGEST_OFFSET = 0.03  # [m] of axis 5 from the wrist
KEPT = 3  # starts of a pose
OUTSIDE_WEIGHT = 20.0  # of a displacement outside its limits against one from the preferred posture
FARTHEST_OUTSIDE = 0.45  # [rad] outside a limit from which a start still finds in, along the redundancy
STRETCHED = 0.08  # by which a cosine may pass 1: for the wrist's offset, and joint 1 between two of its values
FULL_TURN = 2.0 * np.pi


def wrist_and_shoulder(axes: FloatArray, points: FloatArray) -> FloatArray | None:
    """Return shoulder, wrist and the point of axis 5 nearest to the wrist (3, 3) [m]; None: not such an arm."""
    if len(axes) != JOINTS:
        return None
    shoulder, wrist = _meeting(axes, points, 1, 2), _meeting(axes, points, 5, 6)
    square = (axes[1] @ axes[2], axes[4] @ axes[5], axes[5] @ axes[6], 1.0 - axes[4] @ axes[6])
    if shoulder is None or wrist is None or max(abs(each) for each in square) > SQUARE:
        return None
    middle = points[4] + axes[4] * (axes[4] @ (wrist - points[4]))
    if np.linalg.norm(middle - wrist) > LARGEST_OFFSET:
        return None
    return np.ascontiguousarray(np.stack([shoulder, wrist, middle]))


def _meeting(axes: FloatArray, points: FloatArray, one: int, other: int) -> FloatArray | None:
    """Return where two axes at right angles meet (3,), or None."""
    first = points[one] + axes[one] * (axes[one] @ (points[other] - points[one]))
    second = points[other] + axes[other] * (axes[other] @ (points[one] - points[other]))
    return first if np.linalg.norm(first - second) <= MEETING else None


@numba.njit(cache=True, nogil=True, inline="always")
def _dot(a: FloatArray, b: FloatArray) -> float:
    """Return the product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(cache=True, nogil=True, inline="always")
def _triple(a: FloatArray, b: FloatArray, c: FloatArray) -> float:
    """Return a . (b x c)."""
    return a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _turned(axis: FloatArray, angle: float, vector: FloatArray, result: FloatArray) -> None:
    """Set ``result`` to a vector turned about an axis."""
    cosine, sine = np.cos(angle), np.sin(angle)
    along = _dot(axis, vector) * (1.0 - cosine)
    x, y, z = vector[0], vector[1], vector[2]
    result[0] = cosine * x + sine * (axis[1] * z - axis[2] * y) + along * axis[0]
    result[1] = cosine * y + sine * (axis[2] * x - axis[0] * z) + along * axis[1]
    result[2] = cosine * z + sine * (axis[0] * y - axis[1] * x) + along * axis[2]


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _rated(q: FloatArray, lower: FloatArray, upper: FloatArray, preferred: FloatArray) -> float:
    """Return how far a posture is from the preferred one, and from its limits; inf: too far outside."""
    rate = 0.0
    for joint in range(JOINTS):
        outside = max(lower[joint] - q[joint], q[joint] - upper[joint], 0.0)
        if outside > FARTHEST_OUTSIDE:
            return np.inf
        rate += OUTSIDE_WEIGHT * outside
        rate += 0.1 * abs(q[joint] - preferred[joint])
    return rate


@numba.njit(cache=True, nogil=True, inline="always")
def _wrapped(angle: float, lower: float, upper: float) -> float:
    """Return an angle turned by full turns to be nearest to the middle of its limits."""
    return angle - FULL_TURN * np.round((angle - 0.5 * (lower + upper)) / FULL_TURN)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _keep(q: FloatArray, rate: float, starts: FloatArray, rates: FloatArray) -> None:
    """Insert a posture into the best (k, 7), whose rates (k,) ascend."""
    place = len(rates) - 1
    if rate >= rates[place]:
        return
    while place > 0 and rates[place - 1] > rate:
        rates[place] = rates[place - 1]
        starts[place] = starts[place - 1]
        place -= 1
    rates[place] = rate
    starts[place] = q


@numba.njit(cache=True, nogil=True, error_model="numpy")
def starts_of(
    axes: FloatArray,
    points: FloatArray,
    tip: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    places: FloatArray,
    target: FloatArray,
    preferred: FloatArray,
    firsts: FloatArray,
    starts: FloatArray,
    rates: FloatArray,
    work: FloatArray,
) -> None:
    """Fill ``starts`` (k, 7) [rad] with the best postures that nearly reach a target (4, 4), ``rates`` (k,) inf: none.

    Args:
        axes: Of the joints (7, 3).
        points: On the axes [m] (7, 3).
        tip: Of the gripper at zero displacements (4, 4).
        lower: Limits [rad] (7,).
        upper: Limits [rad] (7,).
        places: Of ``wrist_and_shoulder``.
        target: Gripper pose.
        preferred: Posture to be near to [rad] (7,).
        firsts: Displacements of joint 1 to look at [rad] (f,).
        starts: Is filled.
        rates: Is filled.
        work: Workspace (16, 3).
    """
    rates[:] = np.inf
    shoulder, wrist, middle = places[0], places[1], places[2]
    q = np.empty(JOINTS)
    # Gripper axes and wrist as columns of what the joints turn: motion = target tip^-1.
    motion, place = work[0:3], work[3]
    for r in range(3):
        for c in range(3):
            motion[r, c] = target[r, 0] * tip[c, 0] + target[r, 1] * tip[c, 1] + target[r, 2] * tip[c, 2]
    for r in range(3):
        place[r] = target[r, 3]
        for c in range(3):
            place[r] += motion[r, c] * (wrist[c] - tip[c, 3])
    pointing, across = work[4], work[5]  # where the motion takes axes 5 (and 7) and 6
    for r in range(3):
        pointing[r] = motion[r, 0] * axes[4, 0] + motion[r, 1] * axes[4, 1] + motion[r, 2] * axes[4, 2]
        across[r] = motion[r, 0] * axes[5, 0] + motion[r, 1] * axes[5, 1] + motion[r, 2] * axes[5, 2]
    side = work[6]  # a6 x a5
    side[0] = axes[5, 1] * axes[4, 2] - axes[5, 2] * axes[4, 1]
    side[1] = axes[5, 2] * axes[4, 0] - axes[5, 0] * axes[4, 2]
    side[2] = axes[5, 0] * axes[4, 1] - axes[5, 1] * axes[4, 0]
    # Elbow: shoulder and middle of the wrist as joint 4 sees them.
    near, far = work[7], work[8]
    along_near, along_far = 0.0, 0.0
    for r in range(3):
        near[r], far[r] = shoulder[r] - points[3, r], middle[r] - points[3, r]
    along_near, along_far = _dot(axes[3], near), _dot(axes[3], far)
    for r in range(3):
        near[r] -= along_near * axes[3, r]
        far[r] -= along_far * axes[3, r]
    zero = np.arctan2(_triple(axes[3], far, near), _dot(far, near))
    squares, product = _dot(near, near) + _dot(far, far), 2.0 * np.sqrt(_dot(near, near) * _dot(far, far))
    offset = (along_far - along_near) * (along_far - along_near)
    wanted, bent, turned, ahead, other = work[9], work[10], work[11], work[12], work[13]
    for number in range(len(firsts)):
        q[0] = firsts[number]
        for r in range(3):
            turned[r] = place[r] - points[0, r]
        _turned(axes[0], -q[0], turned, wanted)
        for r in range(3):
            wanted[r] += points[0, r] - shoulder[r]
        cosine = (squares - (_dot(wanted, wanted) - offset)) / product
        if abs(cosine) > 1.0 + STRETCHED:
            continue
        half = np.arccos(min(max(cosine, -1.0), 1.0))
        _turned(axes[0], -q[0], pointing, ahead)
        _turned(axes[0], -q[0], across, other)
        for elbow in range(2):
            q[3] = _wrapped(zero + half if elbow else zero - half, lower[3], upper[3])
            if q[3] < lower[3] - FARTHEST_OUTSIDE or q[3] > upper[3] + FARTHEST_OUTSIDE:
                continue
            for r in range(3):
                turned[r] = middle[r] - points[3, r]
            _turned(axes[3], q[3], turned, bent)
            for r in range(3):
                bent[r] += points[3, r] - shoulder[r]
            one, two = _dot(axes[1], bent), _triple(axes[1], axes[2], bent)
            amplitude = np.sqrt(one * one + two * two)
            cosine = _dot(axes[1], wanted) / amplitude
            if not abs(cosine) <= 1.0 + STRETCHED:
                continue
            middle_angle, half_angle = np.arctan2(two, one), np.arccos(min(max(cosine, -1.0), 1.0))
            for over in range(2):
                angle = middle_angle + half_angle if over else middle_angle - half_angle
                q[2] = _wrapped(angle, lower[2], upper[2])
                _turned(axes[2], q[2], bent, turned)
                share = _dot(axes[1], turned) * _dot(axes[1], wanted)
                angle = np.arctan2(_triple(axes[1], turned, wanted), _dot(turned, wanted) - share)
                q[1] = _wrapped(angle, lower[1], upper[1])
                if q[1] < lower[1] - FARTHEST_OUTSIDE or q[1] > upper[1] + FARTHEST_OUTSIDE:
                    continue
                _wrist(axes, side, ahead, other, q, lower, upper, preferred, starts, rates, work)


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _wrist(
    axes: FloatArray,
    side: FloatArray,
    ahead: FloatArray,
    other: FloatArray,
    q: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    preferred: FloatArray,
    starts: FloatArray,
    rates: FloatArray,
    work: FloatArray,
) -> None:
    """Complete a posture by its joints 5, 6 and 7, either way, and keep it if it is among the best.

    With W = R5 R6 R7: W a5 has cos(q6) along a5 and sin(q6) about it; W a6 then tells joint 7.
    """
    first, second = work[14], work[15]
    _turned(axes[1], -q[1], ahead, first)
    _turned(axes[2], -q[2], first, first)
    _turned(axes[3], -q[3], first, first)
    _turned(axes[1], -q[1], other, second)
    _turned(axes[2], -q[2], second, second)
    _turned(axes[3], -q[3], second, second)
    up, aside = _dot(first, axes[5]), _dot(first, side)
    bend = np.arctan2(np.sqrt(up * up + aside * aside), _dot(first, axes[4]))
    for flipped in range(2):
        sign = -1.0 if flipped else 1.0
        q[5] = sign * bend
        q[4] = _wrapped(np.arctan2(sign * up, sign * aside), lower[4], upper[4])
        # W a6 = cos(q7) R5 a6 + sin(q7) R5 R6 (a7 x a6), the latter at right angles to both R5 a6 and W a7.
        cosine, sine = np.cos(q[4]), np.sin(q[4])
        along = 0.0
        for r in range(3):
            along += second[r] * (cosine * axes[5, r] - sine * side[r])
        # R5 a6 = cos(q5) a6 - sin(q5) a6 x a5; (a5 turned by R5 R6) x (R5 a6) = -(R5 R6 side)
        across = 0.0
        for r in range(3):
            r5_side = cosine * side[r] + sine * axes[5, r]
            across += second[r] * (np.sin(q[5]) * axes[4, r] - np.cos(q[5]) * r5_side)
        q[6] = _wrapped(np.arctan2(across, along), lower[6], upper[6])
        _keep(q, _rated(q, lower, upper, preferred), starts, rates)


@numba.njit(cache=True, nogil=True)
def solve_many(
    axes: FloatArray,
    points: FloatArray,
    tip: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    places: FloatArray,
    targets: FloatArray,
    preferred: FloatArray,
    firsts: FloatArray,
    iterations: int,
    tolerance: float,
    found: npt.NDArray[np.bool_],
    solutions: FloatArray,
) -> None:
    """Fill ``found`` (m,) with whether targets (m, 4, 4) are reached, and how: ``solutions`` (m, 7) [rad].

    Args:
        axes: Of the joints (7, 3).
        points: On the axes [m] (7, 3).
        tip: Of the gripper at zero displacements (4, 4).
        lower: Limits [rad] (7,).
        upper: Limits [rad] (7,).
        places: Of ``wrist_and_shoulder``.
        targets: Gripper poses.
        preferred: Posture to be near to [rad] (7,).
        firsts: Displacements of joint 1 to look at [rad] (f,).
        iterations: From one start, at most.
        tolerance: Norm of the error of position [m] and rotation [rad].
        found: Is filled.
        solutions: Is filled.
    """
    starts, rates, work = np.empty((KEPT, JOINTS)), np.empty(KEPT), np.empty((16, 3))
    for index in range(len(targets)):
        found[index] = False
        target = targets[index]
        starts_of(axes, points, tip, lower, upper, places, target, preferred, firsts, starts, rates, work)
        for number in range(KEPT):
            if rates[number] == np.inf:
                break
            solution, size = descend(axes, points, tip, lower, upper, target, starts[number], iterations, tolerance)
            if size < tolerance:
                found[index] = True
                solutions[index] = solution
                break
