"""Recordings of any supported format as labelled positions in metres, z up."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from handover_ros.errors import BadModelError, BadRecordingError
from handover_ros.mocap.c3d_reader import read_c3d
from handover_ros.mocap.frames import Recording
from handover_ros.mocap.marker_sets import UNITS_IN_METRES, MarkerSet, match_labels
from handover_ros.mocap.raw_recording import RawRecording
from handover_ros.mocap.trc_reader import read_trc
from handover_ros.mocap.vicon_csv_reader import read_vicon_csv

READERS: dict[str, Callable[[Path], RawRecording]] = {".c3d": read_c3d, ".trc": read_trc, ".csv": read_vicon_csv}

MAX_EXTENT = 30.0  # [m] no marker of one recording is farther from the middle, or the unit is wrong
MIN_EXTENT = 0.05  # [m] the markers of a body are spread at least this far, or the unit is wrong


def read_recording(path: Path) -> RawRecording:
    """Return a recording as its file has it; the format follows from the extension.

    Raises:
        BadRecordingError: Unknown extension, missing file, or the reader's complaint.
    """
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise BadRecordingError(f"{path}: unknown extension {path.suffix!r}; known: {', '.join(READERS)}")
    if not path.is_file():
        raise BadRecordingError(f"{path}: no such file")
    return reader(path)


def label_recording(raw: RawRecording, marker_set: MarkerSet) -> Recording:
    """Return the markers of ``marker_set`` out of a raw recording, in metres, z up.

    A point p of the source becomes ``axes @ p * unit + origin_offset``.

    Raises:
        BadRecordingError: A required marker is not in the file, the unit is unknown, or positions in that unit are no
            person's.
    """
    try:
        columns = match_labels(marker_set, raw.names)
    except BadModelError as error:
        raise BadRecordingError(f"{raw.path}: {error}") from None
    declared = marker_set.content.units
    unit = raw.units.strip().lower() if declared == "auto" else declared
    scale = UNITS_IN_METRES.get(unit)
    if scale is None:
        raise BadRecordingError(
            f"{raw.path}: units: {raw.units!r} is not a known unit of length ({', '.join(UNITS_IN_METRES)}); "
            f"mend the file or set units in marker set {marker_set.name!r}"
        )
    positions = np.full((len(raw.positions), len(columns), 3), np.nan)
    present = [index for index, column in enumerate(columns) if column is not None]
    source = np.array([columns[index] for index in present], dtype=int)
    rotation = marker_set.axes_rotation(raw.up) * scale
    positions[:, present] = raw.positions[:, source] @ rotation.T + np.array(marker_set.content.origin_offset)
    # A marker is there with all three coordinates or not at all.
    positions[~np.isfinite(positions).all(axis=2)] = np.nan
    _check_extent(raw, unit, positions)
    return Recording(marker_set.names, marker_set.segments, raw.rate, positions, raw.path)


def load_recording(path: Path | str, marker_set: MarkerSet) -> Recording:
    """Return a C3D, TRC or Vicon CSV file as a labelled recording.

    Raises:
        BadRecordingError: One line that names the file and the field, line or column that is wrong.
    """
    return label_recording(read_recording(Path(path)), marker_set)


def _check_extent(raw: RawRecording, unit: str, positions: np.ndarray) -> None:
    points = positions.reshape(-1, 3)
    points = points[np.isfinite(points[:, 0])]
    if len(points) == 0:
        raise BadRecordingError(f"{raw.path}: not one marker of the set is measured in any frame")
    distances = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    middle = float(np.median(distances))
    if not MIN_EXTENT / 2 <= middle <= MAX_EXTENT / 2:
        raise BadRecordingError(
            f"{raw.path}: units: markers lie {middle:.3g} m from their middle when read as {unit!r}, expected "
            f"{MIN_EXTENT / 2:g} to {MAX_EXTENT / 2:g} m; set the right units in the file or the marker set"
        )
