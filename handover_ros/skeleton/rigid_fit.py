"""Pose of a rigid body from its markers: weighted least squares, robust, with covariance.

Symbols: p_i template positions in the body frame, y_i measured positions, R and t the pose, w_i weights.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from handover_ros.geometry import FloatArray

MIN_MARKERS = 3
MIN_SPREAD = 0.015  # [m] root mean square width across the longest direction; less is a line
OUTLIER = 3.0  # residuals within this many standard deviations are not downweighted
ROBUST_ROUNDS = 4
PRIOR_STRENGTH = 12.0  # residual components the stated marker noise counts for against the observed ones


@dataclass(frozen=True, eq=False)
class RigidFit:
    """A fitted pose.

    Attributes:
        target_from_body: The pose, (4, 4).
        covariance: Of (x y z [m], rotation about fixed axes [rad]), (6, 6).
        residual_rms: Root mean square distance [m] of the used markers from the body.
        consistency: Squared residuals over their expectation; 1 = as the stated noise says.
        used: Which markers entered the fit, shape (n,).
        weights: Weights after downweighting outliers, relative, shape (n,).
    """

    target_from_body: FloatArray
    covariance: FloatArray
    residual_rms: float
    consistency: float
    used: npt.NDArray[np.bool_]
    weights: FloatArray


def kabsch(template: FloatArray, measured: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Return (rotation (3, 3), translation (3,), spread [m]) minimising sum w_i |R p_i + t - y_i|^2 (Umeyama 1991).

    ``spread`` is the root mean square extent of the markers in their second direction: near zero, they lie on a line
    and the rotation is not determined.
    """
    share = weights / weights.sum()
    template_mean, measured_mean = share @ template, share @ measured
    u, singular, vt = np.linalg.svd((share[:, None] * (template - template_mean)).T @ (measured - measured_mean))
    rotation = vt.T @ u.T
    if determinant(rotation) < 0.0:
        u[:, 2] = -u[:, 2]
        rotation = vt.T @ u.T
    return rotation, measured_mean - rotation @ template_mean, math.sqrt(max(float(singular[1]), 0.0))


def determinant(matrix: FloatArray) -> float:
    """Return the determinant of a 3x3 matrix; a fifth of the time of the general one."""
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    return float(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g))


def fit_rigid_body(
    template: FloatArray, measured: FloatArray, weights: FloatArray, noise: float, usable: npt.NDArray[np.bool_]
) -> RigidFit | None:
    """Return the pose of a body, or None when its usable markers do not fix one.

    Markers farther off than their noise explains are downweighted (Cauchy weights, iteratively reweighted least
    squares). A marker of weight w has the standard deviation noise / sqrt(w). The covariance is that of weighted least
    squares, A^-1 s^2 with A = sum w_i J_i^T J_i, J_i = [1, -(R p_i)^], where s^2 blends the stated noise with the
    residuals seen.

    Args:
        template: Marker positions in the body frame [m], shape (n, 3).
        measured: Measured positions [m], shape (n, 3); anything where not usable.
        weights: Relative weights, shape (n,).
        noise: Standard deviation [m] of each coordinate of a marker of weight 1.
        usable: Which markers are in the template and measured, shape (n,).
    """
    index = np.flatnonzero(usable)
    if len(index) < MIN_MARKERS:
        return None
    p, y, nominal = template[index], measured[index], weights[index]
    rotation, translation, spread = kabsch(p, y, nominal)
    if spread < MIN_SPREAD:
        return None
    turned = p @ rotation.T
    residual = y - turned - translation
    squared = np.einsum("ij,ij->i", residual, residual)
    w = nominal
    if (squared * nominal).max() > (OUTLIER * noise) ** 2 * 3.0 and len(index) > MIN_MARKERS:
        for _ in range(ROBUST_ROUNDS):
            scale = _robust_scale(squared * nominal, noise)
            w = nominal / (1.0 + squared * nominal / (OUTLIER * scale) ** 2)
            rotation, translation, spread = kabsch(p, y, w)
            turned = p @ rotation.T
            residual = y - turned - translation
            squared = np.einsum("ij,ij->i", residual, residual)
        if spread < MIN_SPREAD:
            return None
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, translation
    freedom = 3 * len(index) - 6
    chi_squared = float(squared @ w) / noise**2
    scale_squared = (PRIOR_STRENGTH + chi_squared) / (PRIOR_STRENGTH + freedom)
    full = np.zeros(len(template))
    full[index] = w
    return RigidFit(
        target_from_body=pose,
        covariance=_covariance(turned, w, noise**2 * scale_squared),
        residual_rms=float(np.sqrt(squared @ w / w.sum())),
        consistency=chi_squared / freedom,
        used=usable,
        weights=full,
    )


def _robust_scale(squared: FloatArray, noise: float) -> float:
    """Return the scale [m] of most residuals: the median over that of a Rayleigh-like 3-vector, at least the noise."""
    return max(float(np.sqrt(np.median(squared))) / 1.538, noise)


def _covariance(turned: FloatArray, weights: FloatArray, variance: float) -> FloatArray:
    """Return variance * (sum w J^T J)^-1 for J = [1, -(R p)^], shape (6, 6)."""
    total = float(weights.sum())
    x, y, z = (weights @ turned).tolist()
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = ((turned * weights[:, None]).T @ turned).tolist()
    information = np.array(
        [
            [total, 0.0, 0.0, 0.0, z, -y],
            [0.0, total, 0.0, -z, 0.0, x],
            [0.0, 0.0, total, y, -x, 0.0],
            [0.0, -z, y, yy + zz, -xy, -xz],
            [z, 0.0, -x, -xy, xx + zz, -yz],
            [-y, x, 0.0, -xz, -yz, xx + yy],
        ]
    )
    return np.asarray(np.linalg.inv(information) * variance)
