"""From samples of a device to clean marker frames: order, clock, repair, in this sequence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handover_ros.mocap.clock import DeviceClock
from handover_ros.mocap.frames import MarkerFrame
from handover_ros.mocap.repair import MarkerRepair
from handover_ros.mocap.repair_types import RepairSettings
from handover_ros.mocap.sequence import Arrival, FrameSequence
from handover_ros.mocap.sources import MarkerSample

GAP_RESET = 2.0  # [s] after a silence this long nothing is predicted across


@dataclass
class StreamCounters:
    """Frames of a stream that did not come in order.

    Attributes:
        duplicates: Frames that came twice.
        out_of_order: Frames that came late.
        restarts: Times the device counted anew, or a recording started over.
    """

    duplicates: int = 0
    out_of_order: int = 0
    restarts: int = 0


class MarkerPipeline:
    """Cleans one stream of samples.

    Args:
        segments: The segment that carries each of the n markers.
        settings: Gates and times of the repair.
    """

    def __init__(self, segments: tuple[str, ...], settings: RepairSettings | None = None) -> None:
        self.repair = MarkerRepair(segments, settings)
        self.clock = DeviceClock()
        self.sequence = FrameSequence()
        self.counters = StreamCounters()
        self._last_stamp = float("-inf")
        self._no_status = np.zeros(len(segments), dtype=np.uint8)

    def restart(self) -> None:
        """Begin a new stream of the same markers; the counters stay."""
        self.repair.reset()
        self.sequence.restart()
        self.clock.restart()
        self._last_stamp = float("-inf")

    def process(self, sample: MarkerSample) -> MarkerFrame | None:
        """Return the clean frame of a sample, None for a duplicate or a frame that came too late."""
        arrival = self.sequence.classify(sample.device_frame)
        if arrival is Arrival.DUPLICATE:
            self.counters.duplicates += 1
            return None
        if arrival is Arrival.OUT_OF_ORDER:
            self.counters.out_of_order += 1
            return None
        stamp = self.clock.stamp(sample.device_time, sample.reference)
        restarted = sample.restarted or arrival is Arrival.RESTART
        self.counters.restarts += restarted
        if restarted or stamp - self._last_stamp > GAP_RESET:
            self.repair.reset()
        self._last_stamp = stamp
        frame = MarkerFrame(stamp, sample.device_frame, sample.device_time, sample.positions, self._no_status)
        return self.repair.process(frame)

    def report(self) -> dict[str, int | float]:
        """Return all counters by name."""
        repair = self.repair.counters
        return {
            **repair.as_dict(),
            "missing_fraction": repair.missing_fraction,
            "duplicates": self.counters.duplicates,
            "out_of_order": self.counters.out_of_order,
            "restarts": self.counters.restarts,
            "lost_frames": self.sequence.lost,
            "clock_jumps": self.clock.jumps,
            "clock_drift_ppm": self.clock.drift * 1e6,
        }
