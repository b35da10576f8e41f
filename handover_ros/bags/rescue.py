"""What can still be read of a bag whose recorder was killed, or of which a part is lost."""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
import struct
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, BinaryIO, cast

import zstandard
from mcap.exceptions import McapError
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from rosbags.interfaces import Qos
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import TypesysError

from handover_ros.bags.definitions import Definition, store_of
from handover_ros.bags.recording import BagWriter, Storage
from handover_ros.errors import BadRecordingError

SQLITE_PAGES = struct.Struct(">16xH10xI")  # page size and number of pages in the header of a database
SUFFIXES: dict[str, Storage] = {".mcap": "mcap", ".db3": "sqlite3"}
#: What a file that ends in the middle, or holds rubbish, makes the readers raise.
BROKEN = (McapError, ValueError, EOFError, struct.error, KeyError, MemoryError, RuntimeError, OSError,
          zstandard.ZstdError, sqlite3.DatabaseError)  # fmt: skip


@dataclass(frozen=True)
class Rescued:
    """What was saved.

    Attributes:
        path: The whole bag.
        messages: How many it holds.
        end: Time of the last one [ns]; 0: there is none.
    """

    path: Path
    messages: int
    end: int


@dataclass(frozen=True)
class Found:
    """One message that is whole."""

    topic: str
    type_name: str
    definition: str
    digest: str
    profiles: tuple[Qos, ...]
    stamp: int
    data: bytes


def storage_files(path: Path) -> list[Path]:
    """Return the storage files of a bag's folder, or the file itself, in the order they were written."""
    if path.is_file():
        return [path] if path.suffix in SUFFIXES else []
    return sorted((file for file in path.iterdir() if file.suffix in SUFFIXES), key=_order)


def _order(file: Path) -> tuple[int, str]:
    """Return what files of a split bag are sorted by: the number at the end of the name."""
    number = file.stem.rpartition("_")[2]
    return (int(number) if number.isdigit() else 0, file.name)


def rescue(path: Path, target: Path) -> Rescued:
    """Write all messages of a bag that are whole to a new bag.

    Args:
        path: Folder of a bag, or one storage file; metadata.yaml is neither needed nor looked at.
        target: Folder of the new bag.

    Raises:
        BadRecordingError: Nothing can be read.
        BadRequestError: ``target`` exists.
    """
    files = storage_files(path)
    if not files:
        raise BadRecordingError(f"bag {path}: holds no .mcap or .db3 file")
    writer = BagWriter(target, SUFFIXES[files[0].suffix])
    known: set[tuple[str, str]] = set()
    end = 0
    try:
        for file in files:
            for message in whole_messages(file):
                if (message.topic, message.type_name) not in known:
                    known.add((message.topic, message.type_name))
                    definition = Definition(message.definition, message.digest or _digest(message))
                    writer.add(message.topic, message.type_name, definition, list(message.profiles))
                writer.write(message.topic, message.type_name, message.stamp, message.data)
                end = max(end, message.stamp)
        writer.note("rescued_from", path.name)
        writer.close()
    except BaseException:
        shutil.rmtree(target, ignore_errors=True)
        raise
    if not writer.messages:
        shutil.rmtree(target, ignore_errors=True)
        raise BadRecordingError(f"bag {path}: holds no message that is whole")
    return Rescued(target, writer.messages, end)


def _digest(message: Found) -> str:
    """Return the hash of a message's type, from its definition; empty when it cannot be told."""
    try:
        return store_of([(message.type_name, message.definition)]).hash_rihs01(message.type_name)
    except (TypesysError, KeyError):
        return "RIHS01_unknown"


def whole_messages(file: Path) -> Iterator[Found]:
    """Give the messages of one storage file, in the order they were written, up to where it is broken."""
    read = _mcap_messages if file.suffix == ".mcap" else _sqlite_messages
    with contextlib.suppress(*BROKEN):
        yield from read(file)


class _WholeReads:
    """A file of which a read gives all that was asked for, or an error: no message of a cut file is taken for whole."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream

    def read(self, size: int) -> bytes:
        """Return ``size`` bytes; EOFError when there are fewer."""
        data = self._stream.read(size)
        if len(data) < size:
            raise EOFError
        return data


def _mcap_messages(file: Path) -> Iterator[Found]:
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    profiles: dict[int, tuple[Qos, ...]] = {}
    with file.open("rb") as stream:
        reader = StreamReader(
            cast(IO[bytes], _WholeReads(stream)), validate_crcs=True, record_size_limit=file.stat().st_size
        )
        for record in reader.records:
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
                profiles[record.id] = _profiles(record.metadata.get("offered_qos_profiles", ""))
            elif isinstance(record, Message):
                channel = channels[record.channel_id]
                schema = schemas[channel.schema_id]
                digest = channel.metadata.get("topic_type_hash", "")
                text = schema.data.decode("utf-8", "replace")
                yield Found(
                    channel.topic, schema.name, text, digest, profiles[channel.id], record.log_time, record.data
                )


def _sqlite_messages(file: Path) -> Iterator[Found]:
    with tempfile.TemporaryDirectory() as folder:
        # A copy: what was not committed is rolled back at opening, which writes.
        for each in file.parent.glob(f"{file.name}*"):
            shutil.copy(each, folder)
        _fill_up(Path(folder) / file.name)
        connection = sqlite3.connect(Path(folder) / file.name)
        try:
            topics = _sqlite_topics(connection)
            for topic, stamp, data in connection.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id"):
                name, type_name, text, digest, profiles = topics[topic]
                yield Found(name, type_name, text, digest, profiles, stamp, data)
        finally:
            connection.close()


def _fill_up(database: Path) -> None:
    """Make a database that was cut short as long as its header says: what is left of it can be read then."""
    missing = sqlite_length(database) - database.stat().st_size
    if missing > 0:
        with database.open("r+b") as stream:
            stream.truncate(database.stat().st_size + missing)


def sqlite_length(file: Path) -> int:
    """Return how long a database was when it was written last; 0: it is none."""
    with file.open("rb") as stream:
        header = stream.read(SQLITE_PAGES.size)
    if len(header) < SQLITE_PAGES.size:
        return 0
    page, pages = SQLITE_PAGES.unpack(header)
    return int((65536 if page == 1 else page) * pages)


def _sqlite_topics(connection: sqlite3.Connection) -> dict[int, tuple[str, str, str, str, tuple[Qos, ...]]]:
    """Return (name, type, definition, hash, profiles) of the topics of a bag of any version, by number."""
    columns = {row[1] for row in connection.execute("PRAGMA table_info(topics)")}
    texts: dict[str, str] = {}
    with contextlib.suppress(sqlite3.OperationalError):  # older bags have no such table
        texts = dict(connection.execute("SELECT topic_type, encoded_message_definition FROM message_definitions"))
    wanted = ["id", "name", "type", *({"offered_qos_profiles", "type_description_hash"} & columns)]
    topics = {}
    for values in connection.execute(f"SELECT {', '.join(wanted)} FROM topics"):
        row: dict[str, Any] = dict(zip(wanted, values))
        profiles = _profiles(row.get("offered_qos_profiles", ""))
        digest = row.get("type_description_hash", "")
        topics[row["id"]] = (row["name"], row["type"], texts.get(row["type"], ""), digest, profiles)
    return topics


def _profiles(text: str) -> tuple[Qos, ...]:
    """Return the quality of service that a bag notes for a topic; empty when that cannot be read."""
    try:
        return tuple(parse_qos(text))
    except (ReaderError, KeyError, TypeError):
        return ()
