"""Simulated optical motion capture: markers that enough cameras see, with noise, on the device's own clock."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import mujoco
import numpy as np
import numpy.typing as npt

from handover_ros.errors import BadModelError
from handover_ros.geometry import FloatArray
from handover_ros.sim.faults import Faults, RandomGaps

SLOWEST_RATE, FASTEST_RATE = 50.0, 480.0
LARGEST_NOISE = 0.05
CAMERAS_NEEDED = 2
# Scene and objects, robot, person: what hides markers.
HIDING_GROUPS = np.array([1, 0, 0, 1, 1, 0], dtype=np.uint8)
# The marker is at 1 along its ray; a hit before this share hides it.
REACHED = 0.9995
LARGEST_DRIFT = 4e-5
LARGEST_EPOCH = 1e5

BoolArray = npt.NDArray[np.bool_]


class CameraPose(Protocol):
    """What is needed of a camera: where it is and looks [m], and how wide it sees (full angle of a cone) [rad]."""

    @property
    def position(self) -> Sequence[float]:
        """Position in world [m]."""

    @property
    def target(self) -> Sequence[float]:
        """Point it looks at, in world [m]."""

    @property
    def field_of_view(self) -> float:
        """Full angle [rad]."""


@dataclass(frozen=True)
class MocapCamera:
    """A motion-capture camera: ``position`` and ``target`` [m] in world, ``field_of_view`` (full angle) [rad]."""

    position: tuple[float, float, float]
    target: tuple[float, float, float]
    field_of_view: float


@dataclass(frozen=True, eq=False)
class CapturedFrame:
    """One frame as the device delivers it.

    Attributes:
        device_frame: Frame number of the device.
        device_time: The device's clock at capture [s]; its epoch is its own.
        positions: Marker positions in world [m], shape (n, 3), NaN where a marker was not measured.
        names: Marker labels, n.
    """

    device_frame: int
    device_time: float
    positions: FloatArray
    names: tuple[str, ...]


def ring_of_cameras(
    centre: Sequence[float] = (1.2, 0.0, 1.1),
    radius: float = 2.9,
    height: float = 2.6,
    count: int = 8,
    field_of_view: float = 1.1,
) -> tuple[MocapCamera, ...]:
    """Return cameras evenly on a circle [m] about a vertical axis, looking at its centre, as in a capture arena."""
    angles = 2.0 * np.pi * (np.arange(count) + 0.5) / count
    target = (float(centre[0]), float(centre[1]), float(centre[2]))
    return tuple(
        MocapCamera(
            (target[0] + radius * math.cos(angle), target[1] + radius * math.sin(angle), height), target, field_of_view
        )
        for angle in angles
    )


class MotionCapture:
    """A motion-capture system looking at marker sites of a simulation.

    Args:
        model: Compiled model.
        sites: Names of the marker sites; a marker's label is what follows the last ``/``.
        cameras: The cameras; a marker is measured when at least two of them see it.
        rate: Frames per second [Hz], 50 to 480.
        noise: Standard deviation of each coordinate [m].
        seed: Of noise, gaps, clock and faults.
        faults: Disturbances; None: a set of its own, see ``faults``.
        occlusion: Share of samples hidden at random besides, 0 to 1.

    Attributes:
        faults: Its disturbances.
        names: Marker labels.
        rate: Frames per second [Hz].

    Raises:
        BadModelError: A value is out of range or a site does not exist.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        sites: Sequence[str],
        cameras: Sequence[CameraPose],
        rate: float = 240.0,
        noise: float = 0.0007,
        seed: int = 0,
        faults: Faults | None = None,
        occlusion: float = 0.0,
    ) -> None:
        if not SLOWEST_RATE <= rate <= FASTEST_RATE:
            raise BadModelError(f"motion capture rate {rate:g} Hz must be {SLOWEST_RATE:g} to {FASTEST_RATE:g}")
        if not 0.0 <= noise <= LARGEST_NOISE:
            raise BadModelError(f"motion capture noise {noise:g} m must be 0 to {LARGEST_NOISE:g}")
        if not 0.0 <= occlusion <= 1.0:
            raise BadModelError(f"motion capture occlusion {occlusion:g} must be a fraction from 0 to 1")
        if not cameras:
            raise BadModelError("motion capture needs at least one camera")
        self._model = model
        self._sites = np.array([_site(model, name) for name in sites], dtype=int)
        self.names = tuple(name.rpartition("/")[2] for name in sites)
        self.rate = rate
        self.faults = Faults(len(sites), len(cameras), seed) if faults is None else faults
        self._noise, self._occlusion = noise, occlusion
        self._places = np.array([camera.position for camera in cameras], dtype=float)
        axes = np.array([camera.target for camera in cameras], dtype=float) - self._places
        self._axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
        self._cosines = np.cos([camera.field_of_view / 2.0 for camera in cameras])
        self._usefulness = np.zeros(len(cameras))
        self._rng = np.random.default_rng([seed, 11])
        self._gaps = RandomGaps(len(sites), np.random.default_rng([seed, 13]))
        self._epoch = float(self._rng.uniform(0.0, LARGEST_EPOCH))
        self._drift = float(self._rng.uniform(-LARGEST_DRIFT, LARGEST_DRIFT))
        self._frame = int(self._rng.integers(1, 10000))
        self._ghost: tuple[object, FloatArray] | None = None
        self._last: CapturedFrame | None = None

    def capture(self, data: mujoco.MjData, time: float) -> CapturedFrame:
        """Measure the markers at ``time`` [s] of the simulation, whose positions ``data`` holds.

        While frozen, the device delivers its last frame again, with its old frame number and time.
        """
        frame, self._frame = self._frame, self._frame + 1
        if self._last is not None and self.faults.active("freeze", time) is not None:
            return self._last
        truth = data.site_xpos[self._sites]
        positions = truth + self._noise * self._rng.standard_normal(truth.shape)
        dropped = self.faults.active("camera_drop", time)
        seen = self.visible(data, None if dropped is None else int(dropped.magnitude))
        fault = self.faults.active("occlusion", time)
        fraction = self._occlusion if fault is None else max(self._occlusion, fault.magnitude)
        if fraction > 0.0:
            seen &= ~self._gaps.step(fraction, 1.0 / self.rate)
        positions[~seen] = np.nan
        self._mislabel(positions, truth, time)
        jump = self.faults.active("clock_jump", time)
        device_time = self._epoch + time * (1.0 + self._drift) + (0.0 if jump is None else jump.magnitude)
        self._last = CapturedFrame(frame, device_time, positions, self.names)
        return self._last

    def visible(self, data: mujoco.MjData, dropped: int | None = None) -> BoolArray:
        """Return which markers (n,) at least two cameras see; ``dropped``: index of a camera that does not work."""
        positions = data.site_xpos[self._sites]
        # Cameras that saw much lately come first, so that few have to be asked; the order does not change the result.
        order = np.argsort(-self._usefulness, kind="stable")
        rays = positions[None] - self._places[:, None]
        lengths = np.sqrt((rays * rays).sum(axis=-1))
        in_view = (rays * self._axes[:, None]).sum(axis=-1) >= self._cosines[:, None] * lengths
        if dropped is not None:
            in_view[dropped] = False
        missing = np.full(len(positions), CAMERAS_NEEDED)
        for camera in order:
            wanted = np.flatnonzero(in_view[camera] & (missing > 0))
            if len(wanted) == 0:
                continue
            free = self._free_lines(data, camera, rays[camera, wanted])
            missing[wanted[free]] -= 1
            self._usefulness[camera] += 0.05 * (free.mean() - self._usefulness[camera])
            if not missing.any():
                break
        return missing == 0

    def _free_lines(self, data: mujoco.MjData, camera: int, rays: FloatArray) -> BoolArray:
        """Return which rays (k, 3) from a camera to markers meet nothing on the way."""
        count = len(rays)
        geoms, shares = np.empty(count, dtype=np.int32), np.empty(count)
        mujoco.mj_multiRay(
            self._model,
            data,
            self._places[camera],
            np.ascontiguousarray(rays).ravel(),
            HIDING_GROUPS,
            True,
            -1,
            geoms,
            shares,
            None,
            count,
            float(np.linalg.norm(rays, axis=1).max()),
        )
        return (shares < 0.0) | (shares > REACHED)

    def _mislabel(self, positions: FloatArray, truth: FloatArray, time: float) -> None:
        """Swap labels and put ghosts into the measured positions (n, 3), in place."""
        swap = self.faults.active("label_swap", time)
        if swap is not None:
            first, second = swap.markers
            positions[[first, second]] = positions[[second, first]]
        ghost = self.faults.active("ghost", time)
        if ghost is not None:
            marker = ghost.markers[0]
            if self._ghost is None or self._ghost[0] is not ghost:
                self._ghost = (ghost, truth[marker] + ghost.offset)
            positions[marker] = self._ghost[1] + self._noise * self._rng.standard_normal(3)


def _site(model: mujoco.MjModel, name: str) -> int:
    """Return the number of a site.

    Raises:
        BadModelError: There is no such site.
    """
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name)
    if index < 0:
        raise BadModelError(f"marker site {name!r} is not in the simulation's model")
    return int(index)
