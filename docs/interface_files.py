"""Messages, services and actions as their files in ``msg_defs`` have them, with the comments."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
FOLDER = REPOSITORY / "msg_defs"
PACKAGE = "handover_msgs"
PARTS = {"msg": ("",), "srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}
FIELD = re.compile(
    r"(?P<type>[A-Za-z][\w/]*(\[\d*\])?)\s+(?P<name>[a-z]\w*)(\s+(?P<default>[^#\s][^#]*?))?\s*(#\s*(?P<text>.*))?"
)
CONSTANT = re.compile(r"(?P<type>[a-z]\w*)\s+(?P<name>[A-Z]\w*)\s*=\s*(?P<value>[^#]*?)\s*(#\s*(?P<text>.*))?")


class InterfaceError(Exception):
    """A line of an interface file cannot be read."""


@dataclass
class Row:
    """One field or constant.

    Attributes:
        type_name: As written.
        name: Of the field or constant.
        value: Of a constant; empty for fields.
        text: Its comment, lines joined.
        heading: The comment on lines of its own above it; belongs to the fields below too.
    """

    type_name: str
    name: str
    value: str
    text: str
    heading: str = ""


@dataclass(frozen=True)
class Interface:
    """One file.

    Attributes:
        kind: msg, srv or action.
        name: e.g. ``MarkerFrame``.
        text: The comment at the top.
        parts: Fields and constants: of a message one list, of a service two, of an action three.
    """

    kind: str
    name: str
    text: str
    parts: tuple[tuple[Row, ...], ...]

    @property
    def full_name(self) -> str:
        """As ``ros2 interface show`` takes it."""
        return f"{PACKAGE}/{self.kind}/{self.name}"


def interfaces(kind: str) -> list[Interface]:
    """Return all interfaces of a kind (msg, srv, action), by name."""
    return [parse(path) for path in sorted((FOLDER / kind).glob(f"*.{kind}"))]


def parse(path: Path) -> Interface:
    """Return what a file defines.

    Raises:
        InterfaceError: A line is none of field, constant, comment and separator.
    """
    top: list[str] = []
    parts: list[list[Row]] = [[]]
    heading = ""
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        words = line.strip()
        if not words:
            heading = ""
        elif words == "---":
            parts.append([])
            heading = ""
        elif words.startswith("#"):
            text = words.lstrip("# ")
            if line.startswith(" ") and parts[-1]:
                parts[-1][-1].text += f" {text}"  # goes on from the line above
            elif not any(parts) and len(parts) == 1:
                top.append(text)
            else:
                heading = f"{heading} {text}".strip()
        elif match := CONSTANT.fullmatch(words) or FIELD.fullmatch(words):
            found = match.groupdict()
            value = found.get("value") or ""
            parts[-1].append(Row(found["type"], found["name"], value, found["text"] or "", heading))
            heading = ""
        else:
            raise InterfaceError(f"{path.name}:{number}: neither field nor constant: {words}")
    kind = path.suffix[1:]
    if len(parts) != len(PARTS[kind]):
        raise InterfaceError(f"{path.name}: has {len(parts)} parts, a {kind} has {len(PARTS[kind])}")
    return Interface(kind, path.stem, " ".join(top), tuple(tuple(part) for part in parts))
