"""Profiles: what is stored about one person, as readable JSON with a version.

Limits that are not known, and figures that could not be computed, are ``null``; every other number is finite.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, ValidationError, model_validator

from handover_ros.errors import BadModelError, BadRequestError
from handover_ros.geometry import FloatArray
from handover_ros.skeleton.calibration_report import CalibrationReport, JointQuality, MarkerError
from handover_ros.skeleton.tree import Joint, JointKind, Skeleton
from handover_ros.yaml_file import Schema, Vector3, first_problem

FORMAT, VERSION = "handover_ros profile", 1
SAFE_ID = re.compile(r"[A-Za-z0-9_-]{1,64}")
MAX_BYTES = 10_000_000
MAX_TEXT = 500  # characters of a person's name or a note

KIND_NAMES = {kind: kind.name.lower() for kind in JointKind}


def safe_profile_id(profile_id: str) -> str:
    """Return a profile's name as it is, if it can be a file's name.

    Raises:
        BadRequestError: It is empty, too long, or holds anything but letters, digits, - and _.
    """
    if not SAFE_ID.fullmatch(profile_id):
        shown = profile_id if len(profile_id) <= 80 else profile_id[:77] + "..."
        raise BadRequestError(f"profile_id {shown!r}: give 1 to 64 of the letters A-Z a-z, digits, - and _")
    return profile_id


@dataclass(frozen=True, eq=False)
class Profile:
    """Everything stored about one person.

    Attributes:
        profile_id: Name of the file; see :func:`safe_profile_id`.
        person: How the operator calls the person.
        created: Time of the fit, ISO 8601 in UTC.
        marker_set: Marker set of the data.
        template: Template of the skeleton.
        skeleton: The person's skeleton with limits.
        report: What the calibration found out.
        notes: Sentences for the operator.
        source: Where the data came from.
        versions: Versions of the software that made it.
    """

    profile_id: str
    person: str
    created: str
    marker_set: str
    template: str
    skeleton: Skeleton
    report: CalibrationReport
    notes: tuple[str, ...] = ()
    source: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check what becomes a file name.

        Raises:
            BadRequestError: ``profile_id`` is not safe.
        """
        safe_profile_id(self.profile_id)

    @property
    def created_seconds(self) -> float:
        """Time of the fit [s] since 1970."""
        return datetime.fromisoformat(self.created.replace("Z", "+00:00")).timestamp()


def utc_now() -> str:
    """Return the wall clock as ISO 8601 in UTC, to the second."""
    return datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")


# The stored form


def _is_time(text: str) -> str:
    if datetime.fromisoformat(text.replace("Z", "+00:00")).tzinfo is None:
        raise ValueError("needs a time zone, e.g. 2026-01-31T12:00:00Z")
    return text


Text = Annotated[str, Field(max_length=MAX_TEXT)]
Name = Annotated[str, Field(min_length=1, max_length=MAX_TEXT)]
Count = Annotated[int, Field(ge=0)]
Unknowable = Annotated[float | None, Field(description="null: not known")]


class DisplacementEntry(Schema):
    """One displacement; limits in rad or m."""

    name: Name
    axis: Vector3
    lower: Unknowable
    upper: Unknowable

    @model_validator(mode="after")
    def _check(self) -> DisplacementEntry:
        if self.lower is not None and self.upper is not None and self.lower > self.upper:
            raise ValueError(f"limits of {self.name} cross: lower {self.lower:g} is above upper {self.upper:g}")
        return self


class JointEntry(Schema):
    """One joint; point [m] and axes in the zero frame."""

    name: Name
    kind: Literal["revolute", "prismatic", "ball", "free"]
    parent: Name
    segment: Name
    point: Vector3
    displacements: tuple[DisplacementEntry, ...]


class MarkerEntry(Schema):
    """One marker; position [m] in the zero frame."""

    name: Name
    segment: Name
    position: Vector3


class SkeletonEntry(Schema):
    """The skeleton; its name is that of its template."""

    name: Name
    joints: tuple[JointEntry, ...] = Field(min_length=1, max_length=200)
    markers: tuple[MarkerEntry, ...] = Field(max_length=2000)
    hands: dict[Literal["left", "right"], Name]


class MarkerErrorEntry(Schema):
    """How well one marker is explained [m]."""

    name: Name
    segment: Name
    fitted_rms: Unknowable
    heldout_mean: Unknowable


class JointQualityEntry(Schema):
    """What is known of one displacement [rad] or [m]."""

    name: Name
    displacement: Name
    lower: Unknowable
    upper: Unknowable
    moved: Unknowable
    axis_error: Unknowable
    point_error: Unknowable


class ReportEntry(Schema):
    """The calibration's figures and sentences; [m] and [s]."""

    frames: Count
    heldout_frames: Count
    missing_fraction: Unknowable
    fit_rms: Unknowable
    heldout_mean: Unknowable
    seconds: Unknowable
    markers: tuple[MarkerErrorEntry, ...]
    joints: tuple[JointQualityEntry, ...]
    problems: tuple[str, ...]
    advice: tuple[str, ...]


class ProfileFile(Schema):
    """Content of a stored profile, version 1."""

    format: Literal["handover_ros profile"]
    version: Literal[1]
    profile_id: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
    person: Text
    created: Annotated[str, AfterValidator(_is_time)]
    marker_set: Text
    template: Text
    source: str
    versions: dict[str, str]
    notes: tuple[str, ...]
    report: ReportEntry
    skeleton: SkeletonEntry


def profile_to_json(profile: Profile) -> str:
    """Return a profile as JSON text."""
    return readable_json(profile_document(profile)) + "\n"


def profile_document(profile: Profile) -> dict[str, Any]:
    """Return a profile as plain values."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "profile_id": profile.profile_id,
        "person": profile.person,
        "created": profile.created,
        "marker_set": profile.marker_set,
        "template": profile.template,
        "source": profile.source,
        "versions": dict(profile.versions),
        "notes": list(profile.notes),
        "report": report_document(profile.report),
        "skeleton": skeleton_document(profile.skeleton),
    }


def report_document(report: CalibrationReport) -> dict[str, Any]:
    """Return a report as plain values; what is not finite is None."""

    def entry(item: object, schema: type[Schema]) -> dict[str, Any]:
        return {key: _known(getattr(item, key)) for key in schema.model_fields}

    return {
        **entry(report, ReportEntry),
        "markers": [entry(marker, MarkerErrorEntry) for marker in report.markers],
        "joints": [entry(joint, JointQualityEntry) for joint in report.joints],
        "problems": list(report.problems),
        "advice": list(report.advice),
    }


def skeleton_document(skeleton: Skeleton) -> dict[str, Any]:
    """Return a skeleton as plain values."""
    joints = []
    for index, joint in enumerate(skeleton.joints):
        columns = skeleton.slice_of(index)
        limits = zip(skeleton.lower[columns].tolist(), skeleton.upper[columns].tolist())
        displacements = [
            {"name": name, "axis": axis, "lower": _known(lower), "upper": _known(upper)}
            for name, axis, (lower, upper) in zip(joint.displacement_names, joint.axes.tolist(), limits)
        ]
        joints.append(
            {
                "name": joint.name,
                "kind": KIND_NAMES[joint.kind],
                "parent": joint.parent,
                "segment": joint.segment,
                "point": joint.point.tolist(),
                "displacements": displacements,
            }
        )
    markers = [
        {"name": name, "segment": segment, "position": position}
        for name, segment, position in zip(skeleton.marker_names, skeleton.marker_segments, skeleton.markers.tolist())
    ]
    return {"name": skeleton.name, "joints": joints, "markers": markers, "hands": dict(skeleton.hands)}


def _known(value: Any) -> Any:
    """Return a plain value, None for numbers that are not finite."""
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value


def readable_json(value: Any, indent: int = 0) -> str:
    """Return JSON text with an entry a line, but vectors and small objects on one line.

    Raises:
        ValueError: A number is not finite.
    """
    flat = json.dumps(value, ensure_ascii=False, allow_nan=False)
    if not isinstance(value, (dict, list)) or (len(flat) + indent <= 118 and not _is_nested(value)):
        return flat
    space = " " * (indent + 2)
    if isinstance(value, dict):
        items = [f"{json.dumps(key)}: {readable_json(item, indent + 2)}" for key, item in value.items()]
        opening, closing = "{}"
    else:
        items = [readable_json(item, indent + 2) for item in value]
        opening, closing = "[]"
    return f"{opening}\n{space}" + f",\n{space}".join(items) + f"\n{' ' * indent}{closing}"


def _is_nested(value: dict[str, Any] | list[Any]) -> bool:
    """Return whether a value holds objects, or lists of lists."""
    items = value.values() if isinstance(value, dict) else value
    return any(
        isinstance(item, dict) or (isinstance(item, list) and any(isinstance(each, (dict, list)) for each in item))
        for item in items
    )


def read_profile(path: Path) -> Profile:
    """Return the profile in a file.

    Raises:
        BadModelError: The file cannot be read or used; names file and field.
    """
    try:
        if not path.is_file():
            raise BadModelError(f"{path}: no such file")
        if (size := path.stat().st_size) > MAX_BYTES:
            raise BadModelError(f"{path}: {size} bytes, a profile has at most {MAX_BYTES}")
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise BadModelError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise BadModelError(f"{path}: is not UTF-8 text (byte {error.start})") from None
    return profile_from_json(text, str(path))


def profile_from_json(text: str, where: str = "profile") -> Profile:
    """Return the profile of a JSON text.

    Args:
        text: The text.
        where: Name of its file or topic, for the error.

    Raises:
        BadModelError: One line that names ``where`` and the field.
    """
    try:
        document = json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=_without_repetition)
    except json.JSONDecodeError as error:
        cut = "; the file is cut short" if error.pos >= len(text.rstrip()) - 1 else ""
        raise BadModelError(
            f"{where}: is not valid JSON: line {error.lineno}, column {error.colno}: {error.msg}{cut}"
        ) from None
    except (ValueError, RecursionError) as error:
        raise BadModelError(f"{where}: is not valid JSON: {error}") from None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise BadModelError(f"{where}: format: is no profile (expected {FORMAT!r})")
    if document.get("version") != VERSION:
        raise BadModelError(
            f"{where}: version: {str(document.get('version'))[:40]!r} is not known, this software reads {VERSION}; "
            "update it"
        )
    try:
        content = ProfileFile.model_validate(document)
    except ValidationError as error:
        raise BadModelError(f"{where}: {first_problem(error)}") from None
    try:
        skeleton = _skeleton(content)
    except BadModelError as error:
        raise BadModelError(f"{where}: skeleton: {error}") from None
    return Profile(
        profile_id=content.profile_id,
        person=content.person,
        created=content.created,
        marker_set=content.marker_set,
        template=content.template,
        skeleton=skeleton,
        report=_report(content.report),
        notes=content.notes,
        source=content.source,
        versions=content.versions,
    )


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is no number; what is not known is null")


def _without_repetition(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) != len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"field {next(key for key in keys if keys.count(key) > 1)!r} stands twice")
    return result


def _skeleton(content: ProfileFile) -> Skeleton:
    entries = content.skeleton.joints
    joints = tuple(
        Joint(
            entry.name,
            JointKind[entry.kind.upper()],
            entry.parent,
            entry.segment,
            tuple(each.name for each in entry.displacements),
            np.array([each.axis for each in entry.displacements], dtype=float).reshape(-1, 3),
            np.array(entry.point),
        )
        for entry in entries
    )
    displacements = [each for entry in entries for each in entry.displacements]
    markers = content.skeleton.markers
    return Skeleton(
        name=content.skeleton.name,
        joints=joints,
        marker_names=tuple(marker.name for marker in markers),
        marker_segments=tuple(marker.segment for marker in markers),
        markers=np.array([marker.position for marker in markers], dtype=float).reshape(-1, 3),
        lower=_limits([each.lower for each in displacements], -np.inf),
        upper=_limits([each.upper for each in displacements], np.inf),
        hands=tuple(content.skeleton.hands.items()),
    )


def _limits(values: list[float | None], unknown: float) -> FloatArray:
    return np.array([unknown if value is None else value for value in values], dtype=float)


def _report(entry: ReportEntry) -> CalibrationReport:
    def numbers(item: Schema, unknown: Mapping[str, float] | None = None) -> dict[str, Any]:
        values = {key: getattr(item, key) for key in type(item).model_fields}
        return {key: (unknown or {}).get(key, math.nan) if value is None else value for key, value in values.items()}

    open_ended = {"lower": -math.inf, "upper": math.inf}
    return CalibrationReport(
        **{
            **numbers(entry),
            "markers": tuple(MarkerError(**numbers(marker)) for marker in entry.markers),
            "joints": tuple(JointQuality(**numbers(joint, open_ended)) for joint in entry.joints),
        }
    )
