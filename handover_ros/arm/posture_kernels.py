"""Compiled loops over many hand poses: sample the feasible arcs, weigh the samples, find the best posture.

A sample stands for a piece of an arc; its measure is the length of that piece in configuration space [rad], so that
sums over samples are integrals over all feasible configurations, whatever the density.
"""

from __future__ import annotations

import numba
import numpy as np

from handover_ros.arm.swivel_kernels import FULL_TURN, MOST_ARCS, SUMS, IntArray, arcs, make_gates, posture, prepare
from handover_ros.geometry import FloatArray

PIECE = 0.15  # [rad] of swivel between the points at which an arc's length is measured, at most
LONGEST_CHORD = 0.4  # [rad] in configuration space between them
SHORTEST_PIECE = 1e-4  # [rad] of swivel
MOST_POINTS = 256
LEAST_MEASURE = 1e-6  # [rad] of a feasible set that is a single point
GOLDEN = 0.3819660112501051
REFINEMENTS = 40
# Parts of a piece between two points of an arc, which is the shorter the faster the joints turn.
NEAR_ENOUGH = 5e-7  # the cost is flat there
INWARD = 2e-5  # where the slope at the end of an arc shows
LEAST_STEP = 1e-12  # [rad] of swivel


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _walk(sums: FloatArray, bend: float, arc: FloatArray, limits: FloatArray, points: FloatArray) -> int:
    """Fill ``points`` (256, 9) along an arc, from its start to its end; return how many there are.

    Columns: displacements [rad], swivel angle [rad], way from the start in configuration space [rad]. Where the joints
    turn fast, near a pole of the shoulder or the wrist, the points lie closer.
    """
    branch, start, end = int(arc[0]), arc[1], arc[2]
    posture(sums, bend, start, branch, limits, points[0, :7])
    points[0, 7], points[0, 8] = start, 0.0
    count, step = 1, PIECE
    while points[count - 1, 7] < end and count < MOST_POINTS:
        here = points[count - 1, 7]
        phi = min(here + step, end)
        if end - phi < 0.1 * step or count == MOST_POINTS - 1:
            phi = end
        posture(sums, bend, phi, branch, limits, points[count, :7])
        squared = 0.0
        for joint in range(7):
            moved = points[count, joint] - points[count - 1, joint]
            moved -= FULL_TURN * np.round(moved / FULL_TURN)  # from one end of a range of a full turn to the other
            squared += moved * moved
        chord = np.sqrt(squared)
        if chord > LONGEST_CHORD and step > SHORTEST_PIECE and count < MOST_POINTS - 1:
            step *= 0.5
            continue
        points[count, 7], points[count, 8] = phi, points[count - 1, 8] + chord
        count += 1
        if chord < 0.4 * LONGEST_CHORD:
            step = min(2.0 * step, PIECE)
    return count


@numba.njit(cache=True, nogil=True, inline="always")
def _swivel_at(points: FloatArray, count: int, way: float, place: int) -> tuple[float, int]:
    """Return the swivel angle a way along an arc, and the point before it; searched from ``place`` on."""
    while place < count - 2 and points[place + 1, 8] < way:
        place += 1
    span = points[place + 1, 8] - points[place, 8]
    share = (way - points[place, 8]) / span if span > 0.0 else 0.5
    return points[place, 7] + share * (points[place + 1, 7] - points[place, 7]), place


@numba.njit(cache=True, nogil=True, error_model="numpy")
def sample(
    poses: FloatArray,
    shoulder: FloatArray,
    lengths: FloatArray,
    limits: FloatArray,
    step: float,
    postures: FloatArray,
    measures: FloatArray,
    first: IntArray,
) -> int:
    """Fill the postures that sample the feasible sets of hand poses; return how many there are.

    Args:
        poses: Of the hand segment (n, 4, 4).
        shoulder: Its centre [m] (3,).
        lengths: Of upper arm and forearm [m] (2,).
        limits: Lower and upper (2, 7) [rad].
        step: Largest piece of an arc that one sample stands for [rad] in configuration space.
        postures: Is filled as far as it goes (capacity, 7) [rad]; call again with more when the answer is larger.
        measures: Is filled (capacity,) [rad].
        first: Is filled (n + 1,): where the samples of each pose begin.
    """
    sums, axes, work = np.empty((SUMS, 3)), np.empty((3, 3)), np.empty(64)
    found, points = np.empty((MOST_ARCS, 3)), np.empty((MOST_POINTS, 9))
    q = np.empty(7)
    gates = make_gates(limits)
    total, capacity = 0, len(measures)
    for index in range(len(poses)):
        first[index] = total
        bend = prepare(poses[index], shoulder, lengths[0], lengths[1], sums, axes)
        if bend < 0.0:
            continue
        for row in range(arcs(sums, bend, limits, gates, work, found)):
            arc = found[row]
            last = _walk(sums, bend, arc, limits, points) - 1
            way = points[last, 8]
            count = max(1, int(np.ceil(way / step)))
            place = 0
            for part in range(count):
                phi = arc[1]
                if last:
                    phi, place = _swivel_at(points, last + 1, (part + 0.5) * way / count, place)
                if not posture(sums, bend, phi, int(arc[0]), limits, q):
                    continue
                if total < capacity:
                    postures[total] = q
                    measures[total] = max(way / count, LEAST_MEASURE)
                total += 1
    first[len(poses)] = total
    return total


@numba.njit(cache=True, nogil=True, error_model="numpy")
def weigh(costs: FloatArray, measures: FloatArray, first: IntArray, rationality: float, table: FloatArray) -> None:
    """Fill ``table`` (n, 5) with the statistics of each pose's samples, whose costs (total,) are given.

    Columns: measure; log of sum m exp(-rationality C) (-inf: infeasible); mean of C under these weights; mean of C
    under m alone; least C. An infinite rationality leaves the samples of least cost only.
    """
    for index in range(len(first) - 1):
        least, whole, plain = np.inf, 0.0, 0.0
        for place in range(first[index], first[index + 1]):
            least = min(least, costs[place])
            whole += measures[place]
            plain += measures[place] * costs[place]
        weights, weighted = 0.0, 0.0
        for place in range(first[index], first[index + 1]):
            above = costs[place] - least
            share = measures[place]
            if above > 0.0:
                share = 0.0 if rationality == np.inf else share * np.exp(-rationality * above)
            weights += share
            weighted += share * costs[place]
        _store(table, index, whole, plain, least, weights, weighted, rationality)


@numba.njit(cache=True, nogil=True, inline="always")
def _store(
    table: FloatArray,
    index: int,
    whole: float,
    plain: float,
    least: float,
    weights: float,
    weighted: float,
    rationality: float,
) -> None:
    """Set one row of ``weigh``; ``weights`` and ``weighted`` are relative to the least cost."""
    if whole > 0.0:
        table[index, 0] = whole
        table[index, 1] = np.log(weights) - (0.0 if rationality == np.inf else rationality * least)
        table[index, 2] = weighted / weights
        table[index, 3] = plain / whole
        table[index, 4] = least
    else:
        table[index, 0], table[index, 1] = 0.0, -np.inf
        table[index, 2], table[index, 3], table[index, 4] = np.inf, np.inf, np.inf


@numba.njit(cache=True, nogil=True, inline="always")
def _quadratic(q: FloatArray, neutral: FloatArray, weights: FloatArray) -> float:
    """Return sum w (q - q*)^2."""
    cost = 0.0
    for joint in range(7):
        offset = q[joint] - neutral[joint]
        cost += weights[joint] * offset * offset
    return cost


@numba.njit(cache=True, nogil=True, error_model="numpy")
def weigh_quadratic(
    poses: FloatArray,
    shoulder: FloatArray,
    lengths: FloatArray,
    limits: FloatArray,
    step: float,
    neutral: FloatArray,
    weights: FloatArray,
    rationality: float,
    table: FloatArray,
) -> None:
    """Fill ``table`` (n, 5) as ``sample`` and ``weigh`` do together with the cost (3.2); the samples are not kept."""
    sums, axes, work = np.empty((SUMS, 3)), np.empty((3, 3)), np.empty(64)
    found, points = np.empty((MOST_ARCS, 3)), np.empty((MOST_POINTS, 9))
    q = np.empty(7)
    gates = make_gates(limits)
    for index in range(len(poses)):
        least, whole, plain, total, weighted = np.inf, 0.0, 0.0, 0.0, 0.0
        bend = prepare(poses[index], shoulder, lengths[0], lengths[1], sums, axes)
        number = arcs(sums, bend, limits, gates, work, found) if bend >= 0.0 else 0
        for row in range(number):
            arc = found[row]
            last = _walk(sums, bend, arc, limits, points) - 1
            way = points[last, 8]
            count = max(1, int(np.ceil(way / step)))
            measure = max(way / count, LEAST_MEASURE)
            place = 0
            for part in range(count):
                phi = arc[1]
                if last:
                    phi, place = _swivel_at(points, last + 1, (part + 0.5) * way / count, place)
                if not posture(sums, bend, phi, int(arc[0]), limits, q):
                    continue
                cost = _quadratic(q, neutral, weights)
                whole += measure
                plain += measure * cost
                if cost < least:  # the sums are kept relative to the least cost, so that none underflows
                    shrink = 0.0 if rationality == np.inf or total == 0.0 else np.exp(-rationality * (least - cost))
                    total *= shrink
                    weighted *= shrink
                    least = cost
                above = cost - least
                share = measure
                if above > 0.0:
                    share = 0.0 if rationality == np.inf else measure * np.exp(-rationality * above)
                total += share
                weighted += share * cost
        _store(table, index, whole, plain, least, total, weighted, rationality)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _at(
    sums: FloatArray,
    bend: float,
    phi: float,
    branch: int,
    limits: FloatArray,
    neutral: FloatArray,
    weights: FloatArray,
    q: FloatArray,
) -> float:
    """Return the cost at a swivel angle."""
    posture(sums, bend, phi, branch, limits, q)
    return float(_quadratic(q, neutral, weights))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def best(
    poses: FloatArray,
    shoulder: FloatArray,
    lengths: FloatArray,
    limits: FloatArray,
    neutral: FloatArray,
    weights: FloatArray,
    postures: FloatArray,
    costs: FloatArray,
) -> None:
    """Fill the posture (n, 7) of least sum w (q - q*)^2 at each hand pose, and that cost (n,); inf: infeasible."""
    sums, axes, work = np.empty((SUMS, 3)), np.empty((3, 3)), np.empty(64)
    found, points = np.empty((MOST_ARCS, 3)), np.empty((MOST_POINTS, 9))
    values, q = np.empty(MOST_POINTS), np.empty(7)
    gates = make_gates(limits)
    for index in range(len(poses)):
        costs[index] = np.inf
        bend = prepare(poses[index], shoulder, lengths[0], lengths[1], sums, axes)
        number = arcs(sums, bend, limits, gates, work, found) if bend >= 0.0 else 0
        for row in range(number):
            arc = found[row]
            branch = int(arc[0])
            last = _walk(sums, bend, arc, limits, points) - 1
            for place in range(last + 1):
                values[place] = _quadratic(points[place], neutral, weights)
            for place in range(last + 1):
                before, after = max(place - 1, 0), min(place + 1, last)
                if values[place] > values[before] or values[place] > values[after]:
                    continue
                start, phi, end = points[before, 7], points[place, 7], points[after, 7]
                inward = INWARD * (end - start)
                inward = start + inward if place == before else end - inward
                inside = before < place < after
                if inside or _at(sums, bend, inward, branch, limits, neutral, weights, q) < values[place]:
                    phi = _descend(sums, bend, branch, limits, neutral, weights, start, phi, end, values[place], q)
                if posture(sums, bend, phi, branch, limits, q):
                    cost = _quadratic(q, neutral, weights)
                    if cost < costs[index]:
                        costs[index] = cost
                        postures[index] = q


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _descend(
    sums: FloatArray,
    bend: float,
    branch: int,
    limits: FloatArray,
    neutral: FloatArray,
    weights: FloatArray,
    low: float,
    phi: float,
    high: float,
    value: float,
    q: FloatArray,
) -> float:
    """Return the swivel angle of least cost between two others.

    R. P. Brent, Algorithms for Minimization without Derivatives, 1973, chapter 5: parabolas, golden sections where
    they do not converge.
    """
    second, third = phi, phi
    second_value, third_value = value, value
    step, last = 0.0, 0.0
    near = max(NEAR_ENOUGH * (high - low), LEAST_STEP)
    for _ in range(REFINEMENTS):
        middle = 0.5 * (low + high)
        if abs(phi - middle) <= 2.0 * near - 0.5 * (high - low):
            break
        golden = True
        if abs(last) > near:
            r = (phi - second) * (value - third_value)
            p = (phi - third) * (value - second_value)
            numerator = (phi - third) * p - (phi - second) * r
            denominator = 2.0 * (p - r)
            if denominator > 0.0:
                numerator = -numerator
            denominator = abs(denominator)
            if abs(numerator) < abs(0.5 * denominator * last) and denominator * (
                low - phi
            ) < numerator < denominator * (high - phi):
                last, step = step, numerator / denominator
                if phi + step - low < 2.0 * near or high - phi - step < 2.0 * near:
                    step = near if middle > phi else -near
                golden = False
        if golden:
            last = (low if phi >= middle else high) - phi
            step = GOLDEN * last
        tried = phi + (step if abs(step) >= near else (near if step > 0.0 else -near))
        tried_value = _at(sums, bend, tried, branch, limits, neutral, weights, q)
        if tried_value <= value:
            if tried >= phi:
                low = phi
            else:
                high = phi
            third, third_value = second, second_value
            second, second_value = phi, value
            phi, value = tried, tried_value
        else:
            if tried < phi:
                low = tried
            else:
                high = tried
            if tried_value <= second_value or second == phi:
                third, third_value = second, second_value
                second, second_value = tried, tried_value
            elif tried_value <= third_value or third in (phi, second):
                third, third_value = tried, tried_value
    return phi
