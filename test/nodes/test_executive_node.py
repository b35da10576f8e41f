"""The executive as a real process; planner, robot, person and the other nodes' heartbeats are mocked here."""

from __future__ import annotations

import math
import signal
from collections.abc import Iterator

import numpy as np
import pytest
from graph import ANSWER, FIRST_CONTACT, Graph, isolated_graph, wait_for
from handover_msgs.action import ExecuteHandover
from handover_msgs.msg import (
    CellState,
    GripperCommand,
    GripperState,
    HandoverPlan,
    Heartbeat,
    ObjectStates,
    RobotStage,
)
from handover_msgs.srv import PlanHandover, PlanMotion
from rclpy.action import ActionClient
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import Bool
from trajectory_msgs.msg import JointTrajectory

from handover_ros.errors import ErrorCode
from handover_ros.nodes.convert import float_array, trajectory_arrays, trajectory_message
from handover_ros.nodes.runtime import LATCHED, SENSOR_PUBLISHER
from handover_ros.robot.model import RobotModel

pytestmark = pytest.mark.graph

OPEN = 0.05  # [m]
NODES = ("sim_node", "mocap_node", "skeleton_node", "planner_node")


class MockedCell:
    """A robot that is always where its trajectory ends, a planner with one plan, a person who pulls on request."""

    def __init__(self, graph: Graph) -> None:
        node = graph.node
        self.graph = graph
        self.robot = RobotModel.load("baxter")
        self.names = self.robot.arm("left").joint_names
        self.positions = np.array(self.robot.arm("left").postures["home"], dtype=float)
        self.opening, self.gripping = OPEN, False
        self.pull = 0.0  # [N] along world x
        self.object_height = 0.8
        self.alive = set(NODES)
        self.refusal: tuple[int, str] | None = None
        self.enabled: list[bool] = []
        self.motions: list[str] = []
        self.joint_publisher = node.create_publisher(JointState, "robot/joint_states", SENSOR_PUBLISHER)
        self.gripper_publisher = node.create_publisher(GripperState, "robot/gripper_state", SENSOR_PUBLISHER)
        self.object_publisher = node.create_publisher(ObjectStates, "objects/states", SENSOR_PUBLISHER)
        self.heartbeat_publisher = node.create_publisher(Heartbeat, "cell/heartbeat", SENSOR_PUBLISHER)
        node.create_subscription(JointTrajectory, "robot/joint_trajectory", self.follow, SENSOR_PUBLISHER)
        node.create_subscription(GripperCommand, "robot/gripper_command", self.grip, SENSOR_PUBLISHER)
        node.create_subscription(Bool, "robot/enable", lambda message: self.enabled.append(message.data), 10)
        self.images = graph.collect(Image, "robot/display", LATCHED)
        self.cell_states = graph.collect(CellState, "cell/state", LATCHED)
        node.create_service(PlanHandover, "planner/plan_handover", self.plan)
        node.create_service(PlanMotion, "planner/plan_motion", self.plan_motion)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(0.01, self.publish_state, clock=steady)
        node.create_timer(0.2, self.beat, clock=steady)
        self.client = ActionClient(node, ExecuteHandover, "handover/execute")
        self.feedback: list[str] = []
        self.published = 0

    def beat(self) -> None:
        for name in self.alive:
            self.heartbeat_publisher.publish(Heartbeat(node=name, state=Heartbeat.READY))

    def publish_state(self) -> None:
        if "sim_node" not in self.alive:
            return
        torque = self.robot.jacobian("left", self.positions)[:3].T @ np.array([-self.pull, 0.0, 0.0])
        state = JointState(name=list(self.names))
        state.header.stamp = self.graph.node.get_clock().now().to_msg()
        state.position, state.velocity = float_array(self.positions), float_array(np.zeros(7))
        state.effort = float_array(torque)
        self.joint_publisher.publish(state)
        self.published += 1
        gripper = GripperState(arms=["left"], gripping=[bool(self.gripping)])
        gripper.openings, gripper.forces = float_array([self.opening]), float_array([0.0])
        self.gripper_publisher.publish(gripper)
        objects = ObjectStates(names=["mug"])
        objects.poses = float_array([0.7, 0.0, self.object_height, 0.0, 0.0, 0.0, 1.0])
        self.object_publisher.publish(objects)

    def follow(self, message: JointTrajectory) -> None:
        self.positions = trajectory_arrays(message)[2][-1].copy()

    def grip(self, message: GripperCommand) -> None:
        self.opening, self.gripping = message.opening, message.opening < 0.02

    def motion(self, offset: float) -> JointTrajectory:
        ends = np.stack([self.positions, np.array(self.robot.arm("left").postures["home"]) + offset])
        return trajectory_message(self.names, np.array([0.0, 0.3]), ends, np.zeros_like(ends))

    def plan(self, request: PlanHandover.Request, response: PlanHandover.Response) -> PlanHandover.Response:
        if self.refusal is not None:
            response.success = False
            response.error_code, response.message = self.refusal
            return response
        response.success = True
        response.plan = HandoverPlan(plan_id="p", object_name=request.object_name, scheme=request.scheme, arm="left")
        for name, offset, opening in (
            ("approach", 0.05, OPEN),
            ("grasp", None, 0.0),
            ("lift", 0.06, math.nan),
            ("present", 0.1, math.nan),
            ("retract", 0.0, math.nan),
        ):
            stage = RobotStage(name=name, opening=opening)
            if offset is not None:
                stage.trajectory = self.motion(offset)
            response.plan.stages.append(stage)
        return response

    def plan_motion(self, request: PlanMotion.Request, response: PlanMotion.Response) -> PlanMotion.Response:
        self.motions.append(request.posture)
        response.success = True
        response.trajectory = self.motion(0.0)
        return response

    def start(self, object_name: str = "mug"):
        """Send a goal; return its handle."""
        wait_for(self.client.server_is_ready, FIRST_CONTACT, "action handover/execute")
        goal = ExecuteHandover.Goal(object_name=object_name)
        sent = self.graph.on_executor(
            self.client.send_goal_async, goal, lambda message: self.feedback.append(message.feedback.phase)
        )
        return wait_for(lambda: sent.done() and sent.result(), ANSWER, "the goal to be accepted")

    def result(self, handle) -> ExecuteHandover.Result:
        """Return the result of a goal."""
        future = self.graph.on_executor(handle.get_result_async)
        return wait_for(lambda: future.done() and future.result(), ANSWER, "the result").result

    def felt_rest(self) -> None:
        """Wait until the executive has felt the object without a pull for a while."""
        until = self.published + 100
        wait_for(lambda: self.published > until, ANSWER, "joint states to be published")

    def reached(self, phase: str) -> None:
        wait_for(lambda: phase in self.feedback, ANSWER, f"phase {phase}; saw {self.feedback[-3:]}")


@pytest.fixture
def graph() -> Iterator[Graph]:
    with isolated_graph() as graph:
        yield graph


@pytest.fixture
def cell(graph: Graph) -> MockedCell:
    return MockedCell(graph)


def test_a_handover_from_goal_to_result(graph: Graph, cell: MockedCell) -> None:
    executive = graph.start("executive_node", pull_threshold=4.0)
    handle = cell.start()
    cell.reached("waiting")
    assert cell.gripping, "the object must be held until the person pulls"
    assert any(cell.enabled)
    cell.felt_rest()
    cell.pull = 8.0
    wait_for(lambda: not cell.gripping, ANSWER, "the gripper to open")
    cell.pull = 0.0
    result = cell.result(handle)
    assert result.success, result.message
    assert result.taken
    assert list(result.phases) == ["planning", "fetching", "presenting", "waiting", "releasing", "retracting"]
    assert all(seconds >= 0.0 for seconds in result.phase_durations)
    assert cell.images, "the head display must show something"
    wait_for(lambda: cell.cell_states and cell.cell_states[-1].phase == "idle", ANSWER, "the cell to be idle")
    wait_for(lambda: cell.enabled[-1] is False, ANSWER, "the robot to be disabled when idle")
    assert executive.stop() == 0


def test_cancel_while_waiting_puts_the_object_back(graph: Graph, cell: MockedCell) -> None:
    graph.start("executive_node")
    handle = cell.start()
    cell.reached("waiting")
    graph.on_executor(handle.cancel_goal_async)
    result = cell.result(handle)
    assert result.error_code == ErrorCode.CANCELLED
    assert cell.motions == ["put_back", "home"]
    assert not cell.gripping


def test_nobody_takes_it(graph: Graph, cell: MockedCell) -> None:
    graph.start("executive_node", take_limit=1.0)
    result = cell.result(cell.start())
    assert result.error_code == ErrorCode.NOT_TAKEN
    assert not result.taken
    assert cell.motions == ["put_back", "home"]


def test_a_refused_plan_and_a_second_goal_are_answered_and_the_next_one_works(graph: Graph, cell: MockedCell) -> None:
    graph.start("executive_node")
    cell.refusal = (int(ErrorCode.UNKNOWN_NAME), "unknown object 'brick'; known: mug")
    result = cell.result(cell.start("brick"))
    assert (result.success, result.error_code) == (False, ErrorCode.UNKNOWN_NAME)
    assert result.message == "unknown object 'brick'; known: mug"
    cell.refusal = None
    first = cell.start()
    cell.reached("waiting")
    busy = cell.result(cell.start())
    assert busy.error_code == ErrorCode.BUSY
    graph.on_executor(first.cancel_goal_async)
    assert cell.result(first).error_code == ErrorCode.CANCELLED


@pytest.mark.parametrize("lost", NODES)
def test_a_lost_node_is_reported_and_the_robot_stops(graph: Graph, cell: MockedCell, lost: str) -> None:
    graph.start("executive_node")
    handle = cell.start()
    cell.reached("waiting")
    cell.alive.discard(lost)
    result = cell.result(handle)
    assert result.error_code in (ErrorCode.NODE_LOST, ErrorCode.STALE_DATA)
    assert result.error_code == ErrorCode.STALE_DATA or lost in result.message
    wait_for(lambda: cell.enabled[-1] is False, ANSWER, "the robot to be told to hold")
    cell.alive.add(lost)
    cell.feedback.clear()
    again = cell.start()
    cell.reached("waiting")
    graph.on_executor(again.cancel_goal_async)
    assert cell.result(again).error_code == ErrorCode.CANCELLED


def test_stopping_in_the_middle_is_clean_and_tells_the_robot_to_hold(graph: Graph, cell: MockedCell) -> None:
    executive = graph.start("executive_node")
    cell.start()
    cell.reached("presenting")
    executive.signal(signal.SIGTERM)
    assert executive.wait(10.0) == 0
    assert "Traceback" not in executive.text()
    wait_for(lambda: cell.enabled[-1] is False, ANSWER, "the robot to be told to hold")


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"take_limit": -1.0}, ("take_limit", "-1")),
        ({"take_limt": 5.0}, ("take_limt", "unknown parameter")),
        ({"release_policy": "never"}, ("release_policy", "never")),
        ({"take_limit": "soon"}, ("take_limit", "soon")),
        ({"robot": "hal"}, ("hal", "baxter")),
    ],
)
def test_a_bad_parameter_is_one_line_and_status_2(graph: Graph, parameters: dict, words: tuple[str, ...]) -> None:
    executive = graph.start("executive_node", **parameters)
    assert executive.wait(30.0) == 2, executive.text()
    graph.processes.remove(executive)
    lines = [line for line in executive.text().splitlines() if line.strip()]
    assert len(lines) == 1, executive.text()
    assert all(word in lines[0] for word in words), lines[0]
