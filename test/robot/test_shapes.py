"""Solids: placed where they should be, measured right."""

import numpy as np
import pytest

from handover_ros.geometry import make_transform, transform_from_xyz_rpy
from handover_ros.objects import load_object
from handover_ros.robot.shapes import Solid, object_solids, person_solids


@pytest.mark.parametrize(
    ("kind", "size", "point", "expected"),
    [
        ("box", (2.0, 2.0, 2.0), (3.0, 0.0, 0.0), 2.0),
        ("sphere", (0.5,), (0.0, 2.0, 0.0), 1.5),
        ("cylinder", (0.5, 2.0), (0.0, 0.0, 3.0), 2.0),
        ("capsule", (0.5, 2.0), (0.0, 0.0, 3.0), 1.5),
    ],
)
def test_distance_to_a_point(kind, size, point, expected):
    """Sizes mean what the object catalogue says; the distance moves with the solid."""
    solid = Solid("thing", kind, size, np.eye(4))
    assert solid.distance(np.array(point)) == pytest.approx(expected, abs=1e-3)
    shift = np.array([1.0, -2.0, 0.5])
    assert solid.placed(make_transform(np.eye(3), shift)).distance(point + shift) == pytest.approx(expected, abs=1e-3)


def test_point_inside_is_negative():
    assert Solid("thing", "sphere", (0.5,), np.eye(4)).distance(np.zeros(3)) < 0


def test_object_solids_move_with_the_object():
    """A grasped object's fingertips are near one of its solids, wherever it stands."""
    mug = load_object("mug")
    pose = transform_from_xyz_rpy([1.0, 2.0, 3.0], [0.0, 0.0, 1.0])
    point = (pose @ mug.robot_grasps[0].region.centre())[:3, 3]
    assert min(solid.distance(point) for solid in object_solids(mug, pose)) < 0.01


def test_person_covers_trunk_and_head():
    """The solids cover the body's axis from the hips to the head, and not the place of the hands in front."""
    torso = transform_from_xyz_rpy([1.4, 0.0, 1.4], [0.0, 0.0, np.pi])
    solids = person_solids(torso)
    for height in (0.4, 0.9, 1.3, 1.6):
        assert min(solid.distance(np.array([1.4, 0.0, height])) for solid in solids) < 0.0
    assert min(solid.distance(np.array([0.9, 0.0, 1.15])) for solid in solids) > 0.25
