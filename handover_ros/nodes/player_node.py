"""``player_node``: plays a bag to the nodes that run, with ``/clock``; what they publish themselves is left out."""

from __future__ import annotations

import os
import signal
import threading
from pathlib import Path

from handover_msgs.msg import Heartbeat

from handover_ros.bags.reading import Bag
from handover_ros.bags.replay import INPUTS, inputs_of, topic_patterns
from handover_ros.errors import BadRequestError, HandoverError, StaleDataError
from handover_ros.nodes.parameters import ParameterSpec
from handover_ros.nodes.player import Player, Selection
from handover_ros.nodes.runtime import EXIT_BAD_INPUT, SENSOR_PUBLISHER, HandoverNode, main_of, monotonic

NODES_LIMIT = 120.0  # [s] of wall time until the nodes must be there: kernels may have to be compiled
POLL = 0.05  # [s] of wall time

PARAMETERS = (
    ParameterSpec("bag", "", "folder of a bag or of a session, or a file: rosbag2, MCAP or sqlite3"),
    ParameterSpec("speed", 1.0, "recorded seconds per second", 0.01, 100.0),
    ParameterSpec("start", 0.0, "[s] after the first message where to begin", 0.0, 1e7),
    ParameterSpec("duration", 0.0, "[s] of the recording to play; 0: to its end", 0.0, 1e7),
    ParameterSpec("topics", "", "what is played: names or regular expressions, space between; empty: no commands"),
    ParameterSpec("exclude", "", "what is left out: names or regular expressions, space between"),
    ParameterSpec("nodes", "", "nodes to wait for before it begins, space between"),
)


class PlayerNode(HandoverNode):
    """Plays one bag; ends by itself when it is played."""

    def __init__(self) -> None:
        super().__init__("player_node", PARAMETERS)
        parameters = self.parameters
        if not parameters["bag"]:
            raise BadRequestError("player_node: parameter bag: name the bag to play")
        self.bag = Bag(Path(parameters["bag"]).expanduser())
        selection = Selection(
            parameters["speed"],
            parameters["start"],
            parameters["duration"],
            topic_patterns("topics", parameters["topics"]),
            topic_patterns("exclude", parameters["exclude"]),
        )
        nodes = parameters["nodes"].split() or tuple(INPUTS)
        self.player = Player(self, self.bag, selection, inputs_of(nodes))
        for topic, why in self.player.left_out.items():
            self.get_logger().warning(f"{topic} is left out: {why}")
        self.there: set[str] = set()
        self.stopping = threading.Event()
        self.fraction = 0.0
        self.create_subscription(Heartbeat, "cell/heartbeat", self.on_heartbeat, SENSOR_PUBLISHER)
        self.thread = threading.Thread(target=self.play, name="player", daemon=True)
        self.thread.start()
        self.degraded("waiting for the nodes")

    def on_stop(self) -> None:
        """End the replay."""
        self.stopping.set()
        self.thread.join(2.0)
        self.bag.close()

    def on_heartbeat(self, message: Heartbeat) -> None:
        """Note that a node is up."""
        if message.state != Heartbeat.STARTING:
            self.there.add(message.node)

    def check(self) -> None:
        """Raise when the replay is to end."""
        if self.stopping.is_set():
            raise StaleDataError("stopped")

    def play(self) -> None:
        """Play; runs in a thread of its own."""
        try:
            deadline = monotonic() + NODES_LIMIT
            while not (wanted := set(self.parameters["nodes"].split())) <= self.there:
                if self.stopping.wait(POLL):
                    return
                if monotonic() > deadline:
                    raise StaleDataError(f"waited {NODES_LIMIT:g} s for {', '.join(sorted(wanted - self.there))}")
            self.player.prepare()
            self.player.wait_for_listeners(self.check)
            self.player.begin()
            self.ready(f"playing {self.bag.path.name}, {self.bag.duration:.1f} s")
            if self.player.run(self.stopping, self.on_progress):
                self.ready(f"played {self.player.played.total():,} messages to the end")
        except HandoverError as error:
            if not self.stopping.is_set():
                self.last_problem = str(error)
                self.get_logger().error(str(error))
                self.degraded(str(error))
                self.exit_status = EXIT_BAD_INPUT
        if not self.stopping.is_set():
            os.kill(os.getpid(), signal.SIGINT)  # as an operator would end it

    def on_progress(self, fraction: float) -> None:
        """Note how far it is."""
        self.fraction = fraction

    def diagnose(self) -> tuple[bool, str, dict[str, object]]:
        """Report how far it is."""
        values: dict[str, object] = {
            "bag": str(self.bag.path),
            "played_fraction": self.fraction,
            "messages": self.player.played.total(),
            "skipped": self.player.skipped.total(),
            "late_s": self.player.late,
            "last_problem": self.last_problem,
        }
        return not self.last_problem, self.last_problem or f"{100.0 * self.fraction:.0f} % played", values


main = main_of(PlayerNode)

if __name__ == "__main__":
    main()
