"""Fast streams: a thread that waits for one topic only, beside the executor; or a look at the newest now and then.

A turn of rclpy's executor looks at every timer, service and event of the node, twice for each message: 0.6 ms here,
several times the work on a marker frame. Waiting for the one subscription costs a tenth of that.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message

from handover_ros.cell.latency import Latencies

STOP_TIMEOUT = 1.0  # [s]
WAIT = 200_000_000  # [ns] longest wait, so that a stop is noticed


class OwnThread(CallbackGroup):
    """Keeps a subscription out of the executor: its owner takes the messages in a thread of its own."""

    def can_execute(self, entity: Any) -> bool:
        """Return False: the executor is not to look at it."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Return False: the executor has nothing to do."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Do nothing."""


class StreamReader:
    """Calls a function with every message of one topic, in order, from a thread of its own.

    The function runs under ``lock``; other callbacks take it while they change what the function uses. An exception
    in the function ends the process as one in any callback does.

    Attributes:
        latencies: From a message's arrival to the end of what counts of the work on it.

    Args:
        node: Owner of the subscription.
        message_type: Type of the messages.
        topic: Topic name.
        callback: Called with each message.
        profile: Quality of service.
        timed: Whether the end of the callback counts; otherwise it calls ``note_latency`` when what counts is done.
    """

    def __init__(
        self,
        node: Node,
        message_type: type,
        topic: str,
        callback: Callable[[Any], None],
        profile: QoSProfile,
        timed: bool = True,
    ) -> None:
        self._timed, self._received = timed, 0
        self.lock = threading.Lock()
        self.latencies = Latencies()
        self._node = node
        self._callback = callback
        self._context = node.context
        self._subscription = node.create_subscription(
            message_type, topic, callback, profile, callback_group=OwnThread()
        )
        self._message_type = message_type
        self._stop = threading.Event()
        self._error: BaseException | None = None
        self._failed = node.create_guard_condition(self._raise)
        self._thread = threading.Thread(target=self._run, name=f"stream {topic}", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread and the subscription; call before the node is destroyed, from another thread."""
        self._stop.set()
        self._thread.join(STOP_TIMEOUT)
        self._node.destroy_subscription(self._subscription)
        self._node.destroy_guard_condition(self._failed)

    def note_latency(self) -> None:
        """Note how long ago the message at hand arrived."""
        self.latencies.note((time.time_ns() - self._received) * 1e-9)

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        try:
            handle, context = self._subscription.handle, self._context.handle
            assert context is not None  # the node lives
            with handle, context:
                wait_set = rclpy_implementation.WaitSet(1, 0, 0, 0, 0, 0, context)
                while not self._stop.is_set() and self._context.ok():
                    wait_set.clear_entities()
                    wait_set.add_subscription(handle)
                    wait_set.wait(WAIT)
                    while (taken := handle.take_message(self._message_type, False)) is not None:
                        self._received = taken[1]["received_timestamp"]
                        with self.lock:
                            self._callback(taken[0])
                        if self._timed:
                            self.note_latency()
                        if self._stop.is_set():
                            return
        except BaseException as error:
            if self._context.ok() and not self._stop.is_set():
                self._error = error
                self._failed.trigger()


class Latest:
    """The newest message of a topic, converted only when it is asked for.

    The subscription is always there: to make one when it is needed and destroy it afterwards has every process of the
    graph work, and remember.

    Args:
        node: Owner of the subscription.
        message_type: Type of the messages.
        topic: Topic name.
        profile: Quality of service.
    """

    def __init__(self, node: Node, message_type: type, topic: str, profile: QoSProfile) -> None:
        self._message_type = message_type
        self._subscription = node.create_subscription(message_type, topic, print, profile, callback_group=OwnThread())

    def take(self) -> Any:
        """Return the newest message that came since the last call, None when none did."""
        newest, handle = None, self._subscription.handle
        with handle:
            while (taken := handle.take_message(self._message_type, True)) is not None:
                newest = taken[0]
        return None if newest is None else deserialize_message(newest, self._message_type)


class NewestReader:
    """Hands over the newest message of topics a few times a second, however often they come.

    What is in between is never converted: most of the work of a node that only needs to know how things are now.

    Args:
        node: Owner of the subscriptions.
        period: [s] of wall time between two looks.
    """

    def __init__(self, node: Node, period: float) -> None:
        self._node = node
        self._read: list[tuple[Latest, Callable[[Any], None]]] = []
        node.create_timer(period, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def newest_of(self, message_type: type, topic: str, callback: Callable[[Any], None], profile: QoSProfile) -> None:
        """Call ``callback`` from the executor with the newest message of a topic, if there is a new one."""
        self._read.append((Latest(self._node, message_type, topic, profile), callback))

    def _look(self) -> None:
        for latest, callback in self._read:
            if (message := latest.take()) is not None:
                callback(message)
