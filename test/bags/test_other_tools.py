"""Bags of other tools can be read, and ours by theirs: MCAP by its own library, as Foxglove does; SQLite by SQL."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from handover_ros.bags.definitions import Definition
from handover_ros.bags.reading import Bag
from handover_ros.bags.recording import BagWriter
from handover_ros.bags.rescue import rescue
from handover_ros.errors import BadRecordingError

TOPIC, TYPE = "/talk", "std_msgs/msg/String"
DEFINITION = Definition("string data\n", "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18")
HELLO = b"\x00\x01\x00\x00\x03\x00\x00\x00hi\x00"
QOS = """- history: 3
  depth: 0
  reliability: 1
  durability: 1
  deadline: {sec: 9223372036, nsec: 854775807}
  lifespan: {sec: 9223372036, nsec: 854775807}
  liveliness: 1
  liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}
  avoid_ros_namespace_conventions: false
"""


def recorded_by_rosbag2(folder: Path, compression: CompressionType, files: int = 1, whole: bool = True) -> Path:
    """Write what ``ros2 bag record`` of Jazzy writes: chunks with checksums, possibly split."""
    folder.mkdir()
    for number in range(files):
        with (folder / f"bag_{number}.mcap").open("wb") as stream:
            writer = Writer(stream, chunk_size=2000, compression=compression)
            writer.start(profile="ros2", library="libmcap 1.1.0")
            schema = writer.register_schema(TYPE, "ros2msg", DEFINITION.text.encode())
            about = {"offered_qos_profiles": QOS, "topic_type_hash": DEFINITION.digest}
            channel = writer.register_channel(TOPIC, "cdr", schema, about)
            for index in range(100):
                stamp = 10**18 + (100 * number + index) * 10**7
                writer.add_message(channel, stamp, HELLO, stamp, index)
            writer.finish()
    if not whole:
        return folder
    span = {"nanoseconds": (100 * files - 1) * 10**7}
    begin = {"nanoseconds_since_epoch": 10**18}
    about = {"name": TOPIC, "type": TYPE, "serialization_format": "cdr", "offered_qos_profiles": yaml.safe_load(QOS)}
    about["type_description_hash"] = DEFINITION.digest
    content = {
        "version": 9,
        "storage_identifier": "mcap",
        "duration": span,
        "starting_time": begin,
        "message_count": 100 * files,
        "topics_with_message_count": [{"topic_metadata": about, "message_count": 100 * files}],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [f"bag_{number}.mcap" for number in range(files)],
        "files": [],
        "custom_data": None,
        "ros_distro": "jazzy",
    }
    (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": content}))
    return folder


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD])
@pytest.mark.parametrize("files", [1, 3])
@pytest.mark.parametrize("whole", [True, False])
def test_a_bag_of_rosbag2_is_read(tmp_path: Path, compression: CompressionType, files: int, whole: bool) -> None:
    with Bag(recorded_by_rosbag2(tmp_path / "bag", compression, files, whole)) as bag:
        assert bool(bag.note) is not whole
        topic = bag.topics[TOPIC]
        assert topic.latched
        assert (topic.type_name, topic.messages, topic.digest) == (TYPE, 100 * files, DEFINITION.digest)
        assert bag.duration == pytest.approx(files - 0.01)
        stamps = [stamp for _, stamp, data in bag.read() if bag.decode(topic, data).data == "hi"]
    assert stamps == [10**18 + index * 10**7 for index in range(100 * files)]


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD])
def test_wherever_a_bag_is_cut_what_was_before_is_rescued(tmp_path: Path, compression: CompressionType) -> None:
    folder = recorded_by_rosbag2(tmp_path / "bag", compression)
    file = folder / "bag_0.mcap"
    content, before = file.read_bytes(), -1
    for number, size in enumerate(range(0, len(content), len(content) // 9)):
        file.write_bytes(content[:size])
        with pytest.raises(BadRecordingError, match="cut short"):
            Bag(folder)
        try:
            saved = rescue(folder, tmp_path / f"saved_{number}").messages
        except BadRecordingError:
            saved = 0
        assert saved >= before
        before = saved
        if saved:
            with Bag(tmp_path / f"saved_{number}") as bag:
                assert [data for *_, data in bag.read()] == [HELLO] * saved
    assert before > 50


def test_our_bag_is_read_by_the_library_of_the_format(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "bag")
    writer.add(TOPIC, TYPE, DEFINITION, [])
    for index in range(10):
        writer.write(TOPIC, TYPE, 10**18 + index, HELLO)
        if index % 4 == 3:
            writer.flush()
    writer.close()
    with (tmp_path / "bag" / "bag.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == 10
        assert len(summary.chunk_indexes) == 3
        found = [
            (s.name, s.encoding, c.topic, c.message_encoding, m.log_time, m.data) for s, c, m in reader.iter_messages()
        ]
    assert found == [(TYPE, "ros2msg", TOPIC, "cdr", 10**18 + index, HELLO) for index in range(10)]
    content = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert (content["version"], content["storage_identifier"], content["message_count"]) == (9, "mcap", 10)
    assert content["topics_with_message_count"][0]["topic_metadata"]["type_description_hash"] == DEFINITION.digest


def test_our_sqlite_bag_has_the_tables_of_rosbag2(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "bag", "sqlite3")
    writer.add(TOPIC, TYPE, DEFINITION, [])
    writer.write(TOPIC, TYPE, 5, HELLO)
    writer.close()
    connection = sqlite3.connect(tmp_path / "bag" / "bag.db3")
    assert connection.execute("SELECT name, type, serialization_format FROM topics").fetchall() == [
        (TOPIC, TYPE, "cdr")
    ]
    assert connection.execute("SELECT topic_id, timestamp, data FROM messages").fetchall() == [(1, 5, HELLO)]
    assert connection.execute("SELECT topic_type, encoding FROM message_definitions").fetchall() == [(TYPE, "ros2msg")]
    connection.close()


def test_an_old_sqlite_bag_without_definitions_is_read(tmp_path: Path) -> None:
    """As ROS 2 Foxy wrote it; the types are those of Jazzy then."""
    (tmp_path / "bag").mkdir()
    connection = sqlite3.connect(tmp_path / "bag" / "bag_0.db3")
    connection.executescript(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, "
        "serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, "
        "data BLOB NOT NULL);"
    )
    connection.execute("INSERT INTO topics VALUES (1, ?, ?, 'cdr', '')", (TOPIC, TYPE))
    connection.executemany("INSERT INTO messages VALUES (?, 1, ?, ?)", [(n, n, HELLO) for n in range(1, 6)])
    connection.commit()
    connection.close()
    with Bag(tmp_path / "bag") as bag:  # without metadata.yaml, too
        assert "was not closed" in bag.note
        assert [bag.decode(topic, data).data for topic, _, data in bag.read()] == ["hi"] * 5
