"""Disturbances of the simulated motion capture, switched on for a while and the same for the same seed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from handover_ros.errors import BadRequestError, UnknownNameError
from handover_ros.geometry import FloatArray

NO_FAULT = "none"
FAULT_KINDS = (NO_FAULT, "label_swap", "ghost", "camera_drop", "clock_jump", "occlusion", "freeze")
LONGEST_CLOCK_JUMP = 1e6
MEAN_GAP = 0.15
GHOST_DISTANCE = (0.15, 0.45)

BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Fault:
    """One disturbance.

    Attributes:
        kind: One of ``FAULT_KINDS``.
        magnitude: camera_drop: camera index; clock_jump: [s]; occlusion: fraction of samples; others unused.
        end_time: When it is over [s]; infinite: when it is switched off.
        markers: Markers it concerns: label_swap two, ghost one, others none.
        offset: ghost: from where the marker is at first to the ghost [m], shape (3,).
    """

    kind: str
    magnitude: float
    end_time: float
    markers: tuple[int, ...]
    offset: FloatArray


class Faults:
    """The disturbances that are on; at most one of each kind.

    Args:
        marker_count: Number of markers of the system.
        camera_count: Number of cameras of the system.
        seed: Same seed, same markers and same offsets.
    """

    def __init__(self, marker_count: int, camera_count: int, seed: int = 0) -> None:
        self._marker_count = marker_count
        self._camera_count = camera_count
        self._rng = np.random.default_rng([seed, 7])
        self._faults: dict[str, Fault] = {}

    def set(self, kind: str, time: float, magnitude: float = 0.0, duration: float = 0.0) -> None:
        """Switch a disturbance on, or all of them off with ``none``.

        Args:
            kind: One of ``FAULT_KINDS``.
            time: Now [s].
            magnitude: See ``Fault``.
            duration: How long [s]; 0: until ``none``.

        Raises:
            UnknownNameError: There is no such kind.
            BadRequestError: Magnitude or duration are out of range.
        """
        if kind not in FAULT_KINDS:
            raise UnknownNameError("fault", kind, FAULT_KINDS)
        if not (math.isfinite(duration) and duration >= 0.0):
            raise BadRequestError(f"duration {duration:g} s of a fault must be a finite number >= 0")
        self._check_magnitude(kind, magnitude)
        if kind == NO_FAULT:
            self._faults.clear()
            return
        count = {"label_swap": 2, "ghost": 1}.get(kind, 0)
        if count > self._marker_count:
            raise BadRequestError(f"{kind} needs {count} markers, the system has {self._marker_count}")
        markers = tuple(int(i) for i in self._rng.choice(self._marker_count, size=count, replace=False))
        direction = self._rng.normal(size=3)
        offset = direction / np.linalg.norm(direction) * self._rng.uniform(*GHOST_DISTANCE)
        self._faults[kind] = Fault(kind, magnitude, time + duration if duration else math.inf, markers, offset)

    def _check_magnitude(self, kind: str, magnitude: float) -> None:
        """Refuse a magnitude that the kind cannot have."""
        if kind == "camera_drop" and magnitude not in range(self._camera_count):
            raise BadRequestError(
                f"camera_drop: magnitude {magnitude:g} must be a camera index, 0 to {self._camera_count - 1}"
            )
        if kind == "occlusion" and not 0.0 <= magnitude <= 1.0:
            raise BadRequestError(f"occlusion: magnitude {magnitude:g} must be a fraction from 0 to 1")
        if kind == "clock_jump" and not abs(magnitude) <= LONGEST_CLOCK_JUMP:
            raise BadRequestError(
                f"clock_jump: magnitude {magnitude:g} s must be finite, at most {LONGEST_CLOCK_JUMP:g}"
            )

    def active(self, kind: str, time: float) -> Fault | None:
        """Return the disturbance of a kind if it is on at ``time`` [s]."""
        fault = self._faults.get(kind)
        if fault is None:
            return None
        if time >= fault.end_time:
            del self._faults[kind]
            return None
        return fault

    def kinds(self, time: float) -> tuple[str, ...]:
        """Return the kinds that are on at ``time`` [s]."""
        return tuple(kind for kind in FAULT_KINDS if self.active(kind, time) is not None)


class RandomGaps:
    """Markers that vanish at random, each for a while: a two-state Markov chain a marker.

    Args:
        count: Number of markers.
        rng: Source of the gaps.
    """

    def __init__(self, count: int, rng: np.random.Generator) -> None:
        self._hidden = np.zeros(count, dtype=bool)
        self._rng = rng
        self._fraction = 0.0

    def step(self, fraction: float, interval: float) -> BoolArray:
        """Return which markers are hidden (n,) in the next frame.

        Args:
            fraction: Share of samples to be hidden in the long run, 0 to 1; gaps last ``MEAN_GAP`` [s] on average.
            interval: Time since the last frame [s].
        """
        draw = self._rng.random(len(self._hidden))
        if fraction <= 0.0 or fraction >= 1.0:
            self._hidden = np.full(len(self._hidden), fraction >= 1.0)
        elif fraction != self._fraction:
            self._hidden = draw < fraction
        else:
            leave = min(interval / MEAN_GAP, 1.0)
            enter = leave * fraction / (1.0 - fraction)
            if enter > 1.0:
                leave, enter = leave / enter, 1.0
            self._hidden = np.where(self._hidden, draw >= leave, draw < enter)
        self._fraction = fraction
        return self._hidden
