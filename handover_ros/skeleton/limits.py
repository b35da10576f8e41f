"""Joint limits from motion: what the joint reached several times, not what noise reached once."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import savgol_filter

from handover_ros.geometry import FloatArray
from handover_ros.skeleton.angles import GIMBAL
from handover_ros.skeleton.tree import JointKind, Skeleton

SMOOTHING = 0.12  # [s] window over which a displacement is smoothed
SHORTEST_WINDOW = 5  # frames; recordings with less than this in a window are not smoothed
TAIL = 0.0015  # share of the time a displacement may be beyond its limit
UNCERTAIN = 3.0  # a displacement this many times less certain than usual, and than the next, says nothing about limits
CERTAIN_ENOUGH = {True: 0.003, False: np.deg2rad(2.5)}  # [m] for a prismatic joint, [rad] else


def smoothed(displacements: FloatArray, rate: float) -> FloatArray:
    """Return displacements (frames, n) without their noise: a running median, then a local parabola.

    Args:
        displacements: One row for each frame, evenly spaced in time.
        rate: Frames per second [Hz].
    """
    window = round(SMOOTHING * rate) | 1
    if window < SHORTEST_WINDOW or len(displacements) < 2 * window:
        return displacements
    steady = median_filter(displacements, size=(3, 1), mode="nearest")
    return np.asarray(savgol_filter(steady, window, 2, axis=0, mode="nearest"))


def estimate_limits(
    skeleton: Skeleton, displacements: FloatArray, deviations: FloatArray, rate: float
) -> tuple[FloatArray, FloatArray]:
    """Return lower and upper limits (n,) [rad] or [m] of what the person did.

    The limit is where the smoothed displacement spends no more than 0.15 % of the time beyond: three turning points of
    a calibration motion are longer than that, single bad frames are not. Angles of a ball joint whose middle angle is
    near 90 degrees, and frames in which a displacement is hardly known, are left out.

    Args:
        skeleton: The skeleton.
        displacements: Shape (frames, n), evenly spaced in time.
        deviations: Standard deviation of each, shape (frames, n).
        rate: Frames per second [Hz].
    """
    values = smoothed(displacements, rate)
    usual = np.nanmedian(deviations, axis=0)
    joints = [skeleton.joints[joint] for joint in skeleton.displacement_joints]
    enough = np.array([CERTAIN_ENOUGH[joint.kind is JointKind.PRISMATIC] for joint in joints])
    certain = np.isfinite(values) & (deviations <= np.maximum(UNCERTAIN * usual, enough))
    for index, joint in enumerate(skeleton.joints):
        if joint.kind is JointKind.BALL:
            own = skeleton.slice_of(index)
            gimbal = np.abs(np.cos(values[:, own.start + 1])) < 2.0 * GIMBAL
            certain[gimbal, own.start] = certain[gimbal, own.stop - 1] = False
    lower, upper = np.full(values.shape[1], -np.inf), np.full(values.shape[1], np.inf)
    for column in range(values.shape[1]):
        seen = values[certain[:, column], column]
        if len(seen):
            lower[column], upper[column] = np.quantile(seen, [TAIL, 1.0 - TAIL], method="linear")
    return lower, upper
