"""One frame of tracking in one compiled call: predict, judge, correct, keep the limits, read the estimate out."""

from __future__ import annotations

import math

import numba
import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.mocap.frames import MarkerStatus, StatusArray
from handover_ros.skeleton.dynamics_model import fill_dynamics
from handover_ros.skeleton.kernels import turn_of_quaternion
from handover_ros.skeleton.limit_kernels import (
    BALL,
    FREE,
    DisplacementTable,
    LimitTable,
    apply_limits,
    read_displacements,
)
from handover_ros.skeleton.tree import FlatTree, IntArray
from handover_ros.skeleton.ukf_kernels import (
    RELABELLED,
    add_noise,
    factor_columns,
    judge_markers,
    posterior_distance,
    predict,
    spread_points,
    update,
)

BRIDGED = int(MarkerStatus.BRIDGED)
BRIDGED_FACTOR = 5.0  # a predicted marker is this many times less certain than a measured one
POSE, COVARIANCE, VELOCITY = 16, 36, 6  # numbers of a root pose, of its covariance and of its velocity


@numba.njit(cache=True, nogil=True, error_model="numpy")
def step(
    tree: FlatTree,
    limits: LimitTable,
    table: DisplacementTable,
    q: FloatArray,
    rates: FloatArray,
    covariance: FloatArray,
    spectral: FloatArray,
    decay: FloatArray,
    observed: FloatArray,
    source: StatusArray,
    marker_noise: float,
    elapsed: float,
    fade: float,
    gate: float,
    fewest: int,
    startled_share: float,
    startled: FloatArray,
    limited: bool,
    out: FloatArray,
) -> tuple[int, float, float, int, int, int]:
    """Filter one frame, in place.

    Args:
        tree: The skeleton.
        limits: As from ``limit_table``.
        table: As from ``displacement_table``.
        q: Coordinates, shape (nq,).
        rates: Derivatives of the tangent, shape (order - 1, nv).
        covariance: P, shape (order nv, order nv).
        spectral: Spectral density of each tangent's noise, shape (nv,).
        decay: How fast the derivatives fade [1/s], shape (order - 1,).
        observed: Measured positions [m], shape (m, 3), NaN = not measured.
        source: What each position is, a ``MarkerStatus``, shape (m,).
        marker_noise: Standard deviation of a measured marker's coordinate [m].
        elapsed: Time since the frame before [s].
        fade: Factor on the rates beforehand; their uncertainty stays.
        gate: As for ``judge_markers``.
        fewest: So many disbelieved markers at least,
        startled_share: and so large a share of the measured ones mean a sudden motion,
        startled: which is allowed for by white accelerations of these densities [rad^2/s^3] or [m^2/s^3], shape (nv,).
        limited: Whether joint limits bound the estimate.
        out: Filled as by ``read_estimate``.

    Returns:
        How many markers were believed (-1: P is not positive definite), normalised innovation squared, sum of squared
        distances [m^2] of the believed markers, and how many measurements were not believed, were believed under their
        own label, and under another.
    """
    order, nv, markers = rates.shape[0] + 1, rates.shape[1], observed.shape[0]
    transition, noise = np.empty((order, order)), np.empty((order, order))
    gain, mean = np.empty((order * nv, nv)), np.empty((markers, 3))
    first, second = np.empty((markers, 3, nv)), np.empty((markers, 3, nv))
    status, measured, variance = np.empty(markers, dtype=np.int64), np.empty((markers, 3)), np.empty(markers)
    for m in range(markers):
        variance[m] = (marker_noise * (BRIDGED_FACTOR if source[m] == BRIDGED else 1.0)) ** 2
    fill_dynamics(elapsed, decay, transition, noise)
    if fade != 1.0:
        rates *= fade
    predict(tree, q, rates, covariance, transition, noise, spectral)
    gated = seen = 0
    for attempt in range(2):
        if not factor_columns(covariance, nv, gain):
            return -1, math.nan, math.nan, 0, 0, 0
        spread_points(tree, q, gain, mean, first, second)
        gated, seen = judge_markers(observed, mean, first, second, variance, gate, status, measured)
        if attempt == 1 or gated < fewest or gated <= startled_share * (gated + seen):
            break
        # So many markers are rarely wrong at once: the person rather moved more suddenly than expected.
        push, spread = np.empty((2, 2)), np.empty((2, 2))
        fill_dynamics(elapsed, np.zeros(1), push, spread)
        add_noise(covariance, spread, startled, 1.0)
    squared, used = update(tree, q, rates, covariance, gain, mean, first, second, measured, status, variance)
    if limited:
        apply_limits(tree, q, rates, covariance, limits)
    distance = read_estimate(tree, table, q, rates, covariance, measured, status, out)
    relabelled = 0
    for m in range(markers):
        relabelled += status[m] == RELABELLED
    return used, squared, distance, gated, seen, relabelled


@numba.njit(cache=True, nogil=True, error_model="numpy")
def read_estimate(
    tree: FlatTree,
    table: DisplacementTable,
    q: FloatArray,
    rates: FloatArray,
    covariance: FloatArray,
    measured: FloatArray,
    status: IntArray,
    out: FloatArray,
) -> float:
    """Read the estimate out of the state; return the sum of squared distances [m^2] of the believed markers.

    ``out`` is filled with, one after the other: marker predictions (m, 3), displacements (n,), their rates (n,) and
    covariance (n, n), root pose (4, 4), its covariance (6, 6) and velocity (6,); see ``SkeletonEstimate``.
    """
    markers = measured.shape[0]
    free = tree.kind[0] == FREE
    n = displacement_count(tree)
    at = 3 * markers
    distance = posterior_distance(tree, q, measured, status, out[:at].reshape(markers, 3))
    spread = out[at + 2 * n : at + 2 * n + n * n].reshape(n, n)
    read_displacements(tree, table, q, rates[0], covariance, out[at : at + n], out[at + n : at + 2 * n], spread)
    at += 2 * n + n * n
    pose = out[at : at + POSE].reshape(4, 4)
    for r in range(4):
        for c in range(4):
            pose[r, c] = 1.0 if r == c else 0.0
    out[at + POSE : at + POSE + COVARIANCE + VELOCITY] = 0.0
    if free:
        turn_of_quaternion(q, 3, pose)
        at += POSE
        for r in range(6):
            pose[r % 3, 3] = q[r % 3]
            for c in range(6):
                out[at + 6 * r + c] = covariance[r, c]
            out[at + COVARIANCE + r] = rates[0, r]
    return distance


@numba.njit(cache=True, nogil=True, error_model="numpy")
def displacement_count(tree: FlatTree) -> int:
    """Return the number of displacements."""
    count = 0
    for kind in tree.kind:
        count += 0 if kind == FREE else 3 if kind == BALL else 1
    return count


def estimate_size(markers: int, displacements: int) -> int:
    """Return how many numbers ``read_estimate`` fills."""
    return 3 * markers + 2 * displacements + displacements**2 + POSE + COVARIANCE + VELOCITY
