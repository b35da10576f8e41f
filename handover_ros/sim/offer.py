"""When an object counts as offered: the robot holds it out, still, away from the table it came from."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from handover_ros.geometry import FloatArray
from handover_ros.objects.scene import Scene

STILL = 0.02  # [m/s]
STILL_FOR = 0.4  # [s]
WITHDRAWN = 0.25  # [m/s] an offered object moves a little when the person touches it; faster than this it is taken away
ABOVE_TABLE = 0.35  # [m] over a table's top, an object is away from it
SMALLEST_TABLE = 0.2  # [m] boxes with shorter sides are no tables


class OfferWatch:
    """Says which object the robot offers.

    Args:
        scene: Its tables are where the robot takes things from and puts them back.
    """

    def __init__(self, scene: Scene) -> None:
        tables = [box for box in scene.boxes if min(box.size[:2]) >= SMALLEST_TABLE]
        self._centres = np.array([box.world_from_box[:3, 3] for box in tables]).reshape(-1, 3)
        self._halves = np.array([box.size for box in tables]).reshape(-1, 3) / 2.0
        self.reset()

    def reset(self) -> None:
        """Forget what was offered."""
        self._still_since: dict[str, float] = {}
        self._tables: dict[str, npt.NDArray[np.bool_]] = {}  # held object -> the tables over which it was taken up
        self._offered: str | None = None

    def update(
        self, time: float, held: Mapping[str, str], poses: Mapping[str, FloatArray], speeds: Mapping[str, float]
    ) -> str | None:
        """Return the object that is offered now, or None.

        Args:
            time: Now [s].
            held: Object to the arm that holds it.
            poses: Object to world_from_object (4, 4).
            speeds: Object to its speed [m/s].
        """
        if self._offered is not None and (self._offered not in held or speeds[self._offered] > WITHDRAWN):
            self._still_since.pop(self._offered, None)
            self._offered = None
        for name in held:
            place = poses[name][:3, 3]
            if name not in self._tables:
                self._tables[name] = self._low_over(place)
            if speeds[name] > STILL or (self._low_over(place) & self._tables[name]).any():
                self._still_since.pop(name, None)
            elif time - self._still_since.setdefault(name, time) >= STILL_FOR and self._offered is None:
                self._offered = name
        self._still_since = {name: since for name, since in self._still_since.items() if name in held}
        self._tables = {name: tables for name, tables in self._tables.items() if name in held}
        return self._offered

    def _low_over(self, position: FloatArray) -> npt.NDArray[np.bool_]:
        """Return over which tables a point [m] is, and not high above."""
        over = np.all(np.abs(position[:2] - self._centres[:, :2]) <= self._halves[:, :2], axis=1)
        low = position[2] < self._centres[:, 2] + self._halves[:, 2] + ABOVE_TABLE
        return np.asarray(over & low)
