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
from handover_ros.skeleton.kernels import (
    BALL,
    FREE,
    PRISMATIC,
    REVOLUTE,
    joint_poses,
    move,
    place_markers,
    turn_about,
    turn_of_quaternion,
)
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
    step = np.zeros(nv)
    for a in range(order):
        for i in range(nv):
            total = transition[a, a] * rates[a - 1, i] if a > 0 else 0.0
            for b in range(a + 1, order):
                total += transition[a, b] * rates[b - 1, i]
            if a == 0:
                step[i] = total
            else:
                rates[a - 1, i] = total
    move(tree, q, step)
    # F is upper triangular: P becomes F P F^T in place, block rows from above, then block columns from the left.
    n = covariance.shape[0]
    for a in range(order):
        for i in range(a * nv, (a + 1) * nv):
            for j in range(n):
                covariance[i, j] *= transition[a, a]
            for c in range(a + 1, order):
                add_scaled(covariance, i, transition[a, c], covariance, i + (c - a) * nv, n)
    for i in range(n):
        for b in range(order):
            for j in range(b * nv, (b + 1) * nv):
                covariance[i, j] *= transition[b, b]
            for d in range(b + 1, order):
                for j in range(nv):
                    covariance[i, b * nv + j] += transition[b, d] * covariance[i, d * nv + j]
    add_noise(covariance, noise, spectral, 1.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_noise(covariance: FloatArray, noise: FloatArray, spectral: FloatArray, times: float) -> None:
    """Add to P (n, n) what noise of so many times the spectral densities (nv,) does; ``noise`` as for ``predict``."""
    nv = spectral.shape[0]
    for a in range(noise.shape[0]):
        for b in range(noise.shape[0]):
            for i in range(nv):
                covariance[a * nv + i, b * nv + i] += times * noise[a, b] * spectral[i]


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
    # The factor is lower triangular: point j moves the joints from that of tangent j on. From the last to the first,
    # the poses before that joint are those of the mean throughout.
    nv, markers, joints = gain.shape[1], tree.marker.shape[0], tree.kind.shape[0]
    rotation, translation, own = np.empty((joints + 1, 3, 3)), np.empty((joints + 1, 3)), np.empty((3, 3))
    point, step = np.empty_like(q), np.zeros(nv)
    still, moved = np.empty((markers, 3)), np.empty((2, markers, 3))
    poses_from(tree, q, 0, rotation, translation, own)
    place_markers_from(tree, rotation, translation, 0, still)
    root = math.sqrt(nv)
    half, share = 0.5 / root, 0.5 / nv
    mean[:] = 0.0
    start = joints - 1
    for j in range(nv - 1, -1, -1):
        while tree.tangent[start] > j:
            start -= 1
        for side in range(2):
            scale = root if side == 0 else -root
            for i in range(j, nv):
                step[i] = scale * gain[i, j]
            point[:] = q
            move(tree, point, step)
            poses_from(tree, point, start, rotation, translation, own)
            place_markers_from(tree, rotation, translation, start, moved[side])
        for m in range(markers):
            stays = tree.marker_joint[m] < start
            for r in range(3):
                if stays:
                    first[m, r, j] = 0.0
                    second[m, r, j] = 2.0 * still[m, r]
                else:
                    first[m, r, j] = (moved[0, m, r] - moved[1, m, r]) * half
                    second[m, r, j] = moved[0, m, r] + moved[1, m, r]
                mean[m, r] += second[m, r, j] * share
    for m in range(markers):
        for r in range(3):
            for j in range(nv):
                second[m, r, j] = (second[m, r, j] - 2.0 * mean[m, r]) * half


@numba.njit(cache=True, nogil=True, error_model="numpy")
def poses_from(
    tree: FlatTree, q: FloatArray, start: int, rotation: FloatArray, translation: FloatArray, own: FloatArray
) -> None:
    """Fill segment poses as ``kernels.joint_poses`` does, from joint ``start`` on; those before stay."""
    if start == 0:
        for r in range(3):
            translation[0, r] = 0.0
            for c in range(3):
                rotation[0, r, c] = 1.0 if r == c else 0.0
    for j in range(start, tree.kind.shape[0]):
        p, kind, at = tree.parent[j] + 1, tree.kind[j], tree.coordinate[j]
        if kind == PRISMATIC:
            for r in range(3):
                shift = 0.0
                for c in range(3):
                    rotation[j + 1, r, c] = rotation[p, r, c]
                    shift += rotation[p, r, c] * tree.axis[j, c]
                translation[j + 1, r] = translation[p, r] + shift * q[at]
            continue
        if kind == REVOLUTE:
            turn_about(tree.axis[j], q[at], own)
        elif kind == BALL:
            turn_of_quaternion(q, at, own)
        else:
            turn_of_quaternion(q, at + 3, own)
        for r in range(3):
            for c in range(3):
                rotation[j + 1, r, c] = (
                    rotation[p, r, 0] * own[0, c] + rotation[p, r, 1] * own[1, c] + rotation[p, r, 2] * own[2, c]
                )
        for r in range(3):
            moved = translation[p, r]
            for c in range(3):
                if kind == FREE:
                    moved += rotation[p, r, c] * q[at + c]
                else:
                    moved += (rotation[p, r, c] - rotation[j + 1, r, c]) * tree.point[j, c]
            translation[j + 1, r] = moved


@numba.njit(cache=True, nogil=True, error_model="numpy")
def place_markers_from(
    tree: FlatTree, rotation: FloatArray, translation: FloatArray, start: int, out: FloatArray
) -> None:
    """Fill the positions (m, 3) [m] of the markers on the segments of joint ``start`` and those after; 0: of all."""
    for i in range(tree.marker.shape[0]):
        j = tree.marker_joint[i] + 1
        if start > 0 and j <= start:
            continue
        x, y, z = tree.marker[i, 0], tree.marker[i, 1], tree.marker[i, 2]
        for r in range(3):
            out[i, r] = rotation[j, r, 0] * x + rotation[j, r, 1] * y + rotation[j, r, 2] * z + translation[j, r]


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
def within_gate(
    position: FloatArray, mean: FloatArray, first: FloatArray, second: FloatArray, variance: float, gate: float
) -> bool:
    """Return whether ``marker_distance`` is at most the gate; the prediction's own uncertainty only lowers it."""
    squared = 0.0
    for r in range(3):
        squared += (position[r] - mean[r]) ** 2
    return squared <= gate * variance or marker_distance(position, mean, first, second, variance) <= gate


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
        elif not within_gate(observed[m], mean[m], first[m], second[m], variance[m], gate):
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
    used = 0
    for m in range(measured.shape[0]):
        if status[m] == SEEN or status[m] == RELABELLED:
            used += 1
    if used == 0:
        return 0.0, 0
    # [E B]^T and the innovation, in units of the markers' deviations; only what is believed.
    columns, innovation = np.empty((size, 3 * used)), np.empty(3 * used)
    at = 0
    for m in range(measured.shape[0]):
        if status[m] != SEEN and status[m] != RELABELLED:
            continue
        weight = 1.0 / math.sqrt(variance[m])
        for r in range(3):
            innovation[at] = weight * (measured[m, r] - mean[m, r])
            for j in range(nv):
                columns[j, at] = weight * second[m, r, j]
                columns[nv + j, at] = weight * first[m, r, j]
            at += 1
    system, right = np.empty((size, size)), np.empty(size)
    squared = inner_products(columns, innovation, system, right)
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
    # W = G L_BB^-T: then G (M^-1)_BB G^T = W W^T. Both by rows of their transposes, which are long.
    spread, solved, shift = np.empty((nv, n)), np.empty((nv, n)), np.zeros((1, n))
    for j in range(nv):
        for i in range(n):
            spread[j, i] = solved[j, i] = gain[i, j]
        add_scaled(shift, 0, right[nv + j], spread, j, n)
        for k in range(j):
            add_scaled(solved, j, -system[nv + j, nv + k], solved, k, n)
        inverse = 1.0 / system[nv + j, nv + j]
        for i in range(n):
            solved[j, i] *= inverse
    for i in range(n):
        for j in range(nv):
            one, other = solved[j, i], spread[j, i]
            for k in range(i + 1):
                covariance[i, k] += one * solved[j, k] - other * spread[j, k]
        for k in range(i):
            covariance[k, i] = covariance[i, k]
    apply_shift(tree, q, rates, shift[0])
    return squared, used


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def inner_products(rows: FloatArray, vector: FloatArray, system: FloatArray, right: FloatArray) -> float:
    """Fill ``right`` (k,) with rows (k, c) times a vector (c,), the lower half of ``system`` (k, k) with rows by rows.

    Returns:
        The vector's squared length.
    """
    size, count = rows.shape
    squared = 0.0
    for c in range(count):
        squared += vector[c] * vector[c]
    for a in range(size):
        total = 0.0
        for c in range(count):
            total += rows[a, c] * vector[c]
        right[a] = total
        # Four at a time keep the processor busy.
        b = 0
        while b + 3 <= a:
            s0 = s1 = s2 = s3 = 0.0
            for c in range(count):
                own = rows[a, c]
                s0 += own * rows[b, c]
                s1 += own * rows[b + 1, c]
                s2 += own * rows[b + 2, c]
                s3 += own * rows[b + 3, c]
            system[a, b], system[a, b + 1], system[a, b + 2], system[a, b + 3] = s0, s1, s2, s3
            b += 4
        while b <= a:
            total = 0.0
            for c in range(count):
                total += rows[a, c] * rows[b, c]
            system[a, b] = total
            b += 1
    return squared


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=True, inline="always")
def add_scaled(rows: FloatArray, at: int, factor: float, others: FloatArray, which: int, count: int) -> None:
    """Add factor * others[which, :count] to rows[at, :count], in place."""
    for c in range(count):
        rows[at, c] += factor * others[which, c]


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
    variance = 0.0
    for k in range(count):
        if direction[k] != 0.0:
            for i in range(count):
                variance += direction[k] * covariance[k, i] * direction[i]
    if not variance > 1e-16:
        return 0.0
    sigma = math.sqrt(variance)
    room = (limit - value) / sigma if upper else (value - limit) / sigma
    if room > 3.0:
        return 0.0
    column = np.zeros(n)
    for k in range(count):
        if direction[k] != 0.0:
            for i in range(n):
                column[i] += direction[k] * covariance[k, i]
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
