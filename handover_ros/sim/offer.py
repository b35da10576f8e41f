"""When an object counts as offered: the robot holds it out, still, away from the tables."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

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
        scene: Its tables are where nothing is offered.
    """

    def __init__(self, scene: Scene) -> None:
        tables = [box for box in scene.boxes if min(box.size[:2]) >= SMALLEST_TABLE]
        self._centres = np.array([box.world_from_box[:3, 3] for box in tables]).reshape(-1, 3)
        self._halves = np.array([box.size for box in tables]).reshape(-1, 3) / 2.0
        self.reset()

    def reset(self) -> None:
        """Forget what was offered."""
        self._still_since: dict[str, float] = {}
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
            if speeds[name] > STILL or not self._away_from_tables(poses[name][:3, 3]):
                self._still_since.pop(name, None)
            elif time - self._still_since.setdefault(name, time) >= STILL_FOR and self._offered is None:
                self._offered = name
        for name in [name for name in self._still_since if name not in held]:
            del self._still_since[name]
        return self._offered

    def _away_from_tables(self, position: FloatArray) -> bool:
        """Return whether a point [m] is beside all tables or high above them."""
        over = np.all(np.abs(position[:2] - self._centres[:, :2]) <= self._halves[:, :2], axis=1)
        low = position[2] < self._centres[:, 2] + self._halves[:, 2] + ABOVE_TABLE
        return not bool(np.any(over & low))
