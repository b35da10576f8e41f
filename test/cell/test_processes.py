"""Processes are started, watched and stopped without a trace."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from handover_ros.cell.processes import CellProcesses, NodeLaunch, parameter_text
from handover_ros.errors import BadRequestError

STUBBORN = (
    "import signal, time\nfor s in (2, 15): signal.signal(s, signal.SIG_IGN)\nprint('up', flush=True)\ntime.sleep(60)"
)


class Script(NodeLaunch):
    """A Python text in place of a node."""

    def command(self) -> list[str]:
        return [sys.executable, "-c", str(self.parameters["text"])]


def script(name: str, text: str) -> Script:
    return Script(name, {"text": text})


def wait_for_line(path: Path, text: str) -> None:
    deadline = time.monotonic() + 10.0
    while text not in path.read_text():
        assert time.monotonic() < deadline, path.read_text()
        time.sleep(0.01)


def test_stop_ends_even_a_stubborn_process_within_five_seconds(tmp_path: Path):
    processes = CellProcesses(tmp_path)
    node = processes.start(script("stubborn", STUBBORN))
    wait_for_line(node.log, "up")
    assert processes.stop() == {"stubborn": -signal.SIGKILL}


def test_leaving_the_block_stops_everything(tmp_path: Path):
    with CellProcesses(tmp_path) as processes:
        node = processes.start(script("sleeper", "print('up', flush=True)\nimport time; time.sleep(60)"))
        wait_for_line(node.log, "up")
    assert node.status is not None


def test_a_node_that_ends_is_reported_once_with_its_last_line(tmp_path: Path):
    with CellProcesses(tmp_path) as processes:
        node = processes.start(script("short", "import sys; print('x'); sys.exit('error: no such file')"))
        node.process.wait(10.0)
        assert [ended.launch.node for ended in processes.ended()] == ["short"]
        assert node.last_line() == "error: no such file"
        assert processes.ended() == []


def test_a_running_node_is_not_started_twice(tmp_path: Path):
    with CellProcesses(tmp_path) as processes:
        processes.start(script("one", "import time; time.sleep(60)"))
        with pytest.raises(BadRequestError, match="runs already"):
            processes.start(script("one", "pass"))


def test_nodes_end_when_their_parent_is_killed(tmp_path: Path):
    parent = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import sys, time\n"
            f"sys.path[:0] = {sys.path!r}\n"
            "from pathlib import Path\n"
            "from test_processes import script\n"
            "from handover_ros.cell.processes import CellProcesses\n"
            f"node = CellProcesses(Path({str(tmp_path)!r})).start(script('child', 'import time; time.sleep(60)'))\n"
            "print(node.process.pid, flush=True)\n"
            "time.sleep(60)",
        ],
        stdout=subprocess.PIPE,
        text=True,
        env=dict(os.environ, PYTHONPATH=os.pathsep.join([str(Path(__file__).parent), *sys.path])),
    )
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    parent.kill()
    parent.wait()
    deadline = time.monotonic() + 10.0
    while Path(f"/proc/{child}").exists() and "Z" not in Path(f"/proc/{child}/stat").read_text().split(")")[1][:3]:
        assert time.monotonic() < deadline, "the child outlived its parent"
        time.sleep(0.01)


@given(
    st.one_of(st.booleans(), st.integers(-1000, 1000), st.floats(-1e6, 1e6), st.text("abcN0:'\"{}- /.", max_size=12))
)
def test_a_parameter_keeps_its_type_and_value_through_yaml(value):
    read = yaml.safe_load(parameter_text(value))
    assert type(read) is type(value) or isinstance(value, float)
    assert read == value or float(read) == value
