"""What set-up says to the person: one line a step, one line when it cannot go on."""

from __future__ import annotations

import shutil
import sys
import time
from types import TracebackType


class SetupError(Exception):
    """Set-up cannot go on; the message is one line that says what to do."""


class Interrupted(BaseException):
    """SIGTERM or SIGHUP arrived; as KeyboardInterrupt, nothing but the outermost place catches it."""


def say(text: str) -> None:
    """Print one line to standard error, where progress goes; standard output belongs to the commands."""
    print(text, file=sys.stderr, flush=True)


class Step:
    """The line of one step: ``[2/4] Installing ... 61 s``; on a terminal the seconds run while it works."""

    def __init__(self, number: int, total: int, title: str) -> None:
        self.head = f"[{number}/{total}] {title} ..."
        self.result = ""
        self._start = time.monotonic()
        self._live = sys.stderr.isatty()

    def __enter__(self) -> Step:
        print(self.head, end="", file=sys.stderr, flush=True)
        return self

    def tick(self) -> None:
        """Show how long the step has been running; called a few times a second."""
        if self._live:
            line = f"{self.head} {self.seconds:.0f} s"[: shutil.get_terminal_size().columns - 1]
            print(f"\r{line}", end="", file=sys.stderr, flush=True)

    @property
    def seconds(self) -> float:
        """How long the step has been running [s]."""
        return time.monotonic() - self._start

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            outcome = "failed" if issubclass(kind, Exception) else "interrupted"
        else:
            outcome = f"{self.result}{', ' if self.result else ''}{self.seconds:.1f} s"
        start = f"\r{self.head}" if self._live else ""
        print(f"{start} {outcome}", file=sys.stderr, flush=True)
