"""Reading a bag: whole, left behind by a killed recorder, or cut short; by anybody who records rosbag2."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from rosbags.interfaces import ConnectionExtRosbag2, MessageDefinitionFormat, Qos, QosDurability
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.typesys.store import Typestore

from handover_ros.bags.definitions import SEPARATOR, store_of
from handover_ros.bags.rescue import BROKEN, Rescued, rescue, sqlite_length, storage_files
from handover_ros.errors import BadRecordingError, HandoverError, UnknownNameError

METADATA = "metadata.yaml"
BAG = "bag"  # folder of the bag in a session's folder


@dataclass(frozen=True)
class Topic:
    """One topic of a bag.

    Attributes:
        name: Whole name.
        type_name: E.g. ``handover_msgs/msg/MarkerFrame``.
        definition: Of the type, as rosbag2 stores it; empty: the bag brings none.
        digest: Hash of the type; empty: unknown.
        profiles: Quality of service of its publishers.
        messages: How many there are.
    """

    name: str
    type_name: str
    definition: str
    digest: str
    profiles: tuple[Qos, ...]
    messages: int

    @property
    def latched(self) -> bool:
        """Whether who comes later gets the last message."""
        return bool(self.profiles) and all(q.durability is QosDurability.TRANSIENT_LOCAL for q in self.profiles)


class Bag:
    """An open bag; a context manager.

    Args:
        path: Folder of a bag, of a session with a bag in it, or a storage file.

    Attributes:
        path: The bag.
        topics: By name.
        start: Time of the first message [ns].
        end: Time of the last one [ns].
        note: What is to be said about it in one line; empty: it is whole.

    Raises:
        BadRecordingError: There is no bag, or it is cut short or damaged; says how to mend that.
    """

    def __init__(self, path: Path) -> None:
        self.path = bag_folder(path)
        self.note = ""
        self._store: Typestore | None = None
        with contextlib.ExitStack() as stack:
            self._reader = self._open(stack)
            self.topics = _topics(self._reader)
            self._stack = stack.pop_all()
        self.start, self.end = self._reader.start_time, self._reader.end_time - 1
        if not self._reader.message_count:
            self.start = self.end = 0

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the bag."""
        self._stack.close()

    def _open(self, stack: contextlib.ExitStack) -> Reader:
        unfinished = self.path.is_dir() and not (self.path / METADATA).is_file()
        place = self.path
        if unfinished:
            rescued = rescue(self.path, Path(stack.enter_context(tempfile.TemporaryDirectory())) / BAG)
            self.note = (
                f"{self.path.name} was not closed (was its recorder killed?): {rescued.messages:,} messages "
                f"up to {clock(rescued.end)} are whole"
            )
            place = rescued.path
        else:
            for file in storage_files(self.path):
                if not _has_its_end(file):
                    raise self._damaged("its end is missing")
        try:
            reader = Reader(place)
            reader.open()
        except FileNotFoundError as error:
            raise BadRecordingError(f"bag {self.path}: {' '.join(str(error).split())}") from None
        except (ReaderError, *BROKEN) as error:
            raise self._damaged(" ".join(str(error).split())) from None
        stack.callback(reader.close)
        return reader

    def _damaged(self, why: str) -> BadRecordingError:
        """Return the error of a bag that is cut short, with what is left of it."""
        try:
            with tempfile.TemporaryDirectory() as folder:
                saved: Rescued | None = rescue(self.path, Path(folder) / BAG)
        except HandoverError:
            saved = None
        if saved is None:
            return BadRecordingError(f"bag {self.path}: is cut short or damaged ({why}), and no message of it is whole")
        return BadRecordingError(
            f"bag {self.path}: is cut short or damaged ({why}); {saved.messages:,} messages up to {clock(saved.end)} "
            f"are whole; make a bag of them: ./handover bag rescue {self.path}"
        )

    @property
    def messages(self) -> int:
        """How many messages there are."""
        return sum(topic.messages for topic in self.topics.values())

    @property
    def duration(self) -> float:
        """From the first to the last message [s]."""
        return (self.end - self.start) * 1e-9

    @property
    def storage(self) -> str:
        """``mcap`` or ``sqlite3``."""
        return "mcap" if storage_files(self.path)[0].suffix == ".mcap" else "sqlite3"

    @property
    def size(self) -> int:
        """Bytes of the storage files."""
        return sum(file.stat().st_size for file in storage_files(self.path))

    def topic(self, name: str) -> Topic:
        """Return a topic; the leading ``/`` may be left out.

        Raises:
            UnknownNameError: The bag has no such topic.
        """
        whole = name if name.startswith("/") else f"/{name}"
        if whole not in self.topics:
            raise UnknownNameError(f"topic in bag {self.path.name}", whole, tuple(self.topics))
        return self.topics[whole]

    def read(
        self, names: Collection[str] | None = None, start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Topic, int, bytes]]:
        """Give messages in the order of their times: topic, time of reception [ns], serialized message.

        Args:
            names: Topics; default: all.
            start: Time of the first [ns].
            stop: Time before which they were received [ns].

        Raises:
            BadRecordingError: The bag is damaged in the middle.
        """
        wanted = [c for c in self._reader.connections if names is None or c.topic in names]
        if not wanted:
            return
        try:
            for connection, stamp, data in self._reader.messages(wanted, start, stop):
                yield self.topics[connection.topic], stamp, bytes(data)
        except (ReaderError, *BROKEN) as error:
            raise self._damaged(" ".join(str(error).split())) from None

    def decode(self, topic: Topic, data: bytes) -> Any:
        """Return a message as an object with the fields of its type.

        Raises:
            BadRecordingError: It is damaged, or its type unknown.
        """
        if self._store is None:
            self._store = store_of({each.type_name: each.definition for each in self.topics.values()}.items())
        try:
            definition = self._store.get_msgdef(topic.type_name)
            read = definition.deserialize_cdr_le if data[1] & 1 else definition.deserialize_cdr_be
            # Not the store's own function: that refuses bytes after the message, which serializers may leave there.
            return read(data[4:], 0, definition.cls, self._store)[0]
        except Exception as error:  # rosbags' generated code raises whatever the bytes make it
            raise BadRecordingError(
                f"bag {self.path}: a message of {topic.name} cannot be read: {' '.join(str(error).split())[:120]}"
            ) from None


def bag_folder(path: Path) -> Path:
    """Return the bag that a path names: a bag's folder or file, or the bag in a session's folder.

    Raises:
        BadRecordingError: There is none.
    """
    if not path.exists():
        raise BadRecordingError(f"bag {path}: no such file or folder")
    if path.is_dir() and not storage_files(path) and (path / BAG).is_dir():
        path = path / BAG
    if not storage_files(path):
        raise BadRecordingError(f"bag {path}: is no bag: there is no .mcap or .db3 file")
    return path


def clock(stamp: int) -> str:
    """Return a time [ns since 1970] as people read it."""
    return datetime.fromtimestamp(stamp * 1e-9).astimezone().strftime("%Y-%m-%d %H:%M:%S.%f")[:-3]


def _topics(reader: Reader) -> dict[str, Topic]:
    """Return the topics of an open bag by name; of two types under one name the one with more messages."""
    found: dict[str, Topic] = {}
    for connection in reader.connections:
        assert isinstance(connection.ext, ConnectionExtRosbag2)
        definition = connection.msgdef
        text = "" if definition.format is MessageDefinitionFormat.NONE else definition.data
        if definition.format is MessageDefinitionFormat.IDL and not text.startswith(SEPARATOR):
            text = ""
        profiles = tuple(connection.ext.offered_qos_profiles)
        topic = Topic(
            connection.topic, connection.msgtype, text, connection.digest or "", profiles, connection.msgcount
        )
        before = found.get(topic.name)
        if before is None or before.messages < topic.messages:
            found[topic.name] = topic
    return dict(sorted(found.items()))


def _has_its_end(file: Path) -> bool:
    """Return whether a storage file is as long as it was when it was closed."""
    size = file.stat().st_size
    with file.open("rb") as stream:
        if file.suffix == ".mcap":
            stream.seek(max(0, size - 8))
            return stream.read(8) == b"\x89MCAP0\r\n"
    return size >= max(1, sqlite_length(file))
