"""A skeleton as URDF, so that any ROS tool shows the person: RViz, robot_state_publisher, pinocchio, MuJoCo.

One link for each segment; its frame has the axes of the zero frame and its origin at its joint's point. A joint has
the name of its displacement, so that a JointState of displacement names moves the person. URDF knows no ball joint:
three revolute joints in sequence with light links between them stand for it (eq. 2.12). A free root is the root link;
where it stands is a transform that somebody publishes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from handover_ros.errors import BadModelError, UnknownNameError
from handover_ros.geometry import FloatArray
from handover_ros.skeleton.landmarks import bones
from handover_ros.skeleton.tree import JointKind, Skeleton

# URDF wants a limit of every joint; these stand for an unknown one.
UNKNOWN_ANGLE, UNKNOWN_LENGTH = 2.0 * np.pi, 10.0  # [rad], [m]
EFFORT, VELOCITY = 300.0, 20.0  # [N m] or [N], [rad/s] or [m/s]: more than a person has, to keep tools from clipping
LIGHT_MASS, LIGHT_INERTIA = 1e-6, 1e-9  # [kg], [kg m2]: tools refuse moving links without any
MARKER_RADIUS = 0.007  # [m]
RADIUS_OF_LENGTH, THINNEST, THICKEST = 0.14, 0.012, 0.045  # a limb's radius over its length, bounds [m]
COLOURS = {"body": "0.45 0.55 0.68 1.0", "marker": "0.92 0.94 0.97 1.0"}


@dataclass(frozen=True, eq=False)
class SegmentInertia:
    """How heavy a segment is, in the zero frame.

    Attributes:
        mass: [kg].
        centre: Centre of mass [m], shape (3,).
        tensor: Inertia about the centre of mass [kg m2], shape (3, 3).
    """

    mass: float
    centre: FloatArray
    tensor: FloatArray


def skeleton_urdf(
    skeleton: Skeleton, inertias: Mapping[str, SegmentInertia] | None = None, name: str = "person"
) -> str:
    """Return the URDF document of a skeleton.

    Args:
        skeleton: The skeleton.
        inertias: Inertia of segments by name; others are light.
        name: Name of the robot in the document.

    Raises:
        UnknownNameError: An inertia is of a segment that the skeleton does not have.
        BadModelError: Two links would have the same name.
    """
    inertias = dict(inertias or {})
    segments = [skeleton.root, *(joint.segment for joint in skeleton.joints if joint.segment != skeleton.root)]
    if unknown := [segment for segment in inertias if segment not in segments]:
        raise UnknownNameError("segment", unknown[0], segments)
    robot = ElementTree.Element("robot", name=name)
    for material, colour in COLOURS.items():
        ElementTree.SubElement(ElementTree.SubElement(robot, "material", name=material), "color", rgba=colour)
    origins = {skeleton.root: np.zeros(3)}
    root = ElementTree.SubElement(robot, "link", name=skeleton.root)
    if skeleton.root in inertias:
        _add_inertia(root, inertias[skeleton.root], np.zeros(3))
    _add_looks(root, skeleton, skeleton.root, np.zeros(3))
    for index, joint in enumerate(skeleton.joints):
        if joint.kind is JointKind.FREE:
            continue
        parent, offset = joint.parent, joint.point - origins[joint.parent]
        columns = skeleton.slice_of(index)
        limits = zip(skeleton.lower[columns], skeleton.upper[columns])
        for displacement, axis, (lower, upper) in zip(joint.displacement_names, joint.axes, limits):
            last = displacement == joint.displacement_names[-1]
            child = joint.segment if last else f"{displacement}_link"
            _add_joint(robot, displacement, joint.kind, parent, child, offset, axis, (float(lower), float(upper)))
            link = ElementTree.SubElement(robot, "link", name=child)
            light = SegmentInertia(LIGHT_MASS, joint.point, LIGHT_INERTIA * np.eye(3))
            _add_inertia(link, inertias.get(child, light) if last else light, joint.point)
            parent, offset = child, np.zeros(3)
        origins[joint.segment] = joint.point
        _add_looks(link, skeleton, joint.segment, joint.point)
    links = [link.attrib["name"] for link in robot.iter("link")]
    if repeated := [link for link in links if links.count(link) > 1]:
        raise BadModelError(f"skeleton {skeleton.name!r}: the name {repeated[0]!r} stands for two links; rename one")
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def _numbers(values: FloatArray) -> str:
    """Return numbers as an attribute, exactly."""
    return " ".join(repr(float(value)) for value in values)


def _add_joint(
    robot: ElementTree.Element,
    name: str,
    kind: JointKind,
    parent: str,
    child: str,
    offset: FloatArray,
    axis: FloatArray,
    limits: tuple[float, float],
) -> None:
    """Add one joint; ``offset`` [m] leads from the parent link's origin to the joint's."""
    slides = kind is JointKind.PRISMATIC
    unknown = UNKNOWN_LENGTH if slides else UNKNOWN_ANGLE
    lower, upper = (value if np.isfinite(value) else np.sign(value) * unknown for value in limits)
    joint = ElementTree.SubElement(robot, "joint", name=name, type="prismatic" if slides else "revolute")
    ElementTree.SubElement(joint, "origin", xyz=_numbers(offset), rpy="0 0 0")
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    ElementTree.SubElement(joint, "axis", xyz=_numbers(axis))
    bounds = {"lower": lower, "upper": upper, "effort": EFFORT, "velocity": VELOCITY}
    ElementTree.SubElement(joint, "limit", {key: repr(float(value)) for key, value in bounds.items()})


def _add_inertia(link: ElementTree.Element, inertia: SegmentInertia, origin: FloatArray) -> None:
    """Add mass and inertia to a link whose frame has its origin at ``origin`` in the zero frame."""
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=_numbers(inertia.centre - origin), rpy="0 0 0")
    ElementTree.SubElement(inertial, "mass", value=repr(float(inertia.mass)))
    names = [(f"i{'xyz'[row]}{'xyz'[column]}", row, column) for row in range(3) for column in range(row, 3)]
    tensor = {key: repr(float(inertia.tensor[row, column])) for key, row, column in names}
    ElementTree.SubElement(inertial, "inertia", tensor)


def _add_looks(link: ElementTree.Element, skeleton: Skeleton, segment: str, origin: FloatArray) -> None:
    """Add rounded limbs from the segment's joint centre to the next ones, and its markers."""
    for owner, start, end in bones(skeleton):
        if owner != segment:
            continue
        length = float(np.linalg.norm(end - start))
        radius = float(np.clip(RADIUS_OF_LENGTH * length, THINNEST, THICKEST))
        turn = Rotation.align_vectors((end - start)[None], np.array([[0.0, 0.0, 1.0]]))[0]
        middle = 0.5 * (start + end) - origin
        _add_shape(link, "cylinder", {"radius": radius, "length": length}, middle, turn.as_euler("xyz"), "body")
        for tip in (start, end):
            _add_shape(link, "sphere", {"radius": radius}, tip - origin, np.zeros(3), "body")
    for position, owner in zip(skeleton.markers, skeleton.marker_segments):
        if owner == segment:
            _add_shape(link, "sphere", {"radius": MARKER_RADIUS}, position - origin, np.zeros(3), "marker")


def _add_shape(
    link: ElementTree.Element, shape: str, size: dict[str, float], xyz: FloatArray, rpy: FloatArray, material: str
) -> None:
    """Add one visual."""
    visual = ElementTree.SubElement(link, "visual")
    ElementTree.SubElement(visual, "origin", xyz=_numbers(xyz), rpy=_numbers(rpy))
    geometry = ElementTree.SubElement(visual, "geometry")
    ElementTree.SubElement(geometry, shape, {key: repr(value) for key, value in size.items()})
    ElementTree.SubElement(visual, "material", name=material)
