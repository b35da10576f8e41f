"""Whether a tracked person stands still: a handover planned for somebody who is turning away fits nobody."""

from __future__ import annotations

from collections import deque

import numpy as np

from handover_ros.errors import BadRequestError
from handover_ros.geometry import FloatArray, rotation_angle

SPACING = 0.05  # [s] between the poses that are kept


class Stillness:
    """Watches a torso pose over a window of time.

    A person who stands sways by about a centimetre and a degree; the limits are several times that.

    Args:
        window: [s] over which the pose must stay.
        distance: [m] it may move within the window.
        angle: [rad] it may turn within the window.

    Raises:
        BadRequestError: A limit is not positive.
    """

    def __init__(self, window: float = 0.6, distance: float = 0.03, angle: float = 0.07) -> None:
        if min(window, distance, angle) <= 0.0:
            raise BadRequestError(f"stillness limits must be positive, got {window:g} s, {distance:g} m, {angle:g} rad")
        self.window, self.distance, self.angle = window, distance, angle
        self._poses: deque[tuple[float, FloatArray]] = deque()

    def update(self, time: float, world_from_torso: FloatArray) -> None:
        """Take the torso's pose (4, 4) at ``time`` [s]; a clock that went back starts afresh."""
        if self._poses and time < self._poses[-1][0]:
            self._poses.clear()
        if self._poses and time - self._poses[-1][0] < SPACING:
            return
        self._poses.append((time, world_from_torso.copy()))
        while self._poses[-1][0] - self._poses[0][0] > self.window + SPACING:
            self._poses.popleft()

    def still(self) -> bool:
        """Return whether the pose was known for the whole window and stayed within the limits."""
        if not self._poses or self._poses[-1][0] - self._poses[0][0] < self.window:
            return False
        newest = self._poses[-1][1]
        return all(
            np.linalg.norm(pose[:3, 3] - newest[:3, 3]) <= self.distance and rotation_angle(pose, newest) <= self.angle
            for _, pose in self._poses
        )
