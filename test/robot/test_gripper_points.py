"""A gripper as points."""

import coal
import numpy as np
import pinocchio as pin
import pytest

from handover_ros.geometry import invert_transform, transform_points
from handover_ros.robot import RobotGeometry, RobotModel
from handover_ros.robot.gripper_points import SPACING, _lattice, gripper_points

ROBOT = RobotModel.load()
GEOMETRY = RobotGeometry(ROBOT)


def pyramid():
    """A convex solid that is no primitive: a square pyramid beside its origin."""
    points = coal.StdVec_Vec3s()
    for corner in [[0.0, 0.0, 0.0], [0.08, 0.0, 0.0], [0.08, 0.06, 0.0], [0.0, 0.06, 0.0], [0.04, 0.03, 0.05]]:
        points.append(np.array(corner))
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(0, 5)
    mesh.addVertices(np.array(list(points)))
    mesh.endModel()
    mesh.buildConvexHull(True, "Qt")
    return mesh.convex


SHAPES = {
    "box": coal.Box(0.03, 0.1, 0.05),
    "thin box": coal.Box(0.002, 0.1, 0.05),
    "cylinder": coal.Cylinder(0.04, 0.1),
    "capsule": coal.Capsule(0.03, 0.08),
    "sphere": coal.Sphere(0.05),
    "pyramid": pyramid(),
}


def outside(shape, points):
    """Return how far points (n, 3) are outside a primitive [m] (n,), negative or zero inside."""
    if isinstance(shape, coal.Box):
        return (np.abs(points) - shape.halfSide).max(axis=1)
    if isinstance(shape, coal.Sphere):
        return np.linalg.norm(points, axis=1) - shape.radius
    radius = np.linalg.norm(points[:, :2], axis=1)
    if isinstance(shape, coal.Cylinder):
        return np.maximum(radius - shape.radius, np.abs(points[:, 2]) - shape.halfLength)
    return np.hypot(radius, np.maximum(np.abs(points[:, 2]) - shape.halfLength, 0.0)) - shape.radius


def box_of(shape):
    shape.computeLocalAABB()
    return shape.aabb_local.min_, shape.aabb_local.max_


@pytest.mark.parametrize("name", SHAPES)
def test_points_of_a_solid_fill_it_to_its_faces(name):
    """None lies outside (a mesh: outside its box), and along every axis some lie on both ends."""
    shape = SHAPES[name]
    points, (low, high) = _lattice(shape), box_of(shape)
    if name == "pyramid":
        assert ((points >= low - 1e-9) & (points <= high + 1e-9)).all()
    else:
        assert outside(shape, points).max() <= 1e-9
    np.testing.assert_allclose(points.min(axis=0), low, atol=0.002)
    np.testing.assert_allclose(points.max(axis=0), high, atol=0.002)


@pytest.mark.parametrize("name", ["box", "cylinder", "capsule", "sphere"])
def test_no_place_in_a_solid_is_far_from_a_point(name):
    """Any place inside is nearer to a point than the diagonal of the lattice: a hand's box cannot slip through."""
    shape = SHAPES[name]
    low, high = box_of(shape)
    places = np.random.default_rng(0).uniform(low, high, (2000, 3))
    places = places[outside(shape, places) < 0.0]
    nearest = np.linalg.norm(places[:, None] - _lattice(shape)[None], axis=2).min(axis=1)
    assert nearest.max() <= SPACING * np.sqrt(3.0)


@pytest.mark.parametrize("arm", ROBOT.arm_names)
def test_points_lie_in_the_grippers_solids_and_reach_their_faces(arm):
    """In the gripper's frame, with the arm anywhere: each point in some solid, each solid with points at its ends."""
    points = gripper_points(GEOMETRY, arm)
    model, solids = ROBOT.pinocchio_model, GEOMETRY.base
    rng = np.random.default_rng(1)
    joints = rng.uniform(ROBOT.arm(arm).lower, ROBOT.arm(arm).upper)
    placements = pin.GeometryData(solids)
    pin.updateGeometryPlacements(model, model.createData(), solids, placements, ROBOT.configuration({arm: joints}))
    world = transform_points(ROBOT.gripper_pose(arm, joints), points)
    inside = np.zeros(len(points), dtype=bool)
    for index in GEOMETRY.hand(arm):
        shape = solids.geometryObjects[index].geometry
        local = transform_points(invert_transform(placements.oMg[index].homogeneous), world)
        mine = outside(shape, local) <= 1e-6
        inside |= mine
        low, high = box_of(shape)
        np.testing.assert_allclose(local[mine].min(axis=0), low, atol=1e-3)
        np.testing.assert_allclose(local[mine].max(axis=0), high, atol=1e-3)
    assert inside.all()


@pytest.mark.parametrize("arm", ROBOT.arm_names)
def test_the_gripper_frame_is_between_the_finger_tips(arm):
    """The fingers point along z and end near its origin; the wrist is behind, and the place between them is empty."""
    points = gripper_points(GEOMETRY, arm)
    assert -0.02 < points[:, 2].max() < 0.03
    assert points[:, 2].min() < -0.1
    assert np.linalg.norm(points, axis=1).min() > 0.01
    np.testing.assert_array_equal(points, gripper_points(GEOMETRY, arm))
