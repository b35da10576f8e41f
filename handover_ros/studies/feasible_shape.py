"""What a feasible set looks like: how far it spreads, into how many parts it falls, how near it comes to a posture."""

from __future__ import annotations

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage

from handover_ros.geometry import FloatArray

APART = 0.5  # [rad] between two parts; neighbouring samples are several times nearer


def spread(postures: FloatArray) -> float:
    """Return the root mean square distance [rad] of postures (k, d) from their mean."""
    return float(np.sqrt(np.square(postures - postures.mean(axis=0)).sum(axis=1).mean()))


def parts(postures: FloatArray) -> int:
    """Return into how many parts postures (k, d) fall that are farther than ``APART`` from each other."""
    if len(postures) < 2:
        return len(postures)
    return int(fcluster(linkage(postures, "single"), APART, "distance").max())


def nearest(postures: FloatArray, posture: FloatArray) -> float:
    """Return the distance [rad] of the nearest of postures (k, d) from a posture (d,)."""
    return float(np.linalg.norm(postures - posture, axis=1).min())
