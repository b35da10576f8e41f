"""The operator's side of the graph: waits until the cell is ready, runs handovers, reads what happened.

Used by ``handover demo`` and ``handover up``; not a node of the cell. The true state it reads from the simulator is
for judging the outcome only.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from handover_msgs.action import ExecuteHandover
from handover_msgs.msg import Heartbeat, SimulationEvent, SimulationTruth, SkeletonState
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from handover_ros.errors import HandoverError, StaleDataError
from handover_ros.nodes.runtime import RECORDER, SENSOR_CONSUMER, SENSOR_PUBLISHER

POLL = 0.02  # [s] of wall time
ANSWER_LIMIT = 30.0  # [s] of wall time a service may take

Value = TypeVar("Value")


class InterruptedByOperatorError(HandoverError):
    """The operator pressed Ctrl-C."""


@dataclass(frozen=True)
class Interrupt:
    """A flag that Ctrl-C sets; every wait of the operator looks at it."""

    event: threading.Event

    def check(self) -> None:
        """Raise when the operator wants to stop."""
        if self.event.is_set():
            raise InterruptedByOperatorError("interrupted")


class Operator:
    """A node with its executor in a thread; every method blocks, bounded and interruptible.

    Args:
        interrupt: Set by Ctrl-C.
        watch: Called while waiting; raises when the cell is broken (a node ended).
    """

    def __init__(self, interrupt: Interrupt, watch: Callable[[], None] = lambda: None) -> None:
        self.interrupt = interrupt
        self.watch = watch
        self.context = Context()
        rclpy.init(context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node("operator", context=self.context, start_parameter_services=False)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self._clients: dict[str, Any] = {}
        self.states: dict[str, int] = {}
        self.events: list[SimulationEvent] = []
        self.truth: SimulationTruth | None = None
        self.taken_truth: SimulationTruth | None = None  # of the moment an object was last taken
        self.skeleton: SkeletonState | None = None
        self.residuals: list[float] = []
        self.realtime_factors: list[float] = []
        self.diagnostics: dict[str, dict[str, str]] = {}
        node = self.node
        node.create_subscription(Heartbeat, "cell/heartbeat", self._on_heartbeat, SENSOR_PUBLISHER)
        node.create_subscription(SimulationEvent, "sim/events", self._on_event, RECORDER)
        node.create_subscription(SimulationTruth, "sim/truth", self._on_truth, SENSOR_CONSUMER)
        node.create_subscription(SkeletonState, "human/skeleton_state", self._on_skeleton, SENSOR_CONSUMER)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, SENSOR_PUBLISHER)
        self.handover_client = ActionClient(node, ExecuteHandover, "handover/execute")
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._spin, daemon=True, name="operator")
        self._thread.start()

    def _spin(self) -> None:
        with contextlib.suppress(ExternalShutdownException):
            while self.context.ok() and not self._stop.is_set():
                self.executor.spin_once(timeout_sec=0.5)

    def close(self) -> None:
        """Leave the graph; the context last, since shutting it down under a running executor can hang."""
        self._stop.set()
        self._thread.join(timeout=3.0)
        self.executor.shutdown(timeout_sec=1.0)
        self.node.destroy_node()
        self.context.try_shutdown()

    def _on_event(self, message: SimulationEvent) -> None:
        self.events.append(message)
        if message.kind == "taken":
            self.taken_truth = self.truth

    def _on_heartbeat(self, message: Heartbeat) -> None:
        self.states[message.node] = message.state

    def _on_truth(self, message: SimulationTruth) -> None:
        self.truth = message
        if message.realtime_factor > 0.0:
            self.realtime_factors.append(message.realtime_factor)

    def _on_skeleton(self, message: SkeletonState) -> None:
        self.skeleton = message
        if message.valid and np.isfinite(message.residual_rms):
            self.residuals.append(message.residual_rms)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.diagnostics[status.name] = {pair.key: pair.value for pair in status.values}

    def wait(self, predicate: Callable[[], Value], limit: float, what: str) -> Value:
        """Return the first true value of ``predicate``.

        Raises:
            StaleDataError: Not within ``limit`` [s] of wall time; says ``what`` was waited for.
        """
        deadline = time.monotonic() + limit
        while True:
            self.interrupt.check()
            self.watch()
            if value := predicate():
                return value
            if time.monotonic() > deadline:
                raise StaleDataError(f"waited {limit:g} s for {what}")
            time.sleep(POLL)

    def wait_ready(self, nodes: tuple[str, ...], limit: float) -> None:
        """Wait until every node says it is ready, the action is served and the person's torso is tracked."""
        self.wait(
            lambda: all(self.states.get(node, Heartbeat.STARTING) != Heartbeat.STARTING for node in nodes),
            limit,
            "all nodes to be ready",
        )
        self.wait(self.handover_client.server_is_ready, limit, "action handover/execute")
        self.wait(lambda: self.skeleton is not None and self.skeleton.valid, limit, "a valid human/skeleton_state")

    def call(self, service_type: Any, name: str, request: Any, limit: float = ANSWER_LIMIT) -> Any:
        """Return a service's answer."""
        client = self._clients.get(name)
        if client is None:  # kept: each new one has every process of the graph work, and remember
            client = self._clients[name] = self.node.create_client(service_type, name)
        self.wait(client.service_is_ready, limit, f"service {name}")
        future = client.call_async(request)
        self.wait(future.done, limit, f"the answer of {name}")
        return future.result()

    def _on_executor(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call ``function`` in the executor's thread and return its result.

        rclpy's action client must be used from there: an answer that arrives before the caller's thread has noted the
        request's number is lost.
        """
        task = self.executor.create_task(function, *arguments)
        self.wait(task.done, ANSWER_LIMIT, "the executor")
        return task.result()

    def render(self) -> str:
        """Have the simulator render a picture; return the file's name, empty when it cannot."""
        answer = self.call(Trigger, "sim/render", Trigger.Request())
        return answer.message if answer.success else ""

    def hand_over(
        self, goal: ExecuteHandover.Goal, on_phase: Callable[[str, str], None], limit: float
    ) -> ExecuteHandover.Result:
        """Run one handover and return its result; on Ctrl-C the handover is cancelled first.

        Args:
            goal: Which object, which scheme.
            on_phase: Called with (phase, message) when the phase changes, from this thread.
            limit: [s] of wall time.
        """
        news: list[ExecuteHandover.Feedback] = []
        sent = self._on_executor(
            self.handover_client.send_goal_async, goal, lambda message: news.append(message.feedback)
        )
        handle = self.wait(lambda: sent.done() and sent.result(), ANSWER_LIMIT, "the goal to be accepted")
        future = self._on_executor(handle.get_result_async)
        phase = ""

        def look() -> bool:
            nonlocal phase
            while news:
                feedback = news.pop(0)
                if feedback.phase != phase:
                    phase = feedback.phase
                    on_phase(feedback.phase, feedback.message)
            return future.done()

        try:
            self.wait(look, limit, f"the handover of {goal.object_name} to end")
        except InterruptedByOperatorError:
            self.executor.create_task(handle.cancel_goal_async)
            raise
        return future.result().result

    def holder_of(self, object_name: str) -> str:
        """Return who truly holds an object; empty when unknown."""
        truth = self.truth
        if truth is None or object_name not in truth.object_names:
            return ""
        return truth.holders[list(truth.object_names).index(object_name)]


@contextlib.contextmanager
def operating(interrupt: Interrupt, watch: Callable[[], None] = lambda: None) -> Iterator[Operator]:
    """Give an operator that leaves the graph at the end."""
    operator = Operator(interrupt, watch)
    try:
        yield operator
    finally:
        operator.close()
