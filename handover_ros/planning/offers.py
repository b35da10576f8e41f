"""Offers: poses at which an object could be given to a person, and what chooses them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.objects.catalogue import ObjectModel
from handover_ros.planning.types import ExpectedPosture, TrackedPerson


@dataclass(frozen=True, eq=False)
class Offer:
    """A pose at which an object could be offered.

    Attributes:
        world_from_object: Shape (4, 4).
        region: Human grasp region that is turned to the person; empty: none in particular.
        world_from_hand: The person's hand there. Shape (4, 4).
        reach: Horizontal direction in which the person's hand comes, in the world. Shape (3,).
        nominal: Whether it is the scheme's own position, not one beside it.
        world_from_other_hand: The other hand, for objects that need two; None: one is enough. Shape (4, 4).
        expected: The posture the person is expected to take; None: the scheme knows nothing of it.
    """

    world_from_object: FloatArray
    region: str
    world_from_hand: FloatArray
    reach: FloatArray
    nominal: bool
    world_from_other_hand: FloatArray | None = None
    expected: ExpectedPosture | None = None

    @property
    def hands(self) -> tuple[FloatArray, ...]:
        """The one or two hands of the person, each (4, 4)."""
        other = self.world_from_other_hand
        return (self.world_from_hand,) if other is None else (self.world_from_hand, other)


class Scheme(Protocol):
    """Chooses where to offer an object."""

    @property
    def name(self) -> str:
        """Name of the scheme."""

    @property
    def needs_person(self) -> bool:
        """Whether the torso pose must be known."""

    def offers(self, model: ObjectModel, world_from_base: FloatArray, person: TrackedPerson | None) -> list[Offer]:
        """Return the poses at which to offer an object, the best first; the planner takes the first it can reach.

        Args:
            model: The object.
            world_from_base: The robot's base frame. Shape (4, 4).
            person: What is known of the person, or None when nobody is tracked.

        Raises:
            StaleDataError: The torso pose is needed and not known.
            HandoverError: Something else of the person is needed and not known.
        """


def levelled(world_from_torso: FloatArray) -> FloatArray:
    """Return a torso frame with the same origin and heading whose z axis is vertical. Shape (4, 4)."""
    forward = world_from_torso[:3, 0]
    if np.hypot(forward[0], forward[1]) < 1e-6:  # bent over by a right angle: the back of the head shows the heading
        forward = -np.sign(forward[2]) * world_from_torso[:3, 2]
    heading = np.array([forward[0], forward[1], 0.0]) / np.hypot(forward[0], forward[1])
    frame = np.eye(4)
    frame[:3, 0], frame[:3, 1] = heading, np.cross([0.0, 0.0, 1.0], heading)
    frame[:3, 3] = world_from_torso[:3, 3]
    return frame
