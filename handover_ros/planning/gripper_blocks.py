"""Which grasps a robot's gripper leaves to a person: those whose hand has room beside it."""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np
import numpy.typing as npt

from handover_ros.geometry import FloatArray, invert_transform
from handover_ros.planning.grasp_set import GraspSet

# A hand around something, in its grip frame (x along the fingers, z out of the palm): palm with bent fingers, and the
# wrist behind it. Rows: centre, half lengths [m]; from the breadth (0.085) and thickness (0.03) of a median hand that
# holds something thin; fingers give way by some millimetres.
HAND_BOXES = np.array([[[-0.005, 0.0, -0.018], [0.042, 0.038, 0.036]], [[-0.070, 0.0, -0.040], [0.028, 0.032, 0.025]]])


def free_grasps(
    points: FloatArray, object_from_gripper: Sequence[FloatArray] | FloatArray, grasps: GraspSet
) -> npt.NDArray[np.bool_]:
    """Return which grasps each robot grasp leaves free, shape (robot grasps, grasps).

    Args:
        points: Of the gripper, in the gripper frame [m] (n, 3).
        object_from_gripper: Robot grasps, each (4, 4).
        grasps: Of the person.
    """
    grippers = np.ascontiguousarray(np.asarray(object_from_gripper, dtype=float).reshape(-1, 4, 4))
    free = np.ones((len(grippers), len(grasps)), dtype=bool)
    for number, poses in enumerate(grasps.poses):
        touched = np.zeros((len(grippers), len(poses)), dtype=bool)
        hand_from_object = np.ascontiguousarray(invert_transform(poses))
        _touching(np.ascontiguousarray(points), grippers, hand_from_object, HAND_BOXES, touched)
        takes = grasps.hands[:, number] >= 0
        free[:, takes] &= ~touched[:, grasps.hands[takes, number]]
    return free


@numba.njit(cache=True, nogil=True)
def _touching(
    points: FloatArray,
    object_from_gripper: FloatArray,
    hand_from_object: FloatArray,
    boxes: FloatArray,
    touched: npt.NDArray[np.bool_],
) -> None:
    """Set ``touched`` (r, k) where a point of gripper r lies in a box of hand k."""
    for row in range(len(object_from_gripper)):
        for column in range(len(hand_from_object)):
            pose = hand_from_object[column] @ object_from_gripper[row]
            for index in range(len(points)):
                x = points[index, 0] * pose[0, 0] + points[index, 1] * pose[0, 1] + points[index, 2] * pose[0, 2]
                y = points[index, 0] * pose[1, 0] + points[index, 1] * pose[1, 1] + points[index, 2] * pose[1, 2]
                z = points[index, 0] * pose[2, 0] + points[index, 1] * pose[2, 1] + points[index, 2] * pose[2, 2]
                x, y, z = x + pose[0, 3], y + pose[1, 3], z + pose[2, 3]
                for box in range(len(boxes)):
                    if (
                        abs(x - boxes[box, 0, 0]) <= boxes[box, 1, 0]
                        and abs(y - boxes[box, 0, 1]) <= boxes[box, 1, 1]
                        and abs(z - boxes[box, 0, 2]) <= boxes[box, 1, 2]
                    ):
                        touched[row, column] = True
                        break
                if touched[row, column]:
                    break
