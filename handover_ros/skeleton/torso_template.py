"""The torso as a rigid body: positions of its markers in the torso frame, estimated from the first frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from handover_ros.errors import HandoverError
from handover_ros.geometry import FloatArray
from handover_ros.mocap.marker_sets import TorsoDefinition
from handover_ros.skeleton.rigid_fit import kabsch

ROUNDS = 10
MIN_COMMON = 3


class TemplateError(HandoverError):
    """The frames collected so far do not fix a torso; more are needed."""


@dataclass(frozen=True, eq=False)
class TorsoMarkers:
    """The torso definition of a marker set, by the index of the markers in a frame.

    Attributes:
        definition: As in the marker set's file.
        index: Where the k torso markers stand in a frame, shape (k,).
        names: Their names.
        weights: Their relative weights, shape (k,).
    """

    definition: TorsoDefinition
    index: npt.NDArray[np.intp]
    names: tuple[str, ...]
    weights: FloatArray

    @classmethod
    def of(cls, definition: TorsoDefinition, frame_names: tuple[str, ...]) -> TorsoMarkers:
        """Return the torso markers that a stream with ``frame_names`` has.

        Raises:
            TemplateError: The stream has fewer than three of them.
        """
        names = tuple(name for name in definition.weights if name in frame_names)
        if len(names) < MIN_COMMON:
            raise TemplateError(
                f"the stream has {len(names)} of the torso's markers ({', '.join(definition.weights)}), needs 3"
            )
        index = np.array([frame_names.index(name) for name in names], dtype=np.intp)
        return cls(definition, index, names, np.array([definition.weights[name] for name in names]))

    def mean(self, positions: FloatArray, names: tuple[str, ...]) -> FloatArray:
        """Return the mean position (3,) of those of ``names`` that are seen.

        Raises:
            TemplateError: None of them is.
        """
        rows = [self.names.index(name) for name in names if name in self.names]
        seen = [row for row in rows if np.isfinite(positions[row, 0])]
        if not seen:
            raise TemplateError(f"none of the torso markers {', '.join(names)} has been seen yet")
        return np.asarray(positions[seen].mean(axis=0))


def procrustes_mean(frames: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the mean shape of a rigid set of markers, in the place it had on average (k, 3), NaN if never seen.

    Generalised Procrustes analysis (Gower 1975) with missing markers: every frame is moved onto the mean shape by a
    rigid motion, the mean is taken again, and the gauge is that of the fullest frame.

    Args:
        frames: Positions [m], shape (f, k, 3), NaN where missing.
        weights: Relative weights of the markers, shape (k,).

    Raises:
        TemplateError: No frame shares three markers with the others.
    """
    seen = np.isfinite(frames[:, :, 0])
    mean = frames[int(np.argmax(seen @ weights))].copy()
    for _ in range(ROUNDS):
        total, count = np.zeros_like(mean), np.zeros(len(mean))
        known = np.isfinite(mean[:, 0])
        for positions, visible in zip(frames, seen):
            common = visible & known
            if common.sum() < MIN_COMMON:
                continue
            rotation, translation, _ = kabsch(positions[common], mean[common], weights[common])
            total[visible] += positions[visible] @ rotation.T + translation
            count[visible] += 1
        if not count.any():
            raise TemplateError("no frame shows three torso markers at once")
        with np.errstate(invalid="ignore"):
            renewed = np.where(count[:, None] > 0, total / np.maximum(count, 1)[:, None], np.nan)
        done = np.array_equal(known, count > 0) and np.nanmax(np.abs(renewed - mean)) < 1e-7
        mean = renewed
        if done:
            break
    return mean


def anatomical_frame(markers: TorsoMarkers, positions: FloatArray) -> FloatArray:
    """Return ``world_from_torso`` (4, 4) built from marker positions (k, 3) [m] as the definition says.

    Raises:
        TemplateError: A needed marker has not been seen.
    """
    definition = markers.definition

    def direction(start: tuple[str, ...], end: tuple[str, ...]) -> FloatArray:
        vector = markers.mean(positions, end) - markers.mean(positions, start)
        return np.asarray(vector / np.linalg.norm(vector))

    z = direction(definition.lower, definition.upper) if definition.upper else np.array([0.0, 0.0, 1.0])
    if definition.left:
        y = direction(definition.right, definition.left)
        y = y - (y @ z) * z
        y /= np.linalg.norm(y)
        x = np.cross(y, z)
    else:
        x = direction(definition.back, definition.front)
        x = x - (x @ z) * z
        x /= np.linalg.norm(x)
        y = np.cross(z, x)
    rotation = np.column_stack([x, y, z])
    frame = np.eye(4)
    frame[:3, :3] = rotation
    frame[:3, 3] = markers.mean(positions, definition.origin) + rotation @ np.array(definition.origin_offset)
    return frame


def estimate_template(markers: TorsoMarkers, frames: FloatArray) -> FloatArray:
    """Return the torso markers' positions in the torso frame [m], shape (k, 3), NaN where never seen.

    Args:
        markers: The torso markers.
        frames: Their world positions in some frames [m], shape (f, k, 3), NaN where missing.

    Raises:
        TemplateError: The frames do not fix a torso.
    """
    mean = procrustes_mean(frames, markers.weights)
    frame = anatomical_frame(markers, mean)
    return np.asarray((mean - frame[:3, 3]) @ frame[:3, :3])


def stated_template(markers: TorsoMarkers) -> FloatArray | None:
    """Return the template (k, 3) written in the marker set, NaN for markers it leaves out; None if it has none."""
    stated = markers.definition.template
    if stated is None:
        return None
    unknown = (np.nan, np.nan, np.nan)
    return np.array([stated.get(name, unknown) for name in markers.names], dtype=float)
