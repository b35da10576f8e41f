"""The shapes of a URDF's links, visual and collision, as plain values (pinocchio gives the joints and inertias)."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from handover_ros.errors import BadModelError
from handover_ros.geometry import FloatArray, transform_from_xyz_rpy

PACKAGE_PREFIX = "package://"
DEFAULT_COLOUR = (0.35, 0.36, 0.38, 1.0)


@dataclass(frozen=True, eq=False)
class LinkShape:
    """One shape of a link.

    Attributes:
        link: Name of the link.
        role: ``visual`` or ``collision``.
        type: ``box``, ``cylinder``, ``sphere`` or ``mesh``.
        size: Box: full lengths; cylinder: radius, length; sphere: radius; mesh: scale of x, y, z [m].
        mesh: Mesh file; None for the other types.
        link_from_shape: Pose of the shape in the link's frame, shape (4, 4).
        colour: Of the link's material: red, green, blue, opacity.
    """

    link: str
    role: Literal["visual", "collision"]
    type: str
    size: tuple[float, ...]
    mesh: Path | None
    link_from_shape: FloatArray
    colour: tuple[float, float, float, float]


def link_shapes(urdf: Path, package_directory: Path) -> tuple[LinkShape, ...]:
    """Return all shapes of a URDF.

    Args:
        urdf: The file.
        package_directory: Folder that ``package://`` addresses start from.

    Raises:
        BadModelError: The file is missing, no XML, or has a shape that is not understood.
    """
    try:
        root = ElementTree.parse(urdf).getroot()
    except (OSError, ElementTree.ParseError) as error:
        raise BadModelError(f"{urdf}: not a URDF that can be read: {error}") from None
    named_colours = {
        material.get("name"): _numbers(colour.get("rgba", ""))
        for material in root.iter("material")
        if (colour := material.find("color")) is not None
    }
    shapes = []
    for link in root.findall("link"):
        for role in ("visual", "collision"):
            for element in link.findall(role):
                try:
                    shapes.append(_shape(link.get("name", ""), role, element, package_directory, named_colours))
                except (TypeError, ValueError) as error:
                    raise BadModelError(f"{urdf}: link {link.get('name')!r}: {role}: {error}") from None
    return tuple(shapes)


def _shape(
    link: str,
    role: Literal["visual", "collision"],
    element: ElementTree.Element,
    package_directory: Path,
    named_colours: dict[str | None, tuple[float, ...]],
) -> LinkShape:
    """Return the shape of one ``visual`` or ``collision`` element."""
    geometry = element.find("geometry")
    if geometry is None or len(geometry) == 0:
        raise ValueError("has no geometry")
    solid, mesh = geometry[0], None
    if solid.tag == "box":
        size = _numbers(solid.get("size", ""))
    elif solid.tag == "cylinder":
        size = (float(solid.get("radius", "")), float(solid.get("length", "")))
    elif solid.tag == "sphere":
        size = (float(solid.get("radius", "")),)
    elif solid.tag == "mesh":
        size = _numbers(solid.get("scale", "1 1 1"))
        name = solid.get("filename", "")
        mesh = package_directory / name.removeprefix(PACKAGE_PREFIX) if name.startswith(PACKAGE_PREFIX) else Path(name)
    else:
        raise ValueError(f"unknown geometry {solid.tag!r}")
    origin = element.find("origin")
    attributes = {} if origin is None else origin.attrib
    pose = transform_from_xyz_rpy(_numbers(attributes.get("xyz", "0 0 0")), _numbers(attributes.get("rpy", "0 0 0")))
    material = element.find("material")
    colour = named_colours.get(material.get("name")) if material is not None else None
    if colour is None or len(colour) != 4:
        colour = DEFAULT_COLOUR
    return LinkShape(link, role, solid.tag, size, mesh, pose, (colour[0], colour[1], colour[2], colour[3]))


def _numbers(text: str) -> tuple[float, ...]:
    """Return the numbers of a space-separated attribute."""
    return tuple(float(part) for part in text.split())
