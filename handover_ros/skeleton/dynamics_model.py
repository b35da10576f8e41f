"""Linear dynamics of one degree of freedom between two frames: white noise drives its acceleration or its jerk.

Movements of people end: a rate and an acceleration fade with time constants of their own. For order 3 this is Singer's
model of a manoeuvre, x'' = a, a' = -a / memory + w (Singer 1970, "Estimating optimal tracking filter performance for
manned maneuvering targets"), with the rate fading as well.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from handover_ros.geometry import FloatArray

SMALLEST_TERM = 1e-17
MOST_TERMS = 60
# Gauss-Legendre on [0, 1]: exact where nothing fades, and to 1e-9 where a frame makes something fade fiftyfold.
NODES, WEIGHTS = (0.5 * (1.0 + np.polynomial.legendre.leggauss(8)[0]), 0.5 * np.polynomial.legendre.leggauss(8)[1])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def fill_transition(elapsed: float, decay: FloatArray, transition: FloatArray) -> None:
    """Fill F (order, order) = exp(A t) for derivatives that fade with the rates ``decay`` (order - 1,) [1/s].

    The exponential's series is summed as it stands: A t is small between frames, and A is triangular.
    """
    order = transition.shape[0]
    term, following = np.zeros((order, order)), np.zeros((order, order))
    for a in range(order):
        for b in range(order):
            term[a, b] = transition[a, b] = 1.0 if a == b else 0.0
    for n in range(1, MOST_TERMS):
        largest = 0.0
        for a in range(order):
            for b in range(a, order):
                # (A term)_ab: A has ones above its diagonal and -decay on it, 0 for the displacement.
                total = term[a + 1, b] if a + 1 < order else 0.0
                if a > 0:
                    total -= decay[a - 1] * term[a, b]
                following[a, b] = total * elapsed / n
                largest = max(largest, abs(following[a, b]))
        for a in range(order):
            for b in range(a, order):
                term[a, b] = following[a, b]
                transition[a, b] += term[a, b]
        if largest < SMALLEST_TERM:
            return


@numba.njit(cache=True, nogil=True, error_model="numpy")
def fill_dynamics(elapsed: float, decay: FloatArray, transition: FloatArray, noise: FloatArray) -> None:
    """Fill F and Q for unit spectral density, (order, order): Q is the integral of f f^T, f the last column of F."""
    order = transition.shape[0]
    for a in range(order):
        for b in range(order):
            noise[a, b] = 0.0
    for k in range(NODES.shape[0]):
        fill_transition(NODES[k] * elapsed, decay, transition)
        for a in range(order):
            for b in range(order):
                noise[a, b] += WEIGHTS[k] * elapsed * transition[a, order - 1] * transition[b, order - 1]
    fill_transition(elapsed, decay, transition)


def decays(order: int, rate_memory: float = math.inf, acceleration_memory: float = math.inf) -> FloatArray:
    """Return how fast the derivatives fade [1/s], shape (order - 1,), from time constants [s]; inf: not at all."""
    return np.array([1.0 / rate_memory, 1.0 / acceleration_memory][: order - 1])


def linear_dynamics(
    elapsed: float, order: int, rate_memory: float = math.inf, acceleration_memory: float = math.inf
) -> tuple[FloatArray, FloatArray]:
    """Return transition F and noise Q for unit spectral density, (order, order) each.

    Args:
        elapsed: Time [s] between the frames.
        order: 2: displacement and rate, 3: acceleration too.
        rate_memory: Time constant [s] with which rates fade; inf: not at all.
        acceleration_memory: The same for accelerations.
    """
    transition, noise = np.empty((order, order)), np.empty((order, order))
    fill_dynamics(elapsed, decays(order, rate_memory, acceleration_memory), transition, noise)
    return transition, noise
