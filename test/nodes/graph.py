"""Real nodes on an isolated ROS domain, and bounded waiting for what they do."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import domain_coordinator
import rclpy
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

FIRST_CONTACT = 30.0  # [s] discovery has a slow mode of 1-3 s, and the machine may be busy
ANSWER = 30.0  # [s] a service's answer
STOP = 10.0  # [s] from SIGINT to the end of a process

REPOSITORY = Path(__file__).resolve().parents[2]


def wait_for(predicate: Callable[[], Any], timeout: float, what: str) -> Any:
    """Return the first true value of ``predicate``; fail with ``what`` after ``timeout`` seconds."""
    deadline = time.monotonic() + timeout
    while True:
        if value := predicate():
            return value
        if time.monotonic() > deadline:
            raise AssertionError(f"waited {timeout:g} s for {what}")
        time.sleep(0.01)


class NodeProcess:
    """One node of the package in a process (group) of its own."""

    def __init__(self, node: str, domain: int, parameters: dict[str, Any], parameter_file: Path | None = None) -> None:
        self.name = node
        command = [sys.executable, "-m", f"handover_ros.nodes.{node}", "--ros-args"]
        if parameter_file is not None:
            command += ["--params-file", str(parameter_file)]
        for key, value in parameters.items():
            command += ["-p", f"{key}:={str(value).lower() if isinstance(value, bool) else value}"]
        environment = dict(
            os.environ,
            ROS_DOMAIN_ID=str(domain),
            ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
            ROS_PYTHON_CHECK_FIELDS="1",
            PYTHONUNBUFFERED="1",
        )
        self.process = subprocess.Popen(
            command,
            env=environment,
            cwd=REPOSITORY,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        self.output: list[str] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        self.output.extend(self.process.stdout)

    def text(self) -> str:
        """Return what the node printed so far."""
        return "".join(self.output)

    def signal(self, number: signal.Signals) -> None:
        """Signal the node's process group."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, number)

    def stop(self, timeout: float = STOP) -> int:
        """Interrupt the node and return its exit status; kill it when it does not stop."""
        if self.process.poll() is None:
            self.signal(signal.SIGINT)
        try:
            return self.wait(timeout)
        except subprocess.TimeoutExpired:
            self.signal(signal.SIGKILL)
            self.wait(timeout)
            raise AssertionError(f"{self.name} did not stop within {timeout:g} s of SIGINT:\n{self.text()}") from None

    def wait(self, timeout: float) -> int:
        """Return the exit status of a node that ends by itself."""
        status = self.process.wait(timeout)
        self._reader.join(timeout=2.0)
        return status


class Graph:
    """A test's own node with an executor thread, and the node processes it started, on one isolated domain."""

    def __init__(self, domain: int) -> None:
        self.domain = domain
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = Node("test_node", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.processes: list[NodeProcess] = []
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        with contextlib.suppress(ExternalShutdownException):
            while self.context.ok() and not self._stop.is_set():
                self.executor.spin_once(timeout_sec=0.1)

    def start(self, node: str, parameter_file: Path | None = None, **parameters: Any) -> NodeProcess:
        """Start one node of the package."""
        process = NodeProcess(node, self.domain, parameters, parameter_file)
        self.processes.append(process)
        return process

    def collect(self, message_type: Any, topic: str, qos: Any) -> list[Any]:
        """Return a list that grows with the messages of a topic."""
        messages: list[Any] = []
        self.node.create_subscription(message_type, topic, messages.append, qos)
        return messages

    def on_executor(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call ``function`` in the executor's thread and return its result.

        rclpy's action client must be used from there: an answer that arrives before the caller's thread has noted the
        request's number is lost.
        """
        task = self.executor.create_task(function, *arguments)
        wait_for(task.done, ANSWER, f"{function} to be called")
        return task.result()

    def call(self, service_type: Any, name: str, request: Any, timeout: float = ANSWER) -> Any:
        """Return a service's answer."""
        client = self.node.create_client(service_type, name)
        try:
            wait_for(client.service_is_ready, FIRST_CONTACT, f"service {name}")
            future = client.call_async(request)
            wait_for(future.done, timeout, f"the answer of {name}")
            return future.result()
        finally:
            self.node.destroy_client(client)

    def close(self) -> None:
        """Stop every process and destroy what was created; fail when a process did not end well."""
        failures = []
        for process in reversed(self.processes):
            if process.process.poll() is None:
                process.signal(signal.SIGINT)
        for process in reversed(self.processes):
            try:
                if process.stop() not in (0, -signal.SIGKILL):
                    failures.append(f"{process.name} ended with {process.process.returncode}:\n{process.text()}")
            except AssertionError as error:
                failures.append(str(error))
        # The context last: to shut it down under a running executor has been seen to hang for ever.
        self._stop.set()
        self._thread.join(timeout=5.0)
        self.executor.shutdown(timeout_sec=1.0)
        self.node.destroy_node()
        self.context.try_shutdown()
        assert not failures, "\n".join(failures)


@contextlib.contextmanager
def isolated_graph() -> Iterator[Graph]:
    """Give a graph on a domain nobody else on this machine uses."""
    with domain_coordinator.domain_id() as domain:
        graph = Graph(domain)
        try:
            yield graph
        finally:
            graph.close()
