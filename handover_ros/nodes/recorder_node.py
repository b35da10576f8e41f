"""``recorder_node``: everything that is said in the graph, or chosen topics, into a rosbag2 bag."""

from __future__ import annotations

import threading
from concurrent.futures import Future
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from rclpy.subscription import Subscription

from handover_ros.bags.definitions import Definition, Definitions
from handover_ros.bags.recording import STORAGES, BagWriter
from handover_ros.bags.replay import CLOCK, topic_patterns
from handover_ros.errors import HandoverError, UnknownNameError
from handover_ros.nodes.bag_qos import message_class, noted_profile, recorder_profile
from handover_ros.nodes.parameters import ParameterSpec
from handover_ros.nodes.runtime import HandoverNode, main_of, monotonic
from handover_ros.nodes.streams import OwnThread

LOOK_PERIOD = 0.1  # [s] of wall time between two looks for new topics
TAKE_PERIOD = 0.02  # [s] of wall time in which messages gather, instead of waking for each of thousands a second

PARAMETERS = (
    ParameterSpec("bag", "", "folder of the bag; must not exist; empty: handover_out/bag-<date>-<time>"),
    ParameterSpec("storage", "mcap", "how it is stored", choices=STORAGES),
    ParameterSpec("topics", "", "what is recorded: topic names or regular expressions, space between; empty: all"),
    ParameterSpec("exclude", "", "what is left out: topic names or regular expressions, space between"),
    ParameterSpec(
        "flush_period", 0.5, "[s] of wall time: at most so much is lost if the recorder is killed", 0.05, 5.0
    ),
)


@dataclass(eq=False)
class Recorded:
    """One topic that is recorded."""

    topic: str
    type_name: str
    message_type: Any
    subscription: Subscription
    alone: bool  # one publisher, whose numbers tell what was lost
    newest: int = 0
    lost: int = 0


class RecorderNode(HandoverNode):
    """Writes a bag; latched topics and message definitions are in it."""

    niceness = 5

    def __init__(self) -> None:
        super().__init__("recorder_node", PARAMETERS)
        given = self.parameters["bag"]
        folder = Path(given).expanduser() if given else Path("handover_out") / f"bag-{datetime.now():%Y%m%d-%H%M%S}"
        self.wanted = topic_patterns("topics", self.parameters["topics"])
        self.unwanted = topic_patterns("exclude", self.parameters["exclude"])
        self.definitions = Definitions()
        self.folder = folder
        self.flush_period = self.parameters["flush_period"]
        self.seen: set[tuple[str, str]] = set()
        self.fresh: list[tuple[Recorded, Definition, list[Any]]] = []
        self.recorded: list[Recorded] = []
        self.lock = threading.Lock()
        self.stop_recording = threading.Event()
        self.failure = ""
        self.counted, self.counted_at = 0, monotonic()
        opened: Future[BagWriter] = Future()
        self.thread = threading.Thread(target=self.record, args=[opened], name="recorder", daemon=True)
        self.thread.start()
        self.writer = opened.result()
        self.create_timer(LOOK_PERIOD, self.look, clock=self.steady_clock)
        self.look()
        self.ready(f"recording to {folder}")

    def on_stop(self) -> None:
        """Take what is still there and close the bag."""
        self.stop_recording.set()
        self.thread.join()
        for recorded in self.recorded:
            self.destroy_subscription(recorded.subscription)
        print(self.summary(), flush=True)

    def summary(self) -> str:
        """Return one line on what was recorded."""
        lost = sum(recorded.lost for recorded in self.recorded)
        topics = sum(count > 0 for count in self.writer.counts.values())
        return (
            f"recorded {self.writer.messages:,} messages of {topics} topics, {self.writer.bytes / 1e6:.1f} MB, "
            f"{lost} lost, to {self.writer.path}" + (f"; {self.failure}" if self.failure else "")
        )

    # Which topics

    def look(self) -> None:
        """Subscribe to what is published since the last look."""
        for recorded in list(self.recorded):
            if recorded.alone and self.count_publishers(recorded.topic) > 1:  # the numbers were those of several
                recorded.alone, recorded.lost = False, 0
        for topic, types in self.get_topic_names_and_types():
            for type_name in types:
                if (topic, type_name) in self.seen or not self.wants(topic):
                    continue
                publishers = [each for each in self.get_publishers_info_by_topic(topic) if each.topic_type == type_name]
                if publishers:
                    self.seen.add((topic, type_name))
                    self.begin(topic, type_name, publishers)

    def wants(self, topic: str) -> bool:
        """Return whether a topic is to be recorded; hidden ones only when they are named, a clock always."""
        if any(pattern.fullmatch(topic) for pattern in self.unwanted):
            return False
        if self.wanted:
            return topic == CLOCK or any(pattern.fullmatch(topic) for pattern in self.wanted)
        return "/_" not in topic

    def begin(self, topic: str, type_name: str, publishers: list[Any]) -> None:
        """Record a topic from now on; one whose type is not installed is told about and left out."""
        try:
            definition, message_type = self.definitions.of(type_name), message_class(type_name)
        except (UnknownNameError, ImportError, AttributeError):
            self.last_problem = f"{topic} is not recorded: message type {type_name} is not installed here"
            self.get_logger().warning(self.last_problem)
            return
        subscription = self.create_subscription(
            message_type, topic, print, recorder_profile(type_name, publishers), callback_group=OwnThread(), raw=True
        )
        recorded = Recorded(topic, type_name, message_type, subscription, len(publishers) == 1)
        with self.lock:
            self.fresh.append((recorded, definition, [noted_profile(each.qos_profile) for each in publishers]))

    # The recorder's thread

    def record(self, opened: Future[BagWriter]) -> None:
        """Write what comes until the node stops; a full disk ends the recording, not the node.

        The bag is opened here, since SQLite wants to be used by one thread only.
        """
        try:
            writer = BagWriter(self.folder, self.parameters["storage"])
        except HandoverError as error:
            opened.set_exception(error)
            return
        opened.set_result(writer)
        flushed = monotonic()
        try:
            while not self.stop_recording.wait(TAKE_PERIOD):
                self.take_all(writer)
                if monotonic() - flushed >= self.flush_period:
                    writer.flush()
                    flushed = monotonic()
            self.take_all(writer)
            writer.close()
        except Exception as error:  # whatever the storage raises: the cell goes on, and everybody is told
            self.failure = f"recording ended: {getattr(error, 'strerror', None) or error} ({writer.path})"
            self.last_problem = self.failure
            self.degraded(self.failure)
            self.get_logger().error(self.failure)

    def take_all(self, writer: BagWriter) -> None:
        """Write all that has come, topic by topic; the times of reception are those of the middleware."""
        with self.lock:
            fresh, self.fresh = self.fresh, []
        for recorded, definition, profiles in fresh:
            writer.add(recorded.topic, recorded.type_name, definition, profiles)
            self.recorded.append(recorded)
        for recorded in self.recorded:
            handle = recorded.subscription.handle
            with handle:
                while (taken := handle.take_message(recorded.message_type, True)) is not None:
                    data, about = taken
                    self.count(recorded, about["publication_sequence_number"])
                    writer.write(recorded.topic, recorded.type_name, about["received_timestamp"], data)

    def count(self, recorded: Recorded, number: int | None) -> None:
        """Count what was lost between the last message of a topic and this one, if one publisher numbers them."""
        if number is None:
            return
        if recorded.alone and recorded.newest and number > recorded.newest + 1:
            recorded.lost += number - recorded.newest - 1
        recorded.newest = number

    def diagnose(self) -> tuple[bool, str, dict[str, object]]:
        """Report rates and losses."""
        now, messages = monotonic(), self.writer.messages
        rate = (messages - self.counted) / max(now - self.counted_at, 1e-3)
        self.counted, self.counted_at = messages, now
        lost = sum(recorded.lost for recorded in self.recorded)
        values: dict[str, object] = {
            "bag": str(self.writer.path),
            "topics": len(self.recorded),
            "messages": messages,
            "megabytes": self.writer.bytes / 1e6,
            "rate_hz": rate,
            "lost_messages": lost,
            "lost_of": " ".join(recorded.topic for recorded in self.recorded if recorded.lost),
            "last_problem": self.last_problem,
        }
        return not (self.failure or lost), self.failure or f"{rate:.0f} messages/s, {lost} lost", values


main = main_of(RecorderNode)

if __name__ == "__main__":
    main()
