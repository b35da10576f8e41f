"""Where the fit of a group of joints starts: trees in series, zero postures, axes, centres, noise."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from handover_ros.geometry import FloatArray
from handover_ros.skeleton.rigid_fit import kabsch
from handover_ros.skeleton.tree import COORDINATES, TANGENTS, FlatTree, JointKind

SEEDS = 8
CENTRE_PULL = 1e-6  # [m^2] variance of the markers' motion that outweighs the pull of their mean


def serial_tree(kinds: list[JointKind], axes: FloatArray, centre: FloatArray, markers: FloatArray) -> FlatTree:
    """Return joints in series through one point, hanging on the world, the last one carrying markers (k, 3)."""
    number = len(kinds)
    return FlatTree(
        kind=np.array(kinds, dtype=np.int64),
        parent=np.arange(-1, number - 1),
        axis=np.array(axes, dtype=float),
        point=np.tile(centre, (number, 1)),
        coordinate=np.cumsum([0, *(COORDINATES[kind] for kind in kinds)], dtype=np.int64)[:-1],
        tangent=np.cumsum([0, *(TANGENTS[kind] for kind in kinds)], dtype=np.int64)[:-1],
        marker_joint=np.full(len(markers), number - 1, dtype=np.int64),
        marker=markers,
    )


def on_free_base(group: FlatTree, base_markers: FloatArray) -> FlatTree:
    """Return a serial tree hung on a free segment that carries markers (b, 3); those come first."""
    return FlatTree(
        kind=np.concatenate([[int(JointKind.FREE)], group.kind]),
        parent=np.concatenate([[-1], group.parent + 1]),
        axis=np.vstack([np.zeros(3), group.axis]),
        point=np.vstack([np.zeros(3), group.point]),
        coordinate=np.concatenate([[0], group.coordinate + COORDINATES[JointKind.FREE]]),
        tangent=np.concatenate([[0], group.tangent + TANGENTS[JointKind.FREE]]),
        marker_joint=np.concatenate([np.zeros(len(base_markers), dtype=np.int64), group.marker_joint + 1]),
        marker=np.vstack([base_markers, group.marker]),
    )


def zero_coordinates(tree: FlatTree) -> FloatArray:
    """Return the coordinates (nq,) of the zero posture."""
    size = int(sum(COORDINATES[JointKind(kind)] for kind in tree.kind))
    zero = np.zeros(size)
    for kind, start in zip(tree.kind, tree.coordinate):
        if kind == JointKind.BALL:
            zero[start + 3] = 1.0
        elif kind == JointKind.FREE:
            zero[start + 6] = 1.0
    return zero


def starting_centres(seen: FloatArray, base_markers: FloatArray, markers: FloatArray) -> list[FloatArray]:
    """Return points (3,) near which the joints of a group may lie.

    First the common centre of the spheres on which the markers move; the error of the placed segment's pose pushes it
    outwards, sometimes far. Then points between the markers of both segments.

    Args:
        seen: The segment's markers as the placed segment sees them [m], shape (frames, k, 3).
        base_markers: The placed segment's own in the zero frame [m], shape (b, 3).
        markers: The segment's in the zero posture [m], shape (k, 3).
    """
    own = markers.mean(axis=0)
    centres = [centre_of_rotation(seen)]
    if len(base_markers):
        centres += [own + share * (base_markers.mean(axis=0) - own) for share in (0.25, 0.5)]
    return [*centres, own]


def centre_of_rotation(seen: FloatArray) -> FloatArray:
    """Return the point (3,) from which every marker keeps its distance best (a sphere for each marker).

    Linear least squares of |y|^2 - 2 y c + s_i = 0. Where the markers hardly curve the centre is held at their mean.

    Args:
        seen: Markers of one segment as the segment it hangs on sees them [m], shape (frames, k, 3).
    """
    visible = np.isfinite(seen[:, :, 0])
    mean = np.nanmean(seen.reshape(-1, 3), axis=0) if visible.any() else np.zeros(3)
    normal, right = np.zeros((3, 3)), np.zeros(3)
    samples = 0
    for i in range(seen.shape[1]):
        y = seen[visible[:, i], i] - mean
        if len(y) < 4:
            continue
        squared = (y**2).sum(axis=1)
        y_centred, squared_centred = y - y.mean(axis=0), squared - squared.mean()
        normal += 4.0 * y_centred.T @ y_centred
        right += 2.0 * y_centred.T @ squared_centred
        samples += len(y)
    return np.asarray(mean + np.linalg.solve(normal + (4.0 * samples * CENTRE_PULL + 1e-12) * np.eye(3), right))


def starting_axes(seen: FloatArray, markers: FloatArray, count: int, rng: np.random.Generator) -> list[FloatArray]:
    """Return starting directions (each (count, 3)) of the axes of a group: first what the motion suggests, then any.

    The main directions of the segment's rotation vectors are a good guess when its joints were moved one at a time.
    """
    if count == 0:
        return [np.zeros((0, 3))]
    seeds = []
    if (vectors := rotation_vectors(seen, markers)) is not None:
        _, _, directions = np.linalg.svd(vectors, full_matrices=True)
        for order in ([0, 1, 2], [1, 0, 2], [0, 2, 1], [2, 0, 1]):
            seeds.append(np.resize(directions[order], (count, 3)))
    while len(seeds) < SEEDS:
        axes = rng.normal(size=(count, 3))
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        if count == 1 or np.abs(axes @ axes.T - np.eye(count)).max() < 0.8:
            seeds.append(axes)
    return seeds


def rotation_vectors(seen: FloatArray, markers: FloatArray) -> FloatArray | None:
    """Return a segment's rotation vectors (k, 3) [rad] from its zero posture; None with fewer than three markers."""
    vectors = []
    for positions in seen:
        visible = np.isfinite(positions[:, 0])
        if visible.sum() >= 3:
            rotation, _, _ = kabsch(markers[visible], positions[visible], np.ones(int(visible.sum())))
            vectors.append(Rotation.from_matrix(rotation).as_rotvec())
    return np.array(vectors) if len(vectors) >= 3 else None


def free_motion_sigma(seen: FloatArray, markers: FloatArray) -> float:
    """Return the deviation [m] of a coordinate when the segment moves freely; 0 with less than three markers."""
    squared, count = 0.0, 0
    for positions in seen:
        visible = np.isfinite(positions[:, 0])
        number = int(visible.sum())
        if number >= 3:
            rotation, translation, _ = kabsch(markers[visible], positions[visible], np.ones(number))
            squared += float(np.sum((markers[visible] @ rotation.T + translation - positions[visible]) ** 2))
            count += 3 * number - 6
    return float(np.sqrt(squared / count)) if count else 0.0


def nearest_seen(seen: FloatArray, reference: int) -> FloatArray:
    """Return each marker's position (k, 3) [m] in the frame nearest to ``reference`` that shows it."""
    result = np.zeros(seen.shape[1:])
    for i in range(seen.shape[1]):
        frames = np.flatnonzero(np.isfinite(seen[:, i, 0]))
        if len(frames):
            result[i] = seen[frames[np.argmin(np.abs(frames - reference))], i]
    return result


def spread(usable: npt.NDArray[np.intp], reference: int, count: int) -> npt.NDArray[np.intp]:
    """Return at most ``count`` frame numbers spread evenly over ``usable``, with ``reference`` among them, in order."""
    picked = usable[np.linspace(0, len(usable) - 1, min(count, len(usable))).astype(int)] if len(usable) else usable
    return np.unique(np.append(picked, reference))
