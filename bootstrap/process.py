"""Running the programs that set-up needs, so that an interrupt leaves none of them behind."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

from bootstrap.console import Step

POLL_PERIOD = 0.25  # [s]
GRACE = 3.0  # [s] between SIGTERM and SIGKILL


def run_logged(
    command: Sequence[str], log: Path, environment: Mapping[str, str], step: Step, directory: Path, lock: int
) -> int:
    """Run a program with its output in a log file, and return its exit status.

    The program gets a session of its own: Ctrl-C reaches only this process, which then ends the program and
    everything it started. It inherits the set-up lock, so that even if this process is killed outright no second
    set-up works in the same folder beside it.

    Args:
        command: Program and arguments.
        log: File that receives standard output and error; replaced.
        environment: The program's whole environment.
        step: Line on the terminal to keep alive.
        directory: Working directory.
        lock: File descriptor of the set-up lock.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("wb") as output:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            env=dict(environment),
            cwd=directory,
            start_new_session=True,
            pass_fds=(lock,),
        )
        try:
            while True:
                try:
                    return process.wait(POLL_PERIOD)
                except subprocess.TimeoutExpired:
                    step.tick()
        except BaseException:
            end_group(process)
            raise


def end_group(process: subprocess.Popen[bytes]) -> None:
    """End a program and everything in its process group: ask, wait a little, then insist."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGTERM)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(GRACE)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
