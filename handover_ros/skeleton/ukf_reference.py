"""The unscented Kalman filter written plainly, on filterpy's own: what the compiled one is tested against.

States on a manifold are filtered by their error: the sigma points are tangents around the present posture, and after
each step the mean error is moved into the posture.
"""

from __future__ import annotations

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from handover_ros.geometry import FloatArray
from handover_ros.skeleton.kernels import marker_positions, move
from handover_ros.skeleton.tree import FlatTree


class PlainFilter:
    """A UKF over posture, rates and, for order 3, accelerations.

    Args:
        tree: The skeleton.
        coordinates: First posture, shape (nq,).
        covariance: First covariance of the error state, shape (order nv, order nv).
        order: 2: white noise drives accelerations, 3: jerks.
    """

    def __init__(self, tree: FlatTree, coordinates: FloatArray, covariance: FloatArray, order: int) -> None:
        self.tree, self.order = tree, order
        self.q = np.array(coordinates, dtype=float)
        size = len(covariance)
        self.nv = size // order
        self.rates = np.zeros((order - 1, self.nv))
        alpha_squared = self.nv / size
        points = MerweScaledSigmaPoints(size, alpha=np.sqrt(alpha_squared), beta=alpha_squared - 1.0, kappa=0.0)
        measurement = 3 * len(tree.marker_joint)
        self.filter = UnscentedKalmanFilter(size, measurement, dt=1.0, hx=None, fx=None, points=points)
        self.filter.P = np.array(covariance, dtype=float)
        self.filter.x = np.zeros(size)

    def predict(self, transition: FloatArray, noise: FloatArray, spectral: FloatArray) -> None:
        """Predict one step; see ``ukf_kernels.predict``."""
        whole = np.kron(transition, np.eye(self.nv))
        self.filter.x = np.concatenate([np.zeros(self.nv), self.rates.ravel()])
        self.filter.Q = np.kron(noise, np.diag(spectral))
        self.filter.predict(fx=lambda error, dt: whole @ error)
        self._fold()

    def update(self, measured: FloatArray, variance: float) -> None:
        """Correct by markers (m, 3) [m], NaN = not measured, whose coordinates have the variance [m^2]."""
        seen = np.isfinite(measured[:, 0])

        def predicted(error: FloatArray) -> FloatArray:
            posture = self.q.copy()
            move(self.tree, posture, np.ascontiguousarray(error[: self.nv]))
            return np.asarray(marker_positions(self.tree, posture[None])[0][seen].ravel())

        self.filter.x = np.concatenate([np.zeros(self.nv), self.rates.ravel()])
        # Fresh points around the prediction: filterpy would reuse those from before the process noise.
        self.filter.sigmas_f = self.filter.points_fn.sigma_points(self.filter.x, self.filter.P)
        values = measured[seen].ravel()
        self.filter.update(values, R=variance * np.eye(len(values)), hx=predicted)
        self._fold()

    def _fold(self) -> None:
        """Move the mean error into the posture."""
        move(self.tree, self.q, np.ascontiguousarray(self.filter.x[: self.nv]))
        self.rates = self.filter.x[self.nv :].reshape(self.order - 1, self.nv).copy()
