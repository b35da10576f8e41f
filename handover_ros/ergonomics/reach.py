"""The reach that leads from one posture to another: every displacement along the same minimum-jerk curve.

T. Flash and N. Hogan, J. Neuroscience 5 (1985): s(t) = 10 (t/T)^3 - 15 (t/T)^4 + 6 (t/T)^5, at rest at both ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from handover_ros.errors import BadRequestError
from handover_ros.geometry import FloatArray

SHORTEST, LONGEST = 0.05, 60.0  # [s] a reach taken as plausible


@dataclass(frozen=True, eq=False)
class Reach:
    """A motion sampled at k instants, and the weights that integrate over it.

    Attributes:
        weights: Weight [s] of each instant in an integral over the reach (Gauss-Legendre), shape (k,).
        displacements: [rad] or [m], shape (..., k, n).
        rates: Their first derivatives, per s, shape (..., k, n).
        accelerations: Second derivatives, per s2, shape (..., k, n).
        jerks: Third derivatives, per s3, shape (..., k, n).
    """

    weights: FloatArray
    displacements: FloatArray
    rates: FloatArray
    accelerations: FloatArray
    jerks: FloatArray

    def integral(self, values: FloatArray) -> FloatArray:
        """Return the integral over the reach, shape (...), of values (..., k)."""
        return np.asarray(values @ self.weights)


def check_duration(duration: float) -> float:
    """Return the duration [s] of a reach.

    Raises:
        BadRequestError: It is none that a person's reach can have.
    """
    if not SHORTEST <= duration <= LONGEST:
        raise BadRequestError(f"duration {duration:g} s of a reach: must lie between {SHORTEST:g} and {LONGEST:g} s")
    return float(duration)


@lru_cache(maxsize=16)
def gauss_legendre(count: int) -> tuple[FloatArray, FloatArray]:
    """Return nodes and weights (count,) of Gauss-Legendre quadrature on [0, 1]; exact for degree 2 count - 1."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return 0.5 * (nodes + 1.0), 0.5 * weights


def minimum_jerk_reach(start: FloatArray, ends: FloatArray, duration: float, samples: int) -> Reach:
    """Return the reaches from one posture to many.

    Args:
        start: Displacements at the beginning [rad, m], shape (n,).
        ends: Displacements at the end, shape (..., n).
        duration: T [s].
        samples: Number of instants k.
    """
    s, weights = gauss_legendre(samples)
    way = (np.asarray(ends, dtype=float) - start)[..., None, :]
    shapes = (
        s**3 * (10.0 - 15.0 * s + 6.0 * s**2),
        30.0 * s**2 * (1.0 - s) ** 2 / duration,
        60.0 * s * (1.0 - 3.0 * s + 2.0 * s**2) / duration**2,
        60.0 * (1.0 - 6.0 * s + 6.0 * s**2) / duration**3,
    )
    path, rates, accelerations, jerks = (way * shape[:, None] for shape in shapes)
    return Reach(duration * weights, start + path, rates, accelerations, jerks)


@lru_cache(maxsize=16)
def differentiation(count: int) -> FloatArray:
    """Return the matrix (count, count) that differentiates the polynomial through ``gauss_legendre``'s nodes on [0, 1].

    By barycentric weights: J.-P. Berrut and L. N. Trefethen, SIAM Review 46 (2004), section 9.3.
    """
    nodes, _ = gauss_legendre(count)
    gaps = nodes[:, None] - nodes[None, :] + np.eye(count)
    # Scaled by 4, the capacity of [0, 1], so that the products stay near 1.
    barycentric = 1.0 / np.prod(4.0 * gaps, axis=1)
    matrix = barycentric[None, :] / barycentric[:, None] / gaps
    np.fill_diagonal(matrix, 0.0)
    np.fill_diagonal(matrix, -matrix.sum(axis=1))
    return np.asarray(matrix)
