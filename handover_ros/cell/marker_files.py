"""Recordings named on the command line: read, labelled, joined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from handover_ros.errors import BadRecordingError, BadRequestError
from handover_ros.mocap.frames import Recording
from handover_ros.mocap.marker_sets import MarkerSet, load_marker_set, matching_marker_set
from handover_ros.mocap.raw_recording import RawRecording
from handover_ros.mocap.recordings import label_recording, read_recording
from handover_ros.resources import config_names

AUTO = "auto"
RATE_TOLERANCE = 0.01  # relative


@dataclass(frozen=True, eq=False)
class JoinedFiles:
    """The frames of one or several files, one after the other.

    Attributes:
        marker_set: The marker set of all.
        recording: All frames.
        starts: First frame of each file.
    """

    marker_set: MarkerSet
    recording: Recording
    starts: tuple[int, ...]


def load_recordings(paths: Sequence[Path], marker_set: str = AUTO) -> JoinedFiles:
    """Return the frames of one or several files of one person.

    Args:
        paths: C3D, TRC or Vicon CSV.
        marker_set: Name or file of the marker set; ``auto``: the one that knows most of the first file's labels.

    Raises:
        BadRequestError: No file is named.
        UnknownNameError: There is no such marker set.
        BadRecordingError: A file cannot be used, no marker set fits, or the rates differ.
    """
    if not paths:
        raise BadRequestError("name at least one recording")
    raws = [read_recording(path) for path in paths]
    chosen = matching(raws[0]) if marker_set == AUTO else load_marker_set(marker_set)
    for raw in raws[1:]:
        if abs(raw.rate - raws[0].rate) > RATE_TOLERANCE * raws[0].rate:
            raise BadRecordingError(
                f"{raw.path}: rate: {raw.rate:g} Hz, but {raws[0].path} has {raws[0].rate:g} Hz; give files of one rate"
            )
    parts = [label_recording(raw, chosen) for raw in raws]
    positions = np.concatenate([part.positions for part in parts])
    starts = np.cumsum([0, *(part.frames for part in parts[:-1])])
    recording = Recording(chosen.names, chosen.segments, parts[0].rate, positions, parts[0].path)
    return JoinedFiles(chosen, recording, tuple(starts.tolist()))


def matching(raw: RawRecording) -> MarkerSet:
    """Return the marker set that fits the labels of a file best.

    Raises:
        BadRecordingError: None fits.
    """
    found = matching_marker_set(raw.names)
    if found is None:
        raise BadRecordingError(
            f"{raw.path}: no marker set fits its labels (tried {', '.join(config_names('marker_sets'))}); write one "
            "and name it with --marker-set"
        )
    return found
