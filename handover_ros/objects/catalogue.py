"""The catalogue of objects: shape, mass and grasps, read from ``config/objects/*.yaml``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from handover_ros.errors import BadModelError
from handover_ros.geometry import FloatArray, make_transform, transform_from_xyz_rpy
from handover_ros.objects.regions import TaskSpaceRegion
from handover_ros.resources import config_file, config_names
from handover_ros.yaml_file import Schema, Vector3, read_yaml

PrimitiveType = Literal["box", "cylinder", "sphere", "capsule"]
SIZE_NUMBERS = {"box": 3, "cylinder": 2, "sphere": 1, "capsule": 2}
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
Colour = tuple[Fraction, Fraction, Fraction, Fraction]


@dataclass(frozen=True, eq=False)
class Primitive:
    """One simple solid of an object.

    Attributes:
        type: ``box``, ``cylinder``, ``sphere`` or ``capsule``.
        size: Box: full lengths x, y, z; cylinder and capsule: radius, length along z (without the capsule's caps);
            sphere: radius [m].
        object_from_primitive: Centre of the solid in the object frame, shape (4, 4).
        colour: Red, green, blue, opacity, each 0 to 1.
    """

    type: PrimitiveType
    size: tuple[float, ...]
    object_from_primitive: FloatArray
    colour: Colour


@dataclass(frozen=True, eq=False)
class RobotGrasp:
    """Gripper poses on an object and the thickness [m] between the fingers there."""

    region: TaskSpaceRegion
    width: float


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """What the cell knows of one kind of object.

    Attributes:
        name: As in ``config/objects``.
        mass: [kg].
        hands: Hands a person needs for it: 1 or 2 (2: one hand in each of two different regions).
        primitives: The shape, used for collision, for contact and to draw it.
        robot_grasps: Where a two-finger gripper can hold it.
        human_grasps: Where a hand can hold it, written for the right hand.
        keep_upright: An open container: it must not lean on the way or at the handover.
    """

    name: str
    mass: float
    hands: int
    primitives: tuple[Primitive, ...]
    robot_grasps: tuple[RobotGrasp, ...]
    human_grasps: tuple[TaskSpaceRegion, ...]
    keep_upright: bool = False


class _Pair(Schema):
    """Closed interval of a displacement."""

    x: tuple[float, float] = (0.0, 0.0)
    y: tuple[float, float] = (0.0, 0.0)
    z: tuple[float, float] = (0.0, 0.0)
    roll: tuple[float, float] = (0.0, 0.0)
    pitch: tuple[float, float] = (0.0, 0.0)
    yaw: tuple[float, float] = (0.0, 0.0)


class _HandFile(Schema):
    """Hand in the region frame: position [m], direction of approach (hand z), direction across the palm (hand y)."""

    xyz: Vector3 = (0.0, 0.0, 0.0)
    approach: Vector3
    across: Vector3


class _RegionFile(Schema):
    """A region as the YAML file writes it."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
    xyz: Vector3 = (0.0, 0.0, 0.0)
    rpy: Vector3 = (0.0, 0.0, 0.0)
    hand: _HandFile
    bounds: _Pair = _Pair()


class _RobotGraspFile(_RegionFile):
    """A robot grasp: a region and the thickness [m] between the fingers."""

    width: Annotated[float, Field(gt=0.0, le=0.2)]


class _PrimitiveFile(Schema):
    """A solid: placed by ``xyz`` and ``rpy``, or, along its length, by ``ends`` (two points)."""

    type: PrimitiveType
    size: tuple[Annotated[float, Field(gt=0.0)], ...]
    xyz: Vector3 = (0.0, 0.0, 0.0)
    rpy: Vector3 = (0.0, 0.0, 0.0)
    ends: tuple[Vector3, Vector3] | None = None
    colour: Colour | None = None

    @model_validator(mode="after")
    def _size_fits_type(self) -> _PrimitiveFile:
        """Check the number of sizes; with ``ends`` the length is not given."""
        expected = SIZE_NUMBERS[self.type] - (1 if self.ends is not None else 0)
        if self.ends is not None and (self.type not in ("cylinder", "capsule") or self.ends[0] == self.ends[1]):
            raise ValueError("'ends' are two different points of a cylinder or capsule")
        if len(self.size) != expected:
            raise ValueError(f"size of a {self.type} holds {expected} numbers, not {len(self.size)}")
        return self


class _ObjectFile(Schema):
    """Content of one file of ``config/objects``."""

    mass: Annotated[float, Field(gt=0.0, le=2.2)]
    hands: Annotated[int, Field(ge=1, le=2)] = 1
    keep_upright: bool = False
    colour: Colour = (0.8, 0.8, 0.8, 1.0)
    primitives: Annotated[list[_PrimitiveFile], Field(min_length=1)]
    robot_grasps: Annotated[list[_RobotGraspFile], Field(min_length=1)]
    human_grasps: Annotated[list[_RegionFile], Field(min_length=1)]

    @model_validator(mode="after")
    def _names_differ(self) -> _ObjectFile:
        """Refuse two regions of one name."""
        for regions in (self.robot_grasps, self.human_grasps):
            names = [region.name for region in regions]
            if len(set(names)) != len(names):
                raise ValueError(f"region names must differ, got {names}")
        if len(self.human_grasps) < self.hands:
            raise ValueError(f"an object for {self.hands} hands needs as many human grasps")
        return self


def load_object(name: str) -> ObjectModel:
    """Return the object of ``config/objects/<name>.yaml``.

    Raises:
        UnknownNameError: There is no such object.
        BadModelError: The file is wrong; the message names file and field.
    """
    path = config_file("objects", name)
    content = read_yaml(path, _ObjectFile)
    try:
        return ObjectModel(
            name=path.stem,
            mass=content.mass,
            hands=content.hands,
            primitives=tuple(_primitive(item, content.colour) for item in content.primitives),
            robot_grasps=tuple(RobotGrasp(_region(item), item.width) for item in content.robot_grasps),
            human_grasps=tuple(_region(item) for item in content.human_grasps),
            keep_upright=content.keep_upright,
        )
    except BadModelError as error:
        raise BadModelError(f"{path}: {error}") from None


def load_catalogue() -> dict[str, ObjectModel]:
    """Return all objects of ``config/objects`` by name."""
    return {name: load_object(name) for name in config_names("objects")}


def _primitive(item: _PrimitiveFile, default_colour: Colour) -> Primitive:
    """Return the solid of a file entry."""
    colour = item.colour or default_colour
    if item.ends is None:
        return Primitive(item.type, item.size, transform_from_xyz_rpy(item.xyz, item.rpy), colour)
    start, end = np.array(item.ends[0]), np.array(item.ends[1])
    axis = (end - start) / np.linalg.norm(end - start)
    helper = np.eye(3)[np.argmin(np.abs(axis))]
    across = np.cross(axis, helper) / np.linalg.norm(np.cross(axis, helper))
    rotation = np.column_stack([np.cross(across, axis), across, axis])
    length = float(np.linalg.norm(end - start))
    return Primitive(item.type, (*item.size, length), make_transform(rotation, (start + end) / 2.0), colour)


def _region(item: _RegionFile) -> TaskSpaceRegion:
    """Return the region of a file entry."""
    approach, across = np.array(item.hand.approach), np.array(item.hand.across)
    lengths = np.linalg.norm(approach), np.linalg.norm(across)
    if min(lengths) < 1e-6 or abs(approach @ across) > 1e-3 * lengths[0] * lengths[1]:
        raise BadModelError(f"region {item.name!r}: hand.approach and hand.across must be perpendicular and not zero")
    approach, across = approach / lengths[0], across / lengths[1]
    rotation = np.column_stack([np.cross(across, approach), across, approach])
    bounds = item.bounds
    return TaskSpaceRegion(
        name=item.name,
        object_from_region=transform_from_xyz_rpy(item.xyz, item.rpy),
        region_from_hand=make_transform(rotation, item.hand.xyz),
        bounds=np.array([bounds.x, bounds.y, bounds.z, bounds.roll, bounds.pitch, bounds.yaw]),
    )
