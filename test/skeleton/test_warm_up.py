"""The made-up arm: real enough that every kernel runs."""

import numpy as np

from handover_ros.mocap.frames import MarkerFrame
from handover_ros.skeleton.tracking import SkeletonTracker
from handover_ros.skeleton.warm_up import (
    NAMES,
    RATE,
    made_up_arm,
    made_up_motion,
    warm_up_calibration,
    warm_up_tracking,
)


def test_the_made_up_arm_is_tracked():
    skeleton = made_up_arm()
    tracker = SkeletonTracker(skeleton, NAMES)
    status = np.zeros(len(NAMES), dtype=np.uint8)
    for number, positions in enumerate(made_up_motion(skeleton)):
        estimate = tracker.update(MarkerFrame(number / RATE, number, number / RATE, positions, status))
    assert estimate.valid
    assert tracker.mean_residual < 0.005


def test_warming_up_raises_nothing():
    warm_up_tracking()
    warm_up_calibration()
