"""Writing a bag so that whatever ends the recorder, all but the last moment can be read again."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Literal

from rosbags.interfaces import Connection, Qos
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

from handover_ros.bags.definitions import Definition
from handover_ros.errors import BadRequestError

Storage = Literal["mcap", "sqlite3"]
STORAGES: tuple[Storage, ...] = ("mcap", "sqlite3")
VERSION: Literal[9] = 9  # of rosbag2's metadata.yaml, that of Jazzy


class BagWriter:
    """A rosbag2 bag being written.

    What was written before the last ``flush`` can be read whatever happens to the process (see ``rescue``).

    Args:
        path: Folder of the bag, which must not exist.
        storage: ``mcap`` or ``sqlite3``.

    Raises:
        BadRequestError: The folder exists or cannot be made.
    """

    def __init__(self, path: Path, storage: Storage = "mcap") -> None:
        self.path = path
        self.counts: Counter[str] = Counter()
        self.bytes = 0
        self._connections: dict[tuple[str, str], Connection] = {}
        try:
            self._writer = Writer(path, version=VERSION, storage_plugin=StoragePlugin[storage.upper()])
            path.parent.mkdir(parents=True, exist_ok=True)
            self._writer.open()
        except (WriterError, OSError) as error:
            raise BadRequestError(f"bag {path}: cannot be written: {error}; name another folder") from None

    def add(self, topic: str, type_name: str, definition: Definition, profiles: list[Qos]) -> None:
        """Say that messages of a topic follow.

        Args:
            topic: Whole name, ``/`` first.
            type_name: E.g. ``handover_msgs/msg/MarkerFrame``.
            definition: Of the type.
            profiles: Quality of service its publishers offer.
        """
        self._connections[topic, type_name] = self._writer.add_connection(
            topic, type_name, msgdef=definition.text, rihs01=definition.digest, offered_qos_profiles=profiles
        )

    def write(self, topic: str, type_name: str, stamp: int, data: bytes) -> None:
        """Write one serialized message, received at ``stamp`` [ns]."""
        self._writer.write(self._connections[topic, type_name], stamp, data)
        self.counts[topic] += 1
        self.bytes += len(data)

    @property
    def messages(self) -> int:
        """How many messages were written."""
        return self.counts.total()

    def flush(self) -> None:
        """Hand everything to the operating system."""
        storage = self._writer.storage
        if isinstance(storage, McapWriter) and storage.chunk.msgs:
            storage.close_chunk()
            storage.bio.flush()
        elif isinstance(storage, Sqlite3Writer):
            storage.conn.commit()

    def note(self, key: str, value: str) -> None:
        """Add a remark to the bag's metadata (``custom_data``)."""
        self._writer.set_custom_data(key, value)

    def close(self) -> None:
        """Write index and metadata; the bag is whole then."""
        self._writer.close()
