"""Timed joint trajectories: as fast as velocity and acceleration limits allow along a path with rounded corners.

The timing is TOPP-RA: H. Pham, Q.-C. Pham, "A new approach to time-optimal path parameterization based on reachability
analysis", IEEE T-RO 34(3), 2018.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
import toppra
from toppra.algorithm import TOPPRA
from toppra.constraint import DiscretizationType, JointAccelerationConstraint, JointVelocityConstraint

from handover_ros.errors import BadRequestError, InfeasibleError
from handover_ros.geometry import FloatArray

logging.getLogger("toppra").setLevel(logging.ERROR)

LIMIT_SHARE = 0.95  # of the limits is used; the rest is for the discretisation
GRID_STEP = 0.06  # [rad] of path length between grid points
BLEND_POINTS = 10  # grid intervals in a rounded corner
SHORTEST_PIECE = 1e-5  # [rad] straight pieces between two corners that are shorter are left out
ON_BORDER = 1e-9  # [rad] of path length
SAMPLES_BETWEEN = 3  # knots at which the limits are checked in the end
STILL = 1e-6  # [rad] paths shorter than this do not move


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A timed joint motion that starts and ends at rest.

    Attributes:
        times: Times of the knots [s], from 0, increasing. Shape (k,).
        positions: [rad]. Shape (k, n).
        velocities: [rad/s]. Shape (k, n).
        accelerations: [rad/s2] just after the knot. Shape (k, n).
    """

    times: FloatArray
    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return float(self.times[-1])

    def sample(self, t: float | FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return positions, velocities and accelerations at times [s], each (..., n); before and after: at rest.

        Between knots: the cubic with their positions and velocities.
        """
        times = np.clip(np.asarray(t, dtype=float), 0.0, self.duration)
        if len(self.times) == 1:
            still = np.zeros((*times.shape, self.positions.shape[1]))
            return still + self.positions[0], still, still.copy()
        i = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2)
        step = (self.times[i + 1] - self.times[i])[..., None]
        s = (times - self.times[i])[..., None] / step
        p0, p1 = self.positions[i], self.positions[i + 1]
        m0, m1 = self.velocities[i] * step, self.velocities[i + 1] * step
        a, b = 2.0 * p0 - 2.0 * p1 + m0 + m1, -3.0 * p0 + 3.0 * p1 - 2.0 * m0 - m1
        position = ((a * s + b) * s + m0) * s + p0
        velocity = ((3.0 * a * s + 2.0 * b) * s + m0) / step
        return position, velocity, (6.0 * a * s + 2.0 * b) / step**2

    def reversed(self) -> Trajectory:
        """Return the same motion backwards."""
        return Trajectory(
            self.duration - self.times[::-1],
            self.positions[::-1].copy(),
            -self.velocities[::-1],
            np.vstack([self.accelerations[-2::-1], self.accelerations[-1:]]),
        )


def parameterise(path: FloatArray, velocity: FloatArray, acceleration: FloatArray, blend: float = 0.0) -> Trajectory:
    """Return the fastest trajectory along a path within velocity and acceleration limits, from rest to rest.

    Args:
        path: Waypoints [rad], joined by straight lines. Shape (k, n), k >= 1.
        velocity: Limits [rad/s]. Shape (n,).
        acceleration: Limits [rad/s2]. Shape (n,).
        blend: Largest distance [rad] of the rounded path from a corner; 0: the motion stops at each waypoint.

    Raises:
        BadRequestError: Not finite, wrong shapes or limits that are not positive.
        InfeasibleError: No timing was found.
    """
    waypoints = np.atleast_2d(np.asarray(path, dtype=float))
    if not np.all(np.isfinite(waypoints)):
        raise BadRequestError("a path must be finite")
    for what, limit in (("velocity", velocity), ("acceleration", acceleration)):
        if np.shape(limit) != waypoints.shape[1:] or not np.all(np.asarray(limit) > 0):
            raise BadRequestError(f"{what} limits must be {waypoints.shape[1]} positive numbers, got {np.array(limit)}")
    moved = np.concatenate([[True], np.max(np.abs(np.diff(waypoints, axis=0)), axis=1) > STILL])
    waypoints = waypoints[moved]
    if len(waypoints) == 1:
        return Trajectory(np.zeros(1), waypoints, np.zeros_like(waypoints), np.zeros_like(waypoints))
    if blend > 0.0:
        return _timed(_RoundedPath(waypoints, blend), velocity, acceleration)
    return _joined(
        [_timed(_RoundedPath(waypoints[i : i + 2], 1.0), velocity, acceleration) for i in range(len(waypoints) - 1)]
    )


class _RoundedPath(toppra.interpolator.AbstractGeometricPath):
    """Straight lines whose corners are replaced by parabolas, by path length as far as the corners; C1."""

    def __init__(self, waypoints: FloatArray, blend: float) -> None:
        offsets = np.diff(waypoints, axis=0)
        lengths = np.linalg.norm(offsets, axis=1)
        directions = offsets / lengths[:, None]
        turns = np.linalg.norm(np.diff(directions, axis=0), axis=1)
        # A parabola over half-width d keeps within d |u2 - u1| / 4 of its corner.
        widths = np.minimum(4.0 * blend / np.maximum(turns, 1e-9), 0.5 * np.minimum(lengths[:-1], lengths[1:]))
        # Pieces: start of parameter, position, direction, second derivative.
        starts, positions, slopes, bends, self.gridpoints = (
            [0.0],
            [waypoints[0]],
            [directions[0]],
            [0 * offsets[0]],
            [0.0],
        )
        s = 0.0
        before = 0.0
        for i, direction in enumerate(directions):
            after = widths[i] if i < len(widths) else 0.0
            straight = lengths[i] - before - after
            if straight > SHORTEST_PIECE:
                self._grid(s, straight, max(2, int(np.ceil(straight / GRID_STEP))))
            s += max(straight, 0.0)
            if i < len(widths):
                starts.append(s)
                positions.append(waypoints[i + 1] - after * direction)
                slopes.append(direction)
                bends.append((directions[i + 1] - direction) / (2.0 * after))
                self._grid(s, 2.0 * after, BLEND_POINTS)
                s += 2.0 * after
                ends_at = lengths[i + 1] - after - (widths[i + 1] if i + 1 < len(widths) else 0.0)
                if ends_at > SHORTEST_PIECE:
                    starts.append(s)
                    positions.append(waypoints[i + 1] + after * directions[i + 1])
                    slopes.append(directions[i + 1])
                    bends.append(0 * direction)
            before = after
        self._starts, self._end = np.array(starts), s
        self._positions, self._slopes, self._bends = np.stack(positions), np.stack(slopes), np.stack(bends)

    def _grid(self, start: float, length: float, count: int) -> None:
        self.gridpoints += list(start + length * np.arange(1, count + 1) / count)

    def __call__(self, path_positions: FloatArray, order: int = 0) -> FloatArray:
        s = np.asarray(path_positions, dtype=float)
        piece = np.clip(np.searchsorted(self._starts, s, side="right") - 1, 0, len(self._starts) - 1)
        u = (s - self._starts[piece])[..., None]
        if order == 0:
            return np.asarray(self._positions[piece] + u * self._slopes[piece] + 0.5 * u**2 * self._bends[piece])
        if order == 1:
            return np.asarray(self._slopes[piece] + u * self._bends[piece])
        # Where straight line and corner meet, the corner's side counts, so that the limits hold on both.
        before = np.clip(np.searchsorted(self._starts, s - ON_BORDER, side="right") - 1, 0, None)
        sharper = np.linalg.norm(self._bends[before], axis=-1) > np.linalg.norm(self._bends[piece], axis=-1)
        return np.asarray(self._bends[np.where(sharper, before, piece)])

    @property
    def dof(self) -> int:
        return self._positions.shape[1]

    @property
    def path_interval(self) -> FloatArray:
        return np.array([0.0, self._end])


def _timed(path: _RoundedPath, velocity: FloatArray, acceleration: FloatArray) -> Trajectory:
    """Return the time-optimal trajectory on a path; its knots are the grid points."""
    grid = np.array(path.gridpoints)
    grid[-1] = path.path_interval[1]
    v, a = LIMIT_SHARE * np.asarray(velocity), LIMIT_SHARE * np.asarray(acceleration)
    bound_velocity = JointVelocityConstraint(np.stack([-v, v], axis=1))
    bound_acceleration = JointAccelerationConstraint(
        np.stack([-a, a], axis=1), discretization_scheme=DiscretizationType.Interpolation
    )
    solver = TOPPRA([bound_velocity, bound_acceleration], path, gridpoints=grid, solver_wrapper="seidel")
    _, speeds, _ = solver.compute_parameterization(0.0, 0.0)
    if speeds is None or not np.all(np.isfinite(speeds)):
        raise InfeasibleError("no timing of the path keeps the velocity and acceleration limits")
    steps = 2.0 * np.diff(grid) / np.maximum(speeds[:-1] + speeds[1:], 1e-9)
    times = np.concatenate([[0.0], np.cumsum(steps)])
    path_accelerations = np.diff(speeds**2) / (2.0 * np.diff(grid))
    path_accelerations = np.append(path_accelerations, path_accelerations[-1])
    slopes, bends = path(grid, 1), path(grid, 2)
    trajectory = Trajectory(
        times,
        path(grid),
        slopes * speeds[:, None],
        slopes * path_accelerations[:, None] + bends * speeds[:, None] ** 2,
    )
    return _slowed(trajectory, velocity, acceleration)


def _slowed(trajectory: Trajectory, velocity: FloatArray, acceleration: FloatArray) -> Trajectory:
    """Return the trajectory, as a whole slowed down as far as its samples between the knots pass a limit."""
    steps = np.linspace(0.0, 1.0, SAMPLES_BETWEEN + 1, endpoint=False)
    inner = trajectory.times[:-1, None] + np.diff(trajectory.times)[:, None] * steps
    times = np.concatenate([inner.ravel(), trajectory.times[1:] * (1.0 - 1e-12)])
    _, speeds, accelerations = trajectory.sample(times)
    fast = float(np.max(np.abs(speeds) / velocity))
    hard = float(np.max(np.abs(accelerations) / acceleration))
    stretch = max(1.0, fast, np.sqrt(hard)) * (1.0 if max(fast, hard) <= 1.0 else 1.0 / LIMIT_SHARE**0.5)
    return Trajectory(
        trajectory.times * stretch,
        trajectory.positions,
        trajectory.velocities / stretch,
        trajectory.accelerations / stretch**2,
    )


def _joined(parts: list[Trajectory]) -> Trajectory:
    """Return trajectories one after the other."""
    offsets = np.concatenate([[0.0], np.cumsum([part.duration for part in parts])])
    return Trajectory(
        np.concatenate(
            [parts[0].times[:1], *(part.times[1:] + t for part, t in zip(parts, offsets[:-1], strict=True))]
        ),
        np.concatenate([parts[0].positions[:1], *(part.positions[1:] for part in parts)]),
        np.concatenate([parts[0].velocities[:1], *(part.velocities[1:] for part in parts)]),
        np.concatenate([*(part.accelerations[:-1] for part in parts), parts[-1].accelerations[-1:]]),
    )
