"""Joint torques of a person whose root stands still: pinocchio's rigid-body algorithms on the skeleton's own tree.

Displacements, rates and torques are ordered as ``Skeleton.displacement_names``; a torque is that of the muscles [N m],
of a prismatic joint a force [N]. All functions take one sample (n,) or many (..., n).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pinocchio

from handover_ros.ergonomics.anthropometry import segment_inertias
from handover_ros.errors import BadModelError
from handover_ros.geometry import FloatArray
from handover_ros.skeleton.tree import Skeleton
from handover_ros.skeleton.urdf import skeleton_urdf

GRAVITY = (0.0, 0.0, -9.80665)  # [m/s2] in the root frame of a person who stands upright


class BodyDynamics:
    """The equations of motion of a skeleton, tau = M(q) qdd + C(q, qd) qd + g(q).

    Not safe to share between threads: pinocchio works in one workspace.

    Attributes:
        skeleton: The skeleton.
        mass: Of all its moving segments [kg].
    """

    def __init__(self, skeleton: Skeleton, body_mass: float, gravity: npt.ArrayLike = GRAVITY) -> None:
        """Build the model.

        Args:
            skeleton: The skeleton, see ``segment_inertias``.
            body_mass: Of the whole person [kg].
            gravity: Acceleration of gravity in the root frame [m/s2], shape (3,).

        Raises:
            BadRequestError: The mass is not that of a person.
            BadModelError: The skeleton has no arm, or gravity is not three finite numbers.
        """
        acceleration = np.asarray(gravity, dtype=float)
        if acceleration.shape != (3,) or not np.isfinite(acceleration).all():
            raise BadModelError(f"gravity must be three finite numbers [m/s2], got {acceleration.tolist()}")
        self.skeleton = skeleton
        self._model = pinocchio.buildModelFromXML(skeleton_urdf(skeleton, segment_inertias(skeleton, body_mass)))
        self._model.gravity.linear = acceleration
        self._data = self._model.createData()
        self._order = np.array(
            [self._model.joints[self._model.getJointId(name)].idx_v for name in skeleton.displacement_names]
        )
        self.mass = float(sum(inertia.mass for inertia in list(self._model.inertias)[1:]))

    def gravity_torque(self, displacements: npt.ArrayLike) -> FloatArray:
        """Return the torques (..., n) that hold a posture, displacements (..., n), against gravity."""
        rest = np.zeros_like(np.asarray(displacements, dtype=float))
        return self.inverse_dynamics(displacements, rest, rest)

    def inverse_dynamics(
        self, displacements: npt.ArrayLike, rates: npt.ArrayLike, accelerations: npt.ArrayLike
    ) -> FloatArray:
        """Return the torques (..., n) of a motion.

        Args:
            displacements: [rad] or [m], shape (..., n).
            rates: [rad/s] or [m/s], shape (..., n).
            accelerations: [rad/s2] or [m/s2], shape (..., n).
        """
        samples, shape = self._samples(displacements, rates, accelerations)
        torques = np.empty_like(samples[0])
        for row, (q, v, a) in enumerate(zip(*samples)):
            torques[row] = pinocchio.rnea(self._model, self._data, q, v, a)
        return torques[:, self._order].reshape(shape)

    def torque_rate(
        self, displacements: npt.ArrayLike, rates: npt.ArrayLike, accelerations: npt.ArrayLike, jerks: npt.ArrayLike
    ) -> FloatArray:
        """Return d(torque)/dt (..., n) [N m/s] of a motion, from the exact derivatives of the equations of motion.

        Args:
            displacements: [rad] or [m], shape (..., n).
            rates: [rad/s] or [m/s], shape (..., n).
            accelerations: [rad/s2] or [m/s2], shape (..., n).
            jerks: [rad/s3] or [m/s3], shape (..., n).
        """
        samples, shape = self._samples(displacements, rates, accelerations, jerks)
        result = np.empty_like(samples[0])
        for row, (q, v, a, jerk) in enumerate(zip(*samples)):
            by_q, by_v, by_a = pinocchio.computeRNEADerivatives(self._model, self._data, q, v, a)
            inertia = np.triu(by_a) + np.triu(by_a, 1).T
            result[row] = by_q @ v + by_v @ a + inertia @ jerk
        return result[:, self._order].reshape(shape)

    def potential_energy(self, displacements: npt.ArrayLike) -> FloatArray:
        """Return the energy of position [J] of postures (..., n), shape (...); zero at the root frame's height."""
        (samples,), shape = self._samples(displacements)
        values = [pinocchio.computePotentialEnergy(self._model, self._data, q) for q in samples]
        return np.array(values).reshape(shape[:-1])

    def _samples(self, *arrays: npt.ArrayLike) -> tuple[list[FloatArray], tuple[int, ...]]:
        """Return arrays (..., n) as samples (k, n) in pinocchio's order, and the shape they had."""
        full = np.broadcast_arrays(*(np.asarray(array, dtype=float) for array in arrays))
        shape = full[0].shape
        result = []
        for array in full:
            samples = np.empty((int(np.prod(shape[:-1])), shape[-1]))
            samples[:, self._order] = array.reshape(-1, shape[-1])
            result.append(samples)
        return result, shape
