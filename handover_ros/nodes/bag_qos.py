"""Quality of service between the graph and a bag: what a recorder asks for, what a bag notes, what a replay offers."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import Any

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

DEPTH = 2000  # messages a recorder may lag behind, and a replay may be ahead
DEEPEST_LATCHED = 1  # a latched topic's last message is what counts
BIG = {"sensor_msgs/msg/Image": 20, "sensor_msgs/msg/PointCloud2": 20}  # depth of topics of large messages
FOREVER = QosTime(9223372036, 854775807)


def message_class(type_name: str) -> Any:
    """Return the Python class of a message type.

    Raises:
        ImportError: Its package is not installed.
        AttributeError: The package has no such message.
    """
    package, _, name = type_name.partition("/msg/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def recorder_profile(type_name: str, publishers: Sequence[TopicEndpointInfo]) -> QoSProfile:
    """Return what suits all publishers of a topic, as strong as they offer, and deep."""
    reliable = all(each.qos_profile.reliability is ReliabilityPolicy.RELIABLE for each in publishers)
    latched = all(each.qos_profile.durability is DurabilityPolicy.TRANSIENT_LOCAL for each in publishers)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=BIG.get(type_name, DEPTH),
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def noted_profile(profile: QoSProfile) -> Qos:
    """Return a publisher's quality of service as a bag notes it."""
    return Qos(
        history=QosHistory[profile.history.name]
        if profile.history.name in QosHistory.__members__
        else QosHistory.UNKNOWN,
        depth=profile.depth,
        reliability=QosReliability[profile.reliability.name],
        durability=QosDurability[profile.durability.name],
        deadline=_noted_time(profile.deadline),
        lifespan=_noted_time(profile.lifespan),
        liveliness=QosLiveliness[profile.liveliness.name],
        liveliness_lease_duration=_noted_time(profile.liveliness_lease_duration),
        avoid_ros_namespace_conventions=profile.avoid_ros_namespace_conventions,
    )


def replay_profile(profiles: Sequence[Qos]) -> QoSProfile:
    """Return what a replay offers: as the recorded publishers did; reliable when that is not known."""
    latched = bool(profiles) and all(each.durability is QosDurability.TRANSIENT_LOCAL for each in profiles)
    best_effort = bool(profiles) and all(each.reliability is QosReliability.BEST_EFFORT for each in profiles)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=DEEPEST_LATCHED if latched else DEPTH,
        reliability=ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def _noted_time(duration: Duration) -> QosTime:
    nanoseconds = duration.nanoseconds
    return FOREVER if nanoseconds >= FOREVER.sec * 10**9 else QosTime(*divmod(nanoseconds, 10**9))
