"""A session's folder as it was left: by a session that ended well, failed, or was killed."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from handover_ros.bags.reading import BAG, Bag
from handover_ros.bags.timeline import read_timeline
from handover_ros.bags.timeline_types import ERROR, WARNING, Timeline
from handover_ros.cell.session import END, FILE, FORMAT, PARAMETERS, START
from handover_ros.cell.session_people import BeliefThen, PersonThen, belief_of, people
from handover_ros.errors import BadRequestError, HandoverError
from handover_ros.resources import config_directory
from handover_ros.yaml_file import first_problem

LOGS = "log"
LOG_END = 1 << 20  # [bytes] of a log that are looked at, from its end
LOG_LINE = re.compile(r"\[(WARN|ERROR|FATAL)\] \[[\d.]+\] \[[^\]]*\]: (.*)")
TRACEBACK = "Traceback (most recent call last)"
HERE = "(session)"  # stands for the session's own folder in a parameter


class Document(BaseModel):
    """Content of ``session.json``; what a later version adds is left alone."""

    model_config = ConfigDict(frozen=True)

    format: int
    command: str
    arguments: dict[str, Any] = {}
    began: datetime
    ended: datetime | None = None
    outcome: str
    versions: dict[str, str] = {}
    commit: str = ""
    host: str = ""
    nodes: dict[str, dict[str, Any]] = {}
    metrics: dict[str, int | float | None] = {}


@dataclass(frozen=True)
class LogLine:
    """A line of a node's log that told of trouble, and how often it is there."""

    node: str
    level: str
    text: str
    times: int


@dataclass(frozen=True)
class Setting:
    """A parameter of a node that is not the package's default; ``default``: what that is."""

    node: str
    name: str
    value: Any
    default: Any


@dataclass(frozen=True, eq=False)
class StoredSession:
    """Everything a session left.

    Attributes:
        folder: Where it is.
        document: Its ``session.json``.
        parameters: Of each node, as it was started.
        start: The people at its start.
        end: The people at its end.
        timeline: What its bag tells; None: there is none that can be read.
        bag_note: What is to be said about the bag; empty: it is whole.
        logs: What the nodes' logs tell of troubles.
        notes: What cannot be read.
    """

    folder: Path
    document: Document
    parameters: Mapping[str, Mapping[str, Any]]
    start: tuple[PersonThen, ...]
    end: tuple[PersonThen, ...]
    timeline: Timeline | None
    bag_note: str
    logs: tuple[LogLine, ...]
    notes: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The folder's name."""
        return self.folder.name

    @property
    def duration(self) -> float:
        """Wall time it took [s]; NaN: it did not end."""
        ended = self.document.ended
        return math.nan if ended is None else (ended - self.document.began).total_seconds()

    @property
    def belief(self) -> BeliefThen | None:
        """The last belief about the person who was active last; None: nobody was, or nothing is known of them."""
        for person in self.end:
            if person.active and person.belief is not None:
                return person.belief
        marks = self.timeline.beliefs if self.timeline is not None else ()
        return belief_of(marks[-1]) if marks else None

    def metrics(self) -> dict[str, float]:
        """Return its own numbers, and those of its bag that it does not tell itself."""
        own = {name: math.nan if value is None else value for name, value in self.document.metrics.items()}
        return {**({} if self.timeline is None else self.timeline.metrics()), **own}

    def settings(self) -> list[Setting]:
        """Return the parameters that are not the package's defaults, but for folders of the session itself."""
        found = []
        for node, given in self.parameters.items():
            defaults = read_parameters(config_directory() / f"{node}.yaml", node) or {}
            for name, value in given.items():
                here = isinstance(value, str) and value.startswith(HERE)
                if not here and (name not in defaults or defaults[name] != value):
                    found.append(Setting(node, name, value, defaults.get(name)))
        return found


def is_session(folder: Path) -> bool:
    """Return whether a folder holds a session."""
    return (folder / FILE).is_file()


def read_session(folder: Path, progress: Callable[[float], None] | None = None) -> StoredSession:
    """Return what a session left.

    Args:
        folder: Its folder.
        progress: Is told how much of the bag is read, 0 to 1.

    Raises:
        BadRequestError: The folder holds no session, or its ``session.json`` is none.
    """
    document = read_document(folder)
    notes: list[str] = []
    timeline, bag_note = _timeline(folder / BAG, progress)
    return StoredSession(
        folder=folder.resolve(),
        document=document,
        parameters=_parameters(folder / PARAMETERS, document, notes),
        start=people(folder / START, notes),
        end=people(folder / END, notes),
        timeline=timeline,
        bag_note=bag_note,
        logs=tuple(line for log in sorted((folder / LOGS).glob("*.log")) for line in trouble_lines(log)),
        notes=tuple(notes),
    )


def read_document(folder: Path) -> Document:
    """Return the content of a session's ``session.json``.

    Raises:
        BadRequestError: There is none, or it is damaged or of another version.
    """
    file = folder / FILE
    if not file.is_file():
        raise BadRequestError(f"{folder}: is no session: there is no {FILE} in it; demo and up write such folders")
    try:
        document = Document.model_validate_json(file.read_bytes())
    except OSError as error:
        raise BadRequestError(f"{file}: cannot be read: {error.strerror or error}") from None
    except ValidationError as error:
        raise BadRequestError(f"{file}: {first_problem(error)}") from None
    if document.format != FORMAT:
        raise BadRequestError(f"{file}: format is {document.format}, this program reads {FORMAT}")
    return document


def _timeline(bag: Path, progress: Callable[[float], None] | None) -> tuple[Timeline | None, str]:
    """Return what a bag tells, and what is to be said about it."""
    if not bag.is_dir():
        return None, "nothing was recorded"
    try:
        with Bag(bag) as opened:
            return read_timeline(opened, progress), opened.note
    except HandoverError as error:
        return None, str(error)


def _parameters(folder: Path, document: Document, notes: list[str]) -> dict[str, dict[str, Any]]:
    """Return the parameters of the nodes, with the session's own folder named as such."""
    home = _home(document)
    found = {}
    for file in sorted(folder.glob("*.yaml")):
        given = read_parameters(file, file.stem)
        if given is None:
            notes.append(f"{PARAMETERS}/{file.name}: cannot be read")
            continue
        found[file.stem] = {name: _anywhere(value, home) for name, value in given.items()}
    return found


def _home(document: Document) -> str:
    """Return the session's folder as it was called when it ran; empty: unknown."""
    for node, name in (("recorder_node", "bag"), ("sim_node", "picture_directory")):
        place = document.nodes.get(node, {}).get(name)
        if isinstance(place, str) and Path(place).is_absolute():
            return str(Path(place).parent)
    return ""


def _anywhere(value: Any, home: str) -> Any:
    """Return a parameter's value as it is in any session, wherever its folder."""
    if home and isinstance(value, str) and (value == home or value.startswith(f"{home}/")):
        return HERE + value[len(home) :]
    return value


def read_parameters(file: Path, node: str) -> dict[str, Any] | None:
    """Return the parameters of a node in a ROS parameter file; None: it cannot be read."""
    try:
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
        given = content[node]["ros__parameters"]
    except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError):
        return None
    return dict(given) if isinstance(given, dict) else None


def trouble_lines(log: Path) -> list[LogLine]:
    """Return the warnings, errors and exceptions of a node's log, each once."""
    try:
        with log.open("rb") as stream:
            stream.seek(max(0, log.stat().st_size - LOG_END))
            text = stream.read(LOG_END).decode("utf-8", "replace")
    except OSError:
        return []
    found: dict[tuple[str, str], int] = {}
    in_traceback = False
    for line in text.splitlines():
        match = LOG_LINE.match(line)
        told: tuple[str, str] | None = None
        if match:
            told = (WARNING if match[1] == "WARN" else ERROR, match[2])
            in_traceback = False
        elif line.startswith(TRACEBACK):
            in_traceback = True
        elif in_traceback and line and not line[0].isspace():
            told, in_traceback = (ERROR, line), False
        elif line.startswith("error: "):
            told = (ERROR, line.removeprefix("error: "))
        if told:
            found[told] = found.get(told, 0) + 1
    return [LogLine(log.stem, level, words, times) for (level, words), times in found.items()]
