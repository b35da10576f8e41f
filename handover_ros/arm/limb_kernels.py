"""Compiled forward kinematics of a right arm's joint centres; the plain twin is ``Arm.hand_pose``."""

from __future__ import annotations

import numba
import numpy as np

from handover_ros.geometry import FloatArray


@numba.njit(cache=True, nogil=True, error_model="numpy")
def limbs(
    postures: FloatArray, shoulder: FloatArray, lengths: FloatArray, grip: FloatArray, points: FloatArray
) -> None:
    """Fill shoulder, elbow, wrist and grip (n, 4, 3) [m] of postures (n, 7) [rad].

    Args:
        postures: Displacements, see ``model.JOINT_NAMES``.
        shoulder: Its centre [m] (3,).
        lengths: Of upper arm and forearm [m] (2,).
        grip: From the wrist along the fingers and out of the palm [m] (2,).
        points: Is filled.
    """
    frame = np.empty((3, 3))
    for index in range(len(postures)):
        q = postures[index]
        frame[:] = 0.0
        frame[0, 0] = frame[1, 1] = frame[2, 2] = 1.0
        _turn(frame, 2, 0, -q[0])  # flexion about -y
        _turn(frame, 1, 2, -q[1])  # abduction about -x
        _turn(frame, 0, 1, q[2])  # rotation about z
        for axis in range(3):
            points[index, 0, axis] = shoulder[axis]
            points[index, 1, axis] = shoulder[axis] - lengths[0] * frame[axis, 2]
        _turn(frame, 2, 0, -q[3])
        for axis in range(3):
            points[index, 2, axis] = points[index, 1, axis] - lengths[1] * frame[axis, 2]
        _turn(frame, 0, 1, q[4])
        _turn(frame, 1, 2, q[5])
        _turn(frame, 2, 0, -q[6])
        for axis in range(3):
            points[index, 3, axis] = points[index, 2, axis] + grip[1] * frame[axis, 1] - grip[0] * frame[axis, 2]


@numba.njit(cache=True, nogil=True, inline="always")
def _turn(frame: FloatArray, first: int, second: int, angle: float) -> None:
    """Turn a frame (3, 3) about its own axis that turns column ``first`` towards column ``second``."""
    cosine, sine = np.cos(angle), np.sin(angle)
    for row in range(3):
        a, b = frame[row, first], frame[row, second]
        frame[row, first] = cosine * a + sine * b
        frame[row, second] = cosine * b - sine * a
