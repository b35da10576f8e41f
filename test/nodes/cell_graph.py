"""The whole graph as real processes, and what a client sees of it."""

from __future__ import annotations

import signal
import time
from pathlib import Path

from graph import ANSWER, FIRST_CONTACT, REPOSITORY, Graph, NodeProcess, wait_for
from handover_msgs.action import ExecuteHandover
from handover_msgs.msg import Heartbeat, SimulationEvent, SimulationTruth, SkeletonState
from rclpy.action import ActionClient
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from handover_ros.nodes.runtime import RECORDER, SENSOR_CONSUMER

NODES = ("sim_node", "mocap_node", "skeleton_node", "planner_node", "executive_node")
HANDOVER = 120.0  # [s] of wall time for a whole handover on a busy machine


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
