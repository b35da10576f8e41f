"""skeleton_node with profiles: the whole person is tracked, swapped cleanly, and never at the cost of the torso."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from graph import ANSWER, FIRST_CONTACT, REPOSITORY, STOP, Graph, isolated_graph, wait_for
from handover_msgs.msg import ActiveProfile, Heartbeat, SkeletonState
from marker_player import MarkerPlayer
from people import NAMES, SEGMENTS, Motion, calibration_motion, random_person
from profiles import profile_of
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from visualization_msgs.msg import Marker, MarkerArray

from handover_ros.files import write_whole
from handover_ros.nodes.convert import seconds_from_stamp, stamp_from_seconds
from handover_ros.nodes.convert_profile import active_profile_message, profile_from_message
from handover_ros.nodes.runtime import LATCHED, RECORDER, SENSOR_PUBLISHER
from handover_ros.nodes.skeleton_node import SWITCH_DELAY
from handover_ros.skeleton.profile import Profile, profile_document, profile_to_json

RATE, FRAMES = 100.0, 1600
WARM = 90.0  # [s] until a profile is tracked: kernels may have to be compiled


class Bench:
    """The node, a person's markers, and what the node says."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.profile = profile_of("anna", seed=5)
        self.motion: Motion = calibration_motion(self.profile.skeleton.with_limits(*whole(5)), FRAMES, RATE)
        self.player = MarkerPlayer(graph, NAMES, SEGMENTS, self.motion.measured, RATE)
        self.active = graph.node.create_publisher(ActiveProfile, "calibration/active_profile", LATCHED)
        self.states: list[SkeletonState] = graph.collect(SkeletonState, "human/skeleton_state", RECORDER)
        self.joints: list[JointState] = graph.collect(JointState, "human/joint_states", RECORDER)
        self.visuals: list[MarkerArray] = graph.collect(MarkerArray, "human/visual", SENSOR_PUBLISHER)
        self.descriptions: list[String] = graph.collect(String, "human/robot_description", LATCHED)
        self.beat = Heartbeat()
        graph.node.create_subscription(Heartbeat, "cell/heartbeat", self.on_beat, QoSProfile(depth=50))

    def on_beat(self, message: Heartbeat) -> None:
        self.beat = message

    def start(self, **parameters):
        self.node = self.graph.start("skeleton_node", REPOSITORY / "config" / "skeleton_node.yaml", **parameters)
        return self.node

    def activate(self, profile: Profile | None) -> None:
        self.active.publish(active_profile_message(profile))

    def tracked(self, profile_id: str) -> SkeletonState:
        """Wait until a person is tracked; return a state."""

        def there():
            assert self.node.process.poll() is None, self.node.text()
            return self.states and self.states[-1].profile_id == profile_id and self.states[-1].valid

        wait_for(there, WARM, f"{profile_id or 'the torso'} to be tracked; it says {self.beat.summary!r}")
        return self.states[-1]


def whole(seed: int) -> tuple[np.ndarray, np.ndarray]:
    person = random_person(seed)
    return person.lower, person.upper


@pytest.fixture
def bench() -> Iterator[Bench]:
    with isolated_graph() as graph:
        bench = Bench(graph)
        yield bench
        bench.player.stop()


@pytest.mark.graph
def test_a_person_is_tracked_swapped_and_left_cleanly(bench: Bench):
    bench.start()
    bench.player.start()
    torso_only = bench.tracked("")
    assert len(torso_only.joint_names) == len(torso_only.displacements) == 0
    assert bench.joints == []

    bench.activate(bench.profile)
    state = bench.tracked("anna")
    names = bench.profile.skeleton.displacement_names
    assert tuple(state.joint_names) == names
    assert len(state.velocities) == 14
    covariance = np.array(state.covariance).reshape(14, 14)
    assert np.allclose(covariance, covariance.T)
    assert (np.diag(covariance) > 0.0).all()
    torso = (state.torso.pose.position, torso_only.torso.pose.position)
    assert abs(torso[0].x - torso[1].x) < 0.2

    bench.player.moving.set()
    begin = len(bench.states)
    wait_for(lambda: len(bench.states) > begin + FRAMES, 60.0, "the motion to be tracked")
    wait_for(lambda: bench.joints and bench.joints[-1].position, ANSWER, "human/joint_states")
    states = [state for state in bench.states[begin : begin + FRAMES] if state.valid]
    assert len(states) > 0.99 * FRAMES
    assert np.median([state.residual_rms for state in states if state.markers_used]) < 0.005
    true = bench.motion.displacements
    found = np.array([state.displacements for state in states])
    elbow = names.index("right_elbow_flexion")
    assert np.ptp(found[:, elbow]) == pytest.approx(np.ptp(true[:, elbow]), abs=0.15)
    stamps = {(state.header.stamp.sec, state.header.stamp.nanosec): state for state in bench.states}
    joint = bench.joints[-20]
    assert tuple(joint.name) == names
    assert joint.position == stamps[joint.header.stamp.sec, joint.header.stamp.nanosec].displacements

    visual = bench.visuals[-1].markers
    limbs = [marker for marker in visual if marker.ns == "limbs" and marker.action == Marker.ADD]
    assert len(limbs) >= 8
    assert all(0.0 < marker.scale.z < 1.0 for marker in limbs)
    assert {"markers", "torso", "joints"} <= {marker.ns for marker in visual}
    wait_for(lambda: bench.descriptions and bench.descriptions[-1].data, ANSWER, "the description")
    robot = ElementTree.fromstring(bench.descriptions[-1].data.partition("\n")[2])
    assert {joint.attrib["name"] for joint in robot.findall("joint")} == set(names)

    bench.activate(profile_of("bert", seed=5))
    assert bench.tracked("bert").profile_id == "bert"
    bench.activate(None)
    assert len(bench.tracked("").displacements) == 0
    wait_for(lambda: bench.descriptions[-1].data == "", ANSWER, "the description to be taken back")
    gaps = np.diff([state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec for state in bench.states])
    assert gaps.min() > 0.0, "no frame is published twice"
    assert gaps.max() < 5.0 / RATE, "the swaps cost no frames"


@pytest.mark.graph
def test_a_profile_is_tracked_with_from_a_frame_that_the_stamps_tell(bench: Bench):
    """So that a replay of the same messages, at any speed, gives the same states."""
    bench.start()
    bench.player.start()
    bench.tracked("")
    message = active_profile_message(bench.profile)
    activated = 1000.0 + (bench.player.sent + 5) / RATE
    message.header.stamp = stamp_from_seconds(activated)
    bench.active.publish(message)
    bench.tracked("anna")
    stamps = {s.profile_id: seconds_from_stamp(s.header.stamp) for s in reversed(bench.states)}
    assert 0.0 <= stamps["anna"] - (activated + SWITCH_DELAY) < 1.5 / RATE


@pytest.mark.graph
def test_a_profile_that_cannot_be_tracked_leaves_the_torso_tracked_with_one_sentence(bench: Bench):
    bench.start()
    without_hand = tuple(name for name in NAMES if name not in ("RARM7", "RARM8"))
    columns = [NAMES.index(name) for name in without_hand]
    bench.player.positions = bench.player.positions[:, columns]
    bench.player.names, bench.player.segments = without_hand, tuple(SEGMENTS[column] for column in columns)
    bench.player.announce()
    bench.player.start()
    bench.tracked("")
    bench.activate(bench.profile)
    wait_for(lambda: bench.beat.state == Heartbeat.DEGRADED, WARM, "the node to say so")
    assert "RARM7" in bench.beat.summary
    assert "torso only" in bench.beat.summary
    assert bench.tracked("").valid
    bench.active.publish(ActiveProfile(document="{"))
    wait_for(lambda: "JSON" in bench.beat.summary, ANSWER, "the damaged document to be named")
    bench.activate(None)
    wait_for(lambda: bench.beat.state == Heartbeat.READY, ANSWER, "the node to be well again")
    bench.player.version = 2
    bench.player.positions = bench.motion.measured
    bench.player.names, bench.player.segments = NAMES, SEGMENTS
    bench.player.announce()
    bench.activate(bench.profile)
    assert bench.tracked("anna").markers_used > 10


@pytest.mark.graph
def test_a_profile_file_is_read_at_the_start_and_a_bad_one_refused(bench: Bench, tmp_path: Path):
    file = tmp_path / "anna.json"
    write_whole(file, profile_to_json(bench.profile))
    bench.start(profile_file=str(file))
    bench.player.start()
    assert bench.tracked("anna").valid
    bench.activate(None)  # the file wins
    time.sleep(0.5)
    assert bench.states[-1].profile_id == "anna"
    file.write_text("{")
    process = bench.graph.start("skeleton_node", profile_file=str(file))
    bench.graph.processes.remove(process)
    assert process.wait(FIRST_CONTACT + STOP) == 2
    lines = process.text().strip().splitlines()
    assert len(lines) == 1
    assert "anna.json" in lines[0]


def test_a_profile_travels_over_the_latched_topic_to_the_last_bit():
    profile = profile_of()
    again = profile_from_message(active_profile_message(profile))
    assert profile_document(again) == profile_document(profile)
    assert profile_from_message(active_profile_message(None)) is None
