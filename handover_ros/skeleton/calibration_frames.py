"""Which frames of a recording are fitted, which are left out, and where the person stands still."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from handover_ros.errors import ErrorCode, HandoverError
from handover_ros.geometry import FloatArray
from handover_ros.mocap.frames import Recording
from handover_ros.mocap.marker_sets import TorsoDefinition
from handover_ros.skeleton.rigid_fit import kabsch
from handover_ros.skeleton.rigid_motion import rigid_motion
from handover_ros.skeleton.torso_template import TemplateError, TorsoMarkers, estimate_template
from handover_ros.skeleton.tree import Skeleton

BLOCK = 0.6  # [s] length of the blocks that are left out
STILL_SEARCH = 4.0  # [s] at the beginning in which the person is expected to stand still
STILL_LENGTH = 0.3  # [s]
LEAST_FIT_FRAMES = 40


def divide(
    observed: FloatArray, blank: Skeleton, rate: float, max_frames: int, holdout: float
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Return frame numbers of the fit and of what is left out of it; a frame must show the root."""
    tree = blank.tree
    usable = np.isfinite(observed[:, :, 0]).sum(axis=1) >= 3
    if blank.is_free:
        usable &= np.isfinite(observed[:, tree.marker_joint == 0, 0]).sum(axis=1) >= 3
    frames = np.arange(len(observed))
    block = (frames / max(BLOCK * rate, 1.0)).astype(int)
    period = round(1.0 / holdout) if holdout > 0.0 else 0
    left_out = (block % period == period - 1) if period else np.zeros(len(frames), dtype=bool)
    fitted, held_out = frames[usable & ~left_out], frames[usable & left_out]
    if len(fitted) < LEAST_FIT_FRAMES:
        raise HandoverError(
            f"only {len(fitted)} frames show at least three markers of {blank.root}, {LEAST_FIT_FRAMES} are "
            "needed; uncover its markers",
            ErrorCode.NOT_ENOUGH_DATA,
        )
    if len(fitted) > max_frames:
        fitted = fitted[np.linspace(0, len(fitted) - 1, max_frames).astype(int)]
    if len(held_out) > max_frames // 3:
        held_out = held_out[np.linspace(0, len(held_out) - 1, max(max_frames // 3, 1)).astype(int)]
    return fitted, held_out


def stillest(observed: FloatArray, rate: float) -> tuple[int, int]:
    """Return the frames [first, last + 1) of the stillest moment near the beginning."""
    length = max(int(STILL_LENGTH * rate), 3)
    end = min(len(observed), max(int(STILL_SEARCH * rate), 3 * length))
    missing = np.isnan(observed)
    highest, lowest = np.where(missing, -np.inf, observed), np.where(missing, np.inf, observed)
    best, where = np.inf, 0
    for start in range(0, max(end - length, 1), max(length // 3, 1)):
        window = slice(start, start + length)
        span = highest[window].max(axis=0) - lowest[window].min(axis=0)
        seen = np.isfinite(span)
        motion = float(span[seen].mean()) if seen.any() else np.inf
        if motion < best:
            best, where = motion, start
    return where, where + length


def nearest(frames: npt.NDArray[np.intp], wanted: int) -> int:
    """Return the frame number nearest to a wanted one."""
    return int(frames[np.argmin(np.abs(frames - wanted))])


def torso_motion(recording: Recording, torso: TorsoDefinition | None) -> FloatArray | None:
    """Return the torso pose of every frame (frames, 4, 4), the nearest one where it is not seen; None: no torso."""
    if torso is None:
        return None
    try:
        markers = TorsoMarkers.of(torso, recording.names)
        few = np.linspace(0, recording.frames - 1, min(60, recording.frames)).astype(int)
        inside = estimate_template(markers, recording.positions[few][:, markers.index])
    except TemplateError:
        return None
    known = np.isfinite(inside[:, 0])
    if known.sum() < 3:
        return None
    positions = recording.positions[:, markers.index[known]]
    poses, shape = rigid_motion(positions, int(np.argmax(np.isfinite(positions[:, :, 0]).sum(axis=1))))
    return np.asarray(poses @ frame_of(inside[known], shape))


def frame_of(inside: FloatArray, outside: FloatArray) -> FloatArray:
    """Return the pose (4, 4) that maps points (k, 3) to points (k, 3), NaN where unknown."""
    known = np.isfinite(inside[:, 0]) & np.isfinite(outside[:, 0])
    rotation, translation, _ = kabsch(inside[known], outside[known], np.ones(int(known.sum())))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, translation
    return pose


def zero_frame(
    blank: Skeleton, observed: FloatArray, reference: int, torso_poses: FloatArray | None
) -> FloatArray | None:
    """Return the zero frame in the world (4, 4) at the reference frame: the torso's, or its axes at the root."""
    if not blank.is_free or torso_poses is None:
        return None
    pose = torso_poses[reference].copy()
    if blank.root != "torso":
        own = [i for i, segment in enumerate(blank.marker_segments) if segment == blank.root]
        pose[:3, 3] = np.nanmean(observed[reference, own], axis=0)
        if not np.isfinite(pose).all():
            return None
    return pose
