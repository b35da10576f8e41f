"""Message definitions: as they are installed, and as a bag brings them; whether the two are the same."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from handover_ros.errors import UnknownNameError

SEPARATOR = "=" * 80  # between a definition and those it needs
IDL = "IDL: "


@dataclass(frozen=True)
class Definition:
    """The definition of one message type.

    Attributes:
        text: With the definitions it needs, as rosbag2 stores them.
        digest: Hash of the type (REP-2016), as the graph announces it.
    """

    text: str
    digest: str


def prefixes() -> list[Path]:
    """Return where packages are installed: ``AMENT_PREFIX_PATH``, then the Python installation."""
    ament = [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    return [*ament, Path(sys.prefix)]


class Definitions:
    """The message definitions of installed packages, read when they are asked for.

    Args:
        folders: Installation prefixes; default: :func:`prefixes`.
    """

    def __init__(self, folders: Sequence[Path] | None = None) -> None:
        self._folders = list(prefixes() if folders is None else folders)
        self._store = get_typestore(Stores.EMPTY)
        self._known: dict[str, Definition] = {}

    def of(self, type_name: str) -> Definition:
        """Return the definition of a type such as ``handover_msgs/msg/MarkerFrame``.

        Raises:
            UnknownNameError: It is not installed.
        """
        if type_name not in self._known:
            self._load(type_name)
            text, _ = self._store.generate_msgdef(type_name, ros_version=2)
            self._known[type_name] = Definition(text, self._store.hash_rihs01(type_name))
        return self._known[type_name]

    def has(self, type_name: str) -> bool:
        """Return whether a type is installed."""
        return self._file(type_name) is not None

    def _file(self, type_name: str) -> Path | None:
        package, _, name = type_name.partition("/msg/")
        files = (folder / "share" / package / "msg" / f"{name}.msg" for folder in self._folders)
        return next((file for file in files if file.is_file()), None)

    def _load(self, type_name: str) -> None:
        """Register a type and all it needs."""
        if type_name in self._store.fielddefs:
            return
        file = self._file(type_name)
        if file is None:
            packages = {folder.name for prefix in self._folders for folder in (prefix / "share").glob("*_msgs")}
            raise UnknownNameError("message type", type_name, [f"those of {package}" for package in packages])
        types = get_types_from_msg(file.read_text(encoding="utf-8"), type_name)
        for needed in needed_types(types[type_name][1]):
            self._load(needed)
        if type_name not in self._store.fielddefs:
            self._store.register(types)


def needed_types(fields: Iterable[tuple[str, Any]]) -> set[str]:
    """Return the names of the message types that fields of rosbags' type system are made of."""
    found = set()
    for _, (kind, inside) in fields:
        while kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):  # of (element, length)
            kind, inside = inside[0]
        if kind is Nodetype.NAME:
            found.add(str(inside))
    return found


def store_of(definitions: Iterable[tuple[str, str]]) -> Typestore:
    """Return a type system for the types of a bag.

    Args:
        definitions: Pairs of type name and definition, as rosbag2 stores them; types without one are those of Jazzy.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    for type_name, text in definitions:
        if text:
            store.register(parsed(type_name, text))
    return store


def parsed(type_name: str, text: str) -> Any:
    """Return the types of a definition as rosbag2 stores it (msg or IDL), as rosbags' type system wants them.

    Raises:
        TypesysError: It is none.
    """
    if text.startswith(f"{SEPARATOR}\n{IDL}"):
        types = {}
        for part in text.split(f"{SEPARATOR}\n{IDL}")[1:]:
            types.update(get_types_from_idl(part.split("\n", 1)[1]))
        return types
    return get_types_from_msg(text, type_name)


def difference(type_name: str, recorded: str, digest: str, installed: Definition) -> str:
    """Return in what a recorded message type differs from the installed one; empty: it does not, or cannot be told.

    Args:
        type_name: Name of the type.
        recorded: Its definition in the bag; empty: the bag brings none.
        digest: Its hash in the bag; empty: unknown.
        installed: The installed one.
    """
    if not recorded:
        if not digest or digest == installed.digest:
            return ""
        return f"hash {digest[:17]} instead of {installed.digest[:17]}"
    try:
        ours, theirs = _fields(type_name, installed.text), _fields(type_name, recorded)
    except (TypesysError, KeyError) as error:
        return f"its definition in the bag cannot be read ({' '.join(str(error).split())[:80]})"
    if ours == theirs:
        return ""
    parts = [f"{name} is needed in the bag only" for name in theirs if name not in ours]
    parts += [f"{name} is not needed in the bag" for name in ours if name not in theirs]
    for name in filter(theirs.__contains__, ours):
        here, there = dict(ours[name]), dict(theirs[name])
        parts += [f"field {field} is in the bag only" for field in there if field not in here]
        parts += [f"field {field} is not in the bag" for field in here if field not in there]
        parts += [f"field {field} has another type" for field in here if here[field] != there.get(field, here[field])]
    told = parts or ["fields stand in another order"]
    return ", ".join(told[:3]) + (", ..." if len(told) > 3 else "")


def _fields(type_name: str, text: str) -> dict[str, list[tuple[str, Any]]]:
    """Return the types of a definition, each with its fields (name, type) in order."""
    return {name: list(fields) for name, (_, fields) in parsed(type_name, text).items()}
