"""Solids for collision checks: primitives placed in the world, and the simple body of the person."""

from __future__ import annotations

from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from handover_ros.geometry import FloatArray, make_transform
from handover_ros.objects.catalogue import ObjectModel

TRUNK_RADIUS = 0.20  # [m] half the width of shoulders and hips
TRUNK_BOTTOM = 0.25  # [m] the capsule's centre line ends here above the floor
HEAD_RADIUS = 0.14  # [m]
HEAD_HEIGHT = 0.22  # [m] centre of the head above the shoulders' midpoint, along the trunk


@dataclass(frozen=True, eq=False)
class Solid:
    """A primitive at a place.

    Attributes:
        name: What a message calls it, e.g. ``right_table``.
        type: ``box``, ``cylinder``, ``sphere`` or ``capsule``.
        size: As in the object catalogue: box: lengths; cylinder, capsule: radius, length; sphere: radius [m].
        parent_from_solid: Its centre, in the world or in the link or object that carries it. Shape (4, 4).
    """

    name: str
    type: str
    size: tuple[float, ...]
    parent_from_solid: FloatArray

    def geometry(self) -> coal.CollisionGeometry:
        """Return the solid's shape for coal."""
        if self.type == "box":
            return coal.Box(*self.size)
        if self.type == "sphere":
            return coal.Sphere(self.size[0])
        if self.type == "cylinder":
            return coal.Cylinder(self.size[0], self.size[1])
        return coal.Capsule(self.size[0], self.size[1])

    def distance(self, point: FloatArray) -> float:
        """Return the distance [m] of a point (3,), given in the parent's frame, from the surface; negative inside."""
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        there = coal.Transform3s(np.eye(3), np.asarray(point, dtype=float))
        here = coal.Transform3s(self.parent_from_solid[:3, :3].copy(), self.parent_from_solid[:3, 3].copy())
        return float(coal.distance(self.geometry(), here, coal.Sphere(1e-4), there, request, result))

    def placed(self, target_from_parent: FloatArray) -> Solid:
        """Return the same solid with its parent's pose applied."""
        return Solid(self.name, self.type, self.size, target_from_parent @ self.parent_from_solid)

    def geometry_object(self, name: str, joint: int, joint_from_solid: FloatArray) -> pin.GeometryObject:
        """Return the solid attached to a joint of a pinocchio model (0: the world)."""
        return pin.GeometryObject(name, joint, pin.SE3(joint_from_solid), self.geometry())


def object_solids(model: ObjectModel, parent_from_object: FloatArray) -> tuple[Solid, ...]:
    """Return the solids of an object at a pose."""
    return tuple(
        Solid(model.name, part.type, tuple(part.size), parent_from_object @ part.object_from_primitive)
        for part in model.primitives
    )


def person_solids(world_from_torso: FloatArray) -> tuple[Solid, ...]:
    """Return trunk and head of a person as capsule and sphere, from the torso frame between the shoulders.

    The trunk's capsule is upright under the shoulders down to the floor, so that it covers hips and legs too; the arms
    are not in it, since they come to the object.
    """
    shoulders = world_from_torso[:3, 3]
    top = max(float(shoulders[2]) - TRUNK_RADIUS / 2.0, TRUNK_BOTTOM + 0.05)
    trunk = make_transform(np.eye(3), [shoulders[0], shoulders[1], (top + TRUNK_BOTTOM) / 2.0])
    head = make_transform(np.eye(3), shoulders + HEAD_HEIGHT * world_from_torso[:3, 2])
    return (
        Solid("person", "capsule", (TRUNK_RADIUS, top - TRUNK_BOTTOM), trunk),
        Solid("person", "sphere", (HEAD_RADIUS,), head),
    )
