"""What happened in a bag, as values: handovers, answers, beliefs, troubles, and how often each topic spoke."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

DIAGNOSTICS, LOG, LOST, SILENT = "diagnostics", "log", "lost", "silent"  # where a trouble was seen
WARNING, ERROR = "warning", "error"
SETTLING = 3.0  # [s] after the cell is ready in which a node may still complain about its start
SHUTDOWN = 5.0  # [s] before the end of a bag in which nodes may end before the recorder does
GAP = 1.5  # [s] a regular topic must be silent for it to be told
GAP_PERIODS = 5.0  # and so many times its usual period


@dataclass(frozen=True)
class PhaseSpan:
    """One phase of a handover.

    Attributes:
        name: E.g. ``fetching``.
        begin: Since the bag's start [s].
        end: Since the bag's start [s].
        seconds: How long it took in ROS time; the bag's time where the messages have no stamp.
    """

    name: str
    begin: float
    end: float
    seconds: float


@dataclass(frozen=True)
class HandoverSpan:
    """One handover, as the executive told it.

    Attributes:
        number: 1, 2, ...
        handover_id: The executive's name of it.
        object_name: What was handed over.
        begin: Since the bag's start [s].
        end: Since the bag's start [s].
        phases: In order.
        ended: Whether it came to an end within the bag.
        taken: Whether the person has the object; None: the bag does not tell.
        placed: Whether they brought it to its goal; None: the bag does not tell.
        dropped: Whether the object fell.
        message: The executive's last sentence.
        scheme: How the pose was chosen; empty: unknown.
        arm: The robot's; empty: unknown.
        planning_time: Wall time of the plan [s]; NaN: unknown.
    """

    number: int
    handover_id: str
    object_name: str
    begin: float
    end: float
    phases: tuple[PhaseSpan, ...]
    ended: bool
    taken: bool | None
    placed: bool | None
    dropped: bool
    message: str
    scheme: str = ""
    arm: str = ""
    planning_time: float = math.nan

    @property
    def duration(self) -> float:
        """How long all phases took [s]."""
        return sum(phase.seconds for phase in self.phases)

    @property
    def outcome(self) -> str:
        """How it ended, in a word or two."""
        if not self.ended:
            return "under way"
        return "unknown" if self.taken is None else "taken" if self.taken else "not taken"


@dataclass(frozen=True)
class Event:
    """Something an operator of the simulation would notice, ``time`` [s] after the bag's start."""

    time: float
    kind: str
    object_name: str
    holder: str
    message: str


@dataclass(frozen=True)
class AnswerMark:
    """How the person took an object; what is not known is empty."""

    time: float
    handover_id: str
    profile_id: str
    object_name: str
    hand: str
    region: str


@dataclass(frozen=True)
class BeliefMark:
    """What was believed of a person's preference from ``time`` [s] on.

    Attributes:
        time: Since the bag's start [s].
        profile_id: Whose.
        observations: Answers taken in.
        entropy: [nat].
        joint_names: Of the numbers.
        mean_neutral: Neutral posture [rad].
        mean_weights: Joint weights [1/rad2].
        surprise: Predicted probability of answers no likelier than the newest; NaN: there is none.
        problem: Why the stored belief cannot be used; empty: it can.
    """

    time: float
    profile_id: str
    observations: int
    entropy: float
    joint_names: tuple[str, ...]
    mean_neutral: tuple[float, ...]
    mean_weights: tuple[float, ...]
    surprise: float
    problem: str


@dataclass(frozen=True)
class Activation:
    """Whose profile was active from ``time`` [s] on; empty: nobody's."""

    time: float
    profile_id: str
    person: str


@dataclass(frozen=True)
class Trouble:
    """Something that was not as it should be.

    Attributes:
        node: Which node.
        begin: Since the bag's start [s].
        end: Since the bag's start [s].
        level: ``warning`` or ``error``.
        message: In words; the worst one.
        times: How often it was said.
        source: ``diagnostics``; ``log`` of the node; ``lost``, for the executive; ``silent``, by its heartbeats.
        starting: Whether it was over soon after the cell was ready.
    """

    node: str
    begin: float
    end: float
    level: str
    message: str
    times: int
    source: str
    starting: bool = False


@dataclass(frozen=True, eq=False)
class TopicCourse:
    """How often one topic spoke.

    Attributes:
        name: Whole name.
        type_name: E.g. ``handover_msgs/msg/MarkerFrame``.
        messages: How many.
        latched: Whether who comes later gets the last one.
        counts: Messages in each time bin.
        first: Time of the first [s].
        last: Time of the last one [s].
        regular: Whether it speaks all the time.
        silence: Longest time without a message after the first one [s], also up to the bag's end if that is longer
            than it takes nodes to stop; NaN: it never spoke.
        silence_begin: When that began [s].
    """

    name: str
    type_name: str
    messages: int
    latched: bool
    counts: npt.NDArray[np.int64]
    first: float
    last: float
    regular: bool
    silence: float
    silence_begin: float

    @property
    def rate(self) -> float:
        """Messages a second between the first and the last one; NaN: there are not two."""
        return (self.messages - 1) / (self.last - self.first) if self.last > self.first else math.nan

    @property
    def gap(self) -> bool:
        """Whether it is a regular topic that fell silent."""
        return self.regular and self.silence > max(GAP, GAP_PERIODS / self.rate)


@dataclass(frozen=True, eq=False)
class Timeline:
    """What happened in a bag. All times are seconds since its first message.

    Attributes:
        path: The bag.
        start: Time of the first message [ns].
        duration: To the last message [s].
        bin_width: Of the time bins [s].
        handovers: In order.
        events: Of the simulation.
        answers: How objects were taken.
        beliefs: The course of what was believed.
        activations: Who was active.
        troubles: Warnings, errors, lost nodes, by their beginning.
        topics: By name.
        clock: Times [s] and the ROS time [s] there, shape (2, n); n = 0: there is no ``/clock``.
        ready: When the executive had all it needs [s]; NaN: it was never, or did not tell.
        unreadable: Messages that could not be decoded.
        left_out: Entries that are not listed because there are too many.
    """

    path: Path
    start: int
    duration: float
    bin_width: float
    handovers: tuple[HandoverSpan, ...]
    events: tuple[Event, ...]
    answers: tuple[AnswerMark, ...]
    beliefs: tuple[BeliefMark, ...]
    activations: tuple[Activation, ...]
    troubles: tuple[Trouble, ...]
    topics: tuple[TopicCourse, ...]
    clock: npt.NDArray[np.float64]
    ready: float
    unreadable: int = 0
    left_out: int = 0

    @property
    def messages(self) -> int:
        """How many there are."""
        return sum(topic.messages for topic in self.topics)

    @property
    def taken(self) -> int:
        """Handovers at the end of which the person has the object."""
        return sum(bool(handover.taken) for handover in self.handovers)

    @property
    def gaps(self) -> tuple[TopicCourse, ...]:
        """The regular topics that fell silent once the cell was ready, the longest silence first."""
        silent = [topic for topic in self.topics if topic.gap]
        late = [topic for topic in silent if not topic.silence_begin + topic.silence < self.ready + SETTLING]
        return tuple(sorted(late, key=lambda topic: -topic.silence))

    @property
    def clock_rate(self) -> float:
        """ROS seconds that pass in a second; NaN: there is no ``/clock``."""
        if self.clock.shape[1] < 2:
            return math.nan
        (begin, end), (ros_begin, ros_end) = self.clock[:, [0, -1]]
        return float((ros_end - ros_begin) / (end - begin)) if end > begin else math.nan

    def ros_time(self, seconds: float) -> float:
        """Return the ROS time [s] at a time of the bag; NaN: there is no ``/clock``."""
        if not self.clock.shape[1]:
            return math.nan
        return float(np.interp(seconds, self.clock[0], self.clock[1]))

    def metrics(self) -> dict[str, float]:
        """Return the numbers by which bags compare."""
        real = [trouble for trouble in self.troubles if not trouble.starting]
        return {
            "messages": self.messages,
            "topics": sum(topic.messages > 0 for topic in self.topics),
            "duration_s": self.duration,
            "handovers": len(self.handovers),
            "taken": self.taken,
            "placed": sum(bool(handover.placed) for handover in self.handovers),
            "dropped": sum(handover.dropped for handover in self.handovers),
            "answers": len(self.answers),
            "observations": max((belief.observations for belief in self.beliefs), default=0),
            "warnings": sum(trouble.level == WARNING for trouble in real),
            "errors": sum(trouble.level == ERROR for trouble in real),
            "lost_nodes": len({trouble.node for trouble in real if trouble.source in (LOST, SILENT)}),
            "gaps": len(self.gaps),
            "longest_gap_s": self.gaps[0].silence if self.gaps else 0.0,
            "ros_time_rate": self.clock_rate,
            "unreadable": self.unreadable,
        }

    def document(self) -> dict[str, Any]:
        """Return what happened for a JSON file, without the counts in the time bins."""
        listed = ("handovers", "events", "answers", "beliefs", "activations", "troubles")
        return {
            "start_ns": self.start,
            "duration_s": plain(self.duration),
            "ready_s": plain(self.ready),
            "ros_time_start_s": plain(self.ros_time(0.0)),
            **{name: plain(getattr(self, name)) for name in listed},
            "gaps": [
                {"topic": topic.name, "begin": plain(topic.silence_begin), "seconds": plain(topic.silence)}
                for topic in self.gaps
            ],
            "left_out": self.left_out,
        }


def plain(value: Any) -> Any:
    """Return a value as JSON has it: data classes as mappings, what is not finite as null."""
    if is_dataclass(value):
        return {each.name: plain(getattr(value, each.name)) for each in fields(value)}
    if isinstance(value, (tuple, list)):
        return [plain(each) for each in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value
