"""What the simulated person sees and feels of the cell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from handover_ros.geometry import FloatArray


@dataclass(frozen=True)
class PersonView:
    """What the person sees and feels of the cell, apart from its own body.

    Attributes:
        objects: Object name to world_from_object (4, 4).
        held_by_robot: Object name to the robot's arm.
        held_by_hand: Hand to the object it holds.
        object_speed: Object name to its speed [m/s].
        offered: Object that the robot holds out and still; None: nothing.
        goals: Object name to world_from_object (4, 4) where the person shall bring it.
    """

    objects: Mapping[str, FloatArray] = field(default_factory=dict)
    held_by_robot: Mapping[str, str] = field(default_factory=dict)
    held_by_hand: Mapping[str, str] = field(default_factory=dict)
    object_speed: Mapping[str, float] = field(default_factory=dict)
    offered: str | None = None
    goals: Mapping[str, FloatArray] = field(default_factory=dict)
