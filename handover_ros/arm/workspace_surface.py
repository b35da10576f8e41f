"""The smooth surface of a voxel volume: faces between full and empty voxels, evened out."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix

from handover_ros.arm.workspace import Workspace
from handover_ros.geometry import FloatArray

ROUNDS = 12
# G. Taubin, "A signal processing approach to fair surface design", SIGGRAPH 1995: in and out, so that nothing shrinks.
INWARD, OUTWARD = 0.5, -0.53


def surface(workspace: Workspace) -> tuple[FloatArray, npt.NDArray[np.int64], FloatArray]:
    """Return vertices (v, 3) [m], faces (f, 4) of vertex indices and outward unit normals (f, 3), root frame."""
    filled = np.pad(workspace.filled, 1)
    corners = []
    for axis in range(3):
        step = np.eye(3, dtype=int)[axis]
        one, other = (np.eye(3, dtype=int)[(axis + k) % 3] for k in (1, 2))
        change = np.diff(filled.astype(np.int8), axis=axis)
        for sign, order in ((-1, (0, 1, 2, 3)), (1, (3, 2, 1, 0))):
            base = np.argwhere(change == sign) + step
            square = np.stack([base, base + one, base + one + other, base + other], axis=1)
            corners.append(square[:, order])
    quads = np.concatenate(corners)
    grid, inverse = np.unique(quads.reshape(-1, 3), axis=0, return_inverse=True)
    faces = inverse.reshape(-1, 4).astype(np.int64)
    vertices = _smooth(np.asarray((grid - 1 + workspace.corner) * workspace.voxel, dtype=float), faces)
    points = vertices[faces]
    normals = np.cross(points[:, 2] - points[:, 0], points[:, 3] - points[:, 1])
    return vertices, faces, normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def _smooth(vertices: FloatArray, faces: npt.NDArray[np.int64]) -> FloatArray:
    """Return vertices (v, 3) moved towards and away from the mean of their neighbours in turn."""
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    count = len(vertices)
    links = coo_matrix((np.ones(len(start)), (start, end)), shape=(count, count))
    links = ((links + links.T) > 0).astype(float)
    degree = np.asarray(links.sum(axis=1))
    for _ in range(ROUNDS):
        for factor in (INWARD, OUTWARD):
            vertices = vertices + factor * (links @ vertices / degree - vertices)
    return vertices
