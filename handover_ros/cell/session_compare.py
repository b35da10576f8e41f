"""Two sessions side by side, as values."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

from handover_ros.bags.timeline_types import HandoverSpan, TopicCourse
from handover_ros.cell.bag_command import phase_durations
from handover_ros.cell.session_folder import StoredSession
from handover_ros.cell.session_people import joint_changes

UNLIKE = 0.1  # share by which rates must differ to be told
MISSING = None  # stands for what one of the sessions does not have
OWN_ARGUMENTS = ("out", "json_file")  # differ always


@dataclass(frozen=True)
class Unlike:
    """Something in which two sessions differ; None: a session does not have it.

    Attributes:
        kind: ``version``, ``argument`` or ``parameter``.
        name: Of it.
        first: In the first session.
        second: In the second one.
    """

    kind: str
    name: str
    first: Any
    second: Any


@dataclass(frozen=True)
class Pair:
    """A number in both sessions; NaN: a session does not have it."""

    name: str
    first: float
    second: float

    @property
    def difference(self) -> float:
        """Second minus first."""
        return self.second - self.first

    @property
    def ratio(self) -> float:
        """Second over first; NaN where that says nothing."""
        return self.second / self.first if self.first else math.nan


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two sessions.

    Attributes:
        first: The first.
        second: The second.
        names: What they are called.
    """

    first: StoredSession
    second: StoredSession

    @property
    def names(self) -> tuple[str, str]:
        """What they are called: their folders' names, with those of the folders around where these are alike."""
        ours, theirs = self.first.folder, self.second.folder
        if ours.name != theirs.name:
            return ours.name, theirs.name
        return "/".join(ours.parts[-2:]), "/".join(theirs.parts[-2:])

    def unlike(self) -> list[Unlike]:
        """Return in which versions, arguments and parameters they differ."""
        ours, theirs = self.first.document, self.second.document
        versions = (
            {"command": ours.command, "commit": ours.commit, **ours.versions},
            {"command": theirs.command, "commit": theirs.commit, **theirs.versions},
        )
        found = differing("version", *versions)
        found += [each for each in differing("argument", ours.arguments, theirs.arguments)
                  if each.name not in OWN_ARGUMENTS]  # fmt: skip
        for node in {**self.first.parameters, **self.second.parameters}:
            given = self.first.parameters.get(node, {}), self.second.parameters.get(node, {})
            found += [Unlike("parameter", f"{node} {each.name}", each.first, each.second)
                      for each in differing("parameter", *given)]  # fmt: skip
        return found

    def metrics(self) -> list[Pair]:
        """Return the numbers of both."""
        ours, theirs = self.first.metrics(), self.second.metrics()
        return [Pair(name, ours.get(name, math.nan), theirs.get(name, math.nan)) for name in {**ours, **theirs}]

    def handovers(self) -> list[tuple[HandoverSpan | None, HandoverSpan | None]]:
        """Return the handovers of both, the first with the first and so on."""
        ours, theirs = (() if each.timeline is None else each.timeline.handovers for each in self.both)
        return list(zip_longest(ours, theirs))

    @property
    def both(self) -> tuple[StoredSession, StoredSession]:
        """Both sessions."""
        return self.first, self.second

    def phases(self) -> list[Pair]:
        """Return the median duration of each phase [s], and of all, over the handovers that were taken."""
        ours, theirs = (phase_medians(session) for session in self.both)
        return [Pair(name, ours.get(name, math.nan), theirs.get(name, math.nan)) for name in {**ours, **theirs}]

    def joints(self) -> list[tuple[str, Pair, Pair]]:
        """Return for each joint of the last beliefs: its name, the mean neutral [deg], the mean weight [1/rad2]."""
        ours, theirs = self.first.belief, self.second.belief
        if ours is None or theirs is None:
            return []
        return [
            (joint, Pair(f"neutral {joint} [deg]", neutral, other), Pair(f"weight {joint} [1/rad²]", weight, weighs))
            for joint, neutral, other, weight, weighs in joint_changes(ours, theirs)
        ]

    def beliefs(self) -> list[Pair]:
        """Return the numbers of the last beliefs; none where a session has no belief."""
        ours, theirs = self.first.belief, self.second.belief
        if ours is None or theirs is None:
            return []
        joints = self.joints()
        return [
            Pair("answers", ours.observations, theirs.observations),
            Pair("entropy [nat]", ours.entropy, theirs.entropy),
            *(neutral for _, neutral, _ in joints),
            *(weight for _, _, weight in joints),
        ]

    def rates(self) -> list[Pair]:
        """Return the rates [Hz] of regular topics that differ, or that only one of them has."""
        ours, theirs = (regular_topics(session) for session in self.both)
        pairs = [
            Pair(name, *(topics[name].rate if name in topics else 0.0 for topics in (ours, theirs)))
            for name in sorted({**ours, **theirs})
        ]
        return [pair for pair in pairs if abs(pair.difference) > UNLIKE * max(pair.first, pair.second)]

    def numbers(self) -> dict[str, float]:
        """Return the numbers of the comparison for a JSON file."""
        kinds = [each.kind for each in self.unlike()]
        joints = self.joints()
        found: dict[str, float] = {
            "versions_differing": kinds.count("version"),
            "arguments_differing": kinds.count("argument"),
            "parameters_differing": kinds.count("parameter"),
            "rates_differing": len(self.rates()),
            "neutral_apart_deg": max((abs(neutral.difference) for _, neutral, _ in joints), default=math.nan),
            "weights_apart": max((abs(weight.difference) for _, _, weight in joints), default=math.nan),
        }
        for pair in self.metrics():
            found |= {f"{pair.name}_difference": pair.difference, f"{pair.name}_ratio": pair.ratio}
        return found


def differing(kind: str, ours: Mapping[str, Any], theirs: Mapping[str, Any]) -> list[Unlike]:
    """Return the entries in which two mappings differ."""
    return [
        Unlike(kind, name, ours.get(name, MISSING), theirs.get(name, MISSING))
        for name in {**ours, **theirs}
        if ours.get(name, MISSING) != theirs.get(name, MISSING)
    ]


def phase_medians(session: StoredSession) -> dict[str, float]:
    """Return the median duration [s] of each phase, of all phases, and of planning by the wall clock."""
    taken = [] if session.timeline is None else [each for each in session.timeline.handovers if each.taken]
    seconds: dict[str, list[float]] = {}
    for handover in taken:
        for name, duration in phase_durations(handover):
            seconds.setdefault(name, []).append(duration)
        seconds.setdefault("all phases", []).append(handover.duration)
        if math.isfinite(handover.planning_time):
            seconds.setdefault("the plan (wall)", []).append(handover.planning_time)
    last = ("all phases", "the plan (wall)")
    names = [name for name in seconds if name not in last] + [name for name in last if name in seconds]
    return {name: statistics.median(seconds[name]) for name in names}


def regular_topics(session: StoredSession) -> dict[str, TopicCourse]:
    """Return the topics of a session that speak all the time."""
    topics = () if session.timeline is None else session.timeline.topics
    return {topic.name: topic for topic in topics if topic.regular}
