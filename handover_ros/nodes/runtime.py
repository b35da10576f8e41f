"""What all nodes share: start and stop, QoS profiles, heartbeat, diagnostics, awaiting a service."""

from __future__ import annotations

import faulthandler
import functools
import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable, Coroutine
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from handover_msgs.msg import Heartbeat
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.client import Client
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from handover_ros.errors import HandoverError, StaleDataError
from handover_ros.nodes.convert import wall_time
from handover_ros.nodes.parameters import ParameterSpec, ParameterTable

HEARTBEAT_PERIOD = 0.2  # [s] wall time
DIAGNOSTICS_PERIOD = 1.0  # [s] wall time, REP-107
DISCOVERY_LIMIT = 5.0  # [s] of wall time a service may take to be discovered
POLL_PERIOD = 0.1  # [s] of wall time between two looks
SWITCH_INTERVAL = 0.001  # [s] a thread may hold the interpreter while a stream's thread waits for it
STOP_LIMIT = 4.0  # [s] of wall time a node may take to end; an operator waits five
WORKER = "_worker"  # how the names of worker threads end
EXIT_BAD_INPUT = 2
EXIT_CRASHED = 1

# The five QoS profiles of the package; there are no others.
#: Publishers of fast streams: nothing is lost while a consumer catches up with two seconds of it.
STREAM_PUBLISHER = QoSProfile(depth=500, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.RELIABLE)
#: Other publishers, and both sides of commands: nothing is lost while the consumer keeps up.
SENSOR_PUBLISHER = QoSProfile(depth=10, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.RELIABLE)
#: Live consumers of streams: the newest sample or none; depth is staleness.
SENSOR_CONSUMER = QoSProfile(depth=2, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT)
#: Consumers that must see every sample: recorders, filters over a stream.
RECORDER = QoSProfile(depth=2000, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.RELIABLE)
#: Names, plans, profiles, beliefs: the last value reaches whoever comes later.
LATCHED = QoSProfile(
    depth=1,
    history=HistoryPolicy.KEEP_LAST,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)


class HandoverNode(Node):
    """Base of the nodes: checked parameters, a heartbeat and diagnostics.

    A subclass creates its publishers, subscriptions and services in its constructor and calls ``ready()`` last.
    ``diagnose`` and ``on_stop`` may be overridden. A subclass whose work can wait sets ``niceness``, so that on a busy
    machine the streams come first.

    Args:
        name: Node name, which is also the executable's name.
        parameters: Declared parameters; an override of any other name is refused.

    Raises:
        BadRequestError: A parameter is unknown, of the wrong type or out of range.
    """

    niceness = 0

    def __init__(self, name: str, parameters: tuple[ParameterSpec, ...] = (), **node_arguments: Any) -> None:
        os.nice(self.niceness)
        super().__init__(name, **node_arguments)
        self.parameters = ParameterTable(self, parameters)
        self.steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.last_problem = ""  # for /diagnostics
        self.exit_status = 0  # of the process, when the node ends by itself
        self._heartbeat_state = Heartbeat.STARTING
        self._heartbeat_summary = "starting"
        self._heartbeat_publisher = self.create_publisher(Heartbeat, "cell/heartbeat", SENSOR_PUBLISHER)
        self._diagnostics_publisher = self.create_publisher(DiagnosticArray, "/diagnostics", SENSOR_PUBLISHER)
        # A group of its own: the heartbeat beats as long as the executor turns.
        liveness = MutuallyExclusiveCallbackGroup()
        self.create_timer(HEARTBEAT_PERIOD, self._beat, callback_group=liveness, clock=self.steady_clock)
        self.create_timer(
            DIAGNOSTICS_PERIOD, self._publish_diagnostics, callback_group=liveness, clock=self.steady_clock
        )

    def ready(self, summary: str = "ready") -> None:
        """Say that the node is ready for work."""
        self._set_heartbeat(Heartbeat.READY, summary)
        self.get_logger().info(summary)

    def degraded(self, summary: str) -> None:
        """Say that the node works with a limitation."""
        self._set_heartbeat(Heartbeat.DEGRADED, summary)

    def seconds_now(self) -> float:
        """Return the ROS time [s] (simulated when ``use_sim_time`` is set)."""
        return self.get_clock().now().nanoseconds * 1e-9

    def diagnose(self) -> tuple[bool, str, dict[str, object]]:
        """Return (is well, one line, values) for /diagnostics; called once a second of wall time."""
        return True, self._heartbeat_summary, {}

    def on_stop(self) -> None:
        """Send last messages (zero command, flush); called once, after the executor stopped."""

    def _set_heartbeat(self, state: int, summary: str) -> None:
        self._heartbeat_state = state
        self._heartbeat_summary = summary
        self._beat()

    def _beat(self) -> None:
        message = Heartbeat(node=self.get_name(), state=self._heartbeat_state, summary=self._heartbeat_summary)
        message.stamp = wall_time()
        self._heartbeat_publisher.publish(message)

    def _publish_diagnostics(self) -> None:
        well, line, values = self.diagnose()
        status = DiagnosticStatus(name=self.get_name(), hardware_id="handover_cell", message=line)
        status.level = DiagnosticStatus.OK if well else DiagnosticStatus.WARN
        status.values = [KeyValue(key=key, value=format_value(value)) for key, value in values.items()]
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics_publisher.publish(array)

    def serve(self, service_type: type, name: str, work: Callable[..., Coroutine[Any, Any, None]], group: Any) -> None:
        """Answer requests by a coroutine ``work(request, response)`` that fills the response.

        Args:
            service_type: Of the service.
            name: Of the service.
            work: Its exceptions become ``success: false`` with code and message, and the node's last problem.
            group: A reentrant callback group, so that a request that waits holds up no other.
        """

        async def callback(request: Any, response: Any) -> Any:
            await answer(response, work(request, response), self)
            if not response.success:
                self.last_problem = response.message
            return response

        self.create_service(service_type, name, callback, callback_group=group)

    async def pause(self, seconds: float) -> None:
        """Let a coroutine wait for ``seconds`` of wall time while the executor goes on."""
        over = Future()
        timer = self.create_timer(seconds, lambda: over.set_result(None), clock=self.steady_clock)
        try:
            await over
        finally:
            self.destroy_timer(timer)

    async def call(self, client: Client, request: Any, timeout: float) -> Any:
        """Await a service's answer inside a callback.

        Args:
            client: Made in a reentrant callback group, as must be the calling callback.
            request: The service's request.
            timeout: [s] of wall time.

        Raises:
            StaleDataError: The service is not there or did not answer in time.
        """
        for _ in range(round(DISCOVERY_LIMIT / POLL_PERIOD)):
            if client.service_is_ready():
                break
            await self.pause(POLL_PERIOD)
        else:
            raise StaleDataError(f"service {client.srv_name} is not there: is its node running?")
        future = client.call_async(request)
        timer = self.create_timer(timeout, future.cancel, clock=self.steady_clock)
        try:
            answer = await future
        finally:
            self.destroy_timer(timer)
        if answer is None:
            client.remove_pending_request(future)
            raise StaleDataError(f"service {client.srv_name} did not answer within {timeout:g} s")
        return answer


def format_value(value: object) -> str:
    """Return a diagnostic value as text: floats with six significant digits."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


class Worker:
    """One background thread that does a node's long work, one job at a time, so that the executor keeps turning.

    A job is a plain function; its result comes back as an rclpy future that a coroutine callback awaits. The future is
    completed from the executor (through a guard condition), never from the thread. It is the same thread for all jobs:
    what one of them freed is there for the next one, and the node's memory stays as it is.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._waiting: queue.SimpleQueue[tuple[Future, Callable[[], Any]]] = queue.SimpleQueue()
        self._finished: list[tuple[Future, Any, Exception | None]] = []
        self._lock = threading.Lock()
        self._guard = node.create_guard_condition(self._deliver)
        threading.Thread(target=self._run, daemon=True, name=f"{node.get_name()}{WORKER}").start()

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future:
        """Start ``function(*arguments)`` when the jobs before it are done; return the future of its result."""
        future = Future()
        self._waiting.put((future, functools.partial(function, *arguments)))
        return future

    def _run(self) -> None:
        while True:
            future, job = self._waiting.get()
            result, error = None, None
            try:
                result = job()
            except Exception as caught:
                error = caught
            del job
            with self._lock:
                self._finished.append((future, result, error))
            del future, result, error  # nothing of a job is kept until the next one
            if self._node.context.ok():
                self._guard.trigger()

    def _deliver(self) -> None:
        with self._lock:
            finished, self._finished = self._finished, []
        for future, result, error in finished:
            if error is not None:
                future.set_exception(error)
            else:
                future.set_result(result)


async def answer(response: Any, work: Coroutine[Any, Any, None], node: Node) -> Any:
    """Await ``work``, which fills ``response``; turn an error into ``success: false, error_code, message``.

    Nothing raises across the graph: an error that is nobody's to mend is logged with its traceback and answered as
    INTERNAL.
    """
    try:
        await work
    except HandoverError as error:
        response.success, response.error_code, response.message = False, int(error.code), str(error)
    except Exception as error:
        node.get_logger().error(f"internal error: {error!r}", exc_info=True)
        response.success, response.error_code = False, 500
        response.message = f"internal error in {node.get_name()}: {error!r}; see its log"
    return response


def leave_at_once(name: str) -> None:
    """End the process although the middleware does not let go; say where every thread stood."""
    print(f"{name}: did not shut down within {STOP_LIMIT:g} s and leaves at once", file=sys.stderr)
    faulthandler.dump_traceback(all_threads=True)
    os._exit(EXIT_CRASHED)


def spin_until(executor: SingleThreadedExecutor, stop: threading.Event) -> None:
    """Turn the executor until ``stop`` is set or the context is shut down.

    No timeout is given, since rclpy makes a timer for each; the heartbeat wakes the executor often enough.
    """
    try:
        while not stop.is_set():
            executor.spin_once()
    except ExternalShutdownException:
        pass


def run_node(factory: Callable[[], HandoverNode], arguments: list[str] | None = None) -> int:
    """Run one node until SIGINT or SIGTERM and return the process's exit status.

    The signals are taken here, not by rclpy, so that the node can still send its last messages. An exception in a
    callback ends the process with its traceback and status 1; bad parameters or files with one line and status 2.
    """
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = factory()
    except HandoverError as error:
        print(f"error: {error}", file=sys.stderr, flush=True)
        rclpy.try_shutdown()
        return EXIT_BAD_INPUT
    sys.setswitchinterval(SWITCH_INTERVAL)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    crashed: list[BaseException] = []

    def spin() -> None:
        try:
            spin_until(executor, stop)
        except BaseException as error:
            crashed.append(error)
            stop.set()

    thread = threading.Thread(target=spin, name="executor", daemon=True)
    thread.start()
    while not stop.wait(timeout=0.5):
        # A bounded wait, so that Python gets to run its signal handlers on every platform.
        pass
    leave = threading.Timer(STOP_LIMIT, leave_at_once, args=[node.get_name()])
    leave.daemon = True
    leave.start()
    executor.wake()
    thread.join(timeout=STOP_LIMIT / 2.0)
    try:
        node.on_stop()
        node.destroy_node()
        executor.shutdown(timeout_sec=1.0)
    finally:
        rclpy.try_shutdown()
        leave.cancel()
    if crashed:
        sys.excepthook(type(crashed[0]), crashed[0], crashed[0].__traceback__)
        return EXIT_CRASHED
    return node.exit_status


def main_of(factory: Callable[[], HandoverNode]) -> Callable[[], None]:
    """Return the console entry point of a node."""

    def main() -> None:
        status = run_node(factory)
        for number in (signal.SIGINT, signal.SIGTERM):
            # Python's exit puts the default handlers back: a second Ctrl-C would kill a node that ended well.
            signal.signal(number, signal.SIG_IGN)
        sys.exit(status)

    return main


def monotonic() -> float:
    """Return the steady wall clock [s], for ages and liveness."""
    return time.monotonic()
