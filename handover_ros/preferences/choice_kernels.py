"""Compiled Boltzmann choices (Bestick 2017, eq. 4.3) of many believed persons over one feasible set.

The quadratic cost (4.2) is C = sum_j (w_j q_j + b_j) q_j + constant with b_j = -2 w_j q*_j. Configurations are the
inner index everywhere, so that the loops over them run in vector registers. Plain twin: ``reference``.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from handover_ros.geometry import FloatArray

# Sums may be reordered; infinities and NaN keep their meaning. The exponential's own steps may not.
FAST = {"reassoc", "contract", "arcp", "nsz"}
# exp(x) = 2^n exp(r) with |r| <= log(2) / 2: rounding by the mantissa's end, Cody and Waite's two-part log(2).
ROUND = 6755399441055744.0  # 1.5 * 2^52: adding it leaves the nearest integer in the last bits
LOG2_HIGH, LOG2_LOW, PER_LOG2 = 0.693147180369123816490, 1.90821492927058770002e-10, 1.44269504088896338700
# exp(r) by the polynomial of degree 11 through its values at the Chebyshev nodes of |r| <= log(2) / 2: to 3e-18.
P2, P3, P4, P5 = 0.5000000000000019, 0.1666666666666668, 0.0416666666664881, 0.008333333333319601
P6, P7, P8 = 0.0013888888952314775, 0.00019841269890047113, 2.4801485482328494e-05
P9, P10, P11 = 2.755724091857897e-06, 2.763263963904103e-07, 2.5110037605963777e-08
LEAST_EXPONENT = -708.0  # below, exp is 0


@numba.njit(cache=True, nogil=True, fastmath={"contract"}, error_model="numpy")
def exp_below_one(x: float) -> float:
    """Return exp(x) for x <= 0 to 4e-16, in operations that vectorise; 0 below -708."""
    y = max(x, LEAST_EXPONENT)
    shifted = y * PER_LOG2 + ROUND
    n = shifted - ROUND
    r = (y - n * LOG2_HIGH) - n * LOG2_LOW
    r2 = r * r
    r4 = r2 * r2
    # Estrin's order: short chains, so that the processor works on several terms at a time.
    high = ((P4 + P5 * r) + (P6 + P7 * r) * r2) + r4 * ((P8 + P9 * r) + (P10 + P11 * r) * r2)
    series = ((1.0 + r) + (P2 + P3 * r) * r2) + r4 * high
    bits = (np.float64(shifted).view(np.int64) + 1023) << 52
    return series * np.int64(bits).view(np.float64) if x >= LEAST_EXPONENT else 0.0


@numba.njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def costs_of(
    configurations: FloatArray, squares: FloatArray, slopes: FloatArray, constant: float, costs: FloatArray
) -> None:
    """Fill ``costs`` (k,) with what each configuration costs one believed person."""
    costs[:] = constant
    joints, done = len(configurations), 0
    while done < joints:
        # Several joints at a time, so that ``costs`` is read and written less often.
        left, q, w, b = joints - done, configurations[done:], squares[done:], slopes[done:]
        if left >= 4:
            _add_four(q, w, b, costs)
            done += 4
        elif left == 3:
            _add_three(q, w, b, costs)
            done += 3
        else:
            _add_one(q[0], w[0], b[0], costs)
            done += 1


@numba.njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _add_four(configurations: FloatArray, squares: FloatArray, slopes: FloatArray, costs: FloatArray) -> None:
    """Add what the first four joints cost."""
    first, second, third, fourth = configurations[0], configurations[1], configurations[2], configurations[3]
    w1, w2, w3, w4 = squares[0], squares[1], squares[2], squares[3]
    b1, b2, b3, b4 = slopes[0], slopes[1], slopes[2], slopes[3]
    for k in range(len(costs)):
        half = (w1 * first[k] + b1) * first[k] + (w2 * second[k] + b2) * second[k]
        costs[k] += half + (w3 * third[k] + b3) * third[k] + (w4 * fourth[k] + b4) * fourth[k]


@numba.njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _add_three(configurations: FloatArray, squares: FloatArray, slopes: FloatArray, costs: FloatArray) -> None:
    """Add what the first three joints cost."""
    first, second, third = configurations[0], configurations[1], configurations[2]
    w1, w2, w3, b1, b2, b3 = squares[0], squares[1], squares[2], slopes[0], slopes[1], slopes[2]
    for k in range(len(costs)):
        two = (w1 * first[k] + b1) * first[k] + (w2 * second[k] + b2) * second[k]
        costs[k] += two + (w3 * third[k] + b3) * third[k]


@numba.njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _add_one(configurations: FloatArray, square: float, slope: float, costs: FloatArray) -> None:
    """Add what one joint costs."""
    for k in range(len(costs)):
        costs[k] += (square * configurations[k] + slope) * configurations[k]


@numba.njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def greatest(values: FloatArray) -> float:
    """Return the greatest of values (k,), in four chains, which is as fast as comparing can be made here."""
    first = second = third = fourth = -np.inf
    whole = len(values) // 4 * 4
    for k in range(0, whole, 4):
        a, b, c, d = values[k], values[k + 1], values[k + 2], values[k + 3]
        first = a if a > first else first
        second = b if b > second else second
        third = c if c > third else third
        fourth = d if d > fourth else fourth
    for k in range(whole, len(values)):
        first = max(first, values[k])
    return max(max(first, second), max(third, fourth))


@numba.njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def shares_of(costs: FloatArray, attraction: FloatArray, rationality: float, shares: FloatArray) -> tuple[float, float]:
    """Fill ``shares`` (k,) with exp(attraction - rationality cost - top); return top and the sum of the shares."""
    for k in range(len(costs)):
        shares[k] = attraction[k] - rationality * costs[k]
    top = greatest(shares)
    total = 0.0
    for k in range(len(costs)):
        shares[k] = exp_below_one(shares[k] - top)
        total += shares[k]
    return top, total


@numba.njit(cache=True, nogil=True, error_model="numpy")
def log_sums(
    configurations: FloatArray,
    attraction: FloatArray,
    squares: FloatArray,
    slopes: FloatArray,
    rationality: FloatArray,
    out: FloatArray,
) -> None:
    """Fill ``out`` (n,) with log sum_k exp(attraction_k - rationality C_k), the cost's constant left out.

    Args:
        configurations: Displacements [rad], shape (d, k).
        attraction: Log measure of each configuration (k,).
        squares: w of each believed person (n, d).
        slopes: b of each (n, d).
        rationality: Of each (n,).
        out: Filled, shape (n,).
    """
    count = configurations.shape[1]
    costs, shares = np.empty(count), np.empty(count)
    for i in range(len(squares)):
        costs_of(configurations, squares[i], slopes[i], 0.0, costs)
        top, total = shares_of(costs, attraction, rationality[i], shares)
        out[i] = top + math.log(total)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def survey(
    configurations: FloatArray,
    attraction: FloatArray,
    squares: FloatArray,
    slopes: FloatArray,
    constants: FloatArray,
    rationality: FloatArray,
    weights: FloatArray,
    predicted: FloatArray,
    table: FloatArray,
) -> None:
    """Survey how believed persons would choose.

    Adds their choices, weighted, to ``predicted`` (k,), and fills ``table`` (n, 3) with the entropy of each choice
    [nat], its expected cost and the least cost. Arguments as for ``log_sums``; ``constants`` (n,) of the costs.
    """
    count = configurations.shape[1]
    costs, shares = np.empty(count), np.empty(count)
    for i in range(len(squares)):
        costs_of(configurations, squares[i], slopes[i], constants[i], costs)
        top, total = shares_of(costs, attraction, rationality[i], shares)
        table[i, 0], table[i, 1], table[i, 2] = _moments(costs, attraction, shares, rationality[i], top, total)
        _add(shares, weights[i] / total, predicted)


@numba.njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _moments(
    costs: FloatArray, attraction: FloatArray, shares: FloatArray, rationality: float, top: float, total: float
) -> tuple[float, float, float]:
    """Return entropy, mean and least cost of one choice."""
    mean, exponent = 0.0, 0.0
    for k in range(len(costs)):
        mean += shares[k] * costs[k]
        exponent += shares[k] * attraction[k]
    mean /= total
    return top + math.log(total) - exponent / total + rationality * mean, mean, least(costs)


@numba.njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def least(values: FloatArray) -> float:
    """Return the least of values (k,), as ``greatest`` does."""
    first = second = third = fourth = np.inf
    whole = len(values) // 4 * 4
    for k in range(0, whole, 4):
        a, b, c, d = values[k], values[k + 1], values[k + 2], values[k + 3]
        first = a if a < first else first
        second = b if b < second else second
        third = c if c < third else third
        fourth = d if d < fourth else fourth
    for k in range(whole, len(values)):
        first = min(first, values[k])
    return min(min(first, second), min(third, fourth))


@numba.njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _add(values: FloatArray, factor: float, total: FloatArray) -> None:
    """Add ``factor`` times ``values`` (k,) to ``total`` (k,)."""
    for k in range(len(values)):
        total[k] += factor * values[k]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def group_probabilities(
    configurations: FloatArray,
    attraction: FloatArray,
    group: FloatArray,
    squares: FloatArray,
    slopes: FloatArray,
    rationality: FloatArray,
    out: FloatArray,
) -> None:
    """Fill ``out`` (n, groups) with the probability that a configuration of each group (k,) is chosen."""
    count = configurations.shape[1]
    costs, shares = np.empty(count), np.empty(count)
    for i in range(len(squares)):
        costs_of(configurations, squares[i], slopes[i], 0.0, costs)
        _, total = shares_of(costs, attraction, rationality[i], shares)
        out[i] = 0.0
        for k in range(count):
            out[i, group[k]] += shares[k]
        for g in range(out.shape[1]):
            out[i, g] /= total
