"""Compiled unscented Kalman filter over a skeleton's posture (eq. 2.7), equal to the plain one of ``ukf_reference``.

The state is a posture, on its manifold, and the derivatives of its tangent up to ``order - 1`` (rates, accelerations).
The error state e = (tangent, rates, ...) of length order * nv is Gaussian with covariance P. Two facts make it fast:

* The dynamics are linear in the error state, so that prediction is exact without sigma points.
* Markers depend on the posture only. With the lower Cholesky factor of P the sigma points of the other parts leave the
  markers where they are: 2 nv points are looked at instead of 2 order nv, and the result is the same.

With B_j = (h+ - h-) / (2 sqrt(c)) and E_j = (h+ + h- - 2 mean) / (2 sqrt(c)) the innovation covariance is
S = B B^T + E E^T + R, and with M = 1 + [E B]^T R^-1 [E B] = L L^T the update needs no matrix as large as the
measurement: de = G (M^-1 [E B]^T R^-1 v)_B and P - G (1 - (M^-1)_BB) G^T, where G holds the first nv columns of the
factor of P.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.skeleton.kernels import joint_poses, move, place_markers
from handover_ros.skeleton.normal_equations import cholesky_in_place
from handover_ros.skeleton.tree import FlatTree, IntArray

SEEN, MISSING, GATED, RELABELLED = 0, 1, 2, 3  # what became of a marker


@numba.njit(cache=True, nogil=True, error_model="numpy")
def predict(
    tree: FlatTree,
    q: FloatArray,
    rates: FloatArray,
    covariance: FloatArray,
    transition: FloatArray,
    noise: FloatArray,
    spectral: FloatArray,
) -> None:
    """Move posture and covariance on by one step of linear dynamics, in place.

    Args:
        tree: The skeleton.
        q: Coordinates, shape (nq,).
        rates: Derivatives of the tangent, shape (order - 1, nv).
        covariance: P, shape (order nv, order nv).
        transition: F of one degree of freedom, shape (order, order).
        noise: Q of one degree of freedom for unit spectral density, shape (order, order).
        spectral: Spectral density of each tangent's noise, shape (nv,).
    """
    nv, order = rates.shape[1], transition.shape[0]
    step, change = np.zeros(nv), np.zeros((order - 1, nv))
    for i in range(nv):
        for a in range(1, order):
            step[i] += transition[0, a] * rates[a - 1, i]
            for b in range(1, order):
                change[a - 1, i] += transition[a, b] * rates[b - 1, i]
    move(tree, q, step)
    rates[:] = change
    half = np.zeros_like(covariance)
    for a in range(order):
        for c in range(a, order):
            factor = transition[a, c]
            if factor != 0.0:
                for i in range(nv):
                    for j in range(covariance.shape[0]):
                        half[a * nv + i, j] += factor * covariance[c * nv + i, j]
    covariance[:] = 0.0
    for b in range(order):
        for d in range(b, order):
            factor = transition[b, d]
            if factor != 0.0:
                for i in range(covariance.shape[0]):
                    for j in range(nv):
                        covariance[i, b * nv + j] += factor * half[i, d * nv + j]
    for a in range(order):
        for b in range(order):
            for i in range(nv):
                covariance[a * nv + i, b * nv + i] += noise[a, b] * spectral[i]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def factor_columns(
    covariance: FloatArray,
    nv: int,
    out: FloatArray,
) -> bool:
    """Fill ``out`` (n, nv) with the first nv columns of the lower Cholesky factor of P; return whether that worked."""
    n = covariance.shape[0]
    for j in range(nv):
        total = covariance[j, j]
        for k in range(j):
            total -= out[j, k] * out[j, k]
        if not total > 0.0:
            return False
        out[j, j] = math.sqrt(total)
        for k in range(j):
            out[k, j] = 0.0
        inverse = 1.0 / out[j, j]
        for i in range(j + 1, n):
            total = covariance[i, j]
            for k in range(j):
                total -= out[i, k] * out[j, k]
            out[i, j] = total * inverse
    return True


@numba.njit(cache=True, nogil=True, error_model="numpy")
def spread_points(
    tree: FlatTree,
    q: FloatArray,
    gain: FloatArray,
    mean: FloatArray,
    first: FloatArray,
    second: FloatArray,
) -> None:
    """Look at the sigma points: fill the mean (m, 3), B (m, 3, nv) and E (m, 3, nv) of the predicted markers [m].

    The centre has no weight (the choice alpha^2 = nv / n, beta = alpha^2 - 1, kappa = 0 of Merwe's points), so that all
    weights are positive however large the state is.
    """
    nv, markers, joints = gain.shape[1], tree.marker.shape[0], tree.kind.shape[0]
    rotation, translation = np.empty((joints + 1, 3, 3)), np.empty((joints + 1, 3))
    local, point, step = np.empty((joints, 3, 3)), np.empty_like(q), np.empty(nv)
    plus, minus = np.empty((markers, 3)), np.empty((markers, 3))
    root = math.sqrt(nv)
    mean[:] = 0.0
    for j in range(nv):
        for i in range(nv):
            step[i] = root * gain[i, j]
        point[:] = q
        move(tree, point, step)
        joint_poses(tree, point, rotation, translation, local)
        place_markers(tree, rotation, translation, plus)
        for i in range(nv):
            step[i] = -step[i]
        point[:] = q
        move(tree, point, step)
        joint_poses(tree, point, rotation, translation, local)
        place_markers(tree, rotation, translation, minus)
        for m in range(markers):
            for r in range(3):
                first[m, r, j] = (plus[m, r] - minus[m, r]) / (2.0 * root)
                total = plus[m, r] + minus[m, r]
                second[m, r, j] = total
                mean[m, r] += total / (2.0 * nv)
    for m in range(markers):
        for r in range(3):
            for j in range(nv):
                second[m, r, j] = (second[m, r, j] - 2.0 * mean[m, r]) / (2.0 * root)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def marker_distance(
    position: FloatArray,
    mean: FloatArray,
    first: FloatArray,
    second: FloatArray,
    variance: float,
) -> float:
    """Return the squared Mahalanobis distance of a measured position (3,) from one marker's prediction."""
    s = np.zeros((3, 3))
    for r in range(3):
        for c in range(r + 1):
            total = 0.0
            for j in range(first.shape[1]):
                total += first[r, j] * first[c, j] + second[r, j] * second[c, j]
            s[r, c] = total
        s[r, r] += variance
    cholesky_in_place(s)
    squared = 0.0
    v = np.empty(3)
    for r in range(3):
        v[r] = position[r] - mean[r]
        for c in range(r):
            v[r] -= s[r, c] * v[c]
        v[r] /= s[r, r]
        squared += v[r] * v[r]
    return squared


@numba.njit(cache=True, nogil=True, error_model="numpy")
def judge_markers(
    observed: FloatArray,
    mean: FloatArray,
    first: FloatArray,
    second: FloatArray,
    variance: FloatArray,
    gate: float,
    status: IntArray,
    measured: FloatArray,
) -> tuple[int, int]:
    """Decide which measurements to believe, and put swapped labels back.

    Args:
        observed: Measured positions [m], shape (m, 3), NaN = not measured.
        mean: Predicted positions, shape (m, 3).
        first: B, shape (m, 3, nv).
        second: E, shape (m, 3, nv).
        variance: Of a coordinate of each marker [m^2], shape (m,).
        gate: Largest squared Mahalanobis distance; inf: believe all.
        status: Filled with SEEN, MISSING, GATED or RELABELLED, shape (m,).
        measured: Filled with the positions to use [m], shape (m, 3).

    Returns:
        How many measurements are not believed, and how many are, under their own label.
    """
    markers = observed.shape[0]
    gated = seen = 0
    for m in range(markers):
        measured[m] = observed[m]
        if math.isnan(observed[m, 0]):
            status[m] = MISSING
        elif gate < math.inf and marker_distance(observed[m], mean[m], first[m], second[m], variance[m]) > gate:
            status[m] = GATED
            gated += 1
        else:
            status[m] = SEEN
            seen += 1
    if gated == 0:
        return 0, seen
    # What was measured under a label that it does not fit may belong to another marker that lacks a measurement.
    free = status == GATED
    for m in range(markers):
        if status[m] != GATED and status[m] != MISSING:
            continue
        best, from_ = gate, -1
        for other in range(markers):
            if not free[other] or other == m:
                continue
            distance = marker_distance(observed[other], mean[m], first[m], second[m], variance[m])
            if distance < best:
                best, from_ = distance, other
        if from_ >= 0:
            measured[m] = observed[from_]
            gated -= status[m] == GATED
            status[m] = RELABELLED
            free[from_] = False
    return gated, seen


@numba.njit(cache=True, nogil=True, error_model="numpy")
def update(
    tree: FlatTree,
    q: FloatArray,
    rates: FloatArray,
    covariance: FloatArray,
    gain: FloatArray,
    mean: FloatArray,
    first: FloatArray,
    second: FloatArray,
    measured: FloatArray,
    status: IntArray,
    variance: FloatArray,
) -> tuple[float, int]:
    """Correct posture, rates and covariance by the believed markers, in place.

    Args:
        tree: The skeleton.
        q: Coordinates, shape (nq,).
        rates: Derivatives of the tangent, shape (order - 1, nv).
        covariance: P, shape (n, n).
        gain: First nv columns of P's factor, shape (n, nv).
        mean: Predicted markers, shape (m, 3).
        first: B, shape (m, 3, nv).
        second: E, shape (m, 3, nv).
        measured: Positions [m], shape (m, 3).
        status: As from ``judge_markers``.
        variance: Of a coordinate of each marker [m^2], shape (m,).

    Returns:
        Normalised innovation squared, and the number of believed markers.
    """
    n, nv = gain.shape
    size = 2 * nv
    system, right = np.zeros((size, size)), np.zeros(size)
    columns = np.empty((3, size))
    squared, used = 0.0, 0
    for m in range(measured.shape[0]):
        if status[m] == MISSING or status[m] == GATED:
            continue
        used += 1
        weight = 1.0 / variance[m]
        for r in range(3):
            for j in range(nv):
                columns[r, j] = second[m, r, j]
                columns[r, nv + j] = first[m, r, j]
        for r in range(3):
            v = measured[m, r] - mean[m, r]
            squared += weight * v * v
            for a in range(size):
                scaled = weight * columns[r, a]
                right[a] += scaled * v
                add_scaled(system[a], scaled, columns[r], a + 1)
    if used == 0:
        return 0.0, 0
    for a in range(size):
        system[a, a] += 1.0
    cholesky_in_place(system)
    for a in range(size):
        for b in range(a):
            right[a] -= system[a, b] * right[b]
        right[a] /= system[a, a]
        squared -= right[a] * right[a]
    for a in range(size - 1, nv - 1, -1):
        for b in range(a + 1, size):
            right[a] -= system[b, a] * right[b]
        right[a] /= system[a, a]
    # W = G L_BB^-T: then G (M^-1)_BB G^T = W W^T.
    solved = np.empty((n, nv))
    for i in range(n):
        for j in range(nv):
            total = gain[i, j]
            for k in range(j):
                total -= system[nv + j, nv + k] * solved[i, k]
            solved[i, j] = total / system[nv + j, nv + j]
    for i in range(n):
        for k in range(i + 1):
            total = covariance[i, k]
            for j in range(nv):
                total += solved[i, j] * solved[k, j] - gain[i, j] * gain[k, j]
            covariance[i, k] = total
            covariance[k, i] = total
    shift = np.zeros(n)
    for i in range(n):
        for j in range(nv):
            shift[i] += gain[i, j] * right[nv + j]
    apply_shift(tree, q, rates, shift)
    return squared, used


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def add_scaled(
    row: FloatArray,
    factor: float,
    other: FloatArray,
    count: int,
) -> None:
    """Add factor * other[:count] to row[:count], in place."""
    for c in range(count):
        row[c] += factor * other[c]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def apply_shift(
    tree: FlatTree,
    q: FloatArray,
    rates: FloatArray,
    shift: FloatArray,
) -> None:
    """Move posture and rates by an error state (n,), in place."""
    nv = rates.shape[1]
    move(tree, q, shift[:nv])
    for a in range(rates.shape[0]):
        for i in range(nv):
            rates[a, i] += shift[(a + 1) * nv + i]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def posterior_distance(
    tree: FlatTree,
    q: FloatArray,
    measured: FloatArray,
    status: IntArray,
    predictions: FloatArray,
) -> float:
    """Fill the predicted markers (m, 3) and return the sum of squared distances [m^2] of the believed ones."""
    joints = tree.kind.shape[0]
    rotation, translation = np.empty((joints + 1, 3, 3)), np.empty((joints + 1, 3))
    joint_poses(tree, q, rotation, translation, np.empty((joints, 3, 3)))
    place_markers(tree, rotation, translation, predictions)
    total = 0.0
    for m in range(measured.shape[0]):
        if status[m] == SEEN or status[m] == RELABELLED:
            for r in range(3):
                total += (predictions[m, r] - measured[m, r]) ** 2
    return total


@numba.njit(cache=True, nogil=True, error_model="numpy")
def truncate(
    covariance: FloatArray,
    direction: FloatArray,
    value: float,
    limit: float,
    upper: bool,
    shift: FloatArray,
) -> float:
    """Take into account that a linear function of the state lies on one side of a limit; return its change.

    The Gaussian of the function is cut at the limit and replaced by the Gaussian with the mean and variance of what is
    left (Simon and Simon 2010, "Constrained Kalman filtering via density function truncation").

    Args:
        covariance: P, changed in place, shape (n, n).
        direction: Gradient of the function with respect to the first entries of the state.
        value: Its present value.
        limit: The limit.
        upper: Whether the limit is an upper one.
        shift: Added to: what is to be added to the state, shape (n,).
    """
    n, count = covariance.shape[0], direction.shape[0]
    column = np.zeros(n)
    for i in range(n):
        for k in range(count):
            column[i] += covariance[i, k] * direction[k]
    variance = 0.0
    for k in range(count):
        variance += direction[k] * column[k]
    if not variance > 1e-16:
        return 0.0
    sigma = math.sqrt(variance)
    room = (limit - value) / sigma if upper else (value - limit) / sigma
    if room > 3.0:
        return 0.0
    if room > -5.0:
        density = math.exp(-0.5 * room * room) / math.sqrt(2.0 * math.pi)
        ratio = density / (0.5 * math.erfc(-room / math.sqrt(2.0)))
        moved, kept = sigma * ratio, 1.0 - ratio * (room + ratio)
    else:
        moved, kept = -room * sigma - sigma / room, 1.0 / (room * room)
    change = -moved if upper else moved
    for i in range(n):
        shift[i] += column[i] * change / variance
        for k in range(n):
            covariance[i, k] += column[i] * column[k] * (kept - 1.0) / variance
    return change


@numba.njit(cache=True, nogil=True, error_model="numpy")
def follow_liveliness(
    spectral: FloatArray,
    activity: FloatArray,
    first: FloatArray,
    correction: FloatArray,
    elapsed: float,
    rise: float,
    fall: float,
    aimed: float,
    calmest: float,
    liveliest: float,
) -> None:
    """Let the spectral densities (nv,) follow the corrections (nv,) of the rates, in place.

    Args:
        spectral: The densities, changed.
        activity: Recent squared corrections for each second, changed.
        first: Densities to begin with.
        correction: What the last update changed the rates by.
        elapsed: Time since the frame before [s].
        rise: Time constant of a growing activity [s].
        fall: Of a fading one [s].
        aimed: Share of the activity that becomes the density.
        calmest: Smallest density as a multiple of the first.
        liveliest: Greatest one.
    """
    up, down = -math.expm1(-elapsed / rise), -math.expm1(-elapsed / fall)
    for i in range(spectral.shape[0]):
        seen = correction[i] * correction[i] / elapsed
        activity[i] += (up if seen > activity[i] else down) * (seen - activity[i])
        spectral[i] = min(max(aimed * activity[i], calmest * first[i]), liveliest * first[i])
