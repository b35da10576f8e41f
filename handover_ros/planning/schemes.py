"""Schemes: where an object is offered (dissertation 2.2). Here those without a model of the person, and the files."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np
from pydantic import BaseModel, Field

from handover_ros.geometry import FloatArray
from handover_ros.objects.catalogue import ObjectModel
from handover_ros.planning.expected_cost import ExpectedCostFile, ExpectedCostScheme
from handover_ros.planning.facing import facings, turned_object
from handover_ros.planning.objectives import OBJECTIVES
from handover_ros.planning.offers import HandoverTask, Offer, Scheme, levelled
from handover_ros.planning.personal import PersonalFile, PersonalScheme
from handover_ros.resources import config_file, config_names
from handover_ros.yaml_file import Schema, Vector3, read_yaml


class Variations(Schema):
    """Small changes to try when the nominal pose cannot be reached.

    Attributes:
        offsets: Shifts in the scheme's frame [m], tried in this order.
        tilts: How far the object's top leans away from the person [rad]; not for objects that must stay upright.
        yaws: Turns about the vertical [rad].
    """

    offsets: tuple[Vector3, ...] = Field(default=((0.0, 0.0, 0.0),), min_length=1)
    tilts: tuple[float, ...] = Field(default=(0.0,), min_length=1)
    yaws: tuple[float, ...] = Field(default=(0.0,), min_length=1)


class _ConstantFile(Schema):
    """Content of a file of a constant scheme."""

    kind: Literal["constant"]
    xyz: Vector3
    variations: Variations = Variations()


class _RelativeFile(Schema):
    """Content of a file of a relative scheme."""

    kind: Literal["relative"]
    xyz: Vector3
    level: bool = True
    variations: Variations = Variations()


class _Kind(BaseModel):
    """Tells the kinds apart; the rest is checked by the kind's own schema."""

    kind: Literal["constant", "relative", "personal", "expected_cost", "minimum_mean", "maximum_feasibility"]


@dataclass(frozen=True)
class ConstantScheme:
    """Offers at a fixed place in the robot's base frame, whoever stands there.

    Attributes:
        name: As in ``config/schemes``.
        position: Centre of the object in the base frame [m].
        variations: What to try beside the nominal pose.
    """

    name: str
    position: tuple[float, float, float]
    variations: Variations
    needs_person: bool = False

    def offers(self, task: HandoverTask) -> list[Offer]:
        """Return the offers; the person is taken to stand opposite the robot, reaching towards it."""
        base = task.world_from_base
        return _offers(task.model, base, -base[:3, 0], self.position, self.variations)


@dataclass(frozen=True)
class RelativeScheme:
    """Offers at a place that is constant in the frame of the person's torso, the same for everybody.

    Attributes:
        name: As in ``config/schemes``.
        position: Centre of the object in the torso frame [m].
        level: Ignore how the torso leans, use its heading only.
        variations: What to try beside the nominal pose.
    """

    name: str
    position: tuple[float, float, float]
    level: bool
    variations: Variations
    needs_person: bool = True

    def offers(self, task: HandoverTask) -> list[Offer]:
        """Return the offers in front of the torso.

        Raises:
            StaleDataError: The torso pose is not known.
        """
        person = task.tracked_person(self.name)
        frame = levelled(person.world_from_torso) if self.level else person.world_from_torso
        return _offers(task.model, frame, frame[:3, 0], self.position, self.variations)


def load_scheme(name: str) -> Scheme:
    """Return the scheme of ``config/schemes/<name>.yaml``.

    Raises:
        UnknownNameError: There is no such scheme.
        BadModelError: The file is wrong; the message names file and field.
    """
    path = config_file("schemes", name)
    kind = read_yaml(path, _Kind).kind
    if kind == "constant":
        content = read_yaml(path, _ConstantFile)
        return ConstantScheme(path.stem, content.xyz, content.variations)
    if kind == "personal":
        return PersonalScheme(path.stem, read_yaml(path, PersonalFile))
    if kind in OBJECTIVES:
        return ExpectedCostScheme(path.stem, read_yaml(path, ExpectedCostFile))
    related = read_yaml(path, _RelativeFile)
    return RelativeScheme(path.stem, related.xyz, related.level, related.variations)


def load_schemes() -> dict[str, Scheme]:
    """Return all schemes of ``config/schemes`` by name."""
    return {name: load_scheme(name) for name in config_names("schemes")}


def _offers(
    model: ObjectModel,
    frame: FloatArray,
    direction: FloatArray,
    position: tuple[float, float, float],
    variations: Variations,
) -> list[Offer]:
    """Return offers at ``position`` in ``frame``: shifts outermost, then the ways to face the person, tilts, turns."""
    reach = np.array([direction[0], direction[1], 0.0]) / np.hypot(direction[0], direction[1])
    heading = float(np.arctan2(reach[1], reach[0]))
    tilts = (0.0,) if model.keep_upright else variations.tilts
    offers = []
    for shift, facing, tilt, turn in product(variations.offsets, facings(model), tilts, variations.yaws):
        centre = frame[:3, :3] @ (np.array(position) + shift) + frame[:3, 3]
        world_from_object = turned_object(model, centre, heading + facing.yaw + turn, tilt, reach)
        world_from_hand = world_from_object @ facing.object_from_hand
        other = None if facing.object_from_other_hand is None else world_from_object @ facing.object_from_other_hand
        nominal = not np.any(shift)
        offers.append(Offer(world_from_object, facing.region, world_from_hand, reach, nominal, other))
    return offers
