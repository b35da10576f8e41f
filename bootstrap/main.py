"""``./handover COMMAND``: set up if needed, then run; ``doctor``, ``bench`` and ``test`` are done here."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from types import FrameType

from bootstrap.console import Interrupted, SetupError, say
from bootstrap.environment import cell_environment
from bootstrap.prepare import find_setup, prepare
from bootstrap.steps import Setup

EXIT_BAD_INPUT = 2
HELP = """Usage: ./handover COMMAND [OPTIONS]

The first command sets this clone up (a few minutes, 2 GB in .handover/), then runs.

  demo     hand objects over to a simulated person and show what happened
  up       run the cell until Ctrl-C
  run      run one node
  doctor   what is installed, what is missing, what to type
  bench    measure, with other people's programs in the same run
  test     run all tests
  setup    set up and stop there

After the first command, ./handover --help lists every command and ./handover COMMAND --help its options.
"""


def main(arguments: list[str], source: str) -> int:
    """Run one command of the command line; return its exit status (most commands replace this process)."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _interrupt)
    try:
        return _dispatch(arguments, Path(source))
    except SetupError as error:
        say(f"handover: {error}")
        return EXIT_BAD_INPUT
    except (KeyboardInterrupt, Interrupted) as error:
        say("handover: interrupted; run it again to go on where it stopped")
        return 130 if isinstance(error, KeyboardInterrupt) else 143


def _dispatch(arguments: list[str], source: Path) -> int:
    command = arguments[0] if arguments else ""
    if command == "doctor":
        from bootstrap.doctor import doctor

        return doctor(arguments[1:], source)
    setup = find_setup(source)
    asks_for_help = command in ("", "-h", "--help", "help")
    if asks_for_help and setup.outstanding():
        print(HELP, end="")
        return 0
    prepare(setup)
    if command == "setup":
        say(f"handover: set up in {setup.layout.root}")
        return 0
    if command == "test":
        return _run_tests(setup, arguments[1:])
    if command == "bench":
        return _replace(setup, ["-m", "bench", *arguments[1:]])
    return _replace(setup, ["-m", "handover_ros.cli", *(["--help"] if asks_for_help else arguments)])


def _run_tests(setup: Setup, arguments: list[str]) -> int:
    """Run pytest over the whole source; paths are understood from the caller's folder and from the source."""
    source = setup.layout.source
    resolved = [str(Path(argument).absolute()) if Path(argument).exists() else argument for argument in arguments]
    os.chdir(source)
    # Without it a wrong field type in a message passes silently.
    os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")
    # A background job of a script ignores SIGINT, and so would every process that a test starts and interrupts.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return _replace(setup, ["-m", "pytest", *resolved])


def _replace(setup: Setup, arguments: list[str]) -> int:
    """Become the prepared Python, so that signals, the terminal and the exit status need no passing on."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) == _interrupt:
            signal.signal(number, signal.SIG_DFL)
    environment = cell_environment(setup.layout, setup.ros)
    python = setup.layout.python
    # The caller's folder must not shadow modules (-P came with Python 3.11).
    safe_path = [] if (setup.layout.venv / "lib" / "python3.10").is_dir() else ["-P"]
    sys.stdout.flush()
    os.execve(python, [str(python), *safe_path, *arguments], environment)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise Interrupted
