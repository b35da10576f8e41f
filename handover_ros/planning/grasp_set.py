"""The grasps with which a person can take an object: poses of one hand, or of two hands together."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from handover_ros.arm.model import Side
from handover_ros.errors import BadRequestError
from handover_ros.geometry import FloatArray
from handover_ros.objects.catalogue import ObjectModel

HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])  # the left hand where a region is written for the right
LEAST_APART = 0.15  # [m] between two hands on one object

IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class GraspSet:
    """Grasps on one object.

    Attributes:
        sides: The hands that take part, each once.
        poses: Hand poses object_from_hand (k, 4, 4) of each side.
        regions: Name of the region of each pose, by side.
        hands: For each grasp and side the place of its pose, -1: this hand takes no part; shape (grasps, sides).
    """

    sides: tuple[Side, ...]
    poses: tuple[FloatArray, ...]
    regions: tuple[tuple[str, ...], ...]
    hands: IntArray

    def __len__(self) -> int:
        """Return the number of grasps."""
        return len(self.hands)

    def hand_poses(self, grasp: int) -> dict[Side, FloatArray]:
        """Return object_from_hand (4, 4) of the hands of one grasp, by side."""
        return {
            side: self.poses[number][place]
            for number, (side, place) in enumerate(zip(self.sides, self.hands[grasp]))
            if place >= 0
        }

    def region(self, grasp: int) -> str:
        """Return the name of the region, or of both regions, of one grasp."""
        names = [self.regions[number][place] for number, place in enumerate(self.hands[grasp]) if place >= 0]
        return " and ".join(names)

    def subset(self, kept: npt.NDArray[np.bool_]) -> GraspSet:
        """Return the grasps that are kept (grasps,), with the poses they need only."""
        hands = self.hands[kept]
        poses, regions, places = [], [], np.full(hands.shape, -1, dtype=np.int64)
        for number in range(len(self.sides)):
            used = np.unique(hands[hands[:, number] >= 0, number])
            poses.append(self.poses[number][used])
            regions.append(tuple(self.regions[number][place] for place in used))
            own = hands[:, number] >= 0
            places[own, number] = np.searchsorted(used, hands[own, number])
        return GraspSet(self.sides, tuple(poses), tuple(regions), places)

    @property
    def grasp_regions(self) -> tuple[str, ...]:
        """The region of each grasp."""
        return tuple(self.region(grasp) for grasp in range(len(self)))


@lru_cache(maxsize=64)
def grasp_set(
    model: ObjectModel, sides: tuple[Side, ...], step_length: float = 0.04, step_angle: float = 0.5
) -> GraspSet:
    """Return the grasps of an object: grids over its regions; for two hands all pairs of regions that lie apart.

    Args:
        model: The object.
        sides: Hands that may take it; an object for two hands needs both.
        step_length: Largest distance between neighbours in a region [m].
        step_angle: Largest angle between neighbours [rad].

    Raises:
        BadRequestError: There is no hand, or one where the object needs two.
    """
    if not sides or len(set(sides)) != len(sides):
        raise BadRequestError(f"grasps of {model.name}: sides must name each hand once, got {list(sides)}")
    if len(sides) < model.hands:
        raise BadRequestError(f"{model.name} needs two hands, and only the {sides[0]} one is known")
    poses, regions = [], []
    for side in sides:
        turn = HALF_TURN if side == "left" else np.eye(4)
        grids = [
            region.centre()[None] if model.hands == 2 else region.grid(step_length, step_angle)
            for region in model.human_grasps
        ]
        poses.append(np.concatenate(grids) @ turn)
        regions.append(tuple(r.name for r, grid in zip(model.human_grasps, grids) for _ in range(len(grid))))
    if model.hands == 1:
        hands = np.full((sum(map(len, poses)), len(sides)), -1, dtype=np.int64)
        start = 0
        for number, side_poses in enumerate(poses):
            hands[start : start + len(side_poses), number] = np.arange(len(side_poses))
            start += len(side_poses)
    else:
        apart = np.linalg.norm(poses[0][:, None, :3, 3] - poses[1][None, :, :3, 3], axis=2) >= LEAST_APART
        hands = np.argwhere(apart)
        if not len(hands):
            raise BadRequestError(f"{model.name} needs two hands, and no two of its regions lie {LEAST_APART} m apart")
    for array in (*poses, hands):
        array.setflags(write=False)
    return GraspSet(sides, tuple(poses), tuple(regions), hands)
