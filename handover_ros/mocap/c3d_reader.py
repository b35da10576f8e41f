"""Reads C3D files with ezc3d, after checking that the file is as long as its header says."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import ezc3d
import numpy as np

from handover_ros.errors import BadRecordingError
from handover_ros.mocap.frames import check_rate
from handover_ros.mocap.raw_recording import MAX_BYTES, RawRecording

BLOCK = 512
C3D_KEY = 0x50
INTEL = 84
FRAME_COUNT_OVERFLOW = 65535  # the header's 16-bit last frame is not the true one beyond this


def read_c3d(path: Path) -> RawRecording:
    """Return the points of a C3D file; a negative residual and the exact origin are missing markers.

    Raises:
        BadRecordingError: The file is cut short or no C3D file, or a field of its POINT group cannot be used.
    """
    _check_length(path)
    try:
        content = ezc3d.c3d(str(path))
        points = np.asarray(content["data"]["points"], dtype=float)
        residuals = np.asarray(content["data"]["meta_points"]["residuals"], dtype=float)
        group = content["parameters"]["POINT"]
    except Exception as error:
        # ezc3d raises whatever its C++ streams raise; all of it means that the file cannot be used.
        raise BadRecordingError(f"{path}: cannot be read as C3D: {' '.join(str(error).split())[:200]}") from None
    labels = _labels(path, group, points.shape[1])
    rate = check_rate(path, "POINT:RATE", _number(path, group, "RATE"))
    positions = np.ascontiguousarray(points[:3].transpose(2, 1, 0))
    absent = ~np.isfinite(positions).all(axis=2) | (positions == 0.0).all(axis=2)
    if residuals.size == absent.size:
        absent |= residuals.reshape(points.shape[1], points.shape[2]).T < 0.0
    positions[absent] = np.nan
    if len(positions) == 0:
        raise BadRecordingError(f"{path}: POINT:FRAMES: the file holds no frames")
    vertical = str(_first(group, "Y_SCREEN", "")).strip().upper().lstrip("+-")
    up = {"Z": "z_up", "Y": "y_up"}.get(vertical, "")
    return RawRecording(path, labels, rate, str(_first(group, "UNITS", "")).strip(), up, positions)


def _check_length(path: Path) -> None:
    """Compare the file's length with its header, since ezc3d reads a file cut short without complaint."""
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            header = file.read(BLOCK)
            parameters = file.seek((max(header[0], 1) - 1) * BLOCK) if header else 0
            processor = file.read(4)[3:4]
    except OSError as error:
        raise BadRecordingError(f"{path}: cannot be read: {error.strerror or error}") from None
    if size > MAX_BYTES:
        raise BadRecordingError(f"{path}: {size} bytes, at most {MAX_BYTES} are read")
    if len(header) < BLOCK or header[1] != C3D_KEY or not processor:
        raise BadRecordingError(
            f"{path}: header: not a C3D file, or cut short ({size} bytes; parameters start at {parameters})"
        )
    if processor[0] != INTEL:
        return
    points, analog, first, last = struct.unpack_from("<4H", header, 2)
    (scale,) = struct.unpack_from("<f", header, 12)
    (start,) = struct.unpack_from("<H", header, 16)
    if points == 0:
        raise BadRecordingError(f"{path}: header: holds no points")
    if last < first or last >= FRAME_COUNT_OVERFLOW:
        return
    number_bytes = 4 if scale < 0 else 2
    expected = (start - 1) * BLOCK + (last - first + 1) * (4 * points + analog) * number_bytes
    if size < expected:
        raise BadRecordingError(
            f"{path}: the file is cut short: {size} bytes, its header (frames {first} to {last}) needs {expected}"
        )


def _first(group: dict[str, Any], field: str, default: object) -> Any:
    values = group.get(field, {}).get("value", [])
    return values[0] if len(values) else default


def _number(path: Path, group: dict[str, Any], field: str) -> float:
    try:
        return float(_first(group, field, np.nan))
    except (TypeError, ValueError):
        raise BadRecordingError(f"{path}: POINT:{field}: is not a number") from None


def _labels(path: Path, group: dict[str, Any], points: int) -> tuple[str, ...]:
    names: list[str] = []
    for field in ("LABELS", "LABELS2", "LABELS3"):
        names += [str(name).strip() for name in group.get(field, {}).get("value", [])]
    if len(names) < points:
        raise BadRecordingError(f"{path}: POINT:LABELS: {len(names)} labels for {points} points")
    return tuple(names[:points])
