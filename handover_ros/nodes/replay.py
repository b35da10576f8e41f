"""``handover replay``: a bag drives the real nodes, and what they give is held against what was recorded."""

from __future__ import annotations

import contextlib
import shutil
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import rclpy
from handover_msgs.msg import Heartbeat
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rich.console import Console

from handover_ros.bags.reading import BAG, Bag
from handover_ros.bags.replay import INPUTS, check_inputs, drivable, inputs_of, stamp_of, topic_patterns
from handover_ros.bags.sameness import BELIEFS, STATES, Sameness, compare_beliefs, compare_states
from handover_ros.cell.late_progress import LateProgress
from handover_ros.cell.processes import EXTRA_NODES, NODES, CellProcesses, NodeLaunch, check_alive
from handover_ros.cell.report import output_folder, write_json
from handover_ros.cell.session import PARAMETERS, START
from handover_ros.errors import BadRecordingError, BadRequestError, StaleDataError
from handover_ros.nodes.operator import InterruptedByOperatorError
from handover_ros.nodes.player import Player, Selection
from handover_ros.nodes.runtime import SENSOR_PUBLISHER
from handover_ros.resources import config_directory

READY_LIMIT = 120.0  # [s] of wall time until the nodes are up: kernels may have to be compiled
DISCOVERY = 0.7  # [s] of wall time until nodes of this machine are known
LINGER = 1.5  # [s] of wall time for the last answers to be taken in and recorded
MADE = {"mocap_node": "/mocap/.*", "skeleton_node": "/human/.*", "preference_node": "/preferences/.*"}
EXIT_DIFFERENT, EXIT_INTERRUPTED = 1, 130
POLL = 0.02  # [s]


@dataclass(frozen=True)
class ReplayRequest:
    """What ``handover replay`` was asked for.

    Attributes:
        bag: Folder of a bag or of a session, or a file.
        nodes: Nodes to drive; empty: those the bag has the inputs of.
        start_nodes: Whether they are started; False: they run already.
        speed: Recorded seconds per second.
        start: Where to begin [s].
        duration: How long [s]; 0: to the end.
        expect_same: Whether anything but the same, bit for bit, is a failure.
        topics: Names or patterns of what is played; empty: all but commands.
        exclude: Names or patterns of what is left out.
        json_file: Where to write the numbers too.
        out: Folder of everything written.
    """

    bag: Path
    nodes: tuple[str, ...] = ()
    start_nodes: bool = True
    speed: float = 1.0
    start: float = 0.0
    duration: float = 0.0
    expect_same: bool = False
    topics: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    json_file: Path | None = None
    out: Path | None = None


class Watcher:
    """A node that plays, and sees which others are up."""

    def __init__(self) -> None:
        self.context = Context()
        rclpy.init(context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node("replay", context=self.context, start_parameter_services=False)
        self.states: dict[str, int] = {}
        self.node.create_subscription(Heartbeat, "cell/heartbeat", self._on_heartbeat, SENSOR_PUBLISHER)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._spin, daemon=True, name="replay")
        self._thread.start()

    def _on_heartbeat(self, message: Heartbeat) -> None:
        self.states[message.node] = message.state

    def _spin(self) -> None:
        with contextlib.suppress(ExternalShutdownException):
            while self.context.ok() and not self._stop.is_set():
                self._executor.spin_once(timeout_sec=0.5)

    def up(self, nodes: tuple[str, ...]) -> bool:
        """Return whether all nodes have come up."""
        return all(self.states.get(node, Heartbeat.STARTING) != Heartbeat.STARTING for node in nodes)

    def ready(self, nodes: tuple[str, ...]) -> bool:
        """Return whether all nodes are ready for work."""
        return all(self.states.get(node) == Heartbeat.READY for node in nodes)

    def refuse_company(self, stop: threading.Event) -> None:
        """Raise when nodes of a cell run already.

        Raises:
            BadRequestError: They would hear the replay, and publish beside it.
        """
        stop.wait(DISCOVERY)
        if others := sorted({*NODES, *EXTRA_NODES} & set(self.node.get_node_names())):
            raise BadRequestError(
                f"{', '.join(others)} run in this ROS domain: stop them, choose another ROS_DOMAIN_ID, or play to them "
                "with --no-start-nodes"
            )

    def close(self) -> None:
        """Leave the graph; the context last, since shutting it down under a running executor can hang."""
        self._stop.set()
        self._thread.join(timeout=3.0)
        self._executor.shutdown(timeout_sec=1.0)
        self.node.destroy_node()
        self.context.try_shutdown()


@contextlib.contextmanager
def watching() -> Iterator[Watcher]:
    """Give a watcher that leaves the graph at the end."""
    watcher = Watcher()
    try:
        yield watcher
    finally:
        watcher.close()


def replay_launches(bag: Bag, nodes: tuple[str, ...], folder: Path) -> list[NodeLaunch]:
    """Return how to start the nodes: with the parameters and the profiles of the recorded session, if they are there.

    Args:
        bag: The bag.
        nodes: Which nodes.
        folder: Where the replay keeps its profiles and records what the nodes give.
    """
    session = bag.path.parent
    own: dict[str, dict[str, object]] = {"mocap_node": {"source": "simulator"}}
    profiles = folder / "profiles"
    if (session / START).is_dir():
        shutil.copytree(session / START, profiles)
    own["preference_node"] = {"profile_directory": str(profiles)}
    launches = []
    for node in nodes:
        recorded = session / PARAMETERS / f"{node}.yaml"
        file = recorded if recorded.is_file() else config_directory() / f"{node}.yaml"
        launches.append(NodeLaunch(node, {**own.get(node, {}), "use_sim_time": True}, file))
    made = " ".join(MADE[node] for node in nodes)
    launches.append(NodeLaunch("recorder_node", {"bag": str(folder / BAG), "topics": made}))
    return launches


def run_replay(request: ReplayRequest, console: Console, stop: threading.Event) -> int:
    """Replay a bag and return the exit status: 0; 1 when the same was expected and did not come; 130 when interrupted.

    Raises:
        HandoverError: The bag cannot be played.
    """
    selection = Selection(
        request.speed,
        request.start,
        request.duration,
        topic_patterns("--topic", " ".join(request.topics)),
        topic_patterns("--exclude", " ".join(request.exclude)),
    )
    with Bag(request.bag) as bag:
        if bag.note:
            console.print(bag.note, highlight=False, soft_wrap=True)
        nodes = request.nodes or (drivable(bag) if request.start_nodes else ())
        check_inputs(bag, nodes)
        folder = output_folder(request.out, "replay")
        if request.start_nodes and (folder / BAG).exists():
            raise BadRecordingError(f"--out {folder}: there is a bag already; name another folder")
        with watching() as watcher, CellProcesses(folder / "log") as processes:
            player = Player(watcher.node, bag, selection, inputs_of(nodes or tuple(INPUTS)))
            for topic, why in player.left_out.items():
                console.print(f"{topic} is left out: {why}", highlight=False, soft_wrap=True)
            launches = []
            if request.start_nodes:
                watcher.refuse_company(stop)
                launches = replay_launches(bag, nodes, folder)
            for launch in launches:
                processes.start(launch)
            if launches:
                console.print(f"starting {', '.join(nodes)} ...")
            started = tuple(launch.node for launch in launches)
            whole = _play(player, watcher, processes, started, console, stop)
        metrics = _metrics(bag, player)
        if not whole:
            console.print("interrupted")
            return EXIT_INTERRUPTED
        results = compared(bag, folder, request) if request.start_nodes else []
    console.print(f"played {player.played.total():,} messages of {len(player.played)} topics")
    for result in results:
        console.print(result.sentence(), highlight=False, soft_wrap=True)
        name = "states" if result.topic == STATES else "beliefs"
        metrics |= {
            f"{name}_compared": result.recorded,
            f"{name}_identical": result.identical,
            f"{name}_missing": result.missing,
            f"{name}_unlike": result.unlike,
            f"{name}_largest_difference": max(result.largest.values(), default=0.0),
        }
    console.print(f"everything is in {folder}", highlight=False, soft_wrap=True)
    ok = not request.expect_same or (bool(results) and all(result.equal for result in results))
    for target in filter(None, (folder / "replay.json", request.json_file)):
        write_json(target, "replay", ok, 0, metrics, files=[folder / BAG], folder=str(folder))
    return 0 if ok else EXIT_DIFFERENT


def _play(
    player: Player,
    watcher: Watcher,
    processes: CellProcesses,
    started: tuple[str, ...],
    console: Console,
    stop: threading.Event,
) -> bool:
    """Play the bag to the nodes; return whether it came to the end."""

    def check() -> None:
        check_alive(processes)
        if stop.is_set():
            raise InterruptedByOperatorError("interrupted")

    def wait(limit: float) -> None:
        deadline = time.monotonic() + limit
        while not watcher.up(started):
            check()
            if time.monotonic() > deadline:
                missing = [node for node in started if node not in watcher.states]
                raise StaleDataError(f"waited {limit:g} s for {', '.join(missing)}")
            stop.wait(POLL)

    try:
        wait(READY_LIMIT)
        player.prepare()
        player.wait_for_listeners(check)
        player.begin()
        with LateProgress(console, "playing") as bar:
            whole = player.run(stop, lambda fraction: bar.update(fraction, ""))
        stop.wait(LINGER if started else 0.0)
    except InterruptedByOperatorError:
        return False
    return whole


def compared(bag: Bag, folder: Path, request: ReplayRequest) -> list[Sameness]:
    """Return how like the recording the replay is, as far as it was played."""
    results = []
    with Bag(folder / BAG) as made:
        if STATES in bag.topics and STATES in made.topics:
            stamps = [stamp_of(data) for _, _, data in made.read([STATES])] or [0]
            begin = stamps[0] if request.start > 0.0 else 0
            end = stamps[-1] if request.duration > 0.0 else None
            results.append(compare_states(bag, made, begin, end))
        if BELIEFS in bag.topics and BELIEFS in made.topics and not (request.start or request.duration):
            results.append(compare_beliefs(bag, made))
    return results


def _metrics(bag: Bag, player: Player) -> dict[str, float]:
    return {
        "messages": player.played.total(),
        "topics": len(player.played),
        "skipped": player.skipped.total(),
        "duration_s": bag.duration,
        "late_s": player.late,
    }
