"""Smooth motion of the simulated person: minimum-jerk paths, way-point paths and standing sway."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from handover_ros.geometry import FloatArray
from handover_ros.sim.person_spec import PersonSpec

SWAY_WAVES = 6
SWAY_LONGEST_PERIOD = 14.0


def minimum_jerk(fraction: float) -> float:
    """Return the share of a minimum-jerk movement done at a share of its time (Flash and Hogan 1985)."""
    s = min(max(fraction, 0.0), 1.0)
    return s * s * s * (10.0 + s * (6.0 * s - 15.0))


class Movement:
    """Movement from a moving state to rest: quintic, minimum jerk when it starts at rest.

    Attributes:
        end_time: When it rests [s].
        target: Where it rests.
    """

    def __init__(
        self, time: float, duration: float, start: FloatArray, velocity: FloatArray, target: FloatArray
    ) -> None:
        self.start_time = time
        self.end_time = time + duration
        self.target = target
        change, drift = target - start, velocity * duration
        # start + drift s + c3 s^3 + c4 s^4 + c5 s^5 with the end at rest; no acceleration at either end.
        self._coefficients = (
            start,
            drift,
            10.0 * change - 6.0 * drift,
            8.0 * drift - 15.0 * change,
            6.0 * change - 3.0 * drift,
        )

    def position(self, time: float) -> FloatArray:
        """Return where it is at ``time`` [s]."""
        s = (time - self.start_time) / (self.end_time - self.start_time)
        if s >= 1.0:
            return self.target
        c0, c1, c3, c4, c5 = self._coefficients
        s = max(s, 0.0)
        return c0 + s * (c1 + s * s * (c3 + s * (c4 + s * c5)))


class WayPointPath:
    """A curve through way points, run once from rest to rest with minimum-jerk timing.

    Attributes:
        end_time: When it rests [s].
        target: Last way point.
    """

    def __init__(self, time: float, duration: float, points: FloatArray, lower: FloatArray, upper: FloatArray) -> None:
        self.start_time = time
        self.end_time = time + duration
        self.target = points[-1]
        self._lower, self._upper = lower, upper
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        knots = np.concatenate([[0.0], np.cumsum(np.maximum(steps, 1e-3))])
        self._length = float(knots[-1])
        self._knots = knots
        # Coefficients of scipy's spline, evaluated by hand: a call of the spline object costs 20 us.
        self._coefficients = CubicSpline(knots, points, bc_type="natural").c if len(points) > 2 else None
        self._ends = (points[0], points[-1])

    def position(self, time: float) -> FloatArray:
        """Return where it is at ``time`` [s]."""
        share = minimum_jerk((time - self.start_time) / (self.end_time - self.start_time))
        if self._coefficients is None:
            first, last = self._ends
            return first + share * (last - first)
        along = share * self._length
        index = min(int(np.searchsorted(self._knots, along, side="right")) - 1, len(self._knots) - 2)
        x = along - self._knots[index]
        c3, c2, c1, c0 = self._coefficients[:, index]
        # np.maximum and np.minimum cost half of np.clip.
        return np.minimum(np.maximum(c0 + x * (c1 + x * (c2 + x * c3)), self._lower), self._upper)


class MovementSequence:
    """Minimum-jerk movements through timed postures, at rest at each of them.

    Attributes:
        end_time: When the last one ends [s].
        target: Last posture.
    """

    def __init__(self, time: float, times: FloatArray, postures: FloatArray) -> None:
        self._times = time + times
        self._postures = postures
        self.start_time = time
        self.end_time = float(self._times[-1])
        self.target = postures[-1]

    def position(self, time: float) -> FloatArray:
        """Return where it is at ``time`` [s]."""
        if time >= self.end_time:
            return self.target
        index = max(int(np.searchsorted(self._times, time, side="right")) - 1, 0)
        begin, end = self._times[index], self._times[index + 1]
        share = minimum_jerk((time - begin) / (end - begin))
        return self._postures[index] + share * (self._postures[index + 1] - self._postures[index])


class Sway:
    """Standing sway of the torso coordinates: a few sine waves of random phase, never beyond the amplitude."""

    def __init__(self, person: PersonSpec, rng: np.random.Generator) -> None:
        shortest = person.sway.period
        periods = np.exp(rng.uniform(np.log(shortest), np.log(SWAY_LONGEST_PERIOD), size=(6, SWAY_WAVES)))
        # The waves' amplitudes fall with their frequency, as sway does, and add up to the amplitude at most.
        share = periods / periods.sum(axis=1, keepdims=True)
        p, a = person.sway.position, person.sway.angle
        self._amplitude = share * np.array([p, p, 0.15 * p, a, a, a])[:, None]
        self._frequency = 2.0 * np.pi / periods
        self._phase = rng.uniform(0.0, 2.0 * np.pi, size=(6, SWAY_WAVES))

    def offset(self, time: float) -> FloatArray:
        """Return the sway of the torso coordinates (6,) [m], [rad] at ``time`` [s]."""
        return (self._amplitude * np.sin(self._frequency * time + self._phase)).sum(axis=1)


def blend_poses(poses: list[FloatArray], counts: list[int]) -> FloatArray:
    """Return a path of poses (k, 4, 4) through key poses, with so many steps between each two of them."""
    path = [poses[0][None]]
    for (first, second), count in zip(pairwise(poses), counts, strict=True):
        share = np.linspace(0.0, 1.0, count + 1)[1:]
        part = np.tile(np.eye(4), (count, 1, 1))
        turn = Slerp([0.0, 1.0], Rotation.from_matrix(np.stack([first[:3, :3], second[:3, :3]])))
        part[:, :3, :3] = turn(share).as_matrix()
        part[:, :3, 3] = first[:3, 3] + share[:, None] * (second[:3, 3] - first[:3, 3])
        path.append(part)
    return np.concatenate(path)
