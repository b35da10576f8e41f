"""Plays a bag into the graph: real nodes get what they got, at the time they got it, with the clock they had."""

from __future__ import annotations

import re
import threading
import time
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message
from rclpy.time import Time
from rosgraph_msgs.msg import Clock

from handover_ros.bags.definitions import Definitions
from handover_ros.bags.reading import Bag, Topic
from handover_ros.bags.replay import CLOCK, chosen_topics, first_used, latest_before, other_versions, stamp_of
from handover_ros.errors import BadRequestError
from handover_ros.nodes.bag_qos import message_class, replay_profile
from handover_ros.nodes.runtime import SENSOR_PUBLISHER

TICK = 5_000_000  # [ns] of the bag's time between two ticks of a clock that the bag does not bring
LISTEN_LIMIT = 5.0  # [s] of wall time for subscriptions to be matched
SETTLE = 0.1  # [s] of wall time for a latched message to be worked on before the stream goes on
ACKNOWLEDGE = 1.0  # [s] of wall time
TOLD = 0.2  # [s] of wall time between two words on how far it is
POLL = 0.02  # [s]


@dataclass(frozen=True)
class Selection:
    """What of a bag is played, and how fast.

    Attributes:
        speed: Recorded seconds per second.
        start: Where to begin [s] after the bag's first message.
        duration: How long [s]; 0: to the end.
        wanted: Patterns of topics; empty: what nodes look at.
        unwanted: Patterns of topics left out.
    """

    speed: float = 1.0
    start: float = 0.0
    duration: float = 0.0
    wanted: Sequence[re.Pattern[str]] = ()
    unwanted: Sequence[re.Pattern[str]] = ()


class Player:
    """Publishes the messages of a bag as a node of the graph.

    Args:
        node: Whose publishers they are.
        bag: The bag.
        selection: What of it.
        needed: Topics that must have the installed message types.

    Attributes:
        left_out: Topics of other types, each with what is different.

    Raises:
        BadRecordingError: Nothing is left to play, or a message type is of another version.
        BadRequestError: The start is behind the end.
    """

    def __init__(self, node: Node, bag: Bag, selection: Selection, needed: Collection[str] = ()) -> None:
        self.bag, self.selection, self._node = bag, selection, node
        self.start = bag.start + round(selection.start * 1e9)
        if self.start > bag.end:
            raise BadRequestError(f"start: {selection.start:g} s is behind the end of the bag, {bag.duration:.1f} s")
        self.stop = bag.end + 1
        if selection.duration > 0.0:
            self.stop = min(self.stop, self.start + round(selection.duration * 1e9))
        self.played: Counter[str] = Counter()
        self.skipped: Counter[str] = Counter()
        self.late = 0.0  # [s] of wall time the replay was behind at worst
        self.publishers: dict[str, Publisher] = {}
        self.topics: dict[str, Topic] = {}
        self.left_out: dict[str, str] = {}
        chosen = self.choice(())
        must = set(chosen) if selection.wanted else set(needed)
        self.left_out = other_versions(chosen.values(), must, Definitions(), bag.path)

    def choice(self, published: Collection[str]) -> dict[str, Topic]:
        """Return what is played when others publish some topics."""
        chosen = chosen_topics(self.bag, published, self.selection.wanted, self.selection.unwanted)
        return {name: topic for name, topic in chosen.items() if name not in self.left_out}

    def prepare(self) -> None:
        """Make the publishers, of what nobody else publishes.

        Raises:
            BadRecordingError: Nothing is left to play.
            BadRequestError: Somebody else gives the clock: a live cell, or another replay.
        """
        names = {name for name in self.bag.topics if self._node.count_publishers(name)}
        if self._node.count_publishers(CLOCK):
            raise BadRequestError(
                f"somebody publishes {CLOCK} in this graph (a running cell, or another replay): stop it, or choose "
                "another ROS_DOMAIN_ID"
            )
        self.topics = self.choice(names)
        self.publishers = {
            name: self._node.create_publisher(
                message_class(topic.type_name),
                name,
                SENSOR_PUBLISHER if name == CLOCK else replay_profile(topic.profiles),
            )
            for name, topic in self.topics.items()
        }
        if CLOCK not in self.topics:
            self.publishers[CLOCK] = self._node.create_publisher(Clock, "/clock", SENSOR_PUBLISHER)

    def wait_for_listeners(self, check: Callable[[], None]) -> list[str]:
        """Wait until every subscription to a played topic is matched; return those topics where one still is not.

        Args:
            check: Called while waiting; raises to end it.
        """
        deadline = time.monotonic() + LISTEN_LIMIT
        while True:
            check()
            lacking = [
                name
                for name, publisher in self.publishers.items()
                if publisher.get_subscription_count() < self._node.count_subscribers(name)
            ]
            if not lacking or time.monotonic() > deadline:  # one that asks for more than was recorded never matches
                return lacking
            time.sleep(POLL)

    def begin(self) -> None:
        """Publish what was latched before the start, so that a replay from the middle finds the cell as it was."""
        if CLOCK not in self.topics:
            self._tick(self.start)
        for topic, data in latest_before(self.bag, self.topics, self.start):
            self.publishers[topic.name].publish(data)
            self.played[topic.name] += 1

    def run(self, stop: threading.Event, progress: Callable[[float], None] = lambda fraction: None) -> bool:
        """Play; return whether it came to the end.

        Args:
            stop: Set to end early.
            progress: Called now and then with the share that is played.
        """
        first = first_used(self.bag, self.topics) if self.selection.start == 0.0 else {}
        began, told = time.monotonic(), 0.0
        tick = self.stop + 1 if CLOCK in self.topics else self.start
        speed, span = self.selection.speed, max(self.stop - self.start, 1)
        for topic, stamp, data in self.bag.read(list(self.topics), self.start, self.stop):
            while tick <= stamp:
                self._wait(began + (tick - self.start) * 1e-9 / speed, stop)
                self._tick(tick)
                tick += TICK
            if topic.name in first and stamp_of(data) < first[topic.name]:
                self.skipped[topic.name] += 1
                continue
            self._wait(began + (stamp - self.start) * 1e-9 / speed, stop)
            if stop.is_set():
                return False
            self.publishers[topic.name].publish(data)
            self.played[topic.name] += 1
            if topic.latched:
                began += self._settle(self.publishers[topic.name], stop)
            if (now := time.monotonic()) - told > TOLD:
                told = now
                progress((stamp - self.start) / span)
        progress(1.0)
        for publisher in self.publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGE))
        return True

    def _wait(self, due: float, stop: threading.Event) -> None:
        ahead = due - time.monotonic()
        if ahead > 0.0:
            stop.wait(ahead)
        else:
            self.late = max(self.late, -ahead)

    def _tick(self, stamp: int) -> None:
        self.publishers[CLOCK].publish(serialize_message(Clock(clock=Time(nanoseconds=stamp).to_msg())))

    def _settle(self, publisher: Publisher, stop: threading.Event) -> float:
        """Let what a latched message changes take effect before the stream goes on; return how long that took [s]."""
        if not publisher.get_subscription_count():
            return 0.0
        began = time.monotonic()
        publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGE))
        stop.wait(SETTLE)
        return time.monotonic() - began
