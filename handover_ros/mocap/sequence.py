"""Order of a live stream by the device's frame numbers: duplicates, late frames, a restarted device."""

from __future__ import annotations

from enum import Enum

RESTART_AFTER = 3  # consecutive frames that continue below the last number: the device counts anew


class Arrival(Enum):
    """What a frame is in the order of its stream."""

    NEXT = "next"
    DUPLICATE = "duplicate"
    OUT_OF_ORDER = "out of order"
    RESTART = "restart"


class FrameSequence:
    """Classifies frames by their device frame number.

    Attributes:
        lost: Frame numbers that never came.
    """

    def __init__(self) -> None:
        self.lost = 0
        self.restart()

    def restart(self) -> None:
        """Forget the last frame; the count of lost frames stays."""
        self._last: int | None = None
        self._low: int | None = None
        self._low_count = 0

    def classify(self, device_frame: int) -> Arrival:
        """Return what the frame is; the caller drops duplicates and frames out of order."""
        last = self._last
        if last is None or device_frame > last:
            if last is not None:
                self.lost += device_frame - last - 1
            self._last = device_frame
            self._low_count = 0
            return Arrival.NEXT
        if device_frame == last:
            return Arrival.DUPLICATE
        follows = self._low is not None and self._low < device_frame
        self._low_count = self._low_count + 1 if follows else 1
        self._low = device_frame
        if self._low_count < RESTART_AFTER:
            return Arrival.OUT_OF_ORDER
        self._last, self._low, self._low_count = device_frame, None, 0
        return Arrival.RESTART
