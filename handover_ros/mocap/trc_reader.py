"""Reads TRC files (Motion Analysis, OpenSim): a tab-separated table under a five-line header."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from handover_ros.errors import BadRecordingError
from handover_ros.geometry import FloatArray
from handover_ros.mocap.frames import check_rate
from handover_ros.mocap.raw_recording import RawRecording, check_frame_number, parse_number, parse_row, read_text

HEADER_LINES = 5
LEADING_COLUMNS = 2
MAX_MARKERS = 2000


def read_trc(path: Path) -> RawRecording:
    """Return the markers of a TRC file.

    Raises:
        BadRecordingError: The file is cut short, misses a column or a header field, or has a cell that is no number;
            the message names line and column.
    """
    lines = read_text(path)
    if not lines or not lines[0].startswith("PathFileType"):
        first = lines[0][:40] if lines else ""
        raise BadRecordingError(f"{path}: line 1: a TRC file starts with 'PathFileType', got {first!r}")
    if len(lines) <= HEADER_LINES:
        raise BadRecordingError(
            f"{path}: line {len(lines)}: the file ends within the header; a TRC file needs {HEADER_LINES} header lines "
            "and at least one frame"
        )
    header = _header(path, lines)
    rate = parse_number(path, 3, 1, "DataRate", header["DataRate"])
    check_rate(path, "line 3 (DataRate)", rate)
    frames = int(parse_number(path, 3, 1, "NumFrames", header["NumFrames"]))
    markers = int(parse_number(path, 3, 1, "NumMarkers", header["NumMarkers"]))
    if frames < 1 or not 1 <= markers <= MAX_MARKERS:
        raise BadRecordingError(
            f"{path}: line 3: NumFrames {frames} and NumMarkers {markers} must be at least 1, "
            f"NumMarkers at most {MAX_MARKERS}"
        )
    labels = _labels(path, lines[3], markers)
    positions = _frames(path, lines, labels)
    if len(positions) < frames:
        raise BadRecordingError(
            f"{path}: line {len(lines)}: holds {len(positions)} frames, its header says {frames}; is it cut short?"
        )
    return RawRecording(path=path, names=labels, rate=rate, units=header["Units"], up="", positions=positions)


def _header(path: Path, lines: list[str]) -> dict[str, str]:
    header = dict(zip(lines[1].rstrip().split("\t"), lines[2].rstrip().split("\t")))
    for field in ("DataRate", "NumFrames", "NumMarkers", "Units"):
        if not header.get(field, "").strip():
            raise BadRecordingError(f"{path}: line 3: the header field {field} is missing")
    return {field.strip(): text.strip() for field, text in header.items()}


def _labels(path: Path, text: str, markers: int) -> tuple[str, ...]:
    labels = [cell.strip() for cell in text.split("\t")[LEADING_COLUMNS:] if cell.strip()]
    if len(labels) != markers:
        raise BadRecordingError(f"{path}: line 4: names {len(labels)} markers, the header says NumMarkers {markers}")
    if repeated := sorted({label for label in labels if labels.count(label) > 1}):
        raise BadRecordingError(f"{path}: line 4: label {repeated[0]!r} appears more than once")
    return tuple(labels)


def _frames(path: Path, lines: list[str], labels: tuple[str, ...]) -> FloatArray:
    width = LEADING_COLUMNS + 3 * len(labels)
    missing = [float("nan")] * (3 * len(labels))
    rows: list[list[float]] = []
    previous: int | None = None
    for index in range(HEADER_LINES, len(lines)):
        if not lines[index].strip():
            continue
        line = index + 1
        cells = lines[index].split("\t")
        if len(cells) < width or any(cell.strip() for cell in cells[width:]):
            raise BadRecordingError(
                f"{path}: line {line}: has {len(cells)} columns, expected {width}; "
                "is the file cut short, or does a column miss?"
            )
        number = check_frame_number(path, line, cells[0], previous)
        if previous is not None:
            rows.extend([missing] * (number - previous - 1))
        previous = number
        parse_number(path, line, 2, "time", cells[1])
        rows.append(parse_row(path, line, labels, LEADING_COLUMNS + 1, cells[LEADING_COLUMNS:width]))
    if not rows:
        raise BadRecordingError(f"{path}: line {HEADER_LINES + 1}: holds no frames")
    return np.array(rows).reshape(len(rows), len(labels), 3)
