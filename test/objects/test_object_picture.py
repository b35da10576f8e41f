"""Pictures of objects, and the surfaces they are made of."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from rich.console import Console

from handover_ros.cell.objects_command import ObjectsRequest, gripper_grasps, hand_grasps, run_objects
from handover_ros.errors import UnknownNameError
from handover_ros.geometry import transform_from_xyz_rpy
from handover_ros.objects import load_catalogue
from handover_ros.objects.drawing import (
    View,
    ball,
    box,
    cylinder,
    gripper_surface,
    hand_surface,
    joined,
    object_surface,
    tube,
)
from handover_ros.planning.grasp_set import grasp_set
from handover_ros.robot import RobotModel

CATALOGUE = load_catalogue()
ROBOT = RobotModel.load()
RED = (1.0, 0.0, 0.0, 1.0)
POSE = transform_from_xyz_rpy([0.3, -0.2, 0.5], [0.4, -0.7, 1.1])


def volume(surface):
    """The volume [m3] that faces enclose, positive when all of them look outwards (divergence theorem)."""
    a, b, c, d = (surface.faces[:, corner] for corner in range(4))
    first, second = (np.einsum("ni,ni->n", a, np.cross(*pair)) for pair in ((b, c), (c, d)))
    return float((first + second).sum() / 6.0)


@pytest.mark.parametrize(
    ("surface", "expected"),
    [
        (box([0.1, 0.2, 0.05], POSE, RED), 0.1 * 0.2 * 0.05),
        (cylinder(0.05, 0.2, POSE, RED), np.pi * 0.05**2 * 0.2),
        (ball(0.1, [0.2, 0.1, 0.0], RED), 4.0 / 3.0 * np.pi * 0.1**3),
        (ball((0.1, 0.05, 0.2), [0.2, 0.1, 0.0], RED), 4.0 / 3.0 * np.pi * 0.1 * 0.05 * 0.2),
        (tube([0.1, 0.0, 0.0], [0.1, 0.3, 0.1], (0.04, 0.04), RED, 40),
         np.pi * 0.04**2 * np.sqrt(0.1) + 4.0 / 3.0 * np.pi * 0.04**3),
    ],
    ids=["box", "cylinder", "ball", "ellipsoid", "tube"],
)  # fmt: skip
def test_surfaces_are_closed_and_look_outwards(surface, expected):
    """The faces enclose the solid's volume, wherever it is."""
    assert volume(surface) == pytest.approx(expected, rel=0.08)


@pytest.mark.parametrize("side", ["left", "right"])
def test_hands_and_grippers_look_outwards(side):
    assert volume(hand_surface(POSE, side, RED)) > 1e-4
    assert volume(gripper_surface(POSE, 0.05)) > 1e-4


def test_the_left_hand_is_the_right_ones_mirror_image():
    right, left = (hand_surface(np.eye(4), side, RED).faces.reshape(-1, 3) for side in ("right", "left"))
    assert right[:, 1].min() == pytest.approx(-left[:, 1].max())
    assert right[:, 1].max() == pytest.approx(-left[:, 1].min())


def test_a_view_keeps_lengths_and_up():
    view = View.towards(0.7, 0.4)
    np.testing.assert_allclose(view.axes @ view.axes.T, np.eye(3), atol=1e-12)
    up = view.project(np.array([0.0, 0.0, 1.0]))
    assert up[0] == pytest.approx(0.0)
    assert up[1] > 0.0
    np.testing.assert_allclose(np.cross(view.axes[0], view.axes[1]), view.axes[2], atol=1e-12)


def test_nothing_joined_is_nothing():
    assert len(joined([]).faces) == 0


@pytest.mark.parametrize("name", CATALOGUE)
def test_what_the_solids_of_an_object_hide_of_each_other_is_left_out(name):
    """Never a whole solid, and never anything on the object's outside."""
    model = CATALOGUE[name]
    surface = object_surface(model, np.eye(4))
    assert len(surface.faces) > 20
    everything = np.concatenate([s.faces for s in (object_surface_of(model, part) for part in model.primitives)])
    for bound in (np.min, np.max):
        np.testing.assert_allclose(bound(surface.faces, axis=(0, 1)), bound(everything, axis=(0, 1)), atol=1e-9)


def object_surface_of(model, part):
    return object_surface(replace(model, primitives=(part,)), np.eye(4))


def test_objects_are_drawn_and_told(tmp_path: Path):
    """Only those that were asked for; each picture has coloured hands and object, and is small."""
    console = Console(width=100, record=True, file=io.StringIO())
    names, out = ("mug", "box"), tmp_path / "out"
    assert run_objects(ObjectsRequest(names, json_file=tmp_path / "n.json", out=out), console) == 0
    document = json.loads((tmp_path / "n.json").read_text())
    assert (document["command"], document["metrics"]["objects"]) == ("objects", 2)
    assert document["metrics"]["mug_hand_grasps"] == len(grasp_set(CATALOGUE["mug"], ("right",)))
    assert document["files"] == [str(out / f"{name}.png") for name in names]
    assert sorted(path.name for path in out.iterdir()) == ["box.png", "mug.png", "objects.json"]
    for name in names:
        assert name in console.export_text(clear=False)
        image = matplotlib.image.imread(out / f"{name}.png")
        assert image.shape[1] == 1600
        assert (np.ptp(image[..., :3], axis=2) > 0.15).mean() > 0.02
        assert (out / f"{name}.png").stat().st_size < 400_000


def test_unknown_object(tmp_path: Path):
    with pytest.raises(UnknownNameError, match=r"unknown object 'cup'; known: .*mug"):
        run_objects(ObjectsRequest(("cup",), out=tmp_path / "out"), Console(file=io.StringIO()))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", CATALOGUE)
def test_grasps_of_all_regions_are_shown(name):
    model, robot = CATALOGUE[name], ROBOT
    hands, grippers = hand_grasps(model), gripper_grasps(model, robot)
    assert [each.name for each in hands] == [region.name for region in model.human_grasps]
    assert [each.name for each in grippers] == [grasp.region.name for grasp in model.robot_grasps]
    for each, region in zip(hands, model.human_grasps):
        assert len(each.poses) > 0
        assert all(region.distance(pose)[0] < 1e-6 for pose in each.poses)
    assert all(each.width > 0.0 and len(each.poses) > 0 for each in grippers)
