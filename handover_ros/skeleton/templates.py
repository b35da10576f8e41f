"""Templates: the tree of a kind of skeleton, without lengths, axes or limits; a YAML file each in config/skeletons."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from handover_ros.errors import BadRecordingError, ErrorCode
from handover_ros.geometry import FloatArray
from handover_ros.resources import config_file, config_names
from handover_ros.skeleton.tree import DISPLACEMENTS, WORLD, Joint, JointKind, Skeleton
from handover_ros.yaml_file import Schema, Vector3, read_yaml

Name = Annotated[str, Field(min_length=1, pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
KINDS = {"revolute": JointKind.REVOLUTE, "prismatic": JointKind.PRISMATIC, "ball": JointKind.BALL}
MINIMUM_ROOT_MARKERS = 3


class TemplateJoint(Schema):
    """One joint.

    ``positive`` gives, for each displacement, the direction (root frame: x forward, y left, z up) about or along which
    it counts positive. For a ball joint these directions are its axes in sequence; for other joints only the sign is
    taken from it, the axis itself is fitted. ``meets``: a joint whose axis this one's axis meets in a point.

    Wishes, heard where the markers leave it open: ``right_angle_to`` a joint whose axis this one's crosses at a right
    angle, ``towards`` a joint through whose point this one's axis runs.

    ``side`` says on which side of the body the joint lies, and ``one_way`` that from standing it moves to the positive
    side only (an elbow), to notice when left and right are swapped.
    """

    name: Name
    kind: Literal["revolute", "prismatic", "ball"]
    parent: Name
    segment: Name
    displacements: tuple[Name, ...] = Field(min_length=1)
    positive: tuple[Vector3, ...] = ()
    meets: Name | None = None
    right_angle_to: Name | None = None
    towards: Name | None = None
    side: Literal["left", "right"] | None = None
    one_way: bool = False

    @model_validator(mode="after")
    def _check(self) -> TemplateJoint:
        count = DISPLACEMENTS[KINDS[self.kind]]
        if len(self.displacements) != count:
            raise ValueError(f"displacements: a {self.kind} joint has {count}, got {len(self.displacements)}")
        if self.positive and len(self.positive) != count:
            raise ValueError(f"positive: needs one direction for each of the {count} displacements")
        directions = np.array(self.positive, dtype=float).reshape(-1, 3)
        if len(directions) and np.linalg.norm(directions, axis=1).min() < 1e-6:
            raise ValueError("positive: a direction must not be zero")
        if self.kind == "ball" and len(directions) and np.abs(directions @ directions.T - np.eye(3)).max() > 1e-6:
            raise ValueError("positive: the axes of a ball joint must be of unit length and at right angles")
        return self

    @property
    def directions(self) -> FloatArray:
        """``positive`` as unit vectors (n, 3); x, y, z where it is left out."""
        if not self.positive:
            return np.eye(3)[: len(self.displacements)]
        directions = np.array(self.positive, dtype=float)
        return directions / np.linalg.norm(directions, axis=1, keepdims=True)


class SkeletonTemplate(Schema):
    """Content of ``config/skeletons/<name>.yaml``.

    ``root`` is the segment that moves freely, or ``world`` when the first joints hang on something fixed. ``hands`` are
    the segments that take objects, by side.
    """

    description: str
    root: Name
    joints: tuple[TemplateJoint, ...] = Field(min_length=1)
    hands: dict[Literal["left", "right"], Name] = {}

    @model_validator(mode="after")
    def _check(self) -> SkeletonTemplate:
        known, names = {self.root}, set()
        for joint in self.joints:
            if joint.parent not in known:
                raise ValueError(f"joints.{joint.name}.parent: {joint.parent!r} is carried by no earlier joint")
            if joint.segment in known:
                raise ValueError(f"joints.{joint.name}.segment: {joint.segment!r} is carried twice")
            if joint.meets is not None and joint.meets not in names:
                raise ValueError(f"joints.{joint.name}.meets: {joint.meets!r} is no earlier joint")
            if joint.name in names:
                raise ValueError(f"joints: {joint.name!r} appears twice")
            if joint.right_angle_to is not None and joint.right_angle_to not in names:
                raise ValueError(f"joints.{joint.name}.right_angle_to: {joint.right_angle_to!r} is no earlier joint")
            if joint.towards is not None and joint.towards not in {each.name for each in self.joints}:
                raise ValueError(f"joints.{joint.name}.towards: {joint.towards!r} is no joint")
            known.add(joint.segment)
            names.add(joint.name)
        displacements = [name for joint in self.joints for name in joint.displacements]
        if repeated := sorted({name for name in displacements if displacements.count(name) > 1}):
            raise ValueError(f"joints: displacement {repeated[0]!r} appears twice")
        for side, segment in self.hands.items():
            if segment not in known:
                raise ValueError(f"hands.{side}: {segment!r} is carried by no joint")
        return self

    @property
    def segments(self) -> tuple[str, ...]:
        """All segments, the root first."""
        return (self.root, *(joint.segment for joint in self.joints))


@dataclass(frozen=True)
class NamedTemplate:
    """A template and the name of its file."""

    name: str
    content: SkeletonTemplate


def load_template(name: str) -> NamedTemplate:
    """Return a template of ``config/skeletons`` by name, or by the path of its YAML file.

    Raises:
        UnknownNameError: There is none of that name.
        BadModelError: The file is wrong; the message names file and field.
    """
    path = config_file("skeletons", name)
    return NamedTemplate(path.stem, read_yaml(path, SkeletonTemplate))


def matching_template(segments: tuple[str, ...]) -> NamedTemplate | None:
    """Return the template that makes use of most markers, given the segment of each; the smallest of equals.

    None when no template finds three markers on its root and one on each of its hands.
    """
    best: tuple[tuple[int, int], NamedTemplate] | None = None
    for name in config_names("skeletons"):
        template = load_template(name)
        content = template.content
        used = sum(segment in content.segments for segment in segments)
        root = segments.count(content.root) if content.root != WORLD else MINIMUM_ROOT_MARKERS
        ends = set(content.segments) - {joint.parent for joint in content.joints}
        if root < MINIMUM_ROOT_MARKERS or any(segment not in segments for segment in ends):
            continue
        score = (used, -len(content.joints))
        if best is None or score > best[0]:
            best = score, template
    return best[1] if best else None


def blank_skeleton(template: NamedTemplate, names: tuple[str, ...], segments: tuple[str, ...]) -> Skeleton:
    """Return the skeleton of a template with its markers; geometry and limits are still to be found.

    Args:
        template: The tree.
        names: Marker names of a stream.
        segments: The segment that carries each; markers on segments the template lacks are left out.

    Raises:
        BadRecordingError: A free root carries fewer than three markers, or a segment at the end of a limb none.
    """
    content = template.content
    wanted = [index for index, segment in enumerate(segments) if segment in content.segments]
    used = tuple(segments[index] for index in wanted)
    if content.root != WORLD and used.count(content.root) < MINIMUM_ROOT_MARKERS:
        raise BadRecordingError(
            f"skeleton template {template.name!r} needs at least {MINIMUM_ROOT_MARKERS} markers on segment "
            f"{content.root!r}, the marker set has {used.count(content.root)}; add markers there or choose another "
            "template",
            ErrorCode.NOT_ENOUGH_DATA,
        )
    ends = [segment for segment in content.segments if segment not in {joint.parent for joint in content.joints}]
    for segment in ends:
        if segment not in used:
            raise BadRecordingError(
                f"skeleton template {template.name!r}: no marker on segment {segment!r}, so its joints cannot be seen; "
                "add markers there or choose another template",
                ErrorCode.NOT_ENOUGH_DATA,
            )
    joints = [
        Joint(
            joint.name,
            KINDS[joint.kind],
            joint.parent,
            joint.segment,
            joint.displacements,
            joint.directions,
            np.zeros(3),
        )
        for joint in content.joints
    ]
    if content.root != WORLD:
        root = Joint(f"{content.root}_root", JointKind.FREE, WORLD, content.root, (), np.zeros((0, 3)), np.zeros(3))
        joints.insert(0, root)
    count = sum(len(joint.displacement_names) for joint in joints)
    return Skeleton(
        name=template.name,
        joints=tuple(joints),
        marker_names=tuple(names[index] for index in wanted),
        marker_segments=used,
        markers=np.zeros((len(wanted), 3)),
        lower=np.full(count, -np.inf),
        upper=np.full(count, np.inf),
        hands=tuple(content.hands.items()),
    )
