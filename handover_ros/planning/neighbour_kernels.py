"""Compiled: which poses lie beside another one. Asked for every candidate that a search takes or refuses."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from handover_ros.geometry import FloatArray

FULL_TURN = 2.0 * np.pi


@numba.njit(cache=True, nogil=True)
def strike(
    points: FloatArray, point: FloatArray, apart: float, turned: float, kind: int, left: npt.NDArray[np.bool_]
) -> None:
    """Set ``left`` to False for the poses beside one of them.

    Args:
        points: Poses: x, y, z [m] and three angles [rad] within a full turn of each other, shape (n, 6).
        point: The one, shape (6,).
        apart: Largest difference of a coordinate [m].
        turned: Largest difference of an angle [rad].
        kind: Column of ``left`` that is meant; negative: all.
        left: Shape (n, kinds).
    """
    for row in range(len(points)):
        beside = True
        for axis in range(6):
            step = abs(points[row, axis] - point[axis])
            if axis >= 3:
                step = min(step, FULL_TURN - step)
            if step > (apart if axis < 3 else turned):
                beside = False
                break
        if not beside:
            continue
        if kind >= 0:
            left[row, kind] = False
        else:
            left[row, :] = False
