"""mocap_node and skeleton_node as real processes: live samples, recordings, and what bad input gets."""

from __future__ import annotations

import os
from array import array
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from graph import ANSWER, FIRST_CONTACT, STOP, Graph, isolated_graph, wait_for
from handover_msgs.msg import MarkerFrame, MarkerSet, SkeletonState
from visualization_msgs.msg import MarkerArray

from handover_ros.mocap.marker_sets import load_marker_set
from handover_ros.nodes import mocap_node, skeleton_node
from handover_ros.nodes.convert import float_array, stamp_from_seconds
from handover_ros.nodes.runtime import LATCHED, RECORDER, SENSOR_PUBLISHER
from handover_ros.resources import config_directory

pytestmark = pytest.mark.graph
FOLDER = Path(os.environ.get("HANDOVER_RECORDINGS", Path(__file__).resolve().parents[2] / ".." / "shared" / "data"))
C3D = FOLDER / "pyomeca" / "markers_analogs.c3d"
SET = load_marker_set("upper_body_24")
BODY = np.random.default_rng(7).uniform(-0.15, 0.15, (24, 3)) + [1.4, 0.0, 1.2]


class Device:
    """A motion-capture system on the simulator's topics."""

    def __init__(self, graph: Graph) -> None:
        self.set_publisher = graph.node.create_publisher(MarkerSet, "sim/marker_set", LATCHED)
        self.publisher = graph.node.create_publisher(MarkerFrame, "sim/markers", SENSOR_PUBLISHER)
        self.number = 0

    def announce(self, version: int = 1, names: tuple[str, ...] = SET.names) -> None:
        message = MarkerSet(name="device", version=version, rate=100.0)
        message.marker_names, message.segment_names = list(names), [""] * len(names)
        self.set_publisher.publish(message)

    def send(self, positions: np.ndarray = BODY, version: int = 1, number: int | None = None) -> None:
        number = self.number if number is None else number
        message = MarkerFrame(set_version=version, device_frame=number, device_time=number / 100.0)
        message.header.stamp = stamp_from_seconds(1000.0 + number / 100.0)
        message.positions = float_array(positions)
        message.status = array("B", bytes(np.asarray(positions).size // 3))
        self.publisher.publish(message)
        self.number = number + 1


@pytest.fixture
def graph() -> Iterator[Graph]:
    with isolated_graph() as graph:
        yield graph


def values_of(diagnostics: list[DiagnosticArray], node: str) -> dict[str, str]:
    """Return the newest diagnostic values of a node."""
    for message in reversed(diagnostics):
        for status in message.status:
            if status.name == node:
                return {"": status.message, **{pair.key: pair.value for pair in status.values}}
    return {}


def heard(device: Device, frames: list[MarkerFrame]) -> None:
    """Send frames until the first comes back."""

    def sent_and_heard() -> bool:
        device.send()
        return bool(frames)

    wait_for(sent_and_heard, FIRST_CONTACT, "mocap/markers")


def test_live_samples_come_out_clean_and_the_torso_follows(graph: Graph) -> None:
    frames = graph.collect(MarkerFrame, "mocap/markers", RECORDER)
    sets = graph.collect(MarkerSet, "mocap/marker_set", LATCHED)
    states = graph.collect(SkeletonState, "human/skeleton_state", RECORDER)
    visuals = graph.collect(MarkerArray, "human/visual", SENSOR_PUBLISHER)
    diagnostics = graph.collect(DiagnosticArray, "/diagnostics", RECORDER)
    device = Device(graph)
    shuffled = tuple(reversed(SET.names))
    device.announce(names=tuple(f"suit:{name}" for name in shuffled))
    graph.start("mocap_node", config_directory() / "mocap_node.yaml")
    graph.start("skeleton_node", config_directory() / "skeleton_node.yaml")
    body = BODY[::-1].copy()

    def tracked() -> bool:
        device.send(body)
        return bool(states) and states[-1].valid

    wait_for(tracked, FIRST_CONTACT, "a valid torso")
    assert sets[0].marker_names == list(SET.names)
    assert sets[0].name == "upper_body_24"
    assert frames[-1].header.frame_id == "world"
    np.testing.assert_allclose(np.array(frames[-1].positions).reshape(-1, 3), BODY)

    gap, wrong = body.copy(), body.copy()
    gap[0] = np.nan
    wrong[1] += 0.5
    marks = []
    for disturbed in (gap, wrong, np.full((24, 3), np.inf)):
        marks.append(device.number)
        device.send(disturbed)
        device.send(body)
    device.send(body[:3])
    device.send(body, version=9)
    last = device.number
    device.send(body)
    wait_for(lambda: any(m.device_frame == last for m in frames), ANSWER, "the frame after the bad ones")
    by_number = {m.device_frame: m for m in frames}
    assert by_number[marks[0]].status[23] == MarkerFrame.BRIDGED
    np.testing.assert_allclose(by_number[marks[0]].positions[-3:], BODY[23], atol=1e-6)
    assert by_number[marks[1]].status[22] == MarkerFrame.DROPPED
    assert np.isnan(by_number[marks[1]].positions[66:69]).all()
    assert last - 1 not in by_number
    assert last - 2 not in by_number
    stamps = [m.header.stamp.sec + m.header.stamp.nanosec * 1e-9 for m in frames]
    assert (np.diff(stamps) > 0.0).all()
    assert abs(stamps[-1] - 1000.0 - last / 100.0) < 1e-4  # the capture, not the reception

    wait_for(lambda: values_of(diagnostics, "mocap_node").get("bad_frames") == "2", ANSWER, "the count of bad frames")
    values = values_of(diagnostics, "mocap_node")
    assert values["repaired_jumps"] == "1"
    assert "set_version 9" in values["last_problem"]
    wait_for(lambda: states[-1].valid, ANSWER, "a valid torso")
    covariance = np.array(states[-1].torso.covariance).reshape(6, 6)
    assert np.linalg.eigvalsh(covariance).min() > 0.0
    assert states[-1].markers_used == 8
    assert visuals


def test_a_source_with_other_markers_is_reported_and_may_mend_itself(graph: Graph) -> None:
    frames = graph.collect(MarkerFrame, "mocap/markers", RECORDER)
    diagnostics = graph.collect(DiagnosticArray, "/diagnostics", RECORDER)
    device = Device(graph)
    device.announce(names=("A", "B", "C"))
    process = graph.start("mocap_node")
    wait_for(
        lambda: "CHEST1" in values_of(diagnostics, "mocap_node").get("last_problem", ""), FIRST_CONTACT, "a report"
    )
    assert process.process.poll() is None
    device.announce(version=1)
    heard(device, frames)


@pytest.mark.recordings
def test_a_recording_is_played_to_its_end_at_the_person_s_place(graph: Graph) -> None:
    if not C3D.is_file():
        pytest.skip(f"no real recording {C3D}")
    frames = graph.collect(MarkerFrame, "mocap/markers", RECORDER)
    states = graph.collect(SkeletonState, "human/skeleton_state", RECORDER)
    diagnostics = graph.collect(DiagnosticArray, "/diagnostics", RECORDER)
    graph.start("skeleton_node")
    process = graph.start(
        "mocap_node",
        source="recording",
        recording=C3D,
        marker_set="pyomeca_daphnee",
        placement="auto",
        start_delay=4.0,
    )
    wait_for(lambda: values_of(diagnostics, "mocap_node").get("finished") == "True", FIRST_CONTACT + 20.0, "the end")
    values = values_of(diagnostics, "mocap_node")
    assert (values["frames_read"], values["missing_samples"], values["repaired_jumps"]) == ("580", "305", "0")
    assert 4.0 < float(values["torso_residual_mm"]) < 9.0
    assert "580 frames read" in process.text()
    assert len(frames) > 400
    valid = [state for state in states if state.valid]
    assert len(valid) > 300
    position = valid[0].torso.pose.position
    assert abs(position.x - 1.45) < 0.3
    assert abs(position.y) < 0.3


@pytest.mark.parametrize(
    ("parameters", "problem"),
    [
        ({"marker_set": "upper_body_25"}, "upper_body_25"),
        ({"pace": -1.0}, "pace"),
        ({"sourc": "recording"}, "sourc"),
        ({"source": "kinect"}, "kinect"),
        ({"max_gap": -0.1}, "max_gap"),
        ({"source": "recording"}, "parameter recording"),
        ({"source": "recording", "recording": "/no/such/file.c3d"}, "/no/such/file.c3d: no such file"),
        ({"source": "recording", "recording": "{cut}"}, "cut.csv: line"),
    ],
)
def test_bad_parameters_end_the_node_with_one_line(
    graph: Graph, tmp_path: Path, parameters: dict[str, object], problem: str
) -> None:
    (tmp_path / "cut.csv").write_text("Trajectories\n100\n,,A,,,\n")
    given = {key: str(value).format(cut=tmp_path / "cut.csv") for key, value in parameters.items()}
    process = graph.start("mocap_node", **given)
    graph.processes.remove(process)
    assert process.wait(FIRST_CONTACT + STOP) == 2
    lines = process.text().strip().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("error: ")
    assert problem in lines[0]


@pytest.mark.parametrize("node", [mocap_node, skeleton_node])
def test_the_yaml_names_exactly_the_declared_parameters(node: object) -> None:
    name = node.__name__.rpartition(".")[2]
    content = yaml.safe_load((config_directory() / f"{name}.yaml").read_text())
    assert set(content[name]["ros__parameters"]) == {spec.name for spec in node.PARAMETERS}
