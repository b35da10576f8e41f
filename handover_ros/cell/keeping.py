"""Keeps a session while it runs: whatever ends it, its end and its report are written."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from rich.console import Console

from handover_ros.cell.late_progress import LateProgress
from handover_ros.cell.session import FAILED, Session
from handover_ros.cell.session_report import write_report
from handover_ros.errors import HandoverError


@dataclass
class Kept:
    """How a session goes, filled in by whoever runs it."""

    outcome: str = FAILED
    metrics: Mapping[str, float] = field(default_factory=dict)


@contextlib.contextmanager
def keeping(session: Session, console: Console) -> Iterator[Kept]:
    """Give a place for outcome and numbers; at the end the session's end is written, then its report.

    A long session's report takes a while: Ctrl-C leaves it out.

    Args:
        session: Which has begun.
        console: Where it is told.
    """
    kept = Kept()
    try:
        yield kept
    finally:
        session.end(kept.outcome, kept.metrics)
        with _interruptible():
            try:
                with LateProgress(console, "writing the report (Ctrl-C leaves it out)") as bar:
                    write_report(session.folder, lambda fraction: bar.update(fraction))
            except HandoverError as error:
                console.print(f"no report: {error}", highlight=False, soft_wrap=True)
            except KeyboardInterrupt:
                console.print("the report was left out")


@contextlib.contextmanager
def _interruptible() -> Iterator[None]:
    """Have Ctrl-C raise meanwhile, whatever it did before."""
    try:
        before = signal.signal(signal.SIGINT, signal.default_int_handler)
    except ValueError:  # not in the main thread
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
