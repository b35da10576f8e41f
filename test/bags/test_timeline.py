"""The timeline says what happened in a bag, whatever is missing in it."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import made_bags as made
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from handover_ros.bags import timeline as timeline_module
from handover_ros.bags.definitions import Definition, store_of
from handover_ros.bags.reading import Bag
from handover_ros.bags.recording import BagWriter
from handover_ros.bags.timeline import read_timeline
from handover_ros.bags.timeline_picture import draw_timeline
from handover_ros.bags.timeline_types import ERROR, LOST, SILENT, WARNING, Timeline

PHASES = ("planning", "fetching", "presenting", "waiting", "releasing", "retracting", "returning")
durations = st.floats(0.01, 5.0).map(lambda value: round(value, 3))
runs = st.lists(
    st.tuples(
        st.sampled_from(("mug", "glass", "u_lock")),
        st.lists(durations, min_size=1, max_size=len(PHASES)),
        st.booleans(),
    ),
    max_size=5,
)


def timeline_of(folder: Path, said: list[made.Said], **more) -> Timeline:
    with Bag(made.write_bag(folder, said, **more)) as bag:
        return read_timeline(bag)


@given(runs)
@settings(max_examples=25)
def test_handovers_are_those_that_the_executive_told(content):
    """Order, objects, phases, durations and outcomes are kept; ROS time passes twice as fast as the bag's."""
    made.messages()
    said, time, taken = made.markers(0.0, 0.1, 20.0), 1.0, 0
    for number, (name, seconds, well) in enumerate(content, start=1):
        said += made.handover(time, number, name, list(zip(PHASES, seconds)), well, taken)
        taken += well
        time += sum(seconds) + 0.5
    with tempfile.TemporaryDirectory() as folder:
        found = timeline_of(Path(folder) / "bag", said)
    assert [each.object_name for each in found.handovers] == [name for name, _, _ in content]
    assert [each.taken for each in found.handovers] == [well for _, _, well in content]
    assert found.taken == taken
    for handover, (_, seconds, _) in zip(found.handovers, content, strict=True):
        assert handover.ended
        assert [phase.name for phase in handover.phases] == list(PHASES[: len(seconds)])
        assert [phase.end - phase.begin for phase in handover.phases] == pytest.approx(seconds, abs=1e-6)
        assert [phase.seconds for phase in handover.phases] == pytest.approx([2.0 * s for s in seconds], abs=1e-6)
        assert handover.placed is None


@given(st.lists(st.tuples(st.floats(0.0, 100.0), st.sampled_from(("/a", "/b"))), min_size=1, max_size=60))
@settings(max_examples=25)
def test_every_message_is_in_one_time_bin(content):
    msg = made.messages()
    with tempfile.TemporaryDirectory() as folder:
        found = timeline_of(Path(folder) / "bag", [(time, topic, msg.MarkerFrame()) for time, topic in content])
    assert found.messages == len(content)
    begin = min(time for time, _ in content)
    for topic in found.topics:
        times = sorted(time - begin for time, name in content if name == topic.name)
        assert topic.counts.sum() == topic.messages == len(times)
        assert (topic.first, topic.last) == pytest.approx((times[0], times[-1]), abs=1e-6)
        longest = max(np.diff(times), default=0.0)
        if found.duration - times[-1] <= 5.0:
            assert topic.silence == pytest.approx(longest, abs=1e-6)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_whole_cell(tmp_path: Path, storage):
    found = timeline_of(tmp_path / "bag", made.whole_cell(3), storage=storage)
    assert [(each.object_name, each.outcome) for each in found.handovers] == [
        ("glass", "taken"), ("mug", "taken"), ("glass", "not taken"),
    ]  # fmt: skip
    assert [each.placed for each in found.handovers] == [True, True, False]
    assert {each.scheme for each in found.handovers} == {"personal"}
    assert found.handovers[0].planning_time == 0.4
    assert [(each.profile_id, each.observations, each.entropy) for each in found.beliefs] == [
        ("anna", 0, 11.0), ("anna", 1, 10.0), ("anna", 2, 9.0),
    ]  # fmt: skip
    assert found.beliefs[1].mean_neutral == pytest.approx((0.1, 1.0))
    assert [(each.object_name, each.hand, each.region) for each in found.answers] == [
        ("glass", "right", "handle"), ("mug", "right", "handle"),
    ]  # fmt: skip
    assert [each.profile_id for each in found.activations] == ["anna"]
    assert found.clock_rate == pytest.approx(2.0)
    assert found.ros_time(10.0) == pytest.approx(70.0)
    assert found.ready == pytest.approx(1.4)
    metrics = found.metrics()
    assert (metrics["handovers"], metrics["taken"], metrics["placed"], metrics["errors"]) == (3, 2, 2, 1)
    assert metrics["warnings"] == 0  # the one of the start does not count


def test_both_storages_tell_the_same(tmp_path: Path):
    said = made.whole_cell(2)
    one, other = (timeline_of(tmp_path / kind, said, storage=kind) for kind in ("mcap", "sqlite3"))
    assert one.document() == other.document()


def test_a_killed_recorders_bag_has_a_timeline(tmp_path: Path):
    said = made.whole_cell(2)
    folder = made.write_bag(tmp_path / "bag", said, closed=False)
    with Bag(folder) as bag:
        found = read_timeline(bag)
        assert "not closed" in bag.note
    assert len(found.handovers) == 2
    assert found.messages == len(said)


@pytest.mark.parametrize("share", [0.3, 0.7])
def test_a_cut_bag_has_the_timeline_of_what_is_left(tmp_path: Path, share):
    said = made.markers(0.0, 60.0, 100.0) + made.whole_cell(7)
    folder = made.write_bag(tmp_path / "bag", said)
    file = folder / "bag.mcap"
    with file.open("r+b") as stream:
        stream.truncate(int(share * file.stat().st_size))
    (folder / "metadata.yaml").unlink()
    with Bag(folder) as bag:
        found = read_timeline(bag)
    assert 0 < found.messages < len(said)
    assert found.messages == sum(topic.messages for topic in found.topics)


def test_a_bag_with_markers_only_and_an_empty_one(tmp_path: Path):
    found = timeline_of(tmp_path / "markers", made.markers(0.0, 4.0, 240.0))
    assert (found.handovers, found.events, found.beliefs, found.troubles) == ((), (), (), ())
    assert [topic.rate for topic in found.topics] == pytest.approx([240.0])
    assert np.isnan(found.clock_rate)
    empty = timeline_of(tmp_path / "empty", [])
    assert (empty.messages, empty.duration, empty.topics) == (0, 0.0, ())
    assert empty.document()["handovers"] == []


def test_a_handover_under_way_at_the_end(tmp_path: Path):
    said = made.handover(1.0, 1, "mug", [("planning", 1.0), ("fetching", 2.0)], True)[:2]
    found = timeline_of(tmp_path / "bag", [*said, *made.markers(0.0, 10.0, 10.0)])
    (handover,) = found.handovers
    assert (handover.outcome, handover.taken, handover.ended) == ("under way", None, False)
    assert handover.end == found.duration
    assert handover.phases[-1].seconds == pytest.approx(found.duration - 2.0)


def test_a_handover_that_an_executive_did_not_survive(tmp_path: Path):
    """The executive starts again and counts from zero: the handover was broken off, nobody knows how it ended."""
    said = made.handover(1.0, 3, "mug", [("planning", 1.0), ("fetching", 2.0)], True, 2)[:2]
    found = timeline_of(tmp_path / "bag", [*said, made.state(6.0, "idle", message="waiting")])
    (handover,) = found.handovers
    assert (handover.outcome, handover.ended) == ("unknown", True)
    assert "broken off" in handover.message


def test_states_said_again_are_no_new_phases(tmp_path: Path):
    said = made.handover(1.0, 1, "mug", [("planning", 1.0), ("fetching", 2.0)], True)
    again = [(time + 0.2, topic, message) for time, topic, message in said[:2]]
    (handover,) = timeline_of(tmp_path / "bag", [*said, *again]).handovers
    assert [phase.name for phase in handover.phases] == ["planning", "fetching"]


def test_topics_in_a_namespace_are_known(tmp_path: Path):
    said = [(time, f"/left_cell{topic}", message) for time, topic, message in made.whole_cell(2)]
    found = timeline_of(tmp_path / "bag", said)
    assert len(found.handovers) == 2
    assert found.clock_rate == pytest.approx(2.0)


def test_a_topic_of_another_type_is_only_counted(tmp_path: Path):
    msg = made.messages()
    found = timeline_of(
        tmp_path / "bag", [(0.0, "/cell/state", msg.MarkerFrame()), (1.0, "/rosout", msg.MarkerFrame())]
    )
    assert (found.messages, found.handovers, found.unreadable) == (2, (), 0)


def test_an_older_definition_is_read_for_what_it_has(tmp_path: Path):
    """A cell state without lost_nodes and problems, and a belief without a problem, which is not readable."""
    made.messages()
    text = "string phase\nstd_msgs/Header header\nstring handover_id\nstring object_name\nstring message\n"
    text += "uint32 handovers\nuint32 taken\n"
    header = get_typestore(Stores.ROS2_JAZZY).generate_msgdef("std_msgs/msg/Header", ros_version=2)[0]
    separator = "=" * 80
    text += f"{separator}\nMSG: std_msgs/Header\n{header}"
    name = "handover_msgs/msg/CellState"
    store = store_of([(name, text)])
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](sec=1, nanosec=0)
    writer = BagWriter(tmp_path / "bag")
    writer.add("/cell/state", name, Definition(text, "RIHS01_0"), [])
    for second, (phase, ident) in enumerate((("planning", "a"), ("done", "a"), ("idle", ""))):
        message = types[name](
            phase=phase, header=types["std_msgs/msg/Header"](stamp=stamp, frame_id=""), handover_id=ident,
            object_name="mug", message="", handovers=int(not ident), taken=int(not ident),
        )  # fmt: skip
        writer.write("/cell/state", name, second * 10**9, bytes(store.serialize_cdr(message, name)))
    writer.add(
        "/preferences/belief", "handover_msgs/msg/BeliefSummary", Definition("string profile_id\n", "RIHS01_0"), []
    )
    belief = b"\x00\x01\x00\x00\x02\x00\x00\x00a\x00"
    writer.write("/preferences/belief", "handover_msgs/msg/BeliefSummary", 10**9, belief)
    writer.close()
    with Bag(tmp_path / "bag") as bag:
        found = read_timeline(bag)
    assert [each.outcome for each in found.handovers] == ["taken"]
    assert found.unreadable == 1


def test_a_warning_lasts_from_the_first_to_the_next_good_word(tmp_path: Path):
    said = [made.diagnostics(0.0, "executive_node", 0, "idle")]
    said += [made.diagnostics(float(t), "mocap_node", 1 + (t == 12), f"late {t}") for t in range(10, 15)]
    said += [made.diagnostics(15.0, "mocap_node", 0, "fine"), made.diagnostics(20.0, "mocap_node", 1, "late again")]
    said += [made.log(11.0 + n, "planner_node", 40, "no path") for n in range(3)] + [made.log(1.0, "a", 20, "hello")]
    first, logged, again = timeline_of(tmp_path / "bag", said).troubles
    assert (first.node, first.begin, first.end, first.level) == ("mocap_node", 10.0, 15.0, ERROR)
    assert (first.message, first.times) == ("late 12", 5)
    assert (logged.message, logged.times, logged.begin, logged.end) == ("no path", 3, 11.0, 13.0)
    assert (again.level, again.begin, again.end) == (WARNING, 20.0, 20.0)


def test_nodes_that_fall_silent_are_told(tmp_path: Path):
    said = made.heartbeats("mocap_node", (0.0, 5.0), (9.0, 30.0)) + made.heartbeats("sim_node", (0.0, 10.0))
    said += made.heartbeats("planner_node", (0.0, 27.0))  # stopped with the cell
    said += [made.state(11.0, "idle", lost_nodes=["sim_node"])]
    found = timeline_of(tmp_path / "bag", said)
    assert [(each.node, each.source) for each in found.troubles] == [
        ("mocap_node", SILENT), ("sim_node", SILENT), ("sim_node", LOST),
    ]  # fmt: skip
    assert found.troubles[0].end - found.troubles[0].begin == pytest.approx(4.0)
    assert found.metrics()["lost_nodes"] == 2


def test_the_silence_of_a_regular_topic_is_a_gap(tmp_path: Path):
    said = made.markers(0.0, 10.0, 100.0) + made.markers(13.0, 20.0, 100.0)
    said += made.markers(0.0, 8.0, 50.0, "/mocap/markers")
    said += [(time, "/sim/events", made.messages().SimulationEvent()) for time in (1.0, 19.0)]
    found = timeline_of(tmp_path / "bag", said)
    assert [topic.name for topic in found.gaps] == ["/mocap/markers", "/sim/markers"]
    assert [topic.silence for topic in found.gaps] == pytest.approx([12.01, 3.01], abs=0.02)
    assert found.gaps[1].silence_begin == pytest.approx(9.99)


def test_what_is_kept_is_bounded(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(timeline_module, "MOST", 3)
    said = [made.log(float(n), "a", 30, f"line {n}") for n in range(10)] + made.whole_cell(5)
    said += [(float(n), "/sim/events", made.messages().SimulationEvent(kind="fault")) for n in range(10)]
    found = timeline_of(tmp_path / "bag", said)
    assert max(len(found.events), len(found.troubles), len(found.handovers), len(found.beliefs)) <= 3
    assert found.left_out > 10
    assert found.messages == len(said)


def test_progress_is_told_up_to_the_end(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(timeline_module, "TOLD_EVERY", 10)
    told: list[float] = []
    with Bag(made.write_bag(tmp_path / "bag", made.markers(0.0, 1.0, 100.0))) as bag:
        read_timeline(bag, told.append)
    assert told == pytest.approx([n / 10 for n in range(10)])


# The picture.


def assert_png(path: Path):
    assert path.read_bytes().startswith(b"\x89PNG")
    assert path.stat().st_size > 3000


def test_a_picture_of_everything(tmp_path: Path):
    said = made.whole_cell(3) + [
        made.diagnostics(5.0, "mocap_node", 1, "late"),
        made.log(9.0, "sim_node", 30, "slow " * 40),
    ]
    said += made.heartbeats("planner_node", (0.0, 3.0)) + made.markers(0.0, 3.0, 50.0, "/mocap/markers")
    assert_png(draw_timeline(timeline_of(tmp_path / "bag", said), tmp_path / "new" / "timeline.png"))


@pytest.mark.parametrize("content", ["empty", "one message", "markers", "many handovers", "strange names"])
def test_a_picture_of_anything(tmp_path: Path, content):
    msg = made.messages()
    said: list[made.Said] = {
        "empty": [],
        "one message": [(0.0, "/a", msg.MarkerFrame())],
        "markers": made.markers(0.0, 2.0, 240.0),
        "many handovers": made.whole_cell(40),
        "strange names": [(float(n), f"/topic_{n}", msg.SimulationEvent(kind="$x_$")) for n in range(60)]
        + [(1.0, "/sim/events", msg.SimulationEvent(kind="$\\frac$", object_name="a$b"))]
        + [made.log(1.0, "$\\node$", 30, "costs 5$ or 6$ \\alpha")],
    }[content]
    assert_png(draw_timeline(timeline_of(tmp_path / "bag", said), tmp_path / "timeline.png"))


def test_a_picture_of_a_handover_without_outcome(tmp_path: Path):
    found = timeline_of(tmp_path / "bag", made.whole_cell(2))
    unknown = tuple(replace(each, taken=None, ended=number > 0) for number, each in enumerate(found.handovers))
    assert_png(draw_timeline(replace(found, handovers=unknown), tmp_path / "timeline.png"))
