"""Compiled inverse kinematics of a human arm: every posture that puts the hand at a pose, as arcs of the swivel angle.

With the hand at a pose, shoulder and wrist stand still and the elbow can turn about the line between them: the swivel
angle phi. Turning multiplies every rotation of the chain by I + sin(phi) K + (1 - cos(phi)) K^2, so each of its entries
is a sum p + q cos(phi) + r sin(phi), and a joint at its limit is such a sum at zero: two roots in closed form. Between
neighbouring roots of all limits nothing changes, so that one look there decides for the whole stretch, however narrow
it is. M. Shimizu et al., IEEE Transactions on Robotics 24(5), 2008, treat the limits of a robot in this way.

A posture lies on one of 8 branches: the elbow bends either way, and shoulder and wrist have two Euler triples each. The
number of a branch adds 1 for the elbow bent backwards, 2 for the shoulder's and 4 for the wrist's other triple.

All arms here are right arms (``Arm`` mirrors a left one); hand poses are ``torso_from_hand_segment``: origin in the
wrist, in the zero posture with the torso's axes. The plain twin is ``reference.py``.
"""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from handover_ros.geometry import FloatArray

IntArray = npt.NDArray[np.int64]

SUMS = 18  # rows of ``prepare``
BRANCHES = 8
MOST_ROOTS = 24  # six angles, two limits each, two roots each
MOST_ARCS = 216  # 8 branches of 24 stretches, and points
LIMIT_TOLERANCE = 1e-9  # [rad] by which a displacement may pass its limit: rounding
TANGENT = 1e-12  # by which a sum may miss zero where it only touches it
ROUNDING = 1e-14  # of a sum along a stretch: some are constant there, at the very limit
REACH_TOLERANCE = 1e-12  # of the cosine of the elbow's bend
STRAIGHT = (
    4e-15  # by which that cosine may miss 1 where the arm is straight: half the digits of the bend are lost there
)
PARALLEL = 1e-9  # [m] below which wrist and shoulder are one point
VERTICAL = 1e-6  # length of a line's horizontal part below which it has no lowest side
NO_DIRECTION = 1e-11  # cosine of a middle angle below which the outer two are not determined one by one
CONSTANT = 1e-13  # amplitude of a sum that does not change along the circle
LEAST_ARC = 1e-13  # [rad] of swivel
ONE_POINT = 1e-6  # [rad] of swivel between roots that may be one: where limits meet or are only touched
FULL_TURN = 2.0 * np.pi
HALF_PI = 0.5 * np.pi


@numba.njit(cache=True, nogil=True, inline="always")
def _put(sums: FloatArray, row: int, p: float, q: float, r: float) -> None:
    """Set one row."""
    sums[row, 0], sums[row, 1], sums[row, 2] = p, q, r


@numba.njit(cache=True, nogil=True, inline="always")
def _dot(line: FloatArray, pose: FloatArray, column: int) -> float:
    """Return a vector's component along an axis of the hand."""
    return line[0] * pose[0, column] + line[1] * pose[1, column] + line[2] * pose[2, column]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def prepare(
    pose: FloatArray, shoulder: FloatArray, upper_arm: float, forearm: float, sums: FloatArray, axes: FloatArray
) -> float:
    """Fill ``sums`` (18, 3) with p, q, r of what the joint angles are made of; return the elbow's bend [rad], -1: none.

    With u and v the directions of upper arm and forearm, f and t their front and s their common side, and the hand's
    axes x, y, z: rows 0-9 are the arguments of the Euler angles, u_x, -u_z (q1); -u_y (q2); f_y, s_y (q3); -t.y, s.y
    (q5); -v.y (q6); -v.x, -v.z (q7); rows 10-17, what q3 and q7 are made of once q1 and q5 are known: f_x, f_z, s_x,
    s_z; t.x, s.x, t.z, s.z.

    Args:
        pose: Of the hand segment (4, 4).
        shoulder: Its centre in the torso frame [m] (3,).
        upper_arm: Length [m].
        forearm: Length [m].
        sums: Is filled.
        axes: Workspace (3, 3).
    """
    line, low, out = axes[0], axes[1], axes[2]
    squared = 0.0
    for i in range(3):
        line[i] = pose[i, 3] - shoulder[i]
        squared += line[i] * line[i]
    cosine = (squared - upper_arm * upper_arm - forearm * forearm) / (2.0 * upper_arm * forearm)
    if not (-1.0 - REACH_TOLERANCE <= cosine <= 1.0 + REACH_TOLERANCE):
        return -1.0
    cosine = 1.0 if cosine > 1.0 - STRAIGHT else max(cosine, -1.0)
    bend = np.arccos(cosine)
    distance = np.sqrt(squared)
    if distance > PARALLEL:
        for i in range(3):
            line[i] /= distance
    else:  # the folded arm may point anywhere; of all its postures those are found that turn about the vertical
        line[0], line[1], line[2] = 0.0, 0.0, -1.0
    # Swivel zero is the elbow at its lowest; on a vertical line, the elbow in front.
    if np.hypot(line[0], line[1]) > VERTICAL:
        low[0], low[1], low[2] = line[0] * line[2], line[1] * line[2], line[2] * line[2] - 1.0
    else:
        low[0], low[1], low[2] = 1.0 - line[0] * line[0], -line[0] * line[1], -line[0] * line[2]
    length = np.sqrt(low[0] * low[0] + low[1] * low[1] + low[2] * low[2])
    for i in range(3):
        low[i] /= length
    out[0] = low[1] * line[2] - low[2] * line[1]
    out[1] = low[2] * line[0] - low[0] * line[2]
    out[2] = low[0] * line[1] - low[1] * line[0]
    # Between the line and the upper arm (a) and the forearm (b); exact for the straight and the folded arm too.
    a = np.arctan2(forearm * np.sin(bend), upper_arm + forearm * cosine)
    b = bend - a
    sine_a, cosine_a, sine_b, cosine_b = np.sin(a), np.cos(a), np.sin(b), np.cos(b)
    # e = cos(phi) low + sin(phi) out; u = cos(a) line + sin(a) e, f = sin(a) line - cos(a) e,
    # v = cos(b) line - sin(b) e, t = -sin(b) line - cos(b) e, s = line x e = -cos(phi) out + sin(phi) low.
    _put(sums, 0, cosine_a * line[0], sine_a * low[0], sine_a * out[0])
    _put(sums, 1, -cosine_a * line[2], -sine_a * low[2], -sine_a * out[2])
    _put(sums, 2, -cosine_a * line[1], -sine_a * low[1], -sine_a * out[1])
    _put(sums, 3, sine_a * line[1], -cosine_a * low[1], -cosine_a * out[1])
    _put(sums, 4, 0.0, -out[1], low[1])
    x, y, z = _dot(line, pose, 0), _dot(line, pose, 1), _dot(line, pose, 2)
    low_x, low_y, low_z = _dot(low, pose, 0), _dot(low, pose, 1), _dot(low, pose, 2)
    out_x, out_y, out_z = _dot(out, pose, 0), _dot(out, pose, 1), _dot(out, pose, 2)
    _put(sums, 5, sine_b * y, cosine_b * low_y, cosine_b * out_y)
    _put(sums, 6, 0.0, -out_y, low_y)
    _put(sums, 7, -cosine_b * y, sine_b * low_y, sine_b * out_y)
    _put(sums, 8, -cosine_b * x, sine_b * low_x, sine_b * out_x)
    _put(sums, 9, -cosine_b * z, sine_b * low_z, sine_b * out_z)
    _put(sums, 10, sine_a * line[0], -cosine_a * low[0], -cosine_a * out[0])
    _put(sums, 11, sine_a * line[2], -cosine_a * low[2], -cosine_a * out[2])
    _put(sums, 12, 0.0, -out[0], low[0])
    _put(sums, 13, 0.0, -out[2], low[2])
    _put(sums, 14, -sine_b * x, -cosine_b * low_x, -cosine_b * out_x)
    _put(sums, 15, 0.0, -out_x, low_x)
    _put(sums, 16, -sine_b * z, -cosine_b * low_z, -cosine_b * out_z)
    _put(sums, 17, 0.0, -out_z, low_z)
    return float(bend)


@numba.njit(cache=True, nogil=True, inline="always")
def _value(sums: FloatArray, row: int, cosine: float, sine: float) -> float:
    """Return p + q cos(phi) + r sin(phi) of a row."""
    return sums[row, 0] + sums[row, 1] * cosine + sums[row, 2] * sine


@numba.njit(cache=True, nogil=True, inline="always")
def _near(angle: float, middle: float) -> float:
    """Return an angle turned by full turns to be nearest to the middle of its limits."""
    return angle - FULL_TURN * np.round((angle - middle) / FULL_TURN)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _free_choice(front: float, side: float, sign: float, limits: FloatArray, first: int, last: int) -> float:
    """Return the first outer angle of a triple whose middle one is +-90 degrees: only a sum of the outer two counts.

    The last is then atan2(front, side) + sign * first. Of all pairs within the limits the one with the first nearest
    to the middle of its limits; that middle itself when there is none.
    """
    constant = np.arctan2(front, side)
    middle = 0.5 * (limits[0, first] + limits[1, first])
    best, found = middle, np.inf
    for turn in range(-2, 3):
        one = sign * (limits[0, last] - constant + FULL_TURN * turn)
        other = sign * (limits[1, last] - constant + FULL_TURN * turn)
        low = max(min(one, other), limits[0, first])
        high = min(max(one, other), limits[1, first])
        if low <= high:
            angle = min(max(middle, low), high)
            if abs(angle - middle) < found:
                best, found = angle, abs(angle - middle)
    return best


@numba.njit(cache=True, nogil=True, error_model="numpy")
def posture(sums: FloatArray, bend: float, phi: float, branch: int, limits: FloatArray, q: FloatArray) -> bool:
    """Fill ``q`` (7,) with the displacements [rad] at a swivel angle; return whether all are within ``limits`` (2, 7).

    Angles that turning could add full turns to are those nearest to the middle of their limits.
    """
    cosine, sine = np.cos(phi), np.sin(phi)
    backwards = -1.0 if branch & 1 else 1.0
    over = -1.0 if branch & 2 else 1.0
    wrist_over = -1.0 if branch & 4 else 1.0
    q[3] = backwards * bend
    # Shoulder: R = exp(-y q1) exp(-x q2) exp(z q3) with columns f, s, -u (f and s turned round for the other elbow).
    first, second = _value(sums, 0, cosine, sine), _value(sums, 1, cosine, sine)
    middle = _value(sums, 2, cosine, sine)
    length = np.sqrt(first * first + second * second)
    q[1] = np.arctan2(middle, over * length)
    f_x, f_z = _value(sums, 10, cosine, sine), _value(sums, 11, cosine, sine)
    s_x, s_z = _value(sums, 12, cosine, sine), _value(sums, 13, cosine, sine)
    if length > NO_DIRECTION:
        q[0] = np.arctan2(over * first, over * second)
        sine_1, cosine_1 = over * first / length, over * second / length
    else:
        q[0] = _free_choice(-backwards * s_x, backwards * f_x, np.sign(middle), limits, 0, 2)
        sine_1, cosine_1 = np.sin(q[0]), np.cos(q[0])
    q[2] = np.arctan2(-backwards * (cosine_1 * s_x + sine_1 * s_z), backwards * (cosine_1 * f_x + sine_1 * f_z))
    # Wrist: forearm^T hand = exp(z q5) exp(x q6) exp(-y q7), the forearm's columns t, s, -v (t and s turned round).
    first, second = backwards * _value(sums, 5, cosine, sine), backwards * _value(sums, 6, cosine, sine)
    middle = _value(sums, 7, cosine, sine)
    length = np.sqrt(first * first + second * second)
    q[5] = np.arctan2(middle, wrist_over * length)
    t_x, s_x = backwards * _value(sums, 14, cosine, sine), backwards * _value(sums, 15, cosine, sine)
    t_z, s_z = backwards * _value(sums, 16, cosine, sine), backwards * _value(sums, 17, cosine, sine)
    if length > NO_DIRECTION:
        q[4] = np.arctan2(wrist_over * first, wrist_over * second)
        sine_1, cosine_1 = wrist_over * first / length, wrist_over * second / length
    else:
        q[4] = _free_choice(-t_z, t_x, np.sign(middle), limits, 4, 6)
        sine_1, cosine_1 = np.sin(q[4]), np.cos(q[4])
    q[6] = np.arctan2(-(cosine_1 * t_z + sine_1 * s_z), cosine_1 * t_x + sine_1 * s_x)
    inside = True
    for joint in range(7):
        q[joint] = _near(q[joint], 0.5 * (limits[0, joint] + limits[1, joint]))
        if q[joint] < limits[0, joint] - LIMIT_TOLERANCE or q[joint] > limits[1, joint] + LIMIT_TOLERANCE:
            inside = False
    return inside


@numba.njit(cache=True, nogil=True, error_model="numpy")
def make_gates(limits: FloatArray) -> FloatArray:
    """Return the limits (2, 7) as what ``arcs`` compares with, shape (7, 6).

    Outer angles (0, 2, 4, 6): cosine and sine of the lower and of the upper limit, then 0 for any angle, 1 for a range
    up to half a turn, 2 for a wider one. Middle angles (1, 5): bounds of the sine for the usual triple, and twice for
    the other one, beyond a right angle and below minus a right angle; an empty interval has its lower bound above.
    """
    gates = np.zeros((7, 6))
    for joint in (0, 2, 4, 6):
        low, high = limits[0, joint], limits[1, joint]
        gates[joint, 0], gates[joint, 1] = np.cos(low), np.sin(low)
        gates[joint, 2], gates[joint, 3] = np.cos(high), np.sin(high)
        gates[joint, 4] = 0.0 if high - low >= FULL_TURN else 1.0 if high - low <= np.pi else 2.0
    for joint in (1, 5):
        low, high = limits[0, joint], limits[1, joint]
        gates[joint, 0], gates[joint, 1] = 2.0, -2.0
        gates[joint, 2], gates[joint, 3] = 2.0, -2.0
        gates[joint, 4], gates[joint, 5] = 2.0, -2.0
        if max(low, -HALF_PI) <= min(high, HALF_PI):
            gates[joint, 0], gates[joint, 1] = np.sin(max(low, -HALF_PI)), np.sin(min(high, HALF_PI))
        if high >= HALF_PI:
            gates[joint, 2], gates[joint, 3] = np.sin(high), np.sin(max(low, HALF_PI))
        if low <= -HALF_PI:
            gates[joint, 4], gates[joint, 5] = np.sin(min(high, -HALF_PI)), np.sin(low)
    return gates


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _roots(p: float, q: float, r: float, roots: FloatArray, count: int) -> int:
    """Insert the angles in [0, 2 pi) with p + q cos + r sin = 0 into the sorted ``roots``; return the count."""
    amplitude = np.sqrt(q * q + r * r)
    if abs(p) > amplitude + TANGENT or amplitude < CONSTANT:
        return count
    centre = np.arctan2(r, q)
    half = np.arccos(min(max(-p / amplitude, -1.0), 1.0))
    for sign in range(2):
        angle = centre + half if sign else centre - half
        if angle < 0.0:
            angle += FULL_TURN
        elif angle >= FULL_TURN:
            angle -= FULL_TURN
        place = count
        while place > 0 and roots[place - 1] > angle:
            roots[place] = roots[place - 1]
            place -= 1
        roots[place] = angle
        count += 1
    return count


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _all_roots(sums: FloatArray, gates: FloatArray, limits: FloatArray, roots: FloatArray) -> int:
    """Fill ``roots`` (24,) with the swivel angles at which some angle is at a limit, sorted; return how many."""
    count = 0
    for joint in (0, 2, 4, 6):
        row = 0 if joint == 0 else 3 if joint == 2 else 5 if joint == 4 else 8
        # Both limits of a full turn are one place, at which the displacement jumps.
        for end in range(1 if gates[joint, 4] == 0.0 else 2):  # atan2(y, x) = L or L + pi: y cos(L) - x sin(L) = 0
            cosine, sine = gates[joint, 2 * end], gates[joint, 2 * end + 1]
            p = sums[row, 0] * cosine - sums[row + 1, 0] * sine
            q = sums[row, 1] * cosine - sums[row + 1, 1] * sine
            r = sums[row, 2] * cosine - sums[row + 1, 2] * sine
            count = _roots(p, q, r, roots, count)
    for joint in (1, 5):
        row = 2 if joint == 1 else 7
        for end in range(2):
            p = sums[row, 0] - np.sin(limits[end, joint])
            count = _roots(p, sums[row, 1], sums[row, 2], roots, count)
    return count


@numba.njit(cache=True, nogil=True, inline="always")
def _passes(gates: FloatArray, joint: int, y: float, x: float, slack: float) -> int:
    """Return 1 if atan2(y, x) is within an outer angle's limits, plus 2 if atan2(-y, -x) is."""
    above = y * gates[joint, 0] - x * gates[joint, 1]
    below = x * gates[joint, 3] - y * gates[joint, 2]
    if gates[joint, 4] == 1.0:
        usual = above >= -slack and below >= -slack
        other = above <= slack and below <= slack
    elif gates[joint, 4] == 2.0:
        usual = above >= -slack or below >= -slack
        other = above <= slack or below <= slack
    else:
        usual, other = True, True
    return (1 if usual else 0) + (2 if other else 0)


@numba.njit(cache=True, nogil=True, inline="always")
def _passes_middle(gates: FloatArray, joint: int, sine: float, slack: float) -> int:
    """Return 1 if a middle angle of this sine is within its limits, plus 2 if that of the other triple is."""
    low, high = sine + slack, sine - slack
    usual = gates[joint, 0] <= low and high <= gates[joint, 1]
    other = (gates[joint, 2] <= low and high <= gates[joint, 3]) or (gates[joint, 4] <= low and high <= gates[joint, 5])
    return (1 if usual else 0) + (2 if other else 0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _feasible_branches(sums: FloatArray, gates: FloatArray, phi: float, slack: float) -> int:
    """Return the branches, bit b for branch b, on which all joints but the elbow are within their limits."""
    cosine, sine = np.cos(phi), np.sin(phi)
    shoulder = _passes_middle(gates, 1, _value(sums, 2, cosine, sine), slack)
    if shoulder == 0:
        return 0
    wrist = _passes_middle(gates, 5, _value(sums, 7, cosine, sine), slack)
    if wrist == 0:
        return 0
    shoulder &= _passes(gates, 0, _value(sums, 0, cosine, sine), _value(sums, 1, cosine, sine), slack)
    wrist &= _passes(gates, 6, _value(sums, 8, cosine, sine), _value(sums, 9, cosine, sine), slack)
    if shoulder == 0 or wrist == 0:
        return 0
    rotation = _passes(gates, 2, _value(sums, 3, cosine, sine), _value(sums, 4, cosine, sine), slack)
    pronation = _passes(gates, 4, _value(sums, 5, cosine, sine), _value(sums, 6, cosine, sine), slack)
    branches = 0
    for branch in range(BRANCHES):
        backwards, over, wrist_over = branch & 1, (branch >> 1) & 1, (branch >> 2) & 1
        if (
            (shoulder >> over) & 1
            and (wrist >> wrist_over) & 1
            and (rotation >> (over ^ backwards)) & 1
            and (pronation >> (wrist_over ^ backwards)) & 1
        ):
            branches |= 1 << branch
    return branches


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _covered(branch: int, phi: float, found: FloatArray, count: int) -> bool:
    """Return whether an arc of the branch has a swivel angle, or all but has it."""
    for row in range(count):
        beyond = phi - found[row, 1] + ONE_POINT
        beyond -= FULL_TURN * np.floor(beyond / FULL_TURN)
        if found[row, 0] == branch and beyond <= found[row, 2] - found[row, 1] + 2.0 * ONE_POINT:
            return True
    return False


@numba.njit(cache=True, nogil=True, error_model="numpy")
def arcs(
    sums: FloatArray, bend: float, limits: FloatArray, gates: FloatArray, work: FloatArray, found: FloatArray
) -> int:
    """Fill ``found`` (216, 3) with branch, start and end [rad] of the feasible arcs; return how many there are.

    The arcs of a branch follow each other; then come single points, their end at their start. The whole circle is 2 pi
    long. A joint with limits a full turn apart jumps from one to the other; then no arcs are joined.

    Args:
        sums: Of ``prepare``.
        bend: Of the elbow [rad], >= 0.
        limits: Lower and upper limits [rad] (2, 7).
        gates: Of ``make_gates``.
        work: Workspace (64,).
        found: Is filled.
    """
    roots, q = work[:MOST_ROOTS], work[MOST_ROOTS : MOST_ROOTS + 7]
    elbows = 0
    if limits[0, 3] - LIMIT_TOLERANCE <= bend <= limits[1, 3] + LIMIT_TOLERANCE:
        elbows |= 0b01010101
    if bend > 0.0 and limits[0, 3] - LIMIT_TOLERANCE <= -bend <= limits[1, 3] + LIMIT_TOLERANCE:
        elbows |= 0b10101010
    if elbows == 0:
        return 0
    number = _all_roots(sums, gates, limits, roots)
    if number == 0:
        roots[0] = 0.0
        number = 1
    # Which branches are feasible in each stretch; kept in the workspace.
    stretches = work[MOST_ROOTS + 7 :]
    any_branch = 0
    for index in range(number):
        end = roots[index + 1] if index + 1 < number else roots[0] + FULL_TURN
        here = -1  # too short to count
        if end - roots[index] >= LEAST_ARC:
            here = elbows & _feasible_branches(sums, gates, 0.5 * (roots[index] + end), ROUNDING)
            any_branch |= here
        stretches[index] = here
    joined = True
    for joint in (0, 1, 2, 4, 5, 6):
        joined = joined and limits[1, joint] - limits[0, joint] < FULL_TURN
    count = 0
    for branch in range(BRANCHES):
        if (any_branch >> branch) & 1:
            count = _merged(branch, number, roots, stretches, joined, found, count)
    # Points where limits meet or are touched; when nothing else is feasible, any root within rounding of it.
    arcs_only = count
    for index in range(number):
        before = roots[index - 1] if index > 0 else roots[number - 1] - FULL_TURN
        after = roots[index + 1] if index + 1 < number else roots[0] + FULL_TURN
        if arcs_only > 0 and min(after - roots[index], roots[index] - before) > ONE_POINT:
            continue
        here = elbows & _feasible_branches(sums, gates, roots[index], LIMIT_TOLERANCE)
        for branch in range(BRANCHES):
            if not (here >> branch) & 1 or count == MOST_ARCS or _covered(branch, roots[index], found, count):
                continue
            if posture(sums, bend, roots[index], branch, limits, q):
                found[count, 0], found[count, 1], found[count, 2] = branch, roots[index], roots[index]
                count += 1
    return count


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _merged(
    branch: int, number: int, roots: FloatArray, stretches: FloatArray, joined: bool, found: FloatArray, count: int
) -> int:
    """Append the arcs of one branch, neighbouring stretches joined if told so, across the start of the circle too."""
    before = count
    going_on = False
    for index in range(number):
        here = int(stretches[index])
        if here < 0:
            continue
        if not (here >> branch) & 1:
            going_on = False
            continue
        end = roots[index + 1] if index + 1 < number else roots[0] + FULL_TURN
        if going_on and joined:
            found[count - 1, 2] = end
        else:
            found[count, 0], found[count, 1], found[count, 2] = branch, roots[index], end
            count += 1
        going_on = True
    closes = found[count - 1, 2] - found[before, 1] >= FULL_TURN - LEAST_ARC
    if joined and closes and count - before > 1:
        found[before, 1] = found[count - 1, 1] - FULL_TURN
        count -= 1
    return count
