"""What a person's forearm and hand must keep out of where they put an object down: tables, shelves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from handover_ros.geometry import FloatArray, invert_transform
from handover_ros.planning import obstacle_kernels

BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]
kernels: Any = obstacle_kernels  # numba's functions carry no types

FOREARM_RADII = 0.045, 0.028  # [m] at the elbow and at the wrist
HAND_RADIUS = 0.035  # [m] of a hand that grips, knuckles to palm
ARM_REACH = 0.7  # [m] from the grip to the elbow and what lies about it, of anybody
FOREARM_POINTS, HAND_POINTS = 6, 3


@dataclass(frozen=True, eq=False)
class Obstacles:
    """Boxes in the torso frame.

    Attributes:
        box_from_torso: Shape (k, 4, 4).
        half: Half their lengths [m], shape (k, 3).
    """

    box_from_torso: FloatArray
    half: FloatArray

    def seen_from(self, torso_from_other: FloatArray) -> Obstacles:
        """Return the boxes in another frame, given by its pose (4, 4)."""
        return Obstacles(self.box_from_torso @ torso_from_other, self.half)

    def free(self, limbs: FloatArray) -> BoolArray:
        """Return whether forearm and hand of limbs (n, 4, 3) - shoulder, elbow, wrist, grip [m] - are outside (n,).

        They are balls along the bones, so near each other that no box of the thickness of a shelf fits between.
        """
        return free_each((self,), np.zeros(len(limbs), dtype=np.int64), limbs)


def free_each(obstacles: Sequence[Obstacles], which: IntArray, limbs: FloatArray) -> BoolArray:
    """Return what ``Obstacles.free`` tells of limbs (n, 4, 3) [m], each with obstacles of its own, shape (n,).

    Args:
        obstacles: The same boxes, as seen from several torso frames.
        which: Place in ``obstacles`` of each limb's (n,).
        limbs: Shoulder, elbow, wrist and grip, each in its torso frame.
    """
    outside = np.ones(len(limbs), dtype=bool)
    boxes = np.stack([each.box_from_torso for each in obstacles])
    kernels.free(np.ascontiguousarray(limbs), which, boxes, obstacles[0].half, *_BALLS, outside)
    return outside


def _balls() -> tuple[IntArray, FloatArray, FloatArray]:
    """Return at which joint the bone of each ball begins, where along it the ball is, and its radius [m]."""
    bones = np.repeat([1, 2], [FOREARM_POINTS, HAND_POINTS])
    shares = [np.linspace(0.0, 1.0, FOREARM_POINTS), np.linspace(1.0 / HAND_POINTS, 1.0, HAND_POINTS)]
    radii = [np.linspace(*FOREARM_RADII, FOREARM_POINTS), np.full(HAND_POINTS, HAND_RADIUS)]
    return bones, np.concatenate(shares), np.concatenate(radii)


_BALLS = _balls()


def boxes_near(
    boxes: Sequence[tuple[FloatArray, FloatArray]], world_from_goal: FloatArray
) -> list[tuple[FloatArray, FloatArray]]:
    """Return the boxes that an arm with its hand at a goal could touch at all."""
    place = world_from_goal[:3, 3]
    return [(size, pose) for size, pose in boxes if _distance(pose, place) - _radius(size) <= ARM_REACH]


def _distance(world_from_box: FloatArray, place: FloatArray) -> float:
    """Return the distance [m] of a box's centre from a place."""
    return float(np.linalg.norm(world_from_box[:3, 3] - place))


def _radius(size: FloatArray) -> float:
    """Return the radius [m] of the ball around a box."""
    return float(np.linalg.norm(size)) / 2.0


def obstacles_of(boxes: Sequence[tuple[FloatArray, FloatArray]], world_from_torso: FloatArray) -> Obstacles | None:
    """Return boxes given as lengths (3,) [m] and world_from_box (4, 4) in the torso frame; None for none."""
    if not boxes:
        return None
    poses = np.stack([invert_transform(world_from_box) @ world_from_torso for _, world_from_box in boxes])
    return Obstacles(poses, np.stack([np.asarray(size, dtype=float) / 2.0 for size, _ in boxes]))
