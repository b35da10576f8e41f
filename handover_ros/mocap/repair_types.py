"""Settings, counters and the working values of the repair of marker frames."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt

from handover_ros.geometry import FloatArray
from handover_ros.mocap.frames import StatusArray

BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class RepairSettings:
    """Settings of the repair.

    Attributes:
        max_gap: Longest gap that is bridged [s].
        gate: Distance [m] between a prediction and a measurement that needs no excuse.
        max_acceleration: Greatest acceleration of a marker [m/s^2].
        max_speed: Greatest speed of a marker [m/s].
        confirm_frames: Frames for which markers must be steady at a new place to be believed there.
        neighbour_distance: Markers closer than this [m] are watched for swaps.
    """

    max_gap: float = 0.2
    gate: float = 0.025
    max_acceleration: float = 50.0
    max_speed: float = 4.0
    confirm_frames: int = 4
    neighbour_distance: float = 0.15


@dataclass
class RepairCounters:
    """What the repair saw and did, since start.

    Attributes:
        frames: Frames.
        samples: Marker samples (for each frame, the markers seen so far).
        missing: Samples that were not measured.
        bridged: Missing samples that were predicted.
        dropped: Samples that were measured and not believed.
        jumps: Onsets of dropping a marker that was being tracked.
        ghosts: Onsets of dropping a marker that had been missing.
        swaps: Onsets of a swap that was undone.
        relabelled: Samples put back under their label.
        relocations: Markers believed at a new place.
    """

    frames: int = 0
    samples: int = 0
    missing: int = 0
    bridged: int = 0
    dropped: int = 0
    jumps: int = 0
    ghosts: int = 0
    swaps: int = 0
    relabelled: int = 0
    relocations: int = 0

    def as_dict(self) -> dict[str, int]:
        """Return the counters by name."""
        return asdict(self)

    @property
    def missing_fraction(self) -> float:
        """Share of the samples that were not measured, 0 to 1."""
        return self.missing / self.samples if self.samples else 0.0


@dataclass(slots=True, eq=False)
class Step:
    """One frame under repair.

    Attributes:
        stamp: Time of the frame [s].
        elapsed: Time since the frame before [s].
        age: Time since each marker was last believed [s], shape (n,).
        measured: Positions as measured, under their right labels once resolved [m], shape (n, 3).
        finite: Which were measured under their label, shape (n,).
        predicted: Where they were expected [m], shape (n, 3).
        gate: How far from there is believable [m], shape (n,).
        believed: Which positions of ``measured`` are believed, shape (n,).
        status: One MarkerStatus each, shape (n,).
    """

    stamp: float
    elapsed: float
    age: FloatArray
    measured: FloatArray
    finite: BoolArray
    predicted: FloatArray
    gate: FloatArray
    believed: BoolArray
    status: StatusArray
