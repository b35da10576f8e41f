"""What happened in a bag, read in one pass: topics that speak rarely are decoded, all others only counted."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from handover_ros.bags.reading import Bag, Topic
from handover_ros.bags.timeline_handovers import Handovers
from handover_ros.bags.timeline_troubles import Troubles
from handover_ros.bags.timeline_types import (
    SHUTDOWN,
    Activation,
    AnswerMark,
    BeliefMark,
    Event,
    Timeline,
    TopicCourse,
)
from handover_ros.errors import BadRecordingError

BINS = 200
MOST = 10_000  # entries of each kind that are kept
TOLD_EVERY = 20_000  # messages between two words on the progress
TIME = struct.Struct("<4xiI")  # of a serialized Clock: encapsulation, seconds, nanoseconds
REGULAR_MESSAGES, REGULAR_PERIOD, REGULAR_SHARE = 20, 1.5, 0.1  # see _Course.regular
ON_DEMAND = ("/calibration/progress", "/parameter_events")  # spoken often, but only at times

#: Topics that are decoded, by what their names end with, whatever the namespace.
DECODED = {
    "/cell/state": "handover_msgs/msg/CellState",
    "/cell/heartbeat": "handover_msgs/msg/Heartbeat",
    "/planner/plan": "handover_msgs/msg/HandoverPlan",
    "/sim/events": "handover_msgs/msg/SimulationEvent",
    "/handover/grasp_choice": "handover_msgs/msg/GraspChoice",
    "/preferences/belief": "handover_msgs/msg/BeliefSummary",
    "/calibration/active_profile": "handover_msgs/msg/ActiveProfile",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "/rosout": "rcl_interfaces/msg/Log",
}
CLOCK = ("/clock", "rosgraph_msgs/msg/Clock")


def read_timeline(bag: Bag, progress: Callable[[float], None] | None = None, bins: int = BINS) -> Timeline:
    """Return what happened in a bag; whatever topics it lacks are left out.

    Memory does not grow with the bag but for what happened in it, and that is bounded too.

    Args:
        bag: The bag.
        progress: Is told how much is done, 0 to 1.
        bins: Number of time bins of the counts.

    Raises:
        BadRecordingError: The bag is damaged in the middle.
    """
    reading = _Reading(bag, bins)
    for number, (topic, stamp, data) in enumerate(bag.read()):
        reading.take(topic, stamp, data)
        if progress is not None and number % TOLD_EVERY == 0:
            progress(number / max(1, bag.messages))
    return reading.timeline()


class _Course:
    """Counts the messages of one topic."""

    __slots__ = ("counts", "first", "last", "long_silences", "messages", "silence", "silence_begin")

    def __init__(self, bins: int) -> None:
        self.counts = [0] * bins
        self.messages = 0
        self.long_silences = 0
        self.first = self.last = self.silence = self.silence_begin = math.nan

    def take(self, seconds: float, place: int) -> None:
        """Take in a message at a time [s], in a bin."""
        self.counts[place] += 1
        self.messages += 1
        if self.messages == 1:
            self.first = self.last = self.silence_begin = seconds
            self.silence = 0.0
            return
        self._note_silence(seconds)
        self.last = seconds

    def _note_silence(self, seconds: float) -> None:
        passed = seconds - self.last
        if passed > REGULAR_PERIOD:
            self.long_silences += 1
        if passed > self.silence:
            self.silence, self.silence_begin = passed, self.last

    def regular(self, topic: Topic) -> bool:
        """Return whether the topic speaks all the time: often, and seldom less than once in a second and a half."""
        return (
            not topic.latched
            and not topic.name.endswith(ON_DEMAND)
            and self.messages >= REGULAR_MESSAGES
            and self.long_silences <= REGULAR_SHARE * (self.messages - 1)
        )

    def closed(self, topic: Topic, duration: float) -> TopicCourse:
        """Return the course, with the silence up to the bag's end."""
        regular = self.regular(topic)
        if self.messages and duration - self.last > SHUTDOWN:
            self._note_silence(duration)
        return TopicCourse(
            topic.name, topic.type_name, self.messages, topic.latched, np.array(self.counts, np.int64),
            self.first, self.last, regular, self.silence, self.silence_begin,
        )  # fmt: skip


class _Bounded(list[Any]):
    """A list that keeps no more than so many entries and counts the others."""

    left_out = 0

    def append(self, entry: Any) -> None:
        """Keep an entry if there is room."""
        if len(self) < MOST:
            super().append(entry)
        else:
            self.left_out += 1


class _Reading:
    """What was read of a bag so far."""

    def __init__(self, bag: Bag, bins: int) -> None:
        self.bag = bag
        self.bins = max(1, bins)
        self.duration = max(0.0, bag.duration)
        self.width = self.duration / self.bins
        self.courses = {name: _Course(self.bins) for name in bag.topics}
        self.clock: dict[int, tuple[float, float]] = {}
        self.last_clock: tuple[float, float] | None = None
        self.handovers, self.troubles = Handovers(MOST), Troubles(MOST)
        self.events, self.answers, self.beliefs, self.activations = (_Bounded() for _ in range(4))
        self.unreadable = 0
        takers: dict[str, Callable[[float, Any], None]] = {
            "/cell/state": self._take_state,
            "/cell/heartbeat": lambda seconds, message: self.troubles.take_heartbeat(seconds, message.node),
            "/planner/plan": self.handovers.take_plan,
            "/sim/events": self._take_event,
            "/handover/grasp_choice": self._take_answer,
            "/preferences/belief": self._take_belief,
            "/calibration/active_profile": self._take_activation,
            "/diagnostics": self.troubles.take_diagnostics,
            "/rosout": self.troubles.take_log,
        }
        found = {end: _topic_of(bag, end, type_name) for end, type_name in DECODED.items()}
        self.takers = {topic.name: takers[end] for end, topic in found.items() if topic is not None}
        self.told = {end for end, topic in found.items() if topic is not None}
        clock = _topic_of(bag, *CLOCK)
        self.clock_name = "" if clock is None else clock.name

    def take(self, topic: Topic, stamp: int, data: bytes) -> None:
        """Take in one message."""
        seconds = (stamp - self.bag.start) / 1e9
        place = min(max(int(seconds / self.width), 0), self.bins - 1) if self.width else 0
        self.courses[topic.name].take(seconds, place)
        taker = self.takers.get(topic.name)
        if taker is not None:
            try:
                taker(seconds, self.bag.decode(topic, data))
            except (BadRecordingError, AttributeError, TypeError, ValueError):  # a definition of another version
                self.unreadable += 1
        elif topic.name == self.clock_name and len(data) >= TIME.size:
            whole, fraction = TIME.unpack_from(data)
            self.last_clock = seconds, whole + fraction * 1e-9
            self.clock.setdefault(place, self.last_clock)

    def _take_state(self, seconds: float, state: Any) -> None:
        self.handovers.take_state(seconds, state)
        self.troubles.take_lost(seconds, list(getattr(state, "lost_nodes", ())))

    def _take_event(self, seconds: float, event: Any) -> None:
        self.events.append(Event(seconds, event.kind, event.object_name, event.holder, event.message))

    def _take_answer(self, seconds: float, choice: Any) -> None:
        self.handovers.take_answer(choice)
        self.answers.append(
            AnswerMark(
                seconds, choice.handover_id, choice.profile_id, choice.object_name, choice.hand, choice.grasp_region
            )
        )

    def _take_belief(self, seconds: float, belief: Any) -> None:
        if not belief.profile_id:
            return
        mark = BeliefMark(
            seconds,
            belief.profile_id,
            int(belief.observations),
            float(belief.entropy),
            tuple(belief.joint_names),
            tuple(map(float, belief.mean_neutral)),
            tuple(map(float, belief.mean_weights)),
            float(belief.surprise),
            belief.problem,
        )
        newest = self.beliefs[-1] if self.beliefs else None
        if newest is None or (newest.profile_id, newest.observations) != (mark.profile_id, mark.observations):
            self.beliefs.append(mark)

    def _take_activation(self, seconds: float, active: Any) -> None:
        if not self.activations or self.activations[-1].profile_id != active.info.profile_id:
            self.activations.append(Activation(seconds, active.info.profile_id, active.info.person))

    def timeline(self) -> Timeline:
        """Return what was read."""
        events = tuple(self.events) if "/sim/events" in self.told else None
        kept = (self.events, self.answers, self.beliefs, self.activations)
        return Timeline(
            path=self.bag.path,
            start=self.bag.start,
            duration=self.duration,
            bin_width=self.width,
            handovers=self.handovers.closed(self.duration, events),
            events=tuple(self.events),
            answers=tuple(self.answers),
            beliefs=tuple(self.beliefs),
            activations=tuple(self.activations),
            troubles=self.troubles.closed(self.duration),
            topics=tuple(self.courses[name].closed(topic, self.duration) for name, topic in self.bag.topics.items()),
            clock=self._clock(),
            ready=self.troubles.ready,
            unreadable=self.unreadable,
            left_out=sum(each.left_out for each in kept) + self.handovers.left_out + self.troubles.left_out,
        )

    def _clock(self) -> npt.NDArray[np.float64]:
        pairs = [*self.clock.values(), *([self.last_clock] if self.last_clock else [])]
        return np.array(pairs, float).reshape(-1, 2).T


def _topic_of(bag: Bag, end: str, type_name: str) -> Topic | None:
    """Return the topic that has a type and a name that ends so, the shortest name first; None: there is none."""
    found = [topic for topic in bag.topics.values() if topic.name.endswith(end) and topic.type_name == type_name]
    return min(found, key=lambda topic: (len(topic.name), topic.name), default=None)
