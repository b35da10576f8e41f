"""Half an hour of handovers in the whole graph, recorded: does anything get lost, grow or slow down?

A calibrated person is tracked with the whole skeleton while the robot hands over one object after the other. A latency
is the time from the publishing of a frame's markers to that of its state, as the middleware stamps them; memory is from
the kernel's books on each process.
"""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from rich.console import Console

from handover_ros.bags.replay import stamp_of
from handover_ros.cell.processes import NODES, RECORDER, CellProcesses, NodeLaunch, check_alive
from handover_ros.cell.report import HandoverRecord
from handover_ros.geometry import FloatArray

SAMPLE_PERIOD = 5.0  # [s] of wall time between two looks at the processes
WARM_UP = 300.0  # [s] in which caches fill; growth of memory is measured after it
BIN = 10.0  # [s] of the plot's latencies
PAGE = 4096  # bytes
READY_LIMIT = 120.0  # [s]


@dataclass
class Memory:
    """Resident memory of each node over time."""

    processes: CellProcesses
    seconds: list[float] = field(default_factory=list)
    megabytes: dict[str, list[float]] = field(default_factory=dict)
    stop: threading.Event = field(default_factory=threading.Event)

    def run(self) -> None:
        """Look again and again until told to stop."""
        began = time.monotonic()
        while not self.stop.wait(SAMPLE_PERIOD):
            self.seconds.append(time.monotonic() - began)
            for name, node in self.processes.nodes.items():
                statm = Path(f"/proc/{node.process.pid}/statm")
                pages = int(statm.read_text().split()[1]) if statm.exists() else 0
                self.megabytes.setdefault(name, []).append(pages * PAGE / 1e6)

    def growth(self, warm_up: float) -> dict[str, float]:
        """Return the growth of each node [MB/h] by a straight line through what is after the warm-up."""
        seconds = np.array(self.seconds)
        late = seconds >= min(warm_up, 0.3 * seconds[-1])
        return {
            name: float(np.polyfit(seconds[late], np.array(values)[late], 1)[0] * 3600.0)
            for name, values in self.megabytes.items()
        }


@dataclass(frozen=True, eq=False)
class Stream:
    """Marker frames and the states made of them.

    Attributes:
        seconds: When each state was published, since the first (n,).
        latencies: From the publishing of a frame's markers to that of its state [ms] (n,).
        frames: How many frames the simulator numbered between the first and the last state.
        lost: How many of those have no state, or were not heard of.
    """

    seconds: FloatArray
    latencies: FloatArray
    frames: int
    lost: int


class Probe:
    """Notes when each frame was published on the three topics that it passes; takes no part.

    Args:
        node: Owner of the subscriptions.
    """

    def __init__(self, node: Any) -> None:
        from handover_msgs.msg import MarkerFrame, SkeletonState

        from handover_ros.nodes.runtime import RECORDER as DEEP
        from handover_ros.nodes.streams import OwnThread

        self.sent: dict[int, int] = {}  # device frame -> published [ns]
        self.frame_of: dict[int, int] = {}  # stamp of the cleaned frame [ns] -> device frame
        self.states: dict[int, int] = {}  # stamp [ns] -> published [ns]
        self.stop = threading.Event()
        own = OwnThread()
        self._topics = [
            (node.create_subscription(kind, topic, print, DEEP, callback_group=own), kind, note)
            for kind, topic, note in (
                (MarkerFrame, "sim/markers", self._on_sent),
                (MarkerFrame, "mocap/markers", self._on_clean),
                (SkeletonState, "human/skeleton_state", self._on_state),
            )
        ]

    def _on_sent(self, data: bytes, published: int) -> None:
        self.sent[frame_number(data)] = published

    def _on_clean(self, data: bytes, published: int) -> None:
        self.frame_of[stamp_of(data)] = frame_number(data)

    def _on_state(self, data: bytes, published: int) -> None:
        self.states[stamp_of(data)] = published

    def run(self) -> None:
        """Note until told to stop."""
        while not self.stop.wait(0.05):
            for subscription, kind, note in self._topics:
                handle = subscription.handle
                with handle:
                    while (taken := handle.take_message(kind, True)) is not None:
                        note(taken[0], taken[1]["source_timestamp"])

    def stream(self) -> Stream:
        """Return what was noted."""
        tracked = {self.frame_of[stamp]: at for stamp, at in self.states.items() if stamp in self.frame_of}
        first, last = min(tracked), max(tracked)
        used = np.array([frame for frame in self.sent if frame in tracked])
        ends = np.array([tracked[frame] for frame in used.tolist()])
        begins = np.array([self.sent[frame] for frame in used.tolist()])
        frames = last - first + 1
        return Stream((ends - ends[0]) * 1e-9, (ends - begins) * 1e-6, frames, frames - len(used))


def frame_number(data: bytes) -> int:
    """Return the device's frame number of a serialized MarkerFrame, which stands behind header and set version."""
    (length,) = struct.unpack_from("<I", data, 12)
    behind = -(-(12 + length) // 4) * 4 + 4  # of the text, padded, and the version; counted behind the encapsulation
    return int(struct.unpack_from("<Q", data, 4 + -(-behind // 8) * 8)[0])


def soak(minutes: float, handovers: int, seed: int, folder: Path, console: Console) -> dict[str, float]:
    """Run the cell for so many simulated minutes and at least so many handovers; return the numbers.

    Args:
        minutes: Of operation, after the calibration.
        handovers: At least so many.
        seed: Of the simulation.
        folder: Where bag, logs and plot go.
        console: Where progress is told.
    """
    from handover_msgs.action import ExecuteHandover
    from handover_msgs.srv import ResetSimulation

    from handover_ros.nodes.demo import DemoRequest, hand_over, launches, recorder_launch, wait_simulated
    from handover_ros.nodes.demo_calibration import calibrate_person
    from handover_ros.nodes.operator import Interrupt, operating

    request = DemoRequest(
        handovers=handovers, objects=(), scheme="expected_cost", person="adult", robot="baxter", scene="lab",
        recording=None, marker_set="auto", speed=1.0, pictures=False, calibrate=True, record=True, learn="",
        seed=seed, json_file=None, out=folder,
    )  # fmt: skip
    plan = launches(NODES, request.person, request.robot, request.scene, seed, request.speed, folder)
    own = {"profile_directory": str(folder / "profiles")}
    for node in ("calibration_node", "preference_node"):
        plan[node] = NodeLaunch(node, {**plan[node].parameters, **own}, plan[node].parameter_file)
    names = ("mug", "glass", "handlebars", "u_lock")
    records: list[HandoverRecord] = []
    with CellProcesses(folder / "log") as processes:
        for launch in (recorder_launch(folder), *plan.values()):
            processes.start(launch)
        memory = Memory(processes)
        with operating(Interrupt(threading.Event()), lambda: check_alive(processes)) as operator:
            operator.wait_ready((RECORDER, *plan), READY_LIMIT)
            calibrate_person(request.person, operator, console, wait_simulated)
            probe = Probe(operator.node)
            prober = threading.Thread(target=probe.run, daemon=True)
            prober.start()
            sampler = threading.Thread(target=memory.run, daemon=True)
            sampler.start()
            began = time.monotonic()
            quiet = Console(quiet=True)
            while time.monotonic() - began < 60.0 * minutes or len(records) < handovers:
                name = names[len(records) % len(names)]
                goal = ExecuteHandover.Goal(object_name=name, scheme=request.scheme)
                record, _ = hand_over(len(records) + 1, name, goal, request, operator, quiet)
                records.append(record)
                operator.call(ResetSimulation, "sim/reset", ResetSimulation.Request(seed=-1, objects_only=True))
                if not record.taken:
                    console.print(f"  {record.number} {name}: {record.message}", highlight=False)
                if record.number % 10 == 0:
                    console.print(f"  {record.number} handovers in {(time.monotonic() - began) / 60.0:.1f} min")
            spent = time.monotonic() - began
            memory.stop.set()
            sampler.join()
            probe.stop.set()
            prober.join()
    stream = probe.stream()
    growth = memory.growth(WARM_UP)
    draw_soak(stream, memory, records, folder / "soak.png")
    recorded = (folder / "log" / f"{RECORDER}.log").read_text(encoding="utf-8").strip().splitlines()[-1]
    console.print(recorded, highlight=False)
    return {
        "soak_minutes": spent / 60.0,
        "soak_handovers": len(records),
        "soak_taken": sum(record.taken for record in records),
        "soak_frames": stream.frames,
        "frames_lost": stream.lost,
        "latency_median_ms": float(np.median(stream.latencies)),
        "latency_p99_ms": float(np.percentile(stream.latencies, 99.0)),
        "latency_max_ms": float(stream.latencies.max()),
        "soak_growth_max_mb_per_h": max(growth.values()),
        **{f"soak_growth_{name}_mb_per_h": value for name, value in growth.items()},
    }


def draw_soak(stream: Stream, memory: Memory, records: Sequence[HandoverRecord], path: Path) -> Path:
    """Draw latencies, memory and handovers over time."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, (top, middle, bottom) = pyplot.subplots(3, 1, figsize=(9.0, 9.0), layout="constrained")
    places = (stream.seconds / BIN).astype(int)
    bins = np.unique(places)
    for share, style in ((50.0, "-"), (99.0, "--")):
        values = [np.percentile(stream.latencies[places == each], share) for each in bins]
        top.plot(bins * BIN / 60.0, values, style, color="#4c78a8", label=f"{share:g} % of {BIN:g} s")
    top.axhline(5.0, color="#e45756", linewidth=1.0, label="5 ms")
    top.set_ylabel("markers to state [ms]")
    top.set_title(f"{stream.frames:,} frames, {stream.lost} without a state", loc="left")
    top.legend(frameon=False, ncols=3)
    for name, values in memory.megabytes.items():
        middle.plot(np.array(memory.seconds) / 60.0, values, label=name)
    middle.set_ylabel("resident memory [MB]")
    middle.set_ylim(bottom=0.0)
    middle.legend(frameon=False, ncols=3, fontsize=8)
    durations = np.array([record.duration for record in records])
    ends = np.arange(1, len(records) + 1)
    taken = np.array([record.taken for record in records])
    bottom.bar(ends[taken], durations[taken], color="#54a24b", label="taken")
    bottom.bar(ends[~taken], np.maximum(durations[~taken], 0.5), color="#e45756", label="not taken")
    bottom.set_ylabel("duration of the handover [s]")
    bottom.set_xlabel("handover")
    bottom.legend(frameon=False, ncols=2)
    for axes in (top, middle):
        axes.set_xlabel("time [min]")
    for axes in (top, middle, bottom):
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)
    pyplot.close(figure)
    return path
