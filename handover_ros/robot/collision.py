"""Collision checks of the whole robot: with itself, the scene, objects, a held object and the person (coal)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
import pinocchio as pin

from handover_ros.geometry import FloatArray
from handover_ros.robot.robot_geometry import RobotGeometry
from handover_ros.robot.shapes import Solid

BESIDE_MARGIN = 0.003  # [m] kept by an object that is lifted from between others
START_RETREAT = 0.003  # [m] how much nearer than at the start a pair may come that began within its margin


class Reason(str, Enum):
    """Why a configuration or a pose is not usable."""

    OUT_OF_REACH = "out of reach"
    JOINT_LIMITS = "no solution within the joint limits"
    BLOCKED = "blocked"
    SELF = "self-collision"
    ENVIRONMENT = "collision with the scene"
    OBJECT = "collision with an object"
    PERSON = "too near the person"


@dataclass(frozen=True, eq=False)
class HeldObject:
    """An object in a gripper.

    Attributes:
        arm: The arm that holds it.
        name: The object's name.
        solids: Its solids in the gripper frame.
    """

    arm: str
    name: str
    solids: tuple[Solid, ...]


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Everything but the robot that a check looks at.

    Attributes:
        boxes: Tables, racks, walls, in the world.
        objects: Solids of each object that is not held, by name, in the world.
        person: Solids of the person; empty: nobody there.
        held: What a gripper holds.
        touched: Object that the fingers are about to close on or just let go: may touch that arm's hand.
        touching_arm: The arm whose hand may touch it.
        person_distance: Distance the robot keeps from the person [m].
        held_person_distance: Distance the held object keeps from the person [m].
    """

    boxes: tuple[Solid, ...] = ()
    objects: Mapping[str, tuple[Solid, ...]] = field(default_factory=dict)
    person: tuple[Solid, ...] = ()
    held: HeldObject | None = None
    touched: str = ""
    touching_arm: str = ""
    person_distance: float = 0.15
    held_person_distance: float = 0.05


class CollisionChecker:
    """Checks configurations of the robot in given surroundings.

    Args:
        geometry: The robot's own solids.
        surroundings: Everything else.
        arm: The one arm that moves: pairs that it does not change are left out; empty: all arms.

    Attributes:
        surroundings: What it was made for.
        checks: Configurations checked so far.
    """

    def __init__(self, geometry: RobotGeometry, surroundings: Surroundings, arm: str = "") -> None:
        self.surroundings = surroundings
        self.checks = 0
        self._geometry = geometry
        self._model = geometry.robot.pinocchio_model
        self._data = self._model.createData()
        self._moving = geometry.solids_of(arm) if arm else geometry.movable
        self._solids = geometry.base.copy()
        if arm:
            _keep_pairs_of(self._solids, self._moving)
        self._reasons = [Reason.SELF] * len(self._solids.collisionPairs)
        self._margins = [geometry.margin] * len(self._solids.collisionPairs)
        self._labels = [""] * len(self._solids.collisionPairs)
        self._held_scene_pairs: list[int] = []
        self._held_places: list[int] = []
        self._joint_from_gripper = np.eye(4)
        self._add_surroundings()
        self._results = pin.GeometryData(self._solids)
        for request, margin in zip(self._results.collisionRequests, self._margins, strict=True):
            request.security_margin = margin
        self._active = np.ones(len(self._margins), dtype=bool)
        # Of a thousand pairs a few dozen are near each other: their boxes, grown by the margins, tell which. Margins
        # only ever get less, and then the boxes are larger than need be.
        self._nearby = pin.BroadPhaseManager_SSaPCollisionManager(self._model, self._solids, self._results)

    @property
    def pairs(self) -> int:
        """Number of pairs a check looks at."""
        return int(self._active.sum())

    def is_free(self, configuration: FloatArray) -> bool:
        """Return whether nothing is nearer than its margin at a whole configuration (nq,)."""
        self.checks += 1
        return not pin.computeCollisions(self._model, self._data, self._nearby, configuration, True)

    def hold(self, solids: Sequence[Solid]) -> None:
        """Hold the object in another way from now on; quicker than a new checker.

        Args:
            solids: The same object's solids, in the gripper frame.
        """
        for place, solid in zip(self._held_places, solids, strict=True):
            placement = pin.SE3(self._joint_from_gripper @ solid.parent_from_solid)
            self._solids.geometryObjects[place].placement = placement

    def problems(self, configuration: FloatArray) -> list[tuple[Reason, str]]:
        """Return all pairs nearer than their margin at a configuration (nq,): reason and a few words each."""
        self.checks += 1
        if not pin.computeCollisions(self._model, self._data, self._solids, self._results, configuration, False):
            return []
        hits = enumerate(self._results.collisionResults)
        found = [(self._reasons[i], self._label(i)) for i, hit in hits if self._active[i] and hit.isCollision()]
        return list(dict.fromkeys(found))

    def why(self, configuration: FloatArray) -> tuple[Reason, str] | None:
        """Return why a configuration (nq,) is not free, with a few words, or None when it is free."""
        return next(iter(self.problems(configuration)), None)

    def distance(self, configuration: FloatArray, reason: Reason | None = None) -> float:
        """Return the least distance [m] of checked pairs (of one kind) at a configuration (nq,), inf without pairs.

        Negative: they overlap. The margins play no part.
        """
        distances = self._distances(configuration)
        chosen = [d for i, d in enumerate(distances) if self._active[i] and reason in (None, self._reasons[i])]
        return min(chosen, default=float("inf"))

    def tolerate_start(self, configuration: FloatArray) -> None:
        """Let pairs that are within their margin at ``configuration`` be so, but come no nearer than they are.

        A motion must be able to leave the place where the robot stands, e.g. when the person has come close.
        """
        for i, distance in enumerate(self._distances(configuration)):
            if distance >= self._margins[i]:
                continue
            if distance <= START_RETREAT:
                self._drop(i)
            else:
                self._margins[i] = distance - START_RETREAT
                self._results.collisionRequests[i].security_margin = self._margins[i]

    def ignore_support(self, configuration: FloatArray) -> None:
        """Drop the pairs of held object and scene or other objects that are within their margin at ``configuration``.

        Used for the short straight lift off, or way down to, the surface that carries the object; what stands beside it
        may come as near as ``BESIDE_MARGIN``.
        """
        distances = self._distances(configuration)
        for i in self._held_scene_pairs:
            if distances[i] < self._margins[i]:
                self._drop(i)
            else:
                self._margins[i] = min(self._margins[i], BESIDE_MARGIN)
                self._results.collisionRequests[i].security_margin = self._margins[i]

    def _distances(self, configuration: FloatArray) -> list[float]:
        pin.computeDistances(self._model, self._data, self._solids, self._results, configuration)
        return [result.min_distance for result in self._results.distanceResults]

    def _drop(self, pair: int) -> None:
        self._active[pair] = False
        self._results.deactivateCollisionPair(pair)

    def _label(self, pair: int) -> str:
        if self._labels[pair]:
            return self._labels[pair]
        indices = self._solids.collisionPairs[pair]
        names = (self._solids.geometryObjects[i].name for i in (indices.first, indices.second))
        return " and ".join(name.rsplit("_", 1)[0] for name in names)

    def _pair(self, first: int, second: int, reason: Reason, margin: float, label: str) -> None:
        self._solids.addCollisionPair(pin.CollisionPair(first, second))
        self._reasons.append(reason)
        self._margins.append(margin)
        self._labels.append(label)

    def _add(self, solids: Sequence[Solid], label: str) -> list[int]:
        """Add solids fixed in the world; return their places."""
        return [
            self._solids.addGeometryObject(solid.geometry_object(f"{label}/{i}", 0, solid.parent_from_solid))
            for i, solid in enumerate(solids)
        ]

    def _add_surroundings(self) -> None:
        around, margin = self.surroundings, self._geometry.margin
        fixed: list[tuple[list[int], Reason, float, float, str]] = []  # places, reason, margin, held margin, label
        for i, box in enumerate(around.boxes):
            fixed.append((self._add([box], f"scene/{i}"), Reason.ENVIRONMENT, margin, margin, box.name))
        held_name = around.held.name if around.held else ""
        for name, solids in around.objects.items():
            if name != held_name:
                fixed.append((self._add(solids, f"object/{name}"), Reason.OBJECT, margin, margin, name))
        if around.person:
            places = self._add(around.person, "person")
            fixed.append((places, Reason.PERSON, around.person_distance, around.held_person_distance, "person"))
        touching = self._geometry.hand(around.touching_arm) if around.touched else frozenset()
        for places, reason, distance, _, label in fixed:
            skipped = touching if label == around.touched else frozenset()
            for place in places:
                for link in sorted(self._moving):
                    if link not in skipped:
                        self._pair(link, place, reason, distance, label)
        if around.held is not None:
            self._add_held(around.held, fixed)

    def _add_held(self, held: HeldObject, fixed: list[tuple[list[int], Reason, float, float, str]]) -> None:
        robot = self._geometry.robot
        frame = self._model.frames[self._model.getFrameId(robot.arm(held.arm).tip_frame)]
        joint_from_gripper = self._joint_from_gripper = np.array(frame.placement.homogeneous)
        hand = self._geometry.hand(held.arm)
        robot_solids = len(self._geometry.base.geometryObjects)
        for i, solid in enumerate(held.solids):
            place = self._solids.addGeometryObject(
                solid.geometry_object(f"held/{i}", frame.parentJoint, joint_from_gripper @ solid.parent_from_solid)
            )
            self._held_places.append(place)
            for link in range(robot_solids):
                if link not in hand:
                    self._pair(link, place, Reason.SELF, self._geometry.margin, f"{held.name} and the robot")
            for places, reason, _, distance, label in fixed:
                for other in places:
                    if reason is not Reason.PERSON:
                        self._held_scene_pairs.append(len(self._margins))
                    self._pair(other, place, reason, distance, f"{held.name} and {label}")


def _keep_pairs_of(solids: pin.GeometryModel, moving: frozenset[int]) -> None:
    """Remove the collision pairs without a moving solid."""
    kept = [pair for pair in solids.collisionPairs if pair.first in moving or pair.second in moving]
    kept = [pin.CollisionPair(pair.first, pair.second) for pair in kept]
    solids.removeAllCollisionPairs()
    for pair in kept:
        solids.addCollisionPair(pair)
