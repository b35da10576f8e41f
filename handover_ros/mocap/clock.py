"""From the device's clock to ROS time: the offset of least delay, with drift, and clock jumps."""

from __future__ import annotations

from dataclasses import dataclass

STAMP_STEP = 1e-6  # [s] least distance of two stamps
MAX_DRIFT = 500e-6  # [s/s] a worse clock than this is broken


@dataclass(frozen=True)
class ClockSettings:
    """Settings of a device clock.

    Attributes:
        window: Time [s] over which the least delay is looked for.
        buckets: Parts of the window; each keeps its least delay.
        jump: A device clock that is off by more than this [s] against the reference has jumped.
    """

    window: float = 8.0
    buckets: int = 8
    jump: float = 0.1


class DeviceClock:
    """Maps device times to ROS times.

    A frame's arrival is its capture plus a delay that is never negative, so the smallest ``reference - device`` seen
    lately is the best estimate of the offset between the clocks. Drift is the slope of the least delays over the
    window. Stamps increase strictly; a jump of the device clock re-anchors the offset and is counted.

    Attributes:
        jumps: Clock jumps so far.
        drift: Estimated rate of ROS time against the device's, minus 1 [s/s].
    """

    def __init__(self, settings: ClockSettings | None = None) -> None:
        self._settings = settings or ClockSettings()
        self.jumps = 0
        self.restart()

    def restart(self) -> None:
        """Forget both clocks; the count of jumps stays."""
        self.drift = 0.0
        self._last_stamp = float("-inf")
        self._last_device = float("nan")
        self._buckets: list[tuple[float, float]] = []  # (device time, offset) of the least delay in each
        self._bucket_end = float("-inf")
        self._offset = 0.0  # at device time _offset_time
        self._offset_time = 0.0

    def stamp(self, device_time: float, reference: float) -> float:
        """Return the capture time in ROS time [s].

        Args:
            device_time: The device's clock at capture [s].
            reference: ROS time [s] of reception, or the driver's own stamp when it gives one.
        """
        offset = reference - device_time
        if not self._buckets:
            self._anchor(device_time, offset)
        else:
            early = self._offset_at(device_time) - offset
            if device_time < self._last_device - STAMP_STEP or early > self._settings.jump:
                self.jumps += 1
                self._anchor(device_time, offset)
            else:
                self._observe(device_time, offset)
        self._last_device = device_time
        stamp = max(device_time + self._offset_at(device_time), self._last_stamp + STAMP_STEP)
        self._last_stamp = stamp
        return stamp

    def _offset_at(self, device_time: float) -> float:
        return self._offset + self.drift * (device_time - self._offset_time)

    def _anchor(self, device_time: float, offset: float) -> None:
        self.drift = 0.0
        self._buckets = [(device_time, offset)]
        self._bucket_end = device_time + self._settings.window / self._settings.buckets
        self._offset, self._offset_time = offset, device_time

    def _observe(self, device_time: float, offset: float) -> None:
        if device_time >= self._bucket_end:
            self._buckets.append((device_time, offset))
            self._buckets = self._buckets[-self._settings.buckets :]
            self._bucket_end = device_time + self._settings.window / self._settings.buckets
            self._fit()
        elif offset - self._buckets[-1][1] < self.drift * (device_time - self._buckets[-1][0]):
            self._buckets[-1] = (device_time, offset)
        if offset < self._offset_at(device_time):
            self._offset, self._offset_time = offset, device_time

    def _fit(self) -> None:
        """Fit the line below all least delays of the window; the unfinished last bucket does not steer the slope."""
        finished = self._buckets[:-1]
        if len(finished) >= 3:
            mean_time = sum(time for time, _ in finished) / len(finished)
            mean_offset = sum(offset for _, offset in finished) / len(finished)
            spread = sum((time - mean_time) ** 2 for time, _ in finished)
            slope = sum((time - mean_time) * (offset - mean_offset) for time, offset in finished) / spread
            self.drift = min(max(slope, -MAX_DRIFT), MAX_DRIFT)
        reference = self._buckets[-1][0]
        self._offset_time = reference
        self._offset = min(offset + self.drift * (reference - time) for time, offset in self._buckets)
