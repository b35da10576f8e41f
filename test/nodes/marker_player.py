"""Plays marker frames of a synthetic person on ``mocap/markers``, as ``mocap_node`` would."""

from __future__ import annotations

import threading
import time

import numpy as np
from graph import Graph
from handover_msgs.msg import MarkerFrame as MarkerFrameMessage
from handover_msgs.msg import MarkerSet

from handover_ros.mocap.frames import MarkerFrame
from handover_ros.nodes.convert_human import fill_marker_frame, marker_set_message
from handover_ros.nodes.runtime import LATCHED, SENSOR_PUBLISHER

STILL = 20  # frames at the beginning in which the person stands still


class MarkerPlayer:
    """Publishes frames again and again from a thread, numbered and stamped, until it is stopped.

    The person stands still (the first frames) until told to move.

    Args:
        graph: The test's node.
        names: Marker names.
        segments: The segment of each.
        positions: Frames (k, n, 3) [m].
        rate: Frames per second [Hz] that the stamps say.
        speed: How much faster than that they are sent.
    """

    def __init__(
        self,
        graph: Graph,
        names: tuple[str, ...],
        segments: tuple[str, ...],
        positions: np.ndarray,
        rate: float,
        speed: float = 1.0,
    ) -> None:
        self.names, self.segments, self.rate, self.speed = names, segments, rate, speed
        self.positions = positions
        self.sent = 0
        self.moving = threading.Event()
        self.version = 1
        self._stop = threading.Event()
        self._frames = graph.node.create_publisher(MarkerFrameMessage, "mocap/markers", SENSOR_PUBLISHER)
        self._sets = graph.node.create_publisher(MarkerSet, "mocap/marker_set", LATCHED)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self.announce()

    def announce(self, names: tuple[str, ...] | None = None, rate: float | None = None) -> None:
        """Publish the names of the markers."""
        chosen = names or self.names
        segments = tuple(self.segments[self.names.index(name)] for name in chosen)
        self._sets.publish(
            marker_set_message("upper_body_24", chosen, segments, rate or self.rate, "world", self.version)
        )

    @property
    def listeners(self) -> int:
        """How many subscriptions get the frames."""
        return self._frames.get_subscription_count()

    def start(self) -> MarkerPlayer:
        """Begin to play."""
        self._thread.start()
        return self

    def stop(self) -> None:
        """Play no more."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(5.0)

    def _run(self) -> None:
        message = MarkerFrameMessage()
        message.header.frame_id = "world"
        began, number, moved = time.monotonic(), 0, 0
        while not self._stop.is_set():
            positions = np.ascontiguousarray(self.positions[moved % len(self.positions)])
            moved = moved + 1 if self.moving.is_set() else (moved + 1) % STILL
            number += 1
            message.set_version = self.version
            status = np.zeros(len(positions), dtype=np.uint8)
            frame = MarkerFrame(1000.0 + number / self.rate, number, number / self.rate, positions, status)
            fill_marker_frame(message, frame)
            self._frames.publish(message)
            self.sent = number
            self._stop.wait(max(0.0, began + number / self.rate / self.speed - time.monotonic()))
