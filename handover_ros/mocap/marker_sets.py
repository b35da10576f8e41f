"""Marker sets: which markers of a source are wanted, what carries them, and how the torso is built from them.

One YAML file per set in ``config/marker_sets``; connecting another motion-capture system is writing one more.
"""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from handover_ros.errors import BadModelError
from handover_ros.geometry import FloatArray
from handover_ros.resources import config_file, config_names
from handover_ros.yaml_file import Schema, Vector3, read_yaml

Name = Annotated[str, Field(min_length=1)]
Names = tuple[Name, ...]

AXES: dict[str, tuple[tuple[float, ...], ...]] = {
    "z_up": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "y_up": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
}
UNITS_IN_METRES = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "in": 0.0254, "inch": 0.0254}


class WantedMarker(Schema):
    """One marker of the set: its name here, the labels it has in sources, and the segment that carries it."""

    name: Name
    segment: Name
    match: Names = ()
    required: bool = True


class TorsoDefinition(Schema):
    """How the torso frame (x forward, y left, z up, origin between the shoulders) follows from markers.

    Either ``template`` gives the markers' positions in the torso frame [m], or the axes are built from the first
    good frames: z from the mean of ``lower`` to the mean of ``upper`` (the world's up if they are left out), then
    perpendicular to it y from ``right`` to ``left``, or x from ``back`` to ``front`` if those are left out.
    The origin is the mean of ``origin`` moved by ``origin_offset`` [m, torso frame].
    ``weights`` are relative to 1 = a marker that scatters by ``marker_noise`` [m] about the rigid body.
    """

    weights: dict[Name, Annotated[float, Field(gt=0, le=1)]]
    marker_noise: float = Field(default=0.002, gt=0, le=0.1)
    template: dict[Name, Vector3] | None = None
    front: Names = ()
    back: Names = ()
    left: Names = ()
    right: Names = ()
    upper: Names = ()
    lower: Names = ()
    origin: Names = ()
    origin_offset: Vector3 = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _check(self) -> TorsoDefinition:
        if len(self.weights) < 3:
            raise ValueError(f"weights: a rigid body needs at least 3 markers, got {len(self.weights)}")
        for first, second in (("front", "back"), ("left", "right"), ("upper", "lower")):
            if bool(getattr(self, first)) != bool(getattr(self, second)):
                raise ValueError(f"{first} and {second} must both be given or both be left out")
        if self.template is None:
            if not self.origin:
                raise ValueError("origin: name the markers whose mean is the origin, or give a template")
            if not self.left and not self.front:
                raise ValueError("give left and right, or front and back, or a template")
        for field, names in self.marker_lists():
            if unknown := [name for name in names if name not in self.weights]:
                raise ValueError(f"{field}: {unknown[0]!r} has no weight; known: {', '.join(self.weights)}")
        return self

    def marker_lists(self) -> list[tuple[str, Names]]:
        """Return the fields that list markers, each with its names."""
        fields = ("front", "back", "left", "right", "upper", "lower", "origin")
        lists = [(field, getattr(self, field)) for field in fields]
        return [*lists, ("template", tuple(self.template or ()))]


class MarkerSetFile(Schema):
    """Content of ``config/marker_sets/<name>.yaml``."""

    description: str = ""
    subject: Name = "*"
    case_sensitive: bool = False
    units: Literal["auto", "m", "dm", "cm", "mm", "in"] = "auto"
    axes: Literal["auto", "z_up", "y_up"] | tuple[Vector3, Vector3, Vector3] = "auto"
    origin_offset: Vector3 = (0.0, 0.0, 0.0)
    markers: tuple[WantedMarker, ...] = Field(min_length=3)
    torso: TorsoDefinition

    @model_validator(mode="after")
    def _check(self) -> MarkerSetFile:
        names = [marker.name for marker in self.markers]
        if repeated := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"markers: {repeated[0]!r} appears more than once")
        if unknown := [name for name in self.torso.weights if name not in names]:
            raise ValueError(f"torso.weights: {unknown[0]!r} is not one of the markers")
        if not isinstance(self.axes, str):
            rows = np.array(self.axes)
            if not np.allclose(rows @ rows.T, np.eye(3), atol=1e-6) or np.linalg.det(rows) < 0:
                raise ValueError("axes: the three rows must form a right-handed rotation")
        return self


@dataclass(frozen=True, eq=False)
class MarkerSet:
    """A checked marker set.

    Attributes:
        name: Name of its file.
        content: The file's content.
        names: The n marker names.
        segments: The segment of each marker, n names.
    """

    name: str
    content: MarkerSetFile
    names: tuple[str, ...]
    segments: tuple[str, ...]

    @property
    def torso(self) -> TorsoDefinition:
        """The torso definition."""
        return self.content.torso

    def axes_rotation(self, source_up: str) -> FloatArray:
        """Return the 3x3 rotation from source axes to z up; ``source_up`` is what the file says (z_up, y_up, empty)."""
        axes = self.content.axes
        if axes == "auto":
            axes = "y_up" if source_up == "y_up" else "z_up"
        return np.array(AXES[axes] if isinstance(axes, str) else axes, dtype=float)


def load_marker_set(name: str) -> MarkerSet:
    """Return a marker set by name, or by the path of its YAML file.

    Raises:
        UnknownNameError: There is no marker set of that name.
        BadModelError: Its file cannot be used.
    """
    path = config_file("marker_sets", name)
    content = read_yaml(path, MarkerSetFile)
    return MarkerSet(
        name=path.stem,
        content=content,
        names=tuple(marker.name for marker in content.markers),
        segments=tuple(marker.segment for marker in content.markers),
    )


def match_labels(marker_set: MarkerSet, labels: tuple[str, ...]) -> list[int | None]:
    """Return for each wanted marker the index of its label in a source, None where the source has none.

    A label is ``SUBJECT:LABEL`` or ``LABEL``. A pattern with a colon is compared with the whole label, one without
    with the part after the colon, and the subject then has to match the set's ``subject``; ``*`` and ``?`` are
    wildcards.

    Raises:
        BadModelError: A required marker has no label, or one marker matches several labels.
    """
    content = marker_set.content

    def fold(text: str) -> str:
        return text if content.case_sensitive else text.casefold()

    split = [fold(label).rpartition(":") for label in labels]
    found: list[int | None] = []
    for marker in content.markers:
        hits: list[int] = []
        for pattern in map(fold, marker.match or (marker.name,)):
            for index, (subject, _, short) in enumerate(split):
                whole = f"{subject}:{short}" if subject else short
                if ":" in pattern:
                    hit = fnmatchcase(whole, pattern)
                else:
                    hit = fnmatchcase(short, pattern) and (not subject or fnmatchcase(subject, fold(content.subject)))
                if hit and index not in hits:
                    hits.append(index)
            if hits:
                break
        if len(hits) > 1:
            several = ", ".join(labels[index] for index in hits[:4])
            raise BadModelError(
                f"marker {marker.name!r} of marker set {marker_set.name!r} matches several labels ({several}); "
                "narrow its match or the set's subject"
            )
        if not hits and marker.required:
            raise BadModelError(
                f"no column or label for marker {marker.name!r} of marker set {marker_set.name!r}; "
                f"the source has {', '.join(labels[:60]) or 'no labels'}"
            )
        found.append(hits[0] if hits else None)
    return found


def matching_marker_set(labels: tuple[str, ...]) -> MarkerSet | None:
    """Return the marker set in ``config/marker_sets`` that knows most of a source's labels, or None if none fits."""
    best: tuple[int, MarkerSet] | None = None
    for name in config_names("marker_sets"):
        marker_set = load_marker_set(name)
        try:
            known = sum(index is not None for index in match_labels(marker_set, labels))
        except BadModelError:
            continue
        if best is None or known > best[0]:
            best = (known, marker_set)
    return best[1] if best else None
