"""The whole graph as real processes on an isolated domain: handovers, lost nodes, bad requests."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from graph import ANSWER, FIRST_CONTACT, REPOSITORY, Graph, NodeProcess, isolated_graph, wait_for
from handover_msgs.action import ExecuteHandover
from handover_msgs.msg import Heartbeat, SimulationEvent, SimulationTruth, SkeletonState
from handover_msgs.srv import PlanHandover, ResetSimulation, SetPersonBehaviour, SetSimulationFault
from rclpy.action import ActionClient
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from handover_ros.errors import ErrorCode
from handover_ros.nodes.runtime import RECORDER, SENSOR_CONSUMER

pytestmark = pytest.mark.graph

NODES = ("sim_node", "mocap_node", "skeleton_node", "planner_node", "executive_node")
HANDOVER = 120.0  # [s] of wall time for a whole handover on a busy machine
REPORT = 2.0  # [s] within which a lost node must be reported
SLACK = 1.5  # [s] for the result to travel and this process to look, on a busy machine


class Cell:
    """The graph and what a client sees of it."""

    def __init__(self, graph: Graph, tmp_path: Path) -> None:
        self.graph = graph
        # Six processes at full speed fill two cores; what is tested here does not depend on the speed.
        self.own = {"sim_node": {"realtime_factor": 0.7, "seed": 1, "picture_directory": str(tmp_path)}}
        self.processes: dict[str, NodeProcess] = {}
        self.events = graph.collect(SimulationEvent, "sim/events", RECORDER)
        self.truths: list[SimulationTruth] = []
        self.skeletons: list[SkeletonState] = []
        self.joints: list[JointState] = []
        self.beats: dict[str, float] = {}
        node = graph.node
        node.create_subscription(SimulationTruth, "sim/truth", lambda m: self.keep(self.truths, m), SENSOR_CONSUMER)
        node.create_subscription(
            SkeletonState, "human/skeleton_state", lambda m: self.keep(self.skeletons, m), SENSOR_CONSUMER
        )
        node.create_subscription(JointState, "robot/joint_states", lambda m: self.keep(self.joints, m), SENSOR_CONSUMER)
        node.create_subscription(Heartbeat, "cell/heartbeat", self.on_beat, QoSProfile(depth=50))
        self.client = ActionClient(node, ExecuteHandover, "handover/execute")
        self.feedback: list[str] = []

    @staticmethod
    def keep(messages: list, message: object) -> None:
        messages[:] = [*messages[-3:], message]

    def on_beat(self, message: Heartbeat) -> None:
        if message.state == Heartbeat.READY:
            self.beats[message.node] = time.monotonic()

    def start(self, *nodes: str) -> None:
        """Start nodes and wait until they are ready."""
        began = time.monotonic()
        self.skeletons.clear()
        for node in nodes:
            parameter_file = REPOSITORY / "config" / f"{node}.yaml"
            parameters = self.own.get(node, {"use_sim_time": True})
            self.processes[node] = self.graph.start(node, parameter_file, **parameters)

        def ready() -> bool:
            for node in nodes:
                if self.processes[node].process.poll() is not None:
                    raise AssertionError(f"{node} ended: {self.processes[node].text()}")
            return all(self.beats.get(node, 0.0) > began for node in nodes)

        wait_for(ready, 2 * FIRST_CONTACT, f"{', '.join(nodes)} to be ready")
        wait_for(self.client.server_is_ready, FIRST_CONTACT, "action handover/execute")
        wait_for(lambda: self.skeletons and self.skeletons[-1].valid, FIRST_CONTACT, "the torso to be tracked")

    def kill(self, node: str) -> float:
        """Kill a node at once; return when."""
        self.processes[node].signal(signal.SIGKILL)
        self.processes[node].wait(5.0)
        return time.monotonic()

    def send(self, object_name: str):
        """Send a goal; return its handle."""
        self.feedback.clear()
        goal = ExecuteHandover.Goal(object_name=object_name)
        sent = self.graph.on_executor(
            self.client.send_goal_async, goal, lambda message: self.feedback.append(message.feedback.phase)
        )
        return wait_for(lambda: sent.done() and sent.result(), ANSWER, "the goal to be accepted")

    def result(self, handle, limit: float = HANDOVER) -> ExecuteHandover.Result:
        """Return the result of a goal."""
        future = self.graph.on_executor(handle.get_result_async)
        return wait_for(lambda: future.done() and future.result(), limit, "the result").result

    def reached(self, handle, phase: str) -> None:
        """Wait for a phase; fail at once when the handover ends before."""
        future = self.graph.on_executor(handle.get_result_async)

        def there() -> bool:
            assert not future.done() or phase in self.feedback, future.result().result.message
            return phase in self.feedback

        wait_for(there, HANDOVER, f"phase {phase}")

    def saw(self, kind: str, object_name: str, since: int = 0) -> bool:
        return any(event.kind == kind and event.object_name == object_name for event in self.events[since:])

    def robot_stands_still(self) -> bool:
        message = self.joints[-1]
        return max(abs(speed) for speed in message.velocity) < 0.05


@pytest.fixture
def cell(tmp_path: Path) -> Iterator[Cell]:
    with isolated_graph() as graph:
        yield Cell(graph, tmp_path)


def test_two_objects_end_in_the_persons_hand_and_bad_requests_leave_the_nodes_up(cell: Cell) -> None:
    cell.start(*NODES)
    for name in ("mug", "u_lock"):
        result = cell.result(cell.send(name))
        assert result.success, result.message
        assert result.taken
        assert cell.saw("taken", name)
        wait_for(lambda name=name: cell.saw("placed", name), HANDOVER, f"the {name} to be put down")
        assert list(result.phases) == ["planning", "fetching", "presenting", "waiting", "releasing", "retracting"]
        assert min(result.phase_durations) >= 0.0
        put_back = ResetSimulation.Request(seed=-1, objects_only=True)
        assert cell.graph.call(ResetSimulation, "sim/reset", put_back).success
    assert [event.message for event in cell.events if event.kind == "dropped"] == []
    truth = cell.truths[-1]
    assert (truth.joint_limit_violations, truth.velocity_limit_violations) == (0, 0)

    unknown = cell.result(cell.send("brick"))
    assert unknown.error_code == ErrorCode.UNKNOWN_NAME
    assert "mug" in unknown.message, "the message lists what there is"
    for request, code, words in (
        (PlanHandover.Request(object_name="mug", scheme="telepathy"), ErrorCode.UNKNOWN_NAME, "relative"),
        (PlanHandover.Request(object_name="mug", arm="third"), ErrorCode.UNKNOWN_NAME, "left"),
        (PlanHandover.Request(object_name="mug", time_budget=float("nan")), ErrorCode.BAD_REQUEST, "time_budget"),
    ):
        answer = cell.graph.call(PlanHandover, "planner/plan_handover", request)
        assert (answer.success, answer.error_code) == (False, code), answer.message
        assert words in answer.message
    for service, name, request in (
        (SetSimulationFault, "sim/set_fault", SetSimulationFault.Request(kind="earthquake")),
        (SetSimulationFault, "sim/set_fault", SetSimulationFault.Request(kind="occlusion", magnitude=float("nan"))),
        (SetPersonBehaviour, "sim/set_person", SetPersonBehaviour.Request(behaviour="juggle")),
    ):
        answer = cell.graph.call(service, name, request)
        assert not answer.success
        assert answer.message
    answer = cell.graph.call(ResetSimulation, "sim/reset", ResetSimulation.Request(seed=2, objects_only=False))
    assert answer.success, answer.message
    assert all(process.process.poll() is None for process in cell.processes.values())


def test_nobody_takes_it_then_somebody_drops_it(cell: Cell) -> None:
    cell.start(*NODES)
    call = cell.graph.call
    assert call(SetPersonBehaviour, "sim/set_person", SetPersonBehaviour.Request(behaviour="ignore")).success
    result = cell.result(cell.send("mug"))
    assert result.error_code == ErrorCode.NOT_TAKEN, result.message
    assert not cell.saw("dropped", "mug")
    assert call(SetPersonBehaviour, "sim/set_person", SetPersonBehaviour.Request(behaviour="drop")).success
    result = cell.result(cell.send("mug"))
    assert result.error_code == ErrorCode.OBJECT_DROPPED, result.message
    wait_for(lambda: cell.saw("dropped", "mug"), ANSWER, "the simulator to say that the mug fell")


@pytest.mark.parametrize(
    ("victim", "phase"),
    [
        ("mocap_node", "fetching"),
        ("skeleton_node", "presenting"),
        ("planner_node", "waiting"),
        ("sim_node", "presenting"),
        ("executive_node", "fetching"),
    ],
)
def test_a_killed_node_is_reported_the_robot_stops_and_after_a_restart_the_next_handover_succeeds(
    cell: Cell, victim: str, phase: str
) -> None:
    cell.start(*NODES)
    call = cell.graph.call
    assert call(SetPersonBehaviour, "sim/set_person", SetPersonBehaviour.Request(behaviour="ignore")).success
    handle = cell.send("mug")
    cell.reached(handle, phase)
    killed = cell.kill(victim)
    if victim != "executive_node":
        result = cell.result(handle, REPORT + SLACK)
        assert time.monotonic() - killed < REPORT + SLACK
        assert result.error_code in (ErrorCode.NODE_LOST, ErrorCode.STALE_DATA), result.message
    if victim != "sim_node":
        wait_for(cell.robot_stands_still, REPORT + SLACK, "the robot to stop")
    cell.start(victim)
    ignore = SetPersonBehaviour.Request(behaviour="ignore")
    assert call(SetPersonBehaviour, "sim/set_person", ignore).success
    handle = cell.send("mug")
    # The robot may hold the mug still, in reach: the person shall take it when it is presented, not before.
    cell.reached(handle, "waiting")
    assert call(SetPersonBehaviour, "sim/set_person", SetPersonBehaviour.Request(behaviour="take")).success
    result = cell.result(handle)
    assert result.success, result.message
    assert result.taken
    assert not cell.saw("dropped", "mug")
