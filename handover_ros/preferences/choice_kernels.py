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
# exp(x) = 2^n exp(r) with |r| <= log(2) / 2: rounding by the mantissa's end, Cody and Waite's two-part log(2), Taylor.
ROUND = 6755399441055744.0  # 1.5 * 2^52: adding it leaves the nearest integer in the last bits
LOG2_HIGH, LOG2_LOW, PER_LOG2 = 0.693147180369123816490, 1.90821492927058770002e-10, 1.44269504088896338700
LEAST_EXPONENT = -708.0  # below, exp is 0


@numba.njit(cache=True, nogil=True, fastmath={"contract"}, error_model="numpy")
def exp_below_one(x: float) -> float:
    """Return exp(x) for x <= 0 to 4e-16, in operations that vectorise; 0 below -708."""
    y = max(x, LEAST_EXPONENT)
    shifted = y * PER_LOG2 + ROUND
    n = shifted - ROUND
    r = (y - n * LOG2_HIGH) - n * LOG2_LOW
    series = 1.0 / 6227020800.0
    series = series * r + 1.0 / 479001600.0
    series = series * r + 1.0 / 39916800.0
    series = series * r + 1.0 / 3628800.0
    series = series * r + 1.0 / 362880.0
    series = series * r + 1.0 / 40320.0
    series = series * r + 1.0 / 5040.0
    series = series * r + 1.0 / 720.0
    series = series * r + 1.0 / 120.0
    series = series * r + 1.0 / 24.0
    series = series * r + 1.0 / 6.0
    series = series * r + 0.5
    series = series * r + 1.0
    series = series * r + 1.0
    bits = (np.float64(shifted).view(np.int64) + 1023) << 52
    return series * np.int64(bits).view(np.float64) if x >= LEAST_EXPONENT else 0.0


@numba.njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def costs_of(
    configurations: FloatArray, squares: FloatArray, slopes: FloatArray, constant: float, costs: FloatArray
) -> None:
    """Fill ``costs`` (k,) with what each configuration costs one believed person."""
    count = configurations.shape[1]
    for k in range(count):
        costs[k] = constant
    for j in range(configurations.shape[0]):
        square, slope, row = squares[j], slopes[j], configurations[j]
        for k in range(count):
            costs[k] += (square * row[k] + slope) * row[k]


@numba.njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def shares_of(costs: FloatArray, attraction: FloatArray, rationality: float, shares: FloatArray) -> tuple[float, float]:
    """Fill ``shares`` (k,) with exp(attraction - rationality cost - top); return top and the sum of the shares."""
    count = len(costs)
    top = -np.inf
    for k in range(count):
        shares[k] = attraction[k] - rationality * costs[k]
        top = max(top, shares[k])
    total = 0.0
    for k in range(count):
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
    mean, exponent, least = 0.0, 0.0, np.inf
    for k in range(len(costs)):
        mean += shares[k] * costs[k]
        exponent += shares[k] * max(attraction[k], -1e300)
        least = min(least, costs[k])
    mean /= total
    return top + math.log(total) - exponent / total + rationality * mean, mean, least


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
