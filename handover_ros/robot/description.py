"""What a robot's YAML file says (``config/robots``), and where its URDF and meshes are."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

from pydantic import Field

from handover_ros.errors import BadModelError
from handover_ros.resources import config_file
from handover_ros.yaml_file import Schema, Vector3, read_yaml

SHARE = "example-robot-data"
SHARE_VARIABLE = "HANDOVER_ROBOT_DATA"

PositiveFloat = Annotated[float, Field(gt=0)]


class Placement(Schema):
    """Position [m] and roll, pitch, yaw [rad] about fixed axes, as in URDF."""

    xyz: Vector3
    rpy: Vector3 = (0.0, 0.0, 0.0)


class Box(Placement):
    """A box of full edge lengths [m] that stands for a mesh in collision checks, in the frame of its link."""

    size: tuple[PositiveFloat, PositiveFloat, PositiveFloat]


class ArmDescription(Schema):
    """One arm: the names that select it in the URDF, and the limits the URDF does not have."""

    joints: list[str] = Field(min_length=1)
    tip_frame: str
    finger_joints: list[str] = []
    opening: tuple[Annotated[float, Field(ge=0)], PositiveFloat]
    acceleration: list[PositiveFloat]
    postures: dict[str, list[float]]


class CollisionDescription(Schema):
    """How the URDF's collision geometry is simplified."""

    ignore_links: list[str] = []
    ignore_pairs: list[tuple[str, str]] = []
    boxes: dict[str, list[Box]] = {}
    margin: Annotated[float, Field(ge=0, le=0.2)] = 0.01


class RobotDescription(Schema):
    """A robot as configured: URDF, place in the world, arms."""

    name: str
    urdf: str
    world_from_base: Placement
    velocity_scale: Annotated[float, Field(gt=0, le=1)] = 0.7
    display_link: str = ""
    arms: dict[str, ArmDescription] = Field(min_length=1)
    collision: CollisionDescription = CollisionDescription()


def share_directory() -> Path:
    """Return the folder that holds ``example-robot-data``: what ``package://`` addresses start from.

    Looked for in ``HANDOVER_ROBOT_DATA`` (an operator's own folder), the Python installation and the ament prefixes.

    Raises:
        BadModelError: It is in none of them.
    """
    candidates = []
    if own := os.environ.get(SHARE_VARIABLE):
        candidates.append(Path(own))
    candidates += [Path(entry) / "cmeel.prefix" / "share" for entry in sys.path if entry]
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    candidates += [Path(prefix) / "share" for prefix in prefixes if prefix]
    candidates += [Path("/opt/openrobots/share"), Path(sys.prefix) / "share"]
    for candidate in candidates:
        if (candidate / SHARE / "robots").is_dir():
            return candidate
    raise BadModelError(
        f"the robot models of {SHARE} are not installed; pip install {SHARE}, or set {SHARE_VARIABLE} to the folder "
        f"that holds {SHARE}/robots"
    )


def read_description(name: str) -> tuple[RobotDescription, Path]:
    """Return the checked description of a robot of ``config/robots`` and the path of its URDF.

    Raises:
        UnknownNameError: There is no such robot.
        BadModelError: Its file cannot be used; the message names file and field.
    """
    file = config_file("robots", name)
    description = read_yaml(file, RobotDescription)
    urdf = Path(description.urdf)
    if not urdf.is_absolute():
        urdf = share_directory() / SHARE / urdf
    if not urdf.is_file():
        raise BadModelError(f"{file}: urdf: there is no file {urdf}")
    for arm_name, arm in description.arms.items():
        _check_arm(f"{file}: arms.{arm_name}", arm)
    return description, urdf


def _check_arm(where: str, arm: ArmDescription) -> None:
    """Raise BadModelError when the numbers of an arm do not fit its joints."""
    count = len(arm.joints)
    if len(arm.acceleration) != count:
        raise BadModelError(
            f"{where}.acceleration: must hold {count} numbers, one a joint, holds {len(arm.acceleration)}"
        )
    if arm.opening[0] >= arm.opening[1]:
        raise BadModelError(
            f"{where}.opening: the closed opening {arm.opening[0]} must be below the open {arm.opening[1]}"
        )
    if "home" not in arm.postures:
        raise BadModelError(f"{where}.postures: a posture named home is required")
    for posture, displacements in arm.postures.items():
        if len(displacements) != count:
            raise BadModelError(f"{where}.postures.{posture}: must hold {count} numbers, holds {len(displacements)}")
