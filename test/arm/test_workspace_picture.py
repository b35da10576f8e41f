"""The picture of workspaces, and the surface it draws."""

import matplotlib.image
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.arm.workspace import Workspace, hand_workspace
from handover_ros.arm.workspace_picture import Shown, draw_workspaces, stick_figure
from handover_ros.arm.workspace_surface import surface
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.sim.person_spec import load_person

SKELETON = skeleton_of(load_person("adult"))


def ball(radius, voxel):
    count = int(np.ceil(radius / voxel)) + 2
    index = np.indices((2 * count,) * 3).reshape(3, -1).T - count
    inside = np.linalg.norm((index + 0.5) * voxel, axis=1) < radius
    return Workspace(voxel, np.full(3, -count), inside.reshape((2 * count,) * 3))


@settings(max_examples=10, deadline=None)
@given(st.floats(0.3, 0.8))
def test_surface_is_closed_and_keeps_the_volume(radius):
    vertices, faces, normals = surface(ball(radius, 0.05))
    edges = {}
    for face in faces:
        for a, b in zip(face, np.roll(face, -1)):
            edges[(a, b)] = edges.get((a, b), 0) + 1
    assert all(edges.get((b, a)) == count for (a, b), count in edges.items())
    points = vertices[faces]
    areas = 0.5 * np.cross(points[:, 2] - points[:, 0], points[:, 3] - points[:, 1])
    volume = np.einsum("fi,fi->", points.mean(axis=1), areas) / 3.0
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * radius**3, rel=0.08)
    outward = np.einsum("fi,fi->f", normals, points.mean(axis=1))
    assert (outward > 0.0).mean() > 0.99


def test_stick_figure_stands_up():
    lines, shoulders = stick_figure(SKELETON)
    np.testing.assert_allclose(shoulders, 0.0, atol=1e-12)
    points = np.concatenate(lines)
    assert points[:, 2].min() < -0.6
    raised = np.zeros(14)
    raised[0] = np.pi / 2.0
    assert np.concatenate(stick_figure(SKELETON, raised)[0])[:, 0].max() > 0.5


def test_picture_is_written(tmp_path):
    space = hand_workspace(SKELETON, "right", 0.1)
    nothing = space.difference(space)
    path = tmp_path / "workspace.png"
    draw_workspaces(path, SKELETON, [Shown(space, "all"), Shown(nothing, "nothing")], "Workspace")
    image = matplotlib.image.imread(path)
    assert image.shape[0] > 800
    assert image.std() > 0.02
