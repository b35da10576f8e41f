"""The cell's nodes as processes of this machine: start, watch, stop. Nothing is left behind."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from handover_ros.errors import BadRequestError, HandoverError

#: The nodes of the whole cell, in the order in which they are started.
NODES = (
    "sim_node",
    "mocap_node",
    "skeleton_node",
    "calibration_node",
    "planner_node",
    "preference_node",
    "executive_node",
)

RECORDER = "recorder_node"
#: Nodes that belong to no running cell, but look at it or stand in for it.
EXTRA_NODES = ("recorder_node", "player_node")
PR_SET_PDEATHSIG = 1  # prctl(2): which signal a process gets when its parent dies
#: Grace [s] after each signal; together below the five seconds an operator waits after Ctrl-C.
STOP_SEQUENCE = ((signal.SIGINT, 2.5), (signal.SIGTERM, 1.0), (signal.SIGKILL, 1.0))


@dataclass(frozen=True)
class NodeLaunch:
    """How to start one node.

    Attributes:
        node: Executable name, e.g. ``mocap_node``.
        parameters: Overrides on top of the parameter file.
        parameter_file: ROS parameter YAML; None: only the defaults.
    """

    node: str
    parameters: Mapping[str, object] = field(default_factory=dict)
    parameter_file: Path | None = None

    def command(self) -> list[str]:
        """Return the command line."""
        command = [sys.executable, "-m", f"handover_ros.nodes.{self.node}", "--ros-args"]
        if self.parameter_file is not None:
            command += ["--params-file", str(self.parameter_file)]
        for name, value in self.parameters.items():
            command += ["-p", f"{name}:={parameter_text(value)}"]
        return command


@dataclass
class RunningNode:
    """One started node and its log."""

    launch: NodeLaunch
    process: subprocess.Popen[bytes]
    log: Path
    log_file: IO[bytes]
    reported: bool = False

    @property
    def status(self) -> int | None:
        """Exit status, None while it runs."""
        return self.process.poll()

    def last_line(self) -> str:
        """Return the last line the node printed that is not blank."""
        lines = [line.strip() for line in self.log.read_text(errors="replace").splitlines() if line.strip()]
        return lines[-1] if lines else "it printed nothing"


class CellProcesses:
    """The running nodes of one cell; a context manager that stops what it started.

    Args:
        log_folder: Each node's output goes to ``<log_folder>/<node>.log``.
    """

    def __init__(self, log_folder: Path) -> None:
        self.log_folder = log_folder
        self.nodes: dict[str, RunningNode] = {}

    def __enter__(self) -> CellProcesses:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self, launch: NodeLaunch) -> RunningNode:
        """Start one node in a process group of its own.

        Raises:
            BadRequestError: The node runs already.
        """
        running = self.nodes.get(launch.node)
        if running is not None and running.status is None:
            raise BadRequestError(f"{launch.node} runs already, as process {running.process.pid}")
        self.log_folder.mkdir(parents=True, exist_ok=True)
        log = self.log_folder / f"{launch.node}.log"
        log_file = log.open("ab")
        process = subprocess.Popen(
            launch.command(),
            stdin=subprocess.DEVNULL,
            stdout=log_file,
            stderr=subprocess.STDOUT,
            # Each thread would hoard what it freed in an arena of its own.
            env={"MALLOC_ARENA_MAX": "2", **os.environ, "PYTHONUNBUFFERED": "1"},
            start_new_session=True,
            preexec_fn=end_with_parent if sys.platform == "linux" else None,
        )
        self.nodes[launch.node] = RunningNode(launch, process, log, log_file)
        return self.nodes[launch.node]

    def ended(self) -> list[RunningNode]:
        """Return the nodes that ended since the last call."""
        ended = [node for node in self.nodes.values() if node.status is not None and not node.reported]
        for node in ended:
            node.reported = True
        return ended

    def stop(self) -> dict[str, int]:
        """Stop all nodes, the gentle way first, and the recorder last; return their exit statuses."""
        for number, grace in STOP_SEQUENCE:
            deadline = time.monotonic() + grace
            for recorders in (False, True):
                running = [
                    node
                    for node in self.nodes.values()
                    if node.status is None and (node.launch.node == RECORDER) is recorders
                ]
                for node in running:
                    with contextlib.suppress(ProcessLookupError):
                        os.killpg(node.process.pid, number)
                for node in running:
                    with contextlib.suppress(subprocess.TimeoutExpired):
                        node.process.wait(max(0.1, deadline - time.monotonic()))
        for node in self.nodes.values():
            node.log_file.close()
        return {name: node.process.returncode for name, node in self.nodes.items()}


def check_alive(processes: CellProcesses) -> None:
    """Raise when a node ended that should run, with what it said last; a recorder's end stops nothing.

    Raises:
        HandoverError: A node ended.
    """
    for node in processes.ended():
        line = node.last_line().removeprefix("error: ")
        if node.launch.node == RECORDER:
            print(f"the recording ended ({line}); the cell goes on without", file=sys.stderr)
            continue
        raise HandoverError(f"{node.launch.node} ended with status {node.status}: {line} (log: {node.log})")


def end_with_parent() -> None:
    """Have the kernel interrupt this process when its parent dies, however it dies.

    A background job of a script ignores interrupts, and so would what it starts.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGINT)


def parameter_text(value: object) -> str:
    """Return a parameter's value as the ROS command line takes it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # Quoted, so that YAML keeps "007" or "no" a string.
        return "'" + value.replace("'", "''") + "'"
    return repr(value) if isinstance(value, (int, float)) else str(value)
