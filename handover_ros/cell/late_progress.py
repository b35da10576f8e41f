"""A progress bar for work that takes long."""

from __future__ import annotations

import time

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

SHOWN_AFTER = 2.0  # [s]


class LateProgress:
    """Shows a bar when the work takes longer than two seconds and the output is a terminal; a context manager.

    Args:
        console: Where to show it.
        work: What is being done, in a word or two.
    """

    def __init__(self, console: Console, work: str) -> None:
        self._console, self._work = console, work
        self._began = time.monotonic()
        self._bar: Progress | None = None

    def __enter__(self) -> LateProgress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def update(self, fraction: float, text: str = "") -> None:
        """Tell how much is done (0 to 1), and something about it."""
        if not self._console.is_terminal:
            return
        if self._bar is None:
            if time.monotonic() - self._began < SHOWN_AFTER:
                return
            name, more = TextColumn("{task.description}"), TextColumn("{task.fields[more]}")
            columns = (name, BarColumn(), TimeRemainingColumn(), more)
            self._bar = Progress(*columns, console=self._console, transient=True)
            self._task = self._bar.add_task(self._work, total=1.0, more="")
            self._bar.start()
        self._bar.update(self._task, completed=fraction, more=text)
