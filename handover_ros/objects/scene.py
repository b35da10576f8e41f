"""The scene of a cell: tables, where objects rest and go, where the person stands; from ``config/scenes/*.yaml``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field, model_validator

from handover_ros.errors import BadModelError
from handover_ros.geometry import FloatArray, transform_from_xyz_rpy
from handover_ros.objects.catalogue import Colour
from handover_ros.resources import config_file, config_names
from handover_ros.yaml_file import Schema, Vector3, read_yaml

LEG_WIDTH = 0.04
TOP_THICKNESS = 0.03

Length = Annotated[float, Field(gt=0.0, le=20.0)]


@dataclass(frozen=True, eq=False)
class SceneBox:
    """A fixed box: full lengths ``size`` [m], centre ``world_from_box`` (4, 4), colour (red, green, blue, opacity)."""

    name: str
    size: tuple[float, float, float]
    world_from_box: FloatArray
    colour: Colour


@dataclass(frozen=True)
class Camera:
    """A view of the scene for pictures: ``position`` and ``target`` [m] in world, vertical ``field_of_view`` [rad]."""

    position: tuple[float, float, float]
    target: tuple[float, float, float]
    field_of_view: float
    name: str = "overview"


@dataclass(frozen=True, eq=False)
class Scene:
    """A cell's fixed surroundings and its start.

    Attributes:
        name: As in ``config/scenes``.
        robot: Robot's name, as in ``config/robots``.
        person: Person's name, as in ``config/people``; empty: nobody.
        boxes: Tables, racks and walls.
        placements: Object name to world_from_object (4, 4) at the start.
        goals: Object name to world_from_object (4, 4) where the person shall bring it.
        default_goal_surface: Name of the box on which goals lie.
        person_pose: world_from_feet (4, 4): x forward, origin on the floor between the feet.
        cameras: Views for pictures, the first one is the default.
    """

    name: str
    robot: str
    person: str
    boxes: tuple[SceneBox, ...]
    placements: dict[str, FloatArray]
    goals: dict[str, FloatArray]
    default_goal_surface: str
    person_pose: FloatArray
    cameras: tuple[Camera, ...]

    def box(self, name: str) -> SceneBox:
        """Return a box by name.

        Raises:
            BadModelError: There is no such box.
        """
        for box in self.boxes:
            if box.name == name:
                return box
        raise BadModelError(f"scene {self.name!r} has no box {name!r}; boxes: {', '.join(b.name for b in self.boxes)}")


class _PoseFile(Schema):
    """Position [m] and roll, pitch, yaw [rad] in world."""

    xyz: Vector3
    rpy: Vector3 = (0.0, 0.0, 0.0)


class _BoxFile(_PoseFile):
    """A box: full lengths [m] and pose of its centre."""

    size: tuple[Length, Length, Length]
    colour: Colour = (0.6, 0.6, 0.6, 1.0)


class _TableFile(Schema):
    """A table with four legs: centre of the top, its lengths along x and y, height of its upper side [m]."""

    centre: tuple[float, float]
    size: tuple[Length, Length]
    height: Length
    colour: Colour = (0.72, 0.58, 0.42, 1.0)
    leg_colour: Colour = (0.25, 0.26, 0.28, 1.0)


class _PersonFile(_PoseFile):
    """Who stands where: pose of the floor frame under the person."""

    name: str = ""


class _CameraFile(Schema):
    """A picture's view; ``field_of_view`` is vertical [rad]."""

    position: Vector3
    target: Vector3
    field_of_view: Annotated[float, Field(gt=0.05, lt=2.6)] = 0.8

    @model_validator(mode="after")
    def _looks_somewhere(self) -> _CameraFile:
        """Refuse a camera that looks at itself."""
        if self.position == self.target:
            raise ValueError("position and target must differ")
        return self


class _SceneFile(Schema):
    """Content of one file of ``config/scenes``."""

    robot: str
    person: _PersonFile
    tables: dict[str, _TableFile] = {}
    boxes: dict[str, _BoxFile] = {}
    objects: dict[str, _PoseFile] = {}
    goals: dict[str, _PoseFile] = {}
    goal_surface: str
    cameras: Annotated[dict[str, _CameraFile], Field(min_length=1)]


def load_scene(name: str) -> Scene:
    """Return the scene of ``config/scenes/<name>.yaml``.

    Raises:
        UnknownNameError: There is no such scene.
        BadModelError: The file is wrong or names an object or surface that does not exist.
    """
    path = config_file("scenes", name)
    content = read_yaml(path, _SceneFile)
    known = config_names("objects")
    for field, entries in (("objects", content.objects), ("goals", content.goals)):
        for object_name in entries:
            if object_name not in known:
                raise BadModelError(f"{path}: {field}: unknown object {object_name!r}; known: {', '.join(known)}")
    boxes = [box for table_name, table in content.tables.items() for box in _table_boxes(table_name, table)]
    boxes += [
        SceneBox(box_name, box.size, transform_from_xyz_rpy(box.xyz, box.rpy), box.colour)
        for box_name, box in content.boxes.items()
    ]
    names = [box.name for box in boxes]
    if len(set(names)) != len(names):
        raise BadModelError(f"{path}: two boxes share a name among {names}")
    if content.goal_surface not in names:
        raise BadModelError(f"{path}: goal_surface: no box {content.goal_surface!r}; boxes: {', '.join(names)}")
    return Scene(
        name=path.stem,
        robot=content.robot,
        person=content.person.name,
        boxes=tuple(boxes),
        placements={key: transform_from_xyz_rpy(pose.xyz, pose.rpy) for key, pose in content.objects.items()},
        goals={key: transform_from_xyz_rpy(pose.xyz, pose.rpy) for key, pose in content.goals.items()},
        default_goal_surface=content.goal_surface,
        person_pose=transform_from_xyz_rpy(content.person.xyz, content.person.rpy),
        cameras=tuple(
            Camera(camera.position, camera.target, camera.field_of_view, camera_name)
            for camera_name, camera in content.cameras.items()
        ),
    )


def _table_boxes(name: str, table: _TableFile) -> list[SceneBox]:
    """Return the top (named as the table) and the four legs of a table."""
    (x, y), (length, width) = table.centre, table.size
    top_pose = transform_from_xyz_rpy((x, y, table.height - TOP_THICKNESS / 2.0))
    boxes = [SceneBox(name, (length, width, TOP_THICKNESS), top_pose, table.colour)]
    leg = table.height - TOP_THICKNESS
    for index, (sign_x, sign_y) in enumerate(((1, 1), (1, -1), (-1, 1), (-1, -1)), start=1):
        position = (x + sign_x * (length - LEG_WIDTH) / 2.0, y + sign_y * (width - LEG_WIDTH) / 2.0, leg / 2.0)
        size = (LEG_WIDTH, LEG_WIDTH, leg)
        boxes.append(SceneBox(f"{name}_leg_{index}", size, transform_from_xyz_rpy(position), table.leg_colour))
    return boxes
