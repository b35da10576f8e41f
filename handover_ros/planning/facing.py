"""How an object is turned so that a person can take it: a grasp region for the hand towards the person."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from handover_ros.geometry import FloatArray, make_transform
from handover_ros.objects.catalogue import ObjectModel
from handover_ros.objects.regions import TaskSpaceRegion

MODELS = 64  # object models whose answers are kept
LEAST_HORIZONTAL = 0.6  # share of the palm's approach that must be horizontal to have a direction to face
LEAST_TURN = 0.65  # [rad] between two ways to turn the same region
GRID_LENGTH = 0.05  # [m]
GRID_ANGLE = 0.4  # [rad]


@dataclass(frozen=True, eq=False)
class Facing:
    """One way to turn an object to a person.

    Attributes:
        region: Name of the human grasp region that the person's hand comes to.
        yaw: Turn of the object about the vertical [rad], from the direction in which the hand reaches.
        object_from_hand: The hand at that region. Shape (4, 4).
        object_from_other_hand: The other hand, for objects that need two. Shape (4, 4).
    """

    region: str
    yaw: float
    object_from_hand: FloatArray
    object_from_other_hand: FloatArray | None = None


@lru_cache(maxsize=MODELS)
def facings(model: ObjectModel) -> tuple[Facing, ...]:
    """Return the ways to turn an upright object to a person, those of the first grasp region first.

    With the object turned by ``yaw`` from the direction of the person's reach, the palm approaches that region along
    the reach. For two hands the line between two regions lies across the reach instead.
    """
    if model.hands == 2:
        return _two_handed(model)
    found = [facing for region in model.human_grasps for facing in _region_facings(region)]
    return tuple(found) or (Facing("", 0.0, model.human_grasps[0].centre()),)


@lru_cache(maxsize=MODELS)
def object_centre(model: ObjectModel) -> FloatArray:
    """Return the middle of the box around an object's solids, in its own frame [m]. Shape (3,)."""
    corners = object_corners(model)
    centre = (np.min(corners, axis=0) + np.max(corners, axis=0)) / 2.0
    centre.setflags(write=False)
    return centre


@lru_cache(maxsize=MODELS)
def object_corners(model: ObjectModel) -> FloatArray:
    """Return the outermost corners of the boxes around an object's solids, along its own axes [m]. Shape (k, 3)."""
    corners = []
    for part in model.primitives:
        rotation, middle = part.object_from_primitive[:3, :3], part.object_from_primitive[:3, 3]
        if part.type == "box":
            half = np.abs(rotation) @ (np.array(part.size) / 2.0)
        elif part.type == "sphere":
            half = np.full(3, part.size[0])
        else:
            half = np.abs(rotation[:, 2]) * part.size[1] / 2.0 + part.size[0]
        corners += [middle + half * signs for signs in product((-1.0, 1.0), repeat=3)]
    result = np.array(corners)
    result = result[np.sort(ConvexHull(result).vertices)]  # the others lie between them
    result.setflags(write=False)
    return result


def turned_object(
    model: ObjectModel, centre: FloatArray, yaw: float, tilt: float = 0.0, towards: FloatArray | None = None
) -> FloatArray:
    """Return ``world_from_object`` (4, 4) of an object with its centre at ``centre`` [m].

    It is turned by ``yaw`` [rad] about the vertical, then its top leans by ``tilt`` [rad] to the horizontal direction
    ``towards``.
    """
    rotation = Rotation.from_euler("z", yaw).as_matrix()
    if tilt and towards is not None:
        rotation = Rotation.from_rotvec(tilt * np.cross([0.0, 0.0, 1.0], towards)).as_matrix() @ rotation
    return make_transform(rotation, centre - rotation @ object_centre(model))


def _region_facings(region: TaskSpaceRegion) -> list[Facing]:
    """Return how to turn a region to the person: by its pose nearest to the middle that is taken from the side.

    A wide region, such as the body of a glass, can be turned in several ways; they follow, ever farther from the first.
    """
    middle = region.centre()
    poses = np.concatenate([middle[None], region.grid(GRID_LENGTH, GRID_ANGLE)])
    poses = poses[np.hypot(poses[:, 0, 2], poses[:, 1, 2]) >= LEAST_HORIZONTAL]
    turned = np.linalg.norm((poses - middle)[:, :3, :3], axis=(1, 2))
    found: list[Facing] = []
    for pose in poses[np.argsort(turned, kind="stable")]:
        yaw = -float(np.arctan2(pose[1, 2], pose[0, 2]))
        if all(abs(np.angle(np.exp(1j * (yaw - other.yaw)))) > LEAST_TURN for other in found):
            found.append(Facing(region.name, yaw, pose))
    return found


def _two_handed(model: ObjectModel) -> tuple[Facing, ...]:
    """Return the two turns that put the line between the first two regions that lie apart across the person's reach."""
    first = model.human_grasps[0]
    start = first.centre()[:2, 3]
    for other in model.human_grasps[1:]:
        line = other.centre()[:2, 3] - start
        if np.linalg.norm(line) > 0.02:
            across = float(np.arctan2(line[1], line[0]))
            grips = first.centre(), other.centre()
            return tuple(Facing(first.name, turn - across, *grips) for turn in (np.pi / 2.0, -np.pi / 2.0))
    return (Facing(first.name, 0.0, first.centre()),)
