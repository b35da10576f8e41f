"""What is recorded can be replayed: nothing is lost, a killed recorder leaves nearly everything, nodes say the same."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import handover_msgs.msg
import numpy as np
import pytest
from geometry_msgs.msg import Pose
from graph import ANSWER, FIRST_CONTACT, REPOSITORY, Graph, NodeProcess, isolated_graph, wait_for
from handover_msgs.msg import ActiveProfile, BeliefSummary, GraspChoice, SkeletonState
from marker_player import MarkerPlayer
from people import NAMES, SEGMENTS, calibration_motion
from profiles import report_of
from rclpy.serialization import serialize_message

from handover_ros.arm.model import JOINT_NAMES, arm_of
from handover_ros.bags.definitions import Definition, Definitions
from handover_ros.bags.reading import Bag
from handover_ros.bags.recording import BagWriter
from handover_ros.bags.replay import stamp_of
from handover_ros.geometry import transform_from_xyz_rpy
from handover_ros.nodes.convert import float_array, pose_message, stamp_from_seconds
from handover_ros.nodes.convert_profile import active_profile_message
from handover_ros.nodes.runtime import LATCHED, SENSOR_PUBLISHER
from handover_ros.objects import load_object
from handover_ros.preferences.offered import offered_query
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.sim.person_spec import load_person
from handover_ros.skeleton.profile import Profile

RATE, FRAMES = 240.0, 1200
SETTLED = 120.0  # [s] of wall time on a busy machine, kernels may have to be compiled
SKELETON = skeleton_of(load_person("adult"))
PROFILE = Profile("anna", "Anna", "2026-01-01T00:00:00Z", "simulated", "upper_body", SKELETON, report_of(SKELETON))
LEAST_KEPT = 1.0  # [s] before it was killed, up to which a recorder's bag must reach


def recorder(graph: Graph, bag: Path, **parameters: object) -> NodeProcess:
    """Start a recorder and wait until it records."""
    process = graph.start("recorder_node", REPOSITORY / "config" / "recorder_node.yaml", bag=bag, **parameters)
    wait_for(lambda: "recording to" in process.text(), FIRST_CONTACT, "the recorder")
    return process


def replay(domain: int, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run ``handover replay`` on a domain of its own."""
    environment = dict(os.environ, ROS_DOMAIN_ID=str(domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST", COLUMNS="500")
    command = [sys.executable, "-m", "handover_ros.cli", "replay", *map(str, arguments)]
    return subprocess.run(
        command, env=environment, cwd=REPOSITORY, capture_output=True, text=True, timeout=240.0, check=False
    )


@pytest.fixture
def graph() -> Iterator[Graph]:
    with isolated_graph() as made:
        yield made


def choice() -> GraspChoice:
    """Return how Anna took a mug."""
    torso = transform_from_xyz_rpy(np.array([1.0, 0.0, 1.4]), np.array([0.0, 0.0, np.pi]))
    offered = transform_from_xyz_rpy(np.array([0.45, -0.2, -0.2]), np.zeros(3))
    query = offered_query(load_object("mug"), arm_of(SKELETON, "right"), offered)
    message = GraspChoice(
        handover_id="h1",
        profile_id="anna",
        object_name="mug",
        hand="right",
        grasp_region=query.regions[query.region[0]],
        handover_pose=pose_message(torso @ offered),
        torso=pose_message(torso),
        joint_names=list(JOINT_NAMES),
        displacements=float_array(query.configurations[0]),
        covariance=float_array(np.ravel(1e-4 * np.eye(7))),
        object_from_gripper=Pose(),
    )
    message.object_from_gripper.orientation.w = 0.0
    return message


@pytest.mark.graph
def test_a_session_is_recorded_without_loss_and_replayed_bit_for_bit(graph: Graph, tmp_path: Path) -> None:
    """Markers at 240 Hz, a profile that becomes active in the middle, an answer: the same states, the same belief."""
    bag = tmp_path / "session" / "bag"
    record = recorder(graph, bag)
    preference = {"profile_directory": str(tmp_path / "profiles"), "particles": 300}
    nodes = [
        graph.start("skeleton_node", REPOSITORY / "config" / "skeleton_node.yaml"),
        graph.start("preference_node", REPOSITORY / "config" / "preference_node.yaml", **preference),
    ]
    states = graph.collect(SkeletonState, "human/skeleton_state", SENSOR_PUBLISHER)
    beliefs = graph.collect(BeliefSummary, "preferences/belief", LATCHED)
    active = graph.node.create_publisher(ActiveProfile, "calibration/active_profile", LATCHED)
    choices = graph.node.create_publisher(GraspChoice, "handover/grasp_choice", SENSOR_PUBLISHER)
    player = MarkerPlayer(graph, NAMES, SEGMENTS, calibration_motion(SKELETON, FRAMES, RATE).measured, RATE)
    try:
        wait_for(lambda: player.listeners == 2, SETTLED, "recorder and tracker")
        wait_for(lambda: beliefs, SETTLED, "a belief")
        player.start()
        wait_for(lambda: states and states[-1].valid, SETTLED, "the torso to be tracked")
        message = active_profile_message(PROFILE)
        message.header.stamp = stamp_from_seconds(1000.0 + player.sent / RATE)
        active.publish(message)
        wait_for(lambda: states[-1].profile_id == "anna" and states[-1].valid, SETTLED, "Anna to be tracked")
        player.moving.set()
        wait_for(lambda: beliefs[-1].profile_id == "anna", ANSWER, "a belief about Anna")
        choices.publish(choice())
        wait_for(lambda: beliefs[-1].observations == 1, ANSWER, "the answer to be taken in")
        moving = player.sent
        wait_for(lambda: player.sent > moving + 3 * RATE, ANSWER, "some seconds of motion")
    finally:
        player.stop()
    assert record.stop() == 0, record.text()
    assert " 0 lost" in record.text()
    for node in nodes:
        assert node.stop() == 0, node.text()

    with Bag(bag) as recorded:
        frames = [recorded.decode(topic, data).device_frame for topic, _, data in recorded.read(["/mocap/markers"])]
        assert frames == list(range(1, player.sent + 1)), "every frame that was sent, in order"
        assert recorded.topics["/calibration/active_profile"].latched
        for topic in recorded.topics.values():
            assert Definition(topic.definition, topic.digest) == Definitions().of(topic.type_name)

    result = tmp_path / "replay.json"
    (tmp_path / "session" / "parameters").mkdir()
    (tmp_path / "session" / "parameters" / "preference_node.yaml").write_text(
        "preference_node:\n  ros__parameters:\n    particles: 300\n"
    )
    with isolated_graph() as other:
        done = replay(other.domain, bag, "--speed", 1.5, "--out", tmp_path / "replayed", "--json", result)
    assert done.returncode == 0, done.stderr
    metrics = json.loads(result.read_text())["metrics"]
    assert metrics["states_compared"] > 3 * RATE, "some seconds of motion, and what came before"
    assert metrics["states_missing"] == 0
    assert metrics["states_identical"] == metrics["states_compared"], done.stdout
    assert metrics["beliefs_compared"] == metrics["beliefs_identical"] == 2, done.stdout

    # From the middle, what was latched comes first: Anna is tracked, though she became active before.
    with isolated_graph() as other:
        started = 0.6 * metrics["duration_s"]
        arguments = ("--start", started, "--node", "skeleton_node", "--out", tmp_path / "middle", "--json", result)
        done = replay(other.domain, bag, *arguments)
    assert done.returncode == 0, done.stderr
    ours, theirs = displacements(bag), displacements(tmp_path / "middle")
    late = [stamp for stamp in theirs if stamp > min(theirs) + 10**9]
    assert late
    # The beginning is forgotten, sooner or later: where an arm is near a singular posture, later.
    assert np.median([np.abs(theirs[stamp] - ours[stamp]).max() for stamp in late]) < 0.05


def displacements(path: Path) -> dict[int, np.ndarray]:
    """Return the displacements of the states in a bag by their stamps."""
    with Bag(path) as bag:
        return {
            stamp_of(data): np.array(bag.decode(topic, data).displacements)
            for topic, _, data in bag.read(["/human/skeleton_state"])
        }


@pytest.mark.graph
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_killed_recorder_loses_less_than_the_last_second(graph: Graph, tmp_path: Path, storage: str) -> None:
    process = recorder(graph, tmp_path / "bag", storage=storage)
    player = MarkerPlayer(graph, NAMES, SEGMENTS, np.zeros((10, len(NAMES), 3)), RATE)
    try:
        wait_for(lambda: player.listeners == 1, FIRST_CONTACT, "the recorder to hear")
        player.start()
        wait_for(lambda: player.sent > 3 * RATE, ANSWER, "three seconds of markers")
        killed = time.time()
        process.signal(signal.SIGKILL)
        process.wait(ANSWER)
    finally:
        player.stop()
    with Bag(tmp_path / "bag") as bag:
        assert "killed" in bag.note
        assert bag.topics["/mocap/marker_set"].messages == 1
        arrivals, frames = [], []
        for topic, stamp, data in bag.read(["/mocap/markers"]):
            arrivals.append(stamp * 1e-9)
            frames.append(bag.decode(topic, data).device_frame)
    assert killed - arrivals[-1] < LEAST_KEPT
    assert frames == list(range(frames[0], frames[0] + len(frames))), "what is left has no holes"


# What cannot be replayed: one line.


def bag_of(folder: Path, *topics: str, old: bool = False) -> Path:
    """Return a bag with one message a topic, of today's definitions or of one with another field."""
    writer = BagWriter(folder)
    types = {"/mocap/markers": "MarkerFrame", "/mocap/marker_set": "MarkerSet", "/cell/state": "CellState"}
    for number, topic in enumerate(topics):
        name = f"handover_msgs/msg/{types[topic]}"
        definition = Definitions().of(name)
        if old:
            text = definition.text.replace("uint32 set_version", "uint16 set_version")
            definition = Definition(text, f"RIHS01_{'0' * 64}")
        writer.add(topic, name, definition, [])
        writer.write(topic, name, 10**18 + number, serialize_message(getattr(handover_msgs.msg, types[topic])()))
    writer.close()
    return folder


def one_line(done: subprocess.CompletedProcess[str]) -> str:
    """Return the one line of an error."""
    assert done.returncode == 2, done.stdout + done.stderr
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("error: ")
    return lines[0]


def test_what_cannot_be_replayed_is_refused_with_one_line(tmp_path: Path) -> None:
    streams = ("/mocap/markers", "/mocap/marker_set")
    out = ("--out", tmp_path / "out")
    assert "no such file" in one_line(replay(77, tmp_path / "nothing", *out))
    assert "/mocap/markers" in one_line(replay(77, bag_of(tmp_path / "a", "/cell/state"), *out))
    without = bag_of(tmp_path / "b", "/cell/state", "/mocap/marker_set")
    assert "/mocap/markers, which skeleton_node needs" in one_line(replay(77, without, "--node", "skeleton_node", *out))
    line = one_line(replay(77, bag_of(tmp_path / "c", *streams, old=True), *out))
    assert "/mocap/markers: handover_msgs/msg/MarkerFrame of another version: field set_version" in line
    cut = bag_of(tmp_path / "d", *streams)
    file = next(cut.glob("*.mcap"))
    file.write_bytes(file.read_bytes()[:-100])
    line = one_line(replay(77, cut, *out))
    assert "cut short" in line
    assert "2 messages" in line
    assert "bag rescue" in line
    assert "speed" in one_line(replay(77, bag_of(tmp_path / "e", *streams), "--speed", "-1", *out))
    assert "pattern" in one_line(replay(77, tmp_path / "e", "--topic", "[", *out))
    assert "behind the end" in one_line(replay(77, tmp_path / "e", "--start", "1e6", *out))
    assert "planner_node" in one_line(replay(77, tmp_path / "e", "--node", "planner_node", *out))


@pytest.mark.graph
def test_recorder_and_player_refuse_wrong_parameters_with_their_names(graph: Graph, tmp_path: Path) -> None:
    for node, parameters, words in (
        ("recorder_node", {"flush_perod": 1.0}, "flush_perod"),
        ("recorder_node", {"flush_period": 60.0}, "flush_period"),
        ("recorder_node", {"storage": "zip"}, "storage"),
        ("recorder_node", {"bag": str(tmp_path)}, "exists"),
        ("player_node", {}, "parameter bag"),
        ("player_node", {"bag": str(tmp_path / "none")}, "no such file"),
        ("player_node", {"bag": str(tmp_path), "speed": 0.0}, "speed"),
    ):
        process = graph.start(node, **parameters)
        graph.processes.remove(process)
        assert process.wait(FIRST_CONTACT) == 2, process.text()
        lines = process.text().strip().splitlines()
        assert len(lines) == 1, lines
        assert words in lines[0]
