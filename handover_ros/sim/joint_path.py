"""A commanded joint motion as a piecewise cubic Hermite path in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handover_ros.geometry import FloatArray


@dataclass(frozen=True, eq=False)
class JointPath:
    """Positions and velocities of n joints over time, cubic between knots, standing still after the last one.

    Attributes:
        times: Knots [s] on the simulation's clock, increasing. Shape (k,), k >= 1.
        positions: At the knots [rad]. Shape (k, n).
        velocities: At the knots [rad/s]. Shape (k, n).
    """

    times: FloatArray
    positions: FloatArray
    velocities: FloatArray

    @property
    def end(self) -> float:
        """Time [s] of the last knot."""
        return float(self.times[-1])

    def sample(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Return positions (n,) and velocities (n,) at a time [s]."""
        if time >= self.times[-1]:
            return self.positions[-1], np.zeros_like(self.positions[-1])
        index = max(int(self.times.searchsorted(time, side="right")) - 1, 0)
        length = self.times[index + 1] - self.times[index]
        s = min(max((time - self.times[index]) / length, 0.0), 1.0)
        start, end = self.positions[index], self.positions[index + 1]
        start_slope, end_slope = length * self.velocities[index], length * self.velocities[index + 1]
        step = end - start
        # p(s) = start + start_slope s + square s^2 + cube s^3 on s in [0, 1]
        square = 3.0 * step - 2.0 * start_slope - end_slope
        cube = start_slope + end_slope - 2.0 * step
        position = start + s * (start_slope + s * (square + s * cube))
        velocity = (start_slope + s * (2.0 * square + 3.0 * s * cube)) / length
        return position, velocity

    def fastest(self) -> FloatArray:
        """Return the greatest speed [rad/s] of each joint between the knots. Shape (n,)."""
        if len(self.times) < 2:
            return np.zeros(self.positions.shape[1])
        length = np.diff(self.times)[:, None]
        start_slope, end_slope = length * self.velocities[:-1], length * self.velocities[1:]
        step = np.diff(self.positions, axis=0)
        square = 3.0 * step - 2.0 * start_slope - end_slope
        cube = start_slope + end_slope - 2.0 * step
        # The velocity is a parabola in s: its extremes are the ends and, if it is between them, the vertex.
        vertex = np.clip(np.divide(-square, 3.0 * cube, out=np.zeros_like(cube), where=np.abs(cube) > 1e-12), 0.0, 1.0)
        middle = start_slope + vertex * (2.0 * square + 3.0 * vertex * cube)
        speeds = np.abs(np.stack([start_slope / length, end_slope / length, middle / length]))
        return np.asarray(speeds.max(axis=(0, 1)))

    @staticmethod
    def still(time: float, positions: FloatArray) -> JointPath:
        """Return the path that stays where it is."""
        return JointPath(np.array([time]), positions[None].copy(), np.zeros((1, len(positions))))

    @staticmethod
    def stopping(time: float, positions: FloatArray, velocities: FloatArray, deceleration: FloatArray) -> JointPath:
        """Return the path that comes to rest with constant deceleration, all joints at the same moment.

        Args:
            time: Start [s].
            positions: At the start [rad]. Shape (n,).
            velocities: At the start [rad/s]. Shape (n,).
            deceleration: Greatest of each joint [rad/s2], > 0. Shape (n,).
        """
        duration = float(np.max(np.abs(velocities) / deceleration))
        if duration < 1e-6:
            return JointPath.still(time, positions)
        return JointPath(
            np.array([time, time + duration]),
            np.stack([positions, positions + 0.5 * duration * velocities]),
            np.stack([velocities, np.zeros_like(velocities)]),
        )
