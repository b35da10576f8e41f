"""Marker frames (one sample of all labelled marker positions) and recordings of them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

import numpy as np
import numpy.typing as npt

from handover_ros.errors import BadRecordingError, BadRequestError
from handover_ros.geometry import FloatArray

StatusArray = npt.NDArray[np.uint8]

_ONES = np.ones(3)


class MarkerStatus(IntEnum):
    """What one position of a marker frame is; mirror of the constants of ``handover_msgs/MarkerFrame``."""

    MEASURED = 0
    MISSING = 1
    BRIDGED = 2
    RELABELLED = 3
    DROPPED = 4


@dataclass(frozen=True, eq=False)
class MarkerFrame:
    """One sample of all markers of a marker set.

    Attributes:
        stamp: ROS time of capture [s].
        device_frame: Frame number of the device, as it counts.
        device_time: The device's own clock at capture [s].
        positions: Positions in the world [m], shape (n, 3); a row of NaN is a marker that was not measured.
        status: One :class:`MarkerStatus` per marker, shape (n,).
    """

    stamp: float
    device_frame: int
    device_time: float
    positions: FloatArray
    status: StatusArray


@dataclass(frozen=True, eq=False)
class Recording:
    """Labelled marker positions over time, in metres, z up.

    Attributes:
        names: The n marker names.
        segments: The body segment that carries each marker, n names.
        rate: Frames per second [Hz].
        positions: Positions [m], shape (frames, n, 3), NaN where a marker is missing.
        path: The file it was read from.
    """

    names: tuple[str, ...]
    segments: tuple[str, ...]
    rate: float
    positions: FloatArray
    path: Path

    def __post_init__(self) -> None:
        """Refuse what no consumer could use.

        Raises:
            BadRecordingError: No frames, a rate that is not positive, or shapes that do not fit together.
        """
        frames, n = self.positions.shape[0], len(self.names)
        if self.positions.shape != (frames, n, 3) or len(self.segments) != n:
            raise BadRecordingError(
                f"{self.path}: positions have shape {self.positions.shape}, expected (frames, {n}, 3)"
            )
        if frames == 0:
            raise BadRecordingError(f"{self.path}: holds no frames")
        check_rate(self.path, "rate", self.rate)

    @property
    def frames(self) -> int:
        """Number of frames."""
        return int(self.positions.shape[0])

    @property
    def missing_samples(self) -> int:
        """Number of marker samples that are missing, over all frames."""
        return int(np.isnan(self.positions[:, :, 0]).sum())


def check_rate(path: Path, field: str, rate: float) -> float:
    """Return a frame rate [Hz] as it is, if it is one.

    Raises:
        BadRecordingError: It is not within 1 to 10000 Hz.
    """
    if not 1.0 <= rate <= 10000.0:
        raise BadRecordingError(f"{path}: {field}: a frame rate lies within 1 to 10000 Hz, got {rate:g}")
    return float(rate)


def measured_mask(positions: FloatArray) -> npt.NDArray[np.bool_]:
    """Return which rows of (n, 3) positions are finite, shape (n,)."""
    return np.isfinite(positions @ _ONES)


def positions_from_flat(values: FloatArray, markers: int) -> FloatArray:
    """Return a live sample (3n,) as positions (n, 3) [m]; what is infinite or exactly the origin counts as missing.

    Raises:
        BadRequestError: The sample does not hold three numbers for each marker.
    """
    if values.size != 3 * markers:
        raise BadRequestError(
            f"positions: {values.size} numbers, expected {3 * markers} (3 for each of {markers} markers)"
        )
    positions = np.array(values, dtype=float).reshape(markers, 3)
    absent = ~np.isfinite(positions @ _ONES) | ~positions.any(axis=1)
    if absent.any():
        positions[absent] = np.nan
    return positions
