"""What of a bag is played to which nodes: their inputs, nothing that they or others publish, no commands to a robot."""

from __future__ import annotations

import re
import struct
from collections.abc import Collection, Mapping, Sequence

from handover_ros.bags.definitions import Definitions, difference
from handover_ros.bags.reading import Bag, Topic
from handover_ros.errors import BadRecordingError, BadRequestError, UnknownNameError

CLOCK = "/clock"
#: What a replay gives the nodes that can be driven by one; the rest of the graph acts and does not only look.
INPUTS: Mapping[str, tuple[str, ...]] = {
    "mocap_node": ("/sim/markers", "/sim/marker_set"),
    "skeleton_node": ("/mocap/markers", "/mocap/marker_set"),
    "preference_node": ("/calibration/active_profile", "/handover/grasp_choice"),
}
#: What these nodes give each other.
OUTPUTS: Mapping[str, tuple[str, ...]] = {"mocap_node": ("/mocap/markers", "/mocap/marker_set")}
#: They move a robot, and are only played when they are named.
COMMANDS = ("/robot/joint_trajectory", "/robot/gripper_command", "/robot/enable", "/robot/display")
#: What every node says of itself.
OWN = ("/rosout", "/parameter_events", "/diagnostics", "/cell/heartbeat")
#: A stream, and what a node makes of each of its messages.
MADE_OF = {"/sim/markers": "/mocap/markers", "/mocap/markers": "/human/skeleton_state"}
STAMP = struct.Struct("<4xiI")  # encapsulation, then a header's time, little-endian as all middlewares here write it


def drivable(bag: Bag) -> tuple[str, ...]:
    """Return the nodes that a bag can drive, each on the cleanest data there is.

    Raises:
        BadRecordingError: There are none.
    """
    has = {name for name, topic in bag.topics.items() if topic.messages}
    nodes = [node for node, needed in INPUTS.items() if has.issuperset(needed)]
    if "skeleton_node" in nodes and "mocap_node" in nodes:
        nodes.remove("mocap_node")
    if "mocap_node" in nodes:
        nodes.insert(1, "skeleton_node")
    if not nodes:
        raise BadRecordingError(
            f"bag {bag.path}: lacks what a node could be driven by: /mocap/markers with /mocap/marker_set, or "
            f"/sim/markers with /sim/marker_set; it has {', '.join(sorted(has)) or 'no messages'}"
        )
    return tuple(nodes)


def inputs_of(nodes: Sequence[str]) -> set[str]:
    """Return the topics that nodes need."""
    return {topic for node in nodes for topic in INPUTS.get(node, ())}


def check_inputs(bag: Bag, nodes: Sequence[str]) -> None:
    """Raise when a bag lacks what nodes need.

    Raises:
        UnknownNameError: A node cannot be driven by a bag.
        BadRecordingError: A topic is not there; names it.
    """
    made = {topic for node in nodes for topic in OUTPUTS.get(node, ())}
    for node in nodes:
        if node not in INPUTS:
            raise UnknownNameError("node for a replay", node, tuple(INPUTS))
        for topic in INPUTS[node]:
            found = bag.topics.get(topic)
            if topic not in made and (found is None or not found.messages):
                raise BadRecordingError(
                    f"bag {bag.path}: topic {topic}, which {node} needs, is not in it; "
                    f"it has {', '.join(name for name, each in bag.topics.items() if each.messages) or 'no messages'}"
                )


def other_versions(
    topics: Collection[Topic], needed: Collection[str], installed: Definitions, path: object
) -> dict[str, str]:
    """Return what is different about topics whose message type is not the installed one, by name.

    Args:
        topics: What is to be played.
        needed: Names of those that must be as they are installed.
        installed: The installed definitions.
        path: Of the bag, for the message.

    Raises:
        BadRecordingError: A needed one is different; names topic, type and difference.
    """
    found = {}
    for topic in topics:
        try:
            change = difference(topic.type_name, topic.definition, topic.digest, installed.of(topic.type_name))
        except UnknownNameError:
            change = "it is not installed here"
        if change and topic.name in needed:
            raise BadRecordingError(
                f"bag {path}: topic {topic.name}: {topic.type_name} of another version: {change}; replay it with the "
                f"version that recorded it, or leave it out: --exclude {topic.name}"
            )
        if change:
            found[topic.name] = f"{topic.type_name} of another version: {change}"
    return found


def topic_patterns(source: str, text: str) -> list[re.Pattern[str]]:
    """Return patterns of whole topic names; names may lack the ``/`` at their beginning.

    Args:
        source: Option or parameter they come from, for the message.
        text: Names or regular expressions, space between.

    Raises:
        BadRequestError: One is no regular expression.
    """
    found = []
    for word in text.split():
        try:
            found.append(re.compile(word if word[0] in "/(.[\\" else f"/{word}"))
        except re.error as error:
            raise BadRequestError(f"{source}: {word!r} is no pattern of topic names: {error}") from None
    return found


def chosen_topics(
    bag: Bag,
    published: Collection[str] = (),
    wanted: Sequence[re.Pattern[str]] = (),
    unwanted: Sequence[re.Pattern[str]] = (),
) -> dict[str, Topic]:
    """Return what is played.

    Args:
        bag: The bag.
        published: Topics that somebody publishes already, e.g. what the driven nodes make anew.
        wanted: Patterns of whole names; empty: all but commands and what nodes say of themselves.
        unwanted: Patterns that are left out.

    Raises:
        BadRecordingError: Nothing is left.
    """
    chosen = {}
    for name, topic in bag.topics.items():
        asked = any(pattern.fullmatch(name) for pattern in wanted)
        usual = not wanted and name not in COMMANDS and name not in OWN
        out = any(pattern.fullmatch(name) for pattern in unwanted)
        if topic.messages and name not in published and not out and (asked or usual or name == CLOCK):
            chosen[name] = topic
    if not set(chosen) - {CLOCK}:
        raise BadRecordingError(f"bag {bag.path}: nothing is left to be played; it has {', '.join(bag.topics)}")
    return chosen


def stamp_of(data: bytes) -> int:
    """Return the time [ns] in a serialized message that begins with a header; 0: it is too short."""
    if len(data) < STAMP.size:
        return 0
    seconds, nanoseconds = STAMP.unpack_from(data)
    return int(seconds * 10**9 + nanoseconds)


def first_used(bag: Bag, played: Collection[str]) -> dict[str, int]:
    """Return the stamp [ns] of the first message of a played stream that was used when the bag was recorded.

    A node that came up while the stream ran missed its beginning; a replay leaves that out, and makes the same of it.
    """
    found = {}
    for stream, made in MADE_OF.items():
        if stream in played and stream in bag.topics and made not in played and made in bag.topics:
            first = next(iter(bag.read([made])), None)
            if first is not None:
                found[stream] = stamp_of(first[2])
    return found


def latest_before(bag: Bag, topics: Mapping[str, Topic], start: int) -> list[tuple[Topic, bytes]]:
    """Return the last message before ``start`` [ns] of each latched topic, the oldest first."""
    latest: dict[str, tuple[int, Topic, bytes]] = {}
    for topic, stamp, data in bag.read([name for name, topic in topics.items() if topic.latched], None, start):
        latest[topic.name] = stamp, topic, data
    return [(topic, data) for _, topic, data in sorted(latest.values(), key=lambda entry: entry[0])]
