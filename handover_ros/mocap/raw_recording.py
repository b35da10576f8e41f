"""What the file readers hand over: labels and numbers as the file has them, before units, axes and label mapping."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from handover_ros.errors import BadRecordingError
from handover_ros.geometry import FloatArray

MAX_BYTES = 2_000_000_000
MAX_SKIPPED_FRAMES = 100_000


@dataclass(frozen=True, eq=False)
class RawRecording:
    """Marker positions as a file has them.

    Attributes:
        path: The file.
        names: The m labels, as written, e.g. ``SUBJECT:LABEL``.
        rate: Frames per second [Hz].
        units: Unit of length, as written; empty when the file does not say.
        up: "z_up" or "y_up" when the file says so, else empty.
        positions: Shape (frames, m, 3), in ``units`` and source axes, NaN where missing.
    """

    path: Path
    names: tuple[str, ...]
    rate: float
    units: str
    up: str
    positions: FloatArray


def read_text(path: Path) -> list[str]:
    """Return the lines of a text recording; a byte-order mark is skipped.

    Raises:
        BadRecordingError: The file cannot be read, is far too large or is no UTF-8 text.
    """
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise BadRecordingError(f"{path}: {size} bytes, at most {MAX_BYTES} are read")
        return path.read_bytes().decode("utf-8-sig").splitlines()
    except OSError as error:
        raise BadRecordingError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise BadRecordingError(f"{path}: is not text: byte {error.start} is not UTF-8") from None


def parse_number(path: Path, line: int, column: int, field: str, text: str) -> float:
    """Return a finite number of a text recording; ``line`` and ``column`` count from 1.

    Raises:
        BadRecordingError: It is no number, or NaN or infinity spelled out.
    """
    try:
        value = float(text)
    except ValueError:
        raise BadRecordingError(
            f"{path}: line {line}, column {column} ({field}): {text[:30]!r} is not a number"
        ) from None
    if not math.isfinite(value):
        raise BadRecordingError(
            f"{path}: line {line}, column {column} ({field}): {text.strip()!r} is not a finite number; "
            "leave the cell empty where a marker is missing"
        )
    return value


def parse_row(path: Path, line: int, labels: tuple[str, ...], first_column: int, cells: list[str]) -> list[float]:
    """Return the 3m coordinates of one line, NaN for empty cells.

    Args:
        path: The file, for the message.
        line: Line number from 1.
        labels: The m labels.
        first_column: Column (from 1) of the first cell.
        cells: The 3m cells.

    Raises:
        BadRecordingError: A cell is not a finite number.
    """
    try:
        values = [float(cell) if cell else math.nan for cell in cells]
        total = sum(value for value, cell in zip(values, cells) if cell)
        if math.isfinite(total):
            return values
    except ValueError:
        pass
    values = []
    for index, cell in enumerate(cells):
        if not cell.strip():
            values.append(math.nan)
            continue
        field = f"{labels[index // 3]} {'XYZ'[index % 3]}"
        values.append(parse_number(path, line, first_column + index, field, cell))
    return values


def check_frame_number(path: Path, line: int, text: str, previous: int | None) -> int:
    """Return the frame number of a line.

    Raises:
        BadRecordingError: It is no whole number, does not follow the one before, or skips absurdly many.
    """
    value = parse_number(path, line, 1, "frame number", text)
    number = int(value)
    if number != value:
        raise BadRecordingError(f"{path}: line {line}, column 1 (frame number): {text!r} is not a whole number")
    if previous is not None and not 1 <= number - previous <= MAX_SKIPPED_FRAMES:
        raise BadRecordingError(
            f"{path}: line {line}, column 1 (frame number): {number} does not follow {previous}; frames must increase"
        )
    return number
