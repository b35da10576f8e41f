"""A gripper as points: enough to see which part of an object it leaves to a person's hand."""

from __future__ import annotations

from itertools import product

import coal
import numpy as np
import pinocchio as pin

from handover_ros.geometry import FloatArray, invert_transform
from handover_ros.robot.robot_geometry import RobotGeometry

SPACING = 0.012  # [m] between neighbours


def gripper_points(geometry: RobotGeometry, arm: str) -> FloatArray:
    """Return points (n, 3) [m] in the gripper frame on a lattice through the solids of an open gripper and its wrist.

    Args:
        geometry: Of the robot.
        arm: The arm.
    """
    robot = geometry.robot
    model, solids = robot.pinocchio_model, geometry.base
    data, placements = model.createData(), pin.GeometryData(solids)
    configuration = robot.configuration({})
    pin.updateGeometryPlacements(model, data, solids, placements, configuration)
    gripper_from_world = invert_transform(robot.gripper_pose(arm, robot.arm(arm).home))
    parts = []
    for index in sorted(geometry.hand(arm)):
        gripper_from_solid = gripper_from_world @ placements.oMg[index].homogeneous
        points = _lattice(solids.geometryObjects[index].geometry)
        parts.append(points @ gripper_from_solid[:3, :3].T + gripper_from_solid[:3, 3])
    return np.concatenate(parts)


def _lattice(shape: coal.CollisionGeometry) -> FloatArray:
    """Return points (n, 3) [m] of a shape in its own frame, its outside included."""
    if isinstance(shape, coal.Box):
        return _grid(np.array(shape.halfSide))
    if isinstance(shape, coal.Cylinder | coal.Capsule):
        caps = shape.radius if isinstance(shape, coal.Capsule) else 0.0
        points = _grid(np.array([shape.radius, shape.radius, shape.halfLength + caps]))
        core = np.zeros_like(points)
        core[:, 2] = np.clip(points[:, 2], -shape.halfLength, shape.halfLength)
        offsets = points - core
        # The corners of the grid are drawn in to the round side.
        distance = np.linalg.norm(offsets, axis=1)
        return core + offsets * np.minimum(1.0, shape.radius / np.maximum(distance, 1e-9))[:, None]
    if isinstance(shape, coal.Sphere):
        points = _grid(np.full(3, shape.radius))
        return points * np.minimum(1.0, shape.radius / np.maximum(np.linalg.norm(points, axis=1), 1e-9))[:, None]
    shape.computeLocalAABB()
    box = shape.aabb_local
    return _grid((box.max_ - box.min_) / 2.0) + (box.max_ + box.min_) / 2.0


def _grid(half: FloatArray) -> FloatArray:
    """Return the points (n, 3) of a grid that fills a box of half lengths (3,) to its faces."""
    axes = [np.linspace(-length, length, int(np.ceil(2.0 * length / SPACING)) + 1) for length in half]
    return np.array(list(product(*axes)))
