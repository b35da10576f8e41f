"""Linear dynamics of one degree of freedom between two frames: white noise drives its acceleration or its jerk."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from handover_ros.geometry import FloatArray


@lru_cache(maxsize=64)
def linear_dynamics(elapsed: float, order: int, fade: float = math.inf) -> tuple[FloatArray, FloatArray]:
    """Return transition F and noise Q for unit spectral density, (order, order) each.

    Bar-Shalom, Li, Kirubarajan 2001, "Estimation with Applications to Tracking and Navigation", section 6.2.

    Args:
        elapsed: Time [s] between the frames.
        order: 2: displacement and rate, 3: acceleration too.
        fade: Time constant [s] with which the derivatives fade; inf: not at all.
    """
    t = elapsed
    if order == 2:
        transition = np.array([[1.0, t], [0.0, 1.0]])
        noise = np.array([[t**3 / 3.0, t**2 / 2.0], [t**2 / 2.0, t]])
    else:
        transition = np.array([[1.0, t, t * t / 2.0], [0.0, 1.0, t], [0.0, 0.0, 1.0]])
        noise = np.array(
            [
                [t**5 / 20.0, t**4 / 8.0, t**3 / 6.0],
                [t**4 / 8.0, t**3 / 3.0, t**2 / 2.0],
                [t**3 / 6.0, t**2 / 2.0, t],
            ]
        )
    if math.isfinite(fade):
        transition[:, 1:] *= math.exp(-t / fade)
    for matrix in (transition, noise):
        matrix.setflags(write=False)
    return transition, noise
