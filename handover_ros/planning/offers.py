"""Offers: poses at which an object could be given to a person, and what chooses them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from handover_ros.errors import ErrorCode, StaleDataError
from handover_ros.geometry import FloatArray
from handover_ros.objects.catalogue import ObjectModel
from handover_ros.planning.goal_stance import Box
from handover_ros.planning.types import ExpectedPosture, PredictedChoice, TrackedPerson

BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]


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
        robot_grasp: Place in ``RobotSide.object_from_gripper`` of the grasp it was chosen with; None: any will do.
        predicted: How the person is expected to choose; None: the scheme knows nothing of it.
    """

    world_from_object: FloatArray
    region: str
    world_from_hand: FloatArray
    reach: FloatArray
    nominal: bool
    world_from_other_hand: FloatArray | None = None
    expected: ExpectedPosture | None = None
    robot_grasp: int | None = None
    predicted: PredictedChoice | None = None

    @property
    def hands(self) -> tuple[FloatArray, ...]:
        """The one or two hands of the person, each (4, 4)."""
        other = self.world_from_other_hand
        return (self.world_from_hand,) if other is None else (self.world_from_hand, other)


@dataclass(frozen=True, eq=False)
class RobotSide:
    """What a scheme that chooses the robot's grasp too needs to know of the robot.

    Attributes:
        object_from_gripper: The grasps of one arm, shape (r, 4, 4).
        gripper: The gripper as points in its own frame [m], shape (n, 3).
        stretches: Tells for object poses (n, 4, 4) in the world how far each grasp stretches the arm [m] (n, r); inf:
            farther than it is long.
        kinematic: Tells for object poses (n, 4, 4) and places of grasps (n,) whether the arm can be there (n,),
            collisions aside; misses one in a hundred.
        reachable: Tells whether the arm can pick it up and be there free of collisions: world_from_object (4, 4), place
            of the grasp.
    """

    object_from_gripper: FloatArray
    gripper: FloatArray
    stretches: Callable[[FloatArray], FloatArray]
    kinematic: Callable[[FloatArray, IntArray], BoolArray]
    reachable: Callable[[FloatArray, int], bool]


@dataclass(frozen=True, eq=False)
class HandoverTask:
    """What an object shall be offered for, and to whom.

    Attributes:
        model: The object.
        world_from_base: The robot's base frame. Shape (4, 4).
        person: What is known of the person, or None when nobody is tracked.
        world_from_goal: Object pose to which the person shall bring it, or None. Shape (4, 4).
        person_model: How the person chooses, as in ``choice.person_model``; empty: the scheme's default.
        boxes: Of the scene, for what is in the person's way at the goal.
        robot: The arm that is to offer it; None: not asked for.
        budget: Wall time [s] a scheme may take.
        seed: Of random searches.
    """

    model: ObjectModel
    world_from_base: FloatArray
    person: TrackedPerson | None
    world_from_goal: FloatArray | None = None
    person_model: str = ""
    boxes: tuple[Box, ...] = ()
    robot: RobotSide | None = None
    budget: float = float("inf")
    seed: int = 0

    def tracked_person(self, scheme: str) -> TrackedPerson:
        """Return the person, for the scheme of that name.

        Raises:
            StaleDataError: Nobody is tracked.
        """
        if self.person is None:
            raise StaleDataError(
                f"scheme {scheme!r} needs the person, who is not tracked", ErrorCode.PERSON_NOT_TRACKED
            )
        return self.person


class Scheme(Protocol):
    """Chooses where to offer an object."""

    @property
    def name(self) -> str:
        """Name of the scheme."""

    @property
    def needs_person(self) -> bool:
        """Whether the torso pose must be known."""

    def offers(self, task: HandoverTask) -> list[Offer]:
        """Return the poses at which to offer an object, the best first; the planner takes the first it can reach.

        Args:
            task: The object, the person and what else is known.

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
