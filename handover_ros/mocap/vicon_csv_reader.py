"""Reads the "Trajectories" section of a Vicon Nexus CSV export.

Line by line: the section's name, the rate [Hz], the labels (one every third column), ``Frame,Sub Frame,X,Y,Z,...``,
the units, then one line a frame until an empty line or the end. An empty cell is a missing marker.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from handover_ros.errors import BadRecordingError
from handover_ros.geometry import FloatArray
from handover_ros.mocap.frames import check_rate
from handover_ros.mocap.raw_recording import RawRecording, check_frame_number, parse_number, parse_row, read_text

SECTION = "Trajectories"
HEADER_LINES = 5
LEADING_COLUMNS = 2


def read_vicon_csv(path: Path) -> RawRecording:
    """Return the trajectories of a Vicon CSV file.

    Raises:
        BadRecordingError: The file is cut short, misses a column or has a cell that is no number; the message names
            line and column.
    """
    lines = read_text(path)
    start = next((index for index, text in enumerate(lines) if text.split(",")[0].strip() == SECTION), None)
    if start is None:
        first = lines[0][:40] if lines else ""
        raise BadRecordingError(f"{path}: line 1: no section {SECTION!r} in this CSV file (it starts with {first!r})")
    if len(lines) < start + HEADER_LINES + 1:
        raise BadRecordingError(
            f"{path}: line {len(lines)}: the file ends within the header; the {SECTION} section needs "
            f"{HEADER_LINES} header lines and at least one frame"
        )
    rate_line = start + 2
    rate = parse_number(path, rate_line, 1, "rate", lines[start + 1].split(",")[0])
    check_rate(path, f"line {rate_line}, column 1 (rate)", rate)
    labels = _labels(path, start + 3, lines[start + 2].split(","))
    _check_axes(path, start + 4, labels, lines[start + 3].split(","))
    units = _units(path, start + 5, labels, lines[start + 4].split(","))
    positions = _frames(path, lines, start + HEADER_LINES, labels)
    return RawRecording(path=path, names=labels, rate=rate, units=units, up="", positions=positions)


def _labels(path: Path, line: int, cells: list[str]) -> tuple[str, ...]:
    while cells and not cells[-1].strip():
        cells = cells[:-1]
    labels = []
    for column, cell in enumerate(cells):
        expected = column >= LEADING_COLUMNS and (column - LEADING_COLUMNS) % 3 == 0
        if bool(cell.strip()) != expected:
            what = "a label is missing" if expected else f"unexpected label {cell.strip()!r}"
            raise BadRecordingError(
                f"{path}: line {line}, column {column + 1}: {what}; labels stand in every third column from 3 on: "
                "is a column missing?"
            )
        if expected:
            labels.append(cell.strip())
    if not labels:
        raise BadRecordingError(f"{path}: line {line}: holds no marker labels")
    if repeated := sorted({label for label in labels if labels.count(label) > 1}):
        raise BadRecordingError(f"{path}: line {line}: label {repeated[0]!r} appears more than once")
    return tuple(labels)


def _check_axes(path: Path, line: int, labels: tuple[str, ...], cells: list[str]) -> None:
    if [cell.strip() for cell in cells[:LEADING_COLUMNS]] != ["Frame", "Sub Frame"]:
        raise BadRecordingError(
            f"{path}: line {line}, column 1: expected 'Frame,Sub Frame', got {','.join(cells[:2])!r}"
        )
    for index in range(3 * len(labels)):
        column = LEADING_COLUMNS + index
        got = cells[column].strip() if column < len(cells) else ""
        if got.upper() != "XYZ"[index % 3]:
            raise BadRecordingError(
                f"{path}: line {line}, column {column + 1}: expected {'XYZ'[index % 3]} of marker "
                f"{labels[index // 3]!r}, got {got or 'nothing'!r}; is a column missing?"
            )


def _units(path: Path, line: int, labels: tuple[str, ...], cells: list[str]) -> str:
    units = {cell.strip() for cell in cells[LEADING_COLUMNS : LEADING_COLUMNS + 3 * len(labels)]}
    if len(units) != 1:
        raise BadRecordingError(f"{path}: line {line}: all columns must have one unit, got {sorted(units)}")
    return units.pop()


def _frames(path: Path, lines: list[str], start: int, labels: tuple[str, ...]) -> FloatArray:
    width = LEADING_COLUMNS + 3 * len(labels)
    rows: list[list[float]] = []
    missing = [float("nan")] * (3 * len(labels))
    previous: int | None = None
    for index in range(start, len(lines)):
        text = lines[index]
        if not text.strip(", \t"):
            break
        line = index + 1
        cells = text.split(",")
        if len(cells) < width or any(cell.strip() for cell in cells[width:]):
            raise BadRecordingError(
                f"{path}: line {line}: has {len(cells)} columns, expected {width}; "
                "is the file cut short, or does a column miss?"
            )
        number = check_frame_number(path, line, cells[0], previous)
        if previous is not None:
            rows.extend([missing] * (number - previous - 1))
        previous = number
        rows.append(parse_row(path, line, labels, LEADING_COLUMNS + 1, cells[LEADING_COLUMNS:width]))
    if not rows:
        raise BadRecordingError(f"{path}: line {start + 1}: the {SECTION} section holds no frames")
    return np.array(rows).reshape(len(rows), len(labels), 3)
