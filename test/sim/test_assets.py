"""Mesh conversion: kept shape and colours, one conversion a content, nothing half done."""

import multiprocessing
from pathlib import Path

import numpy as np
import pytest
import trimesh
from trimesh.visual.material import PBRMaterial
from trimesh.visual.texture import TextureVisuals

from handover_ros.errors import BadModelError
from handover_ros.sim import assets
from handover_ros.sim.assets import mesh_parts


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def sphere_file(folder: Path, colour=(200, 10, 20, 255)) -> Path:
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    mesh.visual = TextureVisuals(material=PBRMaterial(baseColorFactor=colour))
    path = folder / "ball.dae"
    path.write_bytes(trimesh.exchange.dae.export_collada(mesh))
    return path


def test_shape_and_colour_are_kept(tmp_path):
    (part,) = mesh_parts(sphere_file(tmp_path))
    converted = trimesh.load_mesh(part.file)
    np.testing.assert_allclose(converted.extents, 0.2, rtol=0.01)
    assert part.colour == pytest.approx((200 / 255, 10 / 255, 20 / 255, 1.0), abs=0.01)


def test_many_faces_become_fewer(tmp_path):
    (part,) = mesh_parts(sphere_file(tmp_path), maximum_faces=2500)
    converted = trimesh.load_mesh(part.file)
    assert len(converted.faces) <= 2500
    np.testing.assert_allclose(converted.extents, 0.2, rtol=0.1)


def test_converted_once_for_the_same_content(tmp_path, monkeypatch):
    source = sphere_file(tmp_path)
    first = mesh_parts(source)
    monkeypatch.setattr(assets, "_convert", lambda *_: pytest.fail("converted again"))
    assert mesh_parts(source) == first


def test_changed_content_is_converted_anew(tmp_path):
    source = sphere_file(tmp_path)
    first = mesh_parts(source)
    sphere_file(tmp_path, colour=(0, 250, 0, 255))
    assert mesh_parts(source) != first


def test_two_processes_at_once_agree(tmp_path):
    source = sphere_file(tmp_path)
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        first, second = pool.map(mesh_parts, [source, source], chunksize=1)
    assert first == second
    assert all(part.file.is_file() for part in first)
    assert [folder.name for folder in (tmp_path / "cache/handover_ros/meshes").iterdir()] == [first[0].file.parent.name]


def test_interrupted_conversion_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(assets, "_obj_text", lambda _: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        mesh_parts(sphere_file(tmp_path))
    assert list((tmp_path / "cache/handover_ros/meshes").iterdir()) == []


@pytest.mark.parametrize("content", [b"", b"<COLLADA>", b"no mesh at all"])
def test_bad_mesh_is_named(tmp_path, content):
    path = tmp_path / "bad.dae"
    path.write_bytes(content)
    with pytest.raises(BadModelError, match=r"bad\.dae"):
        mesh_parts(path)


def test_missing_mesh_is_named(tmp_path):
    with pytest.raises(BadModelError, match=r"gone\.dae"):
        mesh_parts(tmp_path / "gone.dae")
