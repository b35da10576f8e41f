"""The troubles of a bag: what nodes reported in diagnostics and logs, and nodes that fell silent."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from handover_ros.bags.timeline_types import (
    DIAGNOSTICS,
    ERROR,
    LOG,
    LOST,
    SETTLING,
    SHUTDOWN,
    SILENT,
    WARNING,
    Trouble,
)

EXECUTIVE = "executive_node"
LOG_WARNING, LOG_ERROR = 30, 40  # levels of rcl_interfaces/Log
SILENT_AFTER = 2.0  # [s] without a heartbeat, of which there are five a second


@dataclass
class _Open:
    """A trouble that goes on."""

    begin: float
    end: float
    level: int
    message: str
    times: int = 1


class Troubles:
    """Takes in diagnostics, log lines, heartbeats and lost nodes, and gives the troubles.

    Args:
        most: How many are kept.

    Attributes:
        ready: When the executive first was well [s]; NaN: never.
        left_out: How many troubles are not kept.
    """

    def __init__(self, most: int) -> None:
        self.ready = math.nan
        self.left_out = 0
        self._most = most
        self._found: list[Trouble] = []
        self._reported: dict[str, _Open] = {}
        self._logged: dict[tuple[str, str], _Open] = {}
        self._lost: dict[str, float] = {}
        self._beats: dict[str, float] = {}

    def take_diagnostics(self, seconds: float, array: Any) -> None:
        """Take in the verdicts of nodes; from the first that is not well to the next that is, it is one trouble."""
        for status in array.status:
            level = int.from_bytes(status.level, "little") if isinstance(status.level, bytes) else int(status.level)
            now = self._reported.get(status.name)
            if level == 0:
                if status.name == EXECUTIVE and math.isnan(self.ready):
                    self.ready = seconds
                if now is not None:
                    self._end_report(status.name, seconds)
            elif now is None:
                self._reported[status.name] = _Open(seconds, seconds, level, status.message)
            else:
                now.end = seconds
                now.times += 1
                if level > now.level:
                    now.level, now.message = level, status.message

    def take_log(self, seconds: float, line: Any) -> None:
        """Take in a line of a log; the same line again is the same trouble."""
        level = int(line.level)
        if level < LOG_WARNING:
            return
        key = (line.name, line.msg)
        known = self._logged.get(key)
        if known is not None:
            known.end, known.times = seconds, known.times + 1
        elif len(self._logged) < self._most:
            self._logged[key] = _Open(seconds, seconds, level, line.msg)
        else:
            self.left_out += 1

    def take_lost(self, seconds: float, nodes: Sequence[str]) -> None:
        """Take in which nodes the executive misses now."""
        for node in [node for node in self._lost if node not in nodes]:
            self._note_lost(node, seconds)
        for node in nodes:
            self._lost.setdefault(node, seconds)

    def take_heartbeat(self, seconds: float, node: str) -> None:
        """Take in that a node is alive."""
        before = self._beats.get(node)
        if before is not None and seconds - before > SILENT_AFTER:
            self._note_silent(node, before, seconds)
        self._beats[node] = seconds

    def closed(self, duration: float) -> tuple[Trouble, ...]:
        """Return all troubles of a bag of so many seconds, by their beginning."""
        for name in list(self._reported):
            self._end_report(name, self._reported[name].end)
        for node in list(self._lost):
            self._note_lost(node, duration)
        for node, last in self._beats.items():
            if duration - last > SHUTDOWN:
                self._note_silent(node, last, duration)
        for (node, _), told in self._logged.items():
            level = ERROR if told.level >= LOG_ERROR else WARNING
            self._add(Trouble(node, told.begin, told.end, level, told.message, told.times, LOG))
        found = sorted(self._found, key=lambda trouble: (trouble.begin, trouble.node))
        return tuple(replace(trouble, starting=self._starting(trouble)) for trouble in found)

    def _starting(self, trouble: Trouble) -> bool:
        """Return whether a trouble is of the start, and over with it; where no executive tells, none is."""
        return trouble.source in (DIAGNOSTICS, SILENT) and trouble.end < self.ready + SETTLING

    def _end_report(self, name: str, seconds: float) -> None:
        told = self._reported.pop(name)
        level = ERROR if told.level >= 2 else WARNING
        self._add(Trouble(name, told.begin, seconds, level, told.message, told.times, DIAGNOSTICS))

    def _note_lost(self, node: str, seconds: float) -> None:
        self._add(Trouble(node, self._lost.pop(node), seconds, ERROR, "lost: stopped answering", 1, LOST))

    def _note_silent(self, node: str, begin: float, end: float) -> None:
        self._add(Trouble(node, begin, end, ERROR, f"no heartbeat for {end - begin:.1f} s", 1, SILENT))

    def _add(self, trouble: Trouble) -> None:
        if len(self._found) < self._most:
            self._found.append(trouble)
        else:
            self.left_out += 1
