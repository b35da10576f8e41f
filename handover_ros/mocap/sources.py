"""Sources of marker samples: one small protocol, and the recording that plays itself back.

A live system is connected by writing one more class with these members.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from handover_ros.errors import BadRequestError
from handover_ros.geometry import FloatArray
from handover_ros.mocap.frames import Recording

LOOPS = ("none", "restart", "ping_pong")


@dataclass(frozen=True, eq=False)
class MarkerSample:
    """What a device delivers for one frame.

    Attributes:
        device_frame: Frame number, as the device counts.
        device_time: The device's clock at capture [s].
        reference: ROS time [s] the driver gives the frame, the time of reception where it gives none.
        positions: World positions [m], shape (n, 3), NaN where not measured.
        restarted: The motion does not continue the frame before: nothing may be predicted across.
    """

    device_frame: int
    device_time: float
    reference: float
    positions: FloatArray
    restarted: bool = False


class MarkerSource(Protocol):
    """Where marker samples come from."""

    @property
    def names(self) -> tuple[str, ...]:
        """The n marker names, in the order of the positions."""

    @property
    def rate(self) -> float:
        """Nominal frames per second [Hz] of ROS time."""

    def poll(self, now: float) -> MarkerSample | None:
        """Return the next sample that is due at ROS time ``now`` [s], or None."""


class RecordingSource:
    """Plays a recording back, frame by frame, deterministically: the same times give the same samples.

    Args:
        recording: What is played.
        pace: Recorded seconds per second of ROS time.
        start: ROS time [s] of the first frame.
        loop: "none" ends after the last frame, "restart" jumps back to the first, "ping_pong" runs to and fro.

    Raises:
        BadRequestError: The pace is not positive or the loop is none of the three.
    """

    def __init__(self, recording: Recording, pace: float = 1.0, start: float = 0.0, loop: str = "none") -> None:
        if not 0.01 <= pace <= 100.0:
            raise BadRequestError(f"pace: must lie within 0.01 to 100, got {pace:g}")
        if loop not in LOOPS:
            raise BadRequestError(f"loop: {loop!r} is none of {', '.join(LOOPS)}")
        self._recording = recording
        self._loop = loop
        self._start = start
        self._rate = recording.rate * pace
        self._next = 0

    @property
    def names(self) -> tuple[str, ...]:
        """The marker names."""
        return self._recording.names

    @property
    def rate(self) -> float:
        """Frames per second of ROS time [Hz]."""
        return self._rate

    @property
    def delivered(self) -> int:
        """Frames delivered so far."""
        return self._next

    @property
    def finished(self) -> bool:
        """Whether the last frame was delivered; never with a loop."""
        return self._loop == "none" and self._next >= self._recording.frames

    def poll(self, now: float) -> MarkerSample | None:
        """Return the next sample if its time has come, else None; call again until None to catch up."""
        due = self._start + self._next / self._rate
        if self.finished or now < due:
            return None
        index = self._next
        row, restarted = self._row(index)
        self._next += 1
        return MarkerSample(index, index / self._rate, due, self._recording.positions[row].copy(), restarted)

    def _row(self, index: int) -> tuple[int, bool]:
        frames = self._recording.frames
        if self._loop == "ping_pong" and frames > 1:
            phase = index % (2 * frames - 2)
            return (phase if phase < frames else 2 * frames - 2 - phase), False
        return index % frames, index >= frames and index % frames == 0
