"""The robot's DAE meshes as OBJ files that MuJoCo reads, made once and cached by the content of the source file."""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from handover_ros.errors import BadModelError
from handover_ros.resources import cache_directory

FORMAT = "2"  # part of the cache key; change it when the conversion changes
MAXIMUM_FACES = 30_000  # of one part: Baxter's pedestal alone has 75,000, which nobody sees in a picture
FINEST_CELL, COARSEST_CELL = 2e-5, 0.01  # [m] cells within which vertices are merged
PARTS_FILE = "parts.json"

Colour = tuple[float, float, float, float]


@dataclass(frozen=True)
class MeshPart:
    """One single-coloured part of a mesh.

    Attributes:
        file: OBJ file [m].
        colour: Red, green, blue, opacity, each 0 to 1; None when the source gives none.
    """

    file: Path
    colour: Colour | None


def mesh_parts(source: Path, maximum_faces: int = MAXIMUM_FACES) -> tuple[MeshPart, ...]:
    """Return the parts of a mesh file, one a material, converting it on first use.

    The conversion is written to a folder of its own which then takes its final name in one step, so that a process that
    is interrupted, or two that convert the same file at once, leave nothing half done.

    Raises:
        BadModelError: The file is missing or is no mesh, or the cache folder cannot be written.
    """
    try:
        content = source.read_bytes()
    except OSError as error:
        raise BadModelError(f"{source}: mesh cannot be read: {error.strerror or error}") from None
    digest = hashlib.sha256(content + f"|{FORMAT}|{maximum_faces}".encode()).hexdigest()[:20]
    folder = cache_directory() / "meshes" / f"{source.stem}_{digest}"
    if not (folder / PARTS_FILE).is_file():
        _convert(source, folder, maximum_faces)
    parts = json.loads((folder / PARTS_FILE).read_text(encoding="utf-8"))
    return tuple(MeshPart(folder / part["file"], tuple(part["colour"]) if part["colour"] else None) for part in parts)


def _convert(source: Path, folder: Path, maximum_faces: int) -> None:
    """Write the parts of ``source`` into ``folder``, whole or not at all."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    except OSError as error:
        raise BadModelError(f"{folder.parent}: mesh cache cannot be written: {error.strerror or error}") from None
    try:
        parts = []
        for index, (mesh, colour) in enumerate(_load(source)):
            name = f"part_{index}.obj"
            (temporary / name).write_text(_obj_text(_simplified(mesh, maximum_faces)), encoding="utf-8")
            parts.append({"file": name, "colour": colour})
        (temporary / PARTS_FILE).write_text(json.dumps(parts), encoding="utf-8")
        try:
            temporary.rename(folder)
        except OSError:
            if not (folder / PARTS_FILE).is_file():  # otherwise another process was first
                raise
    except OSError as error:
        raise BadModelError(f"{folder}: mesh cache cannot be written: {error.strerror or error}") from None
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _load(source: Path) -> list[tuple[trimesh.Trimesh, Colour | None]]:
    """Return the meshes of a file in its root frame, with their colours."""
    try:
        scene = trimesh.load_scene(str(source))
        parts = []
        for node in scene.graph.nodes_geometry:
            root_from_node, name = scene.graph[node]
            mesh = scene.geometry[name].copy()
            mesh.apply_transform(root_from_node)
            if len(mesh.faces):
                parts.append((mesh, _colour(mesh)))
    except Exception as error:  # trimesh and pycollada raise whatever their parsers raise
        raise BadModelError(f"{source}: not a mesh that can be read: {error}") from None
    if not parts:
        raise BadModelError(f"{source}: holds no triangles")
    return parts


def _colour(mesh: trimesh.Trimesh) -> Colour | None:
    """Return the main colour of a mesh's material; None when it has no material."""
    material = getattr(mesh.visual, "material", None)
    if material is None:
        return None
    red, green, blue, opacity = (float(value) / 255.0 for value in np.asarray(material.main_color)[:4])
    return (red, green, blue, opacity)


def _simplified(mesh: trimesh.Trimesh, maximum_faces: int) -> trimesh.Trimesh:
    """Return a mesh of at most about ``maximum_faces`` faces: vertices within one cell of a grid become their mean.

    Clustering keeps thin panels, which quadric edge collapse tears out of the (not watertight) CAD meshes.
    """
    plain = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    cell = FINEST_CELL
    while True:
        clustered = _clustered(plain, cell)
        if len(clustered.faces) <= maximum_faces or cell > COARSEST_CELL:
            return clustered
        cell *= 1.5


def _clustered(mesh: trimesh.Trimesh, cell: float) -> trimesh.Trimesh:
    """Return a mesh whose vertices within one cube of edge ``cell`` [m] are merged."""
    cubes = np.round(mesh.vertices / cell).astype(np.int64)
    _, cluster, counts = np.unique(cubes, axis=0, return_inverse=True, return_counts=True)
    cluster = cluster.ravel()
    vertices = np.stack([np.bincount(cluster, weights=mesh.vertices[:, axis]) for axis in range(3)], axis=1)
    faces = cluster[mesh.faces]
    apart = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return trimesh.Trimesh(vertices / counts[:, None], faces[apart], process=False)


def _obj_text(mesh: trimesh.Trimesh) -> str:
    """Return vertices and faces as OBJ text."""
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in mesh.vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in mesh.faces + 1]
    return "\n".join(lines) + "\n"
