"""Compiled: whether forearm and hand, as balls along the bones, are outside boxes. A test holds a plain twin to it."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from handover_ros.geometry import FloatArray

IntArray = npt.NDArray[np.int64]


@numba.njit(cache=True, nogil=True)
def free(
    limbs: FloatArray,
    which: IntArray,
    boxes_from_torso: FloatArray,
    half: FloatArray,
    bones: IntArray,
    shares: FloatArray,
    radii: FloatArray,
    outside: npt.NDArray[np.bool_],
) -> None:
    """Fill ``outside`` (n,) with whether every ball of each arm is outside every box.

    Args:
        limbs: Shoulder, elbow, wrist and grip of each arm [m] (n, 4, 3).
        which: Row of ``boxes_from_torso`` that holds for each arm (n,).
        boxes_from_torso: Where the boxes are (s, k, 4, 4).
        half: Half their lengths [m] (k, 3).
        bones: At whose upper end the bone of each ball begins, 1: elbow, 2: wrist (b,).
        shares: Of the bone, where the ball is (b,).
        radii: Of the balls [m] (b,).
        outside: Is filled.
    """
    place = np.empty(3)
    for arm in range(len(limbs)):
        outside[arm] = True
        for ball in range(len(bones)):
            bone, share = bones[ball], shares[ball]
            for axis in range(3):
                place[axis] = limbs[arm, bone, axis] + share * (limbs[arm, bone + 1, axis] - limbs[arm, bone, axis])
            for box in range(len(half)):
                pose = boxes_from_torso[which[arm], box]
                squared = 0.0
                for axis in range(3):
                    along = pose[axis, 3]
                    for c in range(3):
                        along += pose[axis, c] * place[c]
                    beyond = abs(along) - half[box, axis]
                    if beyond > 0.0:
                        squared += beyond * beyond
                if squared < radii[ball] * radii[ball]:
                    outside[arm] = False
                    break
            if not outside[arm]:
                break
