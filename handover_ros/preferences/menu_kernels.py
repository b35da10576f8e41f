"""Compiled information of very many small menus made of the same items, each cost computed once, not once a menu.

A question among few items, as in pairwise preference learning, costs a few exponentials a person. Plain twin:
``reference.plain_information``.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.preferences.choice_kernels import FAST, exp_below_one
from handover_ros.preferences.query import IntArray

LOG2 = 0.693147180559945309417
MANTISSA, ONE = np.int64(0x000FFFFFFFFFFFFF), np.int64(0x3FF0000000000000)
ROOT2 = 1.4142135623730951


@numba.njit(cache=True, nogil=True, fastmath={"contract"}, error_model="numpy")
def log_from_one(x: float) -> float:
    """Return log(x) for finite x >= 1 to 4e-16 of 1 or of itself, in operations that vectorise.

    x = 2^n m with m within a factor of sqrt(2) of 1; log(m) = 2 atanh((m - 1) / (m + 1)) by its series.
    """
    bits = np.float64(x).view(np.int64)
    n = float((bits >> 52) - 1023)
    m = np.int64((bits & MANTISSA) | ONE).view(np.float64)
    large = m > ROOT2
    m = 0.5 * m if large else m
    n = n + 1.0 if large else n
    s = (m - 1.0) / (m + 1.0)
    z = s * s
    z2 = z * z
    z4 = z2 * z2
    low = (1.0 / 3.0 + z / 5.0) + (1.0 / 7.0 + z / 9.0) * z2
    high = (1.0 / 11.0 + z / 13.0) + (1.0 / 15.0 + z / 17.0) * z2
    return n * LOG2 + 2.0 * (s + s * z * (low + z4 * (high + z4 / 19.0)))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def information_of_menus(exponents: FloatArray, weights: FloatArray, menus: IntArray, out: FloatArray) -> None:
    """Fill ``out`` (m,) with the mutual information of person and choice of each menu [nat], H(E[P]) - E[H(P)].

    Args:
        exponents: Attraction less rationality times cost of each item for each person, shape (items, n).
        weights: Of the persons, sum 1, shape (n,).
        menus: Items of each menu, shape (m, k).
        out: Filled, shape (m,).
    """
    count, size = len(weights), menus.shape[1]
    shares, top, total, spread = np.empty((size, count)), np.empty(count), np.empty(count), np.empty(count)
    for place in range(len(menus)):
        _choices(exponents, menus[place], shares, top, total, spread)
        expected = _expected_entropy(total, spread, weights)
        entropy = 0.0
        for k in range(size):
            predicted = _sum_of_products(shares[k], total)
            if predicted > 0.0:
                entropy -= predicted * math.log(predicted)
        out[place] = entropy - expected


@numba.njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _choices(
    exponents: FloatArray, menu: IntArray, shares: FloatArray, top: FloatArray, total: FloatArray, spread: FloatArray
) -> None:
    """Fill each item's share, and of each person their sum ``total`` and ``spread``, that of share times log share."""
    top[:] = exponents[menu[0]]
    for k in range(1, len(menu)):
        row = exponents[menu[k]]
        for i in range(len(top)):
            top[i] = max(top[i], row[i])
    total[:] = 0.0
    spread[:] = 0.0
    for k in range(len(menu)):
        row, share = exponents[menu[k]], shares[k]
        for i in range(len(top)):
            below = row[i] - top[i]
            share[i] = exp_below_one(below)
            total[i] += share[i]
            spread[i] += share[i] * below


@numba.njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _expected_entropy(total: FloatArray, spread: FloatArray, weights: FloatArray) -> float:
    """Return the weighted mean of log(total) - spread / total, and leave weights / total in ``total``."""
    expected = 0.0
    for i in range(len(total)):
        inverse = 1.0 / total[i]
        expected += weights[i] * (log_from_one(total[i]) - spread[i] * inverse)
        total[i] = weights[i] * inverse
    return expected


@numba.njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _sum_of_products(some: FloatArray, others: FloatArray) -> float:
    """Return the sum of some (n,) times others (n,)."""
    total = 0.0
    for i in range(len(some)):
        total += some[i] * others[i]
    return total
