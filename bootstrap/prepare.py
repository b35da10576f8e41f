"""Brings a clone to the point where it can run: does what is outstanding, once, one process at a time."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from bootstrap.console import SetupError, Step, say
from bootstrap.layout import UNFINISHED, Layout, choose_state
from bootstrap.needs import (
    DISK_NEEDED,
    DISK_NEEDED_BUILD,
    DISK_NEEDED_SOURCED,
    Need,
    build_tool_needs,
    combined,
    compiler_need,
    disk_need,
    headers_need,
    platform_need,
    python_need,
)
from bootstrap.ros import SourcedRos, find_sourced
from bootstrap.steps import PlannedStep, Setup


def find_setup(source: Path) -> Setup:
    """Return the set-up of a clone in the way this shell asks for; nothing is made or changed."""
    state = choose_state(source)
    ros = find_sourced(state)
    return Setup(Layout(source, state, "wheels" if ros is None else "sourced"), ros)


def needs(setup: Setup, steps: list[PlannedStep]) -> list[Need]:
    """Return what the machine must have for some steps."""
    names = {step.name for step in steps}
    wanted = []
    if "venv" in names:
        wanted += [platform_need(), python_need()] if setup.ros is None else []
    if "messages" in names:
        wanted += [compiler_need(), *build_tool_needs()]
        wanted += [headers_need()] if setup.ros is None else []
    if names & {"venv", "packages"}:
        wanted.append(disk_need(setup.layout.state, DISK_NEEDED if setup.ros is None else DISK_NEEDED_SOURCED))
    elif names - {"caches"}:
        wanted.append(disk_need(setup.layout.state, DISK_NEEDED_BUILD))
    return wanted


def prepare(setup: Setup) -> None:
    """Do the outstanding steps; returns at once when there are none.

    Raises:
        SetupError: A step cannot be done; the message says what to do.
    """
    if not setup.outstanding():
        return
    try:
        with setup_lock(setup):
            # Another process may have done some of it while this one waited.
            setup.stamps = type(setup.stamps)(setup.stamps.path)
            steps = setup.outstanding()
            missing = [need for need in needs(setup, steps) if not need.found]
            if missing:
                raise SetupError(f"cannot set up: {combined(missing)}")
            for number, step in enumerate(steps, 1):
                with Step(number, len(steps), step.title) as line:
                    setup.stamps.set(step.name, UNFINISHED)
                    step.work(line)
                    setup.stamps.set(step.name, step.stamp)
    except OSError as error:
        raise SetupError(_explain_os_error(error, setup.layout.state)) from error
    finally:
        shutil.rmtree(setup.layout.temporary, ignore_errors=True)


@contextlib.contextmanager
def setup_lock(setup: Setup) -> Iterator[None]:
    """Hold the lock of a clone's set-up; wait, with a line, while another process has it."""
    layout = setup.layout
    for folder in (layout.root, layout.temporary):
        folder.mkdir(parents=True, exist_ok=True)
    with layout.lock_file.open("a+") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            stream.seek(0)
            holder = stream.read().strip() or "unknown"
            say(f"handover: another ./handover (process {holder}) is setting up; waiting for it")
            fcntl.flock(stream, fcntl.LOCK_EX)
        stream.seek(0)
        stream.truncate()
        stream.write(str(os.getpid()))
        stream.flush()
        layout.temporary.mkdir(parents=True, exist_ok=True)
        setup.lock = stream.fileno()
        try:
            yield
        finally:
            setup.lock = -1


def _explain_os_error(error: OSError, state: Path) -> str:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return (
            f"the disk of {state} is full; free {DISK_NEEDED:.0f} GB, or set HANDOVER_HOME to a folder on another disk"
        )
    if error.errno in (errno.EROFS, errno.EACCES, errno.EPERM):
        return f"{error.filename or state} cannot be written; set HANDOVER_HOME to a folder that can"
    return f"{error.filename or state}: {error.strerror or error}; set HANDOVER_HOME to another folder"


def describe(ros: SourcedRos | None) -> str:
    """Return which ROS is used, for people."""
    if ros is None:
        return "ROS 2 Jazzy from PyPI wheels"
    return f"sourced ROS 2 {os.environ.get('ROS_DISTRO', '')} ({ros.rclpy})"
