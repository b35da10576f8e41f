"""The simulated cell as a real process: streams, services, the robot's deadman, bad messages, a clean end."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from graph import FIRST_CONTACT, REPOSITORY, Graph, isolated_graph, wait_for
from handover_msgs.msg import (
    GripperCommand,
    GripperState,
    Heartbeat,
    MarkerFrame,
    MarkerSet,
    ObjectStates,
    SimulationEvent,
    SimulationTruth,
)
from handover_msgs.srv import ResetSimulation, SetPersonBehaviour, SetSimulationFault
from rclpy.clock import Clock as RosClock
from rclpy.clock import ClockType
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from handover_ros.errors import ErrorCode
from handover_ros.nodes.convert import numpy_array, seconds_from_stamp, trajectory_message
from handover_ros.nodes.runtime import LATCHED, RECORDER, SENSOR_PUBLISHER
from handover_ros.nodes.sim_node import PARAMETERS
from handover_ros.robot.model import RobotModel

pytestmark = pytest.mark.graph

STREAM = 30.0  # [s] of wall time for something simulated to happen
ENABLE_PERIOD = 0.1  # [s] of wall time


class Cell:
    """The node under test, what it publishes, and the robot's enable signal."""

    def __init__(self, graph: Graph, pictures: Path) -> None:
        self.graph = graph
        node = graph.node
        self.process = graph.start(
            "sim_node",
            REPOSITORY / "config/sim_node.yaml",
            picture_directory=pictures,
            picture_size="[320, 240]",
            realtime_factor=2.0,
        )
        self.heartbeats = graph.collect(Heartbeat, "cell/heartbeat", SENSOR_PUBLISHER)
        self.clock = graph.collect(Clock, "/clock", SENSOR_PUBLISHER)
        self.frames = graph.collect(MarkerFrame, "sim/markers", RECORDER)
        self.sets = graph.collect(MarkerSet, "sim/marker_set", LATCHED)
        self.joints = graph.collect(JointState, "robot/joint_states", SENSOR_PUBLISHER)
        self.grippers = graph.collect(GripperState, "robot/gripper_state", SENSOR_PUBLISHER)
        self.objects = graph.collect(ObjectStates, "objects/states", SENSOR_PUBLISHER)
        self.truth = graph.collect(SimulationTruth, "sim/truth", SENSOR_PUBLISHER)
        self.events = graph.collect(SimulationEvent, "sim/events", RECORDER)
        self.trajectories = node.create_publisher(JointTrajectory, "robot/joint_trajectory", SENSOR_PUBLISHER)
        self.gripper_commands = node.create_publisher(GripperCommand, "robot/gripper_command", SENSOR_PUBLISHER)
        self.enable = node.create_publisher(Bool, "robot/enable", SENSOR_PUBLISHER)
        self.display = node.create_publisher(Image, "robot/display", LATCHED)
        self.enabled = True
        node.create_timer(ENABLE_PERIOD, self._send_enable, clock=RosClock(clock_type=ClockType.STEADY_TIME))
        wait_for(
            lambda: any(h.state == Heartbeat.READY for h in self.heartbeats), FIRST_CONTACT, "sim_node to be ready"
        )
        publishers = (self.trajectories, self.gripper_commands, self.enable, self.display)
        for publisher in publishers:
            wait_for(publisher.get_subscription_count, FIRST_CONTACT, f"{publisher.topic_name} to be connected")
        wait_for(lambda: self.joints and self.frames and self.objects, FIRST_CONTACT, "the streams")

    def _send_enable(self) -> None:
        if self.enabled:
            self.enable.publish(Bool(data=True))

    def positions(self, arm: str = "left") -> np.ndarray:
        """Return the latest displacements of an arm [rad]."""
        state = self.joints[-1]
        return np.array([state.position[state.name.index(name)] for name in ROBOT.arm(arm).joint_names])

    def wait_simulated(self, seconds: float) -> None:
        """Let simulated time pass."""
        start = seconds_from_stamp(self.clock[-1].clock)
        wait_for(lambda: seconds_from_stamp(self.clock[-1].clock) > start + seconds, STREAM, "simulated time to pass")

    def motion(self, seconds: float = 1.0, amount: float = 0.2) -> JointTrajectory:
        """Return a trajectory of the left arm from home."""
        arm = ROBOT.arm("left")
        return trajectory_message(arm.joint_names, np.array([seconds]), (arm.home + amount)[None], np.zeros((1, 7)))

    def enabled_and_heard(self) -> None:
        """Wait until the robot takes commands."""
        self.enabled = True
        wait_for(lambda: self._takes_gripper_command(), STREAM, "the robot to be enabled")

    def _takes_gripper_command(self) -> bool:
        before = len(self.events)
        self.gripper_commands.publish(GripperCommand(arm="right", opening=0.03, max_force=5.0))
        self.wait_simulated(0.3)
        return not any("held" in event.message for event in self.events[before:])

    def refusal(self, words: str) -> SimulationEvent:
        """Wait for an event that reports a refused message."""
        found = wait_for(
            lambda: [e for e in self.events if e.message.startswith("refused") and words in e.message],
            STREAM,
            f"a refusal with {words!r}",
        )
        return found[-1]


ROBOT = RobotModel.load("baxter")


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with isolated_graph() as graph:
        yield Cell(graph, tmp_path_factory.mktemp("pictures"))


@pytest.fixture(autouse=True)
def start(request: pytest.FixtureRequest) -> None:
    if "cell" in request.fixturenames:
        cell = request.getfixturevalue("cell")
        answer = cell.graph.call(ResetSimulation, "sim/reset", ResetSimulation.Request(seed=1, objects_only=False))
        assert answer.success, answer.message
        cell.wait_simulated(0.1)


def test_streams_name_their_things_and_run_on_one_clock(cell: Cell) -> None:
    cell.wait_simulated(1.0)
    marker_set = cell.sets[-1]
    assert len(marker_set.marker_names) == len(marker_set.segment_names) == 24
    assert marker_set.rate == 240.0
    frame = cell.frames[-1]
    positions = numpy_array(frame.positions, 24, 3)
    missing = np.frombuffer(frame.status, dtype=np.uint8) == MarkerFrame.MISSING
    np.testing.assert_array_equal(np.isnan(positions[:, 0]), missing)
    assert frame.header.frame_id == "world"
    stamps = [seconds_from_stamp(message.header.stamp) for message in cell.frames[-200:]]
    assert np.all(np.diff(stamps) > 0.0)
    assert np.median(np.diff(stamps)) == pytest.approx(1 / 240, abs=0.0011)
    assert abs(stamps[-1] - seconds_from_stamp(cell.clock[-1].clock)) < 1.0
    states = cell.objects[-1]
    assert sorted(states.names) == ["box", "glass", "handlebars", "mug", "pitcher", "plate", "u_lock"]
    assert numpy_array(states.poses, 7, 7).shape == (7, 7)
    truth = cell.truth[-1]
    assert set(truth.holders) == {"table"}
    assert len(truth.joint_names) == len(truth.displacements) == 20
    np.testing.assert_allclose(cell.positions(), ROBOT.arm("left").home, atol=0.01)
    assert cell.grippers[-1].arms == ["left", "right"]


def test_trajectory_is_followed_while_enabled(cell: Cell) -> None:
    cell.enabled_and_heard()
    cell.trajectories.publish(cell.motion())
    goal = ROBOT.arm("left").home + 0.2
    wait_for(lambda: np.abs(cell.positions() - goal).max() < 0.005, STREAM, "the arm to arrive")
    assert cell.truth[-1].velocity_limit_violations == 0


def test_robot_holds_when_enable_falls_silent(cell: Cell) -> None:
    cell.enabled_and_heard()
    cell.trajectories.publish(cell.motion(seconds=30.0, amount=0.5))
    home = ROBOT.arm("left").home
    wait_for(lambda: np.abs(cell.positions() - home).max() > 0.01, STREAM, "the arm to move")
    cell.enabled = False
    wait_for(lambda: np.abs(cell.joints[-1].velocity).max() < 1e-3, STREAM, "the robot to hold")
    held = cell.positions()
    cell.wait_simulated(1.0)
    np.testing.assert_allclose(cell.positions(), held, atol=1e-3)
    cell.trajectories.publish(cell.motion())
    cell.refusal("robot/enable")


def test_bad_messages_are_refused_with_a_line_and_an_event(cell: Cell) -> None:
    cell.enabled_and_heard()
    motion = cell.motion()
    motion.points[0].positions[2] = math.nan
    cell.trajectories.publish(motion)
    cell.refusal("finite")
    motion = cell.motion()
    motion.joint_names[0] = "tail"
    cell.trajectories.publish(motion)
    cell.refusal("left_s0")
    cell.trajectories.publish(JointTrajectory())
    cell.refusal("at least one")
    cell.trajectories.publish(cell.motion(seconds=0.01))
    cell.refusal("limit is")
    cell.gripper_commands.publish(GripperCommand(arm="left", opening=math.nan, max_force=10.0))
    cell.refusal("opening nan")
    cell.gripper_commands.publish(GripperCommand(arm="nose", opening=0.03, max_force=10.0))
    event = cell.refusal("'nose'")
    assert event.kind == "fault"
    cell.display.publish(Image(height=2, width=2, encoding="mono8", data=[0, 0, 0, 0]))
    cell.refusal("mono8")
    assert "'nose'" in cell.process.text()
    np.testing.assert_allclose(cell.positions(), ROBOT.arm("left").home, atol=0.01)


def test_faults_and_behaviours_are_set_by_service(cell: Cell) -> None:
    fault = SetSimulationFault.Request(kind="occlusion", magnitude=1.0, duration=1.0)
    assert cell.graph.call(SetSimulationFault, "sim/set_fault", fault).success
    wait_for(lambda: np.isnan(cell.frames[-1].positions).all(), STREAM, "all markers to be hidden")
    wait_for(lambda: np.isfinite(cell.frames[-1].positions).any(), STREAM, "markers to come back")
    bad = cell.graph.call(SetSimulationFault, "sim/set_fault", SetSimulationFault.Request(kind="gremlins"))
    assert (bad.success, bad.error_code) == (False, ErrorCode.UNKNOWN_NAME)
    assert "label_swap" in bad.message
    bad = cell.graph.call(
        SetSimulationFault, "sim/set_fault", SetSimulationFault.Request(kind="ghost", duration=math.nan)
    )
    assert (bad.success, bad.error_code) == (False, ErrorCode.BAD_REQUEST)
    request = SetPersonBehaviour.Request(behaviour="calibrate")
    answer = cell.graph.call(SetPersonBehaviour, "sim/set_person", request)
    assert answer.success
    assert answer.duration > 1.0
    bad = cell.graph.call(SetPersonBehaviour, "sim/set_person", SetPersonBehaviour.Request(behaviour="fly"))
    assert (bad.success, bad.error_code) == (False, ErrorCode.UNKNOWN_NAME)


@pytest.mark.rendering
def test_picture_is_drawn_by_service(cell: Cell) -> None:
    answer = cell.graph.call(Trigger, "sim/render", Trigger.Request(), timeout=120.0)
    if not answer.success:
        assert "libegl1" in answer.message
        pytest.skip(answer.message)
    assert Path(answer.message).read_bytes().startswith(b"\x89PNG")


def test_reset_puts_things_back_while_the_clock_goes_on(cell: Cell) -> None:
    before = seconds_from_stamp(cell.clock[-1].clock)
    answer = cell.graph.call(ResetSimulation, "sim/reset", ResetSimulation.Request(seed=-1, objects_only=True))
    assert answer.success
    wait_for(lambda: [e for e in cell.events if e.kind == "reset"], STREAM, "the event")
    assert seconds_from_stamp(cell.clock[-1].clock) >= before


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"mocap_rate": -5.0}, "mocap_rate"),
        ({"scene": "moon"}, "moon"),
        ({"person": "unicorn"}, "unicorn"),
        ({"physics_rate": 333.0}, "physics_rate"),
        ({"camera": "backstage"}, "overview"),
        ({"colour": "red"}, "colour"),
    ],
)
def test_bad_parameters_end_in_one_line_and_status_2(parameters: dict[str, object], words: str) -> None:
    with isolated_graph() as graph:
        process = graph.start("sim_node", **parameters)
        assert process.wait(FIRST_CONTACT) == 2
        assert words in process.text()
        assert "Traceback" not in process.text()
        graph.processes.clear()


def test_parameter_file_holds_every_parameter() -> None:
    written = yaml.safe_load((REPOSITORY / "config/sim_node.yaml").read_text())["sim_node"]["ros__parameters"]
    assert {spec.name: spec.default for spec in PARAMETERS} == written
