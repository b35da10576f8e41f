"""How far one posture of an arm is from another as the limbs show it, not as the joint angles do.

With the upper arm straight to the side, shoulder flexion and rotation turn it about the same line: large and opposite
differences of both are then no difference at all. Turns of shoulder and wrist as a whole do not have this fault.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from handover_ros.arm.model import AXES
from handover_ros.geometry import FloatArray

BALLS = (slice(0, 3), slice(4, 7))  # displacements whose axes meet: the shoulder; forearm and wrist
ELBOW = 3


def turns(posture: npt.ArrayLike, configurations: FloatArray) -> FloatArray:
    """Return how limbs turn from a posture (7,) to configurations (k, 7), shape (k, 7) [rad].

    Three numbers each for shoulder and wrist are the rotation vector in the frame that is turned; the fourth is the
    elbow's.
    """
    q = np.asarray(posture, dtype=float)
    found = configurations - q
    for ball in BALLS:
        here, there = rotation(q[None, ball], AXES[ball]), rotation(configurations[:, ball], AXES[ball])
        found[:, ball] = (here.inv() * there).as_rotvec()
    return np.asarray(found)


def turn_jacobian(posture: npt.ArrayLike) -> FloatArray:
    """Return the derivative (7, 7) of ``turns`` from a posture (7,) with respect to the configuration, there."""
    q = np.asarray(posture, dtype=float)
    jacobian = np.zeros((7, 7))
    jacobian[ELBOW, ELBOW] = 1.0
    for ball in BALLS:
        after = Rotation.identity()  # what the joints further out turn
        for column in range(ball.stop - 1, ball.start - 1, -1):
            jacobian[ball, column] = after.inv().apply(AXES[column])
            after = Rotation.from_rotvec(q[column] * AXES[column]) * after
    return jacobian


def rotation(displacements: FloatArray, axes: FloatArray) -> Rotation:
    """Return the rotations of displacements (k, 3) about axes (3, 3), one after the other."""
    first, second, third = (Rotation.from_rotvec(angle[:, None] * axis) for angle, axis in zip(displacements.T, axes))
    return first * second * third
