"""The motion of a rigid set of markers over many frames."""

from __future__ import annotations

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.skeleton.torso_template import procrustes_mean

SHAPE_FRAMES = 60  # frames from which the shape is taken


def rigid_motion(
    observed: FloatArray, reference: int, world_from_zero: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return (world_from_zero poses (frames, 4, 4), marker positions (m, 3)) of a rigid set of markers.

    Frames with fewer than three markers take the pose of the frame beside them.

    Args:
        observed: Markers [m], shape (frames, m, 3), NaN = not measured.
        reference: Frame in which the zero frame is ``world_from_zero``.
        world_from_zero: See ``first_guess``.
    """
    few = np.linspace(0, len(observed) - 1, min(SHAPE_FRAMES, len(observed))).astype(int)
    shape = procrustes_mean(observed[few], np.ones(observed.shape[1]))
    poses = best_poses(shape, observed)
    fill_from_neighbours(poses)
    world_from_shape = poses[reference]
    if world_from_zero is None:
        world_from_zero = np.eye(4)
        world_from_zero[:3, 3] = (world_from_shape[:3, :3] @ np.nanmean(shape, axis=0)) + world_from_shape[:3, 3]
    shape_from_zero = np.linalg.inv(world_from_shape) @ world_from_zero
    markers = (shape - shape_from_zero[:3, 3]) @ shape_from_zero[:3, :3]
    return poses @ shape_from_zero, np.nan_to_num(markers)


def best_poses(shape: FloatArray, observed: FloatArray) -> FloatArray:
    """Return the poses (frames, 4, 4) that move a shape (k, 3) [m] nearest to its markers; NaN with fewer than three.

    ``rigid_fit.kabsch`` for many frames at once.
    """
    seen = np.isfinite(observed[:, :, 0]) & np.isfinite(shape[:, 0])
    share = seen / np.maximum(seen.sum(axis=1, keepdims=True), 1)
    inside, outside = np.nan_to_num(shape), np.where(seen[:, :, None], observed, 0.0)
    inside_mean, outside_mean = share @ inside, np.einsum("fk,fka->fa", share, outside)
    moment = np.einsum(
        "fk,fka,fkb->fab", share, inside[None] - inside_mean[:, None], outside - outside_mean[:, None], optimize=True
    )
    u, _, vt = np.linalg.svd(moment)
    u[:, :, 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))[:, None]
    rotation = np.swapaxes(u @ vt, -1, -2)
    poses = np.zeros((len(observed), 4, 4))
    poses[:, :3, :3], poses[:, 3, 3] = rotation, 1.0
    poses[:, :3, 3] = outside_mean - np.einsum("fab,fb->fa", rotation, inside_mean)
    poses[seen.sum(axis=1) < 3] = np.nan
    return poses


def fill_from_neighbours(poses: FloatArray) -> None:
    """Replace unknown poses (frames, 4, 4) by the nearest known one, in place."""
    known = np.flatnonzero(np.isfinite(poses[:, 0, 0]))
    for k in np.flatnonzero(~np.isfinite(poses[:, 0, 0])):
        poses[k] = poses[known[np.argmin(np.abs(known - k))]] if len(known) else np.eye(4)
