"""What of a bag is played to whom."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

from handover_ros.bags.definitions import Definition, Definitions
from handover_ros.bags.reading import Bag
from handover_ros.bags.recording import BagWriter
from handover_ros.bags.replay import (
    STAMP,
    check_inputs,
    chosen_topics,
    drivable,
    first_used,
    inputs_of,
    latest_before,
    other_versions,
    stamp_of,
)
from handover_ros.errors import BadRecordingError, UnknownNameError

TYPE, DEFINITION = "a/msg/B", Definition("int32 c\n", "RIHS01_0")
CLEAN = ("/mocap/markers", "/mocap/marker_set")
RAW = ("/sim/markers", "/sim/marker_set")
ANSWERS = ("/calibration/active_profile", "/handover/grasp_choice")
FOREVER = QosTime(9223372036, 854775807)


def latched() -> Qos:
    return Qos(
        QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, FOREVER, FOREVER,
        QosLiveliness.AUTOMATIC, FOREVER, False,
    )  # fmt: skip


def stamped(stamp: int) -> bytes:
    return STAMP.pack(*divmod(stamp, 10**9)) + b"more"


def bag_with(folder: Path, messages: dict[str, list[tuple[int, bytes]]]) -> Path:
    writer = BagWriter(folder)
    for topic, entries in messages.items():
        profiles = [latched()] if topic.endswith(("_set", "_profile", "belief")) else []
        writer.add(topic, TYPE, DEFINITION, profiles)
        for stamp, data in entries:
            writer.write(topic, TYPE, stamp, data)
    writer.close()
    return folder


def with_topics(folder: Path, *topics: str) -> Path:
    return bag_with(folder, {topic: [(1, stamped(1))] for topic in topics})


@pytest.mark.parametrize(
    ("topics", "nodes"),
    [
        (CLEAN, ("skeleton_node",)),
        (RAW, ("mocap_node", "skeleton_node")),
        ((*RAW, *CLEAN, *ANSWERS), ("skeleton_node", "preference_node")),
        (ANSWERS, ("preference_node",)),
    ],
)
def test_nodes_are_driven_by_the_cleanest_data(tmp_path: Path, topics: tuple[str, ...], nodes: tuple[str, ...]) -> None:
    with Bag(with_topics(tmp_path / "bag", *topics)) as bag:
        assert drivable(bag) == nodes
        check_inputs(bag, nodes)


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    with Bag(with_topics(tmp_path / "bag", "/cell/state", *RAW)) as bag:
        with pytest.raises(BadRecordingError, match="/mocap/markers, which skeleton_node needs"):
            check_inputs(bag, ["skeleton_node"])
        with pytest.raises(BadRecordingError, match="/calibration/active_profile"):
            check_inputs(bag, ["preference_node"])
        with pytest.raises(UnknownNameError, match="sim_node"):
            check_inputs(bag, ["sim_node"])
        check_inputs(bag, ["skeleton_node", "mocap_node"])  # one makes what the other needs
    with (
        Bag(with_topics(tmp_path / "other", "/cell/state")) as bag,
        pytest.raises(BadRecordingError, match="cell/state"),
    ):
        drivable(bag)


def test_commands_and_what_nodes_say_of_themselves_stay_out_unless_they_are_named(tmp_path: Path) -> None:
    everything = ("/clock", "/robot/enable", "/robot/joint_trajectory", "/rosout", "/robot/joint_states", *CLEAN)
    with Bag(with_topics(tmp_path / "bag", *everything)) as bag:
        assert set(chosen_topics(bag)) == {"/clock", "/robot/joint_states", *CLEAN}
        assert set(chosen_topics(bag, published=CLEAN)) == {"/clock", "/robot/joint_states"}
        assert set(chosen_topics(bag, wanted=[re.compile("/robot/.*")])) == {
            "/clock", "/robot/enable", "/robot/joint_trajectory", "/robot/joint_states",
        }  # fmt: skip
        assert "/clock" not in chosen_topics(bag, unwanted=[re.compile("/clock")])
        with pytest.raises(BadRecordingError, match="nothing is left"):
            chosen_topics(bag, wanted=[re.compile("/nothing")])


def test_frames_that_nobody_used_are_known(tmp_path: Path) -> None:
    frames = [(stamp, stamped(stamp)) for stamp in range(10, 100, 10)]
    states = [(stamp + 1, stamped(stamp)) for stamp in range(40, 100, 10)]
    path = bag_with(tmp_path / "bag", {"/mocap/markers": frames, "/human/skeleton_state": states})
    with Bag(path) as bag:
        assert first_used(bag, ["/mocap/markers"]) == {"/mocap/markers": 40}
        assert first_used(bag, ["/mocap/markers", "/human/skeleton_state"]) == {}, "nobody makes them anew"
        assert first_used(bag, ["/sim/markers"]) == {}, "it is not in the bag"


def test_what_was_latched_before_the_start_comes_once_and_in_order(tmp_path: Path) -> None:
    content = {
        "/calibration/active_profile": [(5, b"old"), (20, b"new"), (90, b"later")],
        "/mocap/marker_set": [(10, b"set")],
        "/mocap/markers": [(30, b"frame")],
    }
    with Bag(bag_with(tmp_path / "bag", content)) as bag:
        found = [(topic.name, data) for topic, data in latest_before(bag, bag.topics, 50)]
    assert found == [("/mocap/marker_set", b"set"), ("/calibration/active_profile", b"new")]


def test_stamps() -> None:
    assert stamp_of(stamped(12_000_000_034)) == 12_000_000_034
    assert stamp_of(b"short") == 0


def test_a_changed_message_matters_only_where_it_is_needed(tmp_path: Path) -> None:
    installed = Definitions([tmp_path])
    (tmp_path / "share" / "a" / "msg").mkdir(parents=True)
    (tmp_path / "share" / "a" / "msg" / "B.msg").write_text("int32 c\nint8 d\n")
    with Bag(with_topics(tmp_path / "bag", "/x", "/y")) as bag:
        topics = bag.topics.values()
        found = other_versions(topics, [], installed, "b")
        assert set(found) == {"/x", "/y"}
        assert "field d is not in the bag" in found["/x"]
        with pytest.raises(BadRecordingError, match="bag b: topic /y: a/msg/B of another version: field d"):
            other_versions(topics, ["/y"], installed, "b")
        (tmp_path / "share" / "a" / "msg" / "B.msg").write_text("int32 c # [m]\n")
        assert other_versions(topics, ["/y"], Definitions([tmp_path]), "b") == {}
        assert "not installed" in other_versions(topics, [], Definitions([tmp_path / "none"]), "b")["/x"]
    assert inputs_of(["skeleton_node", "sim_node"]) == set(CLEAN)
