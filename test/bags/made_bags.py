"""Makes small bags and sessions with what a cell would say."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import pytest
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

from handover_ros.bags.definitions import Definitions
from handover_ros.bags.recording import BagWriter, Storage

START = 1_700_000_000 * 10**9  # [ns] time of the first message of a bag
NO_TIME = QosTime(9223372036, 854775807)
LATCHED = Qos(
    QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, NO_TIME, NO_TIME,
    QosLiveliness.AUTOMATIC, NO_TIME, False,
)  # fmt: skip
LATCHED_TOPICS = ("/cell/state", "/preferences/belief", "/calibration/active_profile", "/planner/plan", "/rosout")
JOINTS = ("shoulder", "elbow")
FLUSHED_EVERY = 200  # messages

Said = tuple[float, str, Any]  # time [s], topic, message


def type_of(message: Any) -> str:
    """Return the type's whole name of a ROS message."""
    package = type(message).__module__.split(".")[0]
    return f"{package}/msg/{type(message).__name__}"


def write_bag(folder: Path, said: Iterable[Said], storage: Storage = "mcap", closed: bool = True) -> Path:
    """Write messages in the order of their times; not closed: as a killed recorder leaves a bag."""
    from rclpy.serialization import serialize_message

    writer = BagWriter(folder, storage)
    definitions, known = Definitions(), set()
    for number, (seconds, topic, message) in enumerate(sorted(said, key=lambda entry: entry[0])):
        if number % FLUSHED_EVERY == 0:
            writer.flush()
        name = type_of(message)
        if topic not in known:
            known.add(topic)
            latched = topic.endswith(LATCHED_TOPICS)
            writer.add(topic, name, definitions.of(name), [LATCHED] if latched else [])
        writer.write(topic, name, START + round(seconds * 1e9), serialize_message(message))
    writer.flush()
    if closed:
        writer.close()
    return folder


def messages() -> Any:
    """Return the package of messages; a test without ROS is left out."""
    pytest.importorskip("rclpy", reason="ROS is not there")
    return pytest.importorskip("handover_msgs.msg", reason="handover_msgs is not built")


def state(seconds: float, phase: str, **more: Any) -> Said:
    """Return a state of the cell; its ROS time is 100 s before that of the bag, twice as fast."""
    message = messages().CellState(phase=phase, **more)
    stamp = round((100.0 + 2.0 * seconds) * 1e9)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
    return seconds, "/cell/state", message


def handover(
    begin: float, number: int, object_name: str, phases: Sequence[tuple[str, float]], taken: bool, before: int = 0
) -> list[Said]:
    """Return what the executive says in one handover.

    Args:
        begin: When [s].
        number: 1, 2, ...
        object_name: Of what.
        phases: Names and durations [s] of the bag's time.
        taken: How it ends.
        before: Handovers taken before.
    """
    told = {"handover_id": f"h{number}", "object_name": object_name, "handovers": number - 1, "taken": before}
    said, time = [], begin
    for name, seconds in phases:
        said.append(state(time, name, message=f"{name} {object_name}", **told))
        time += seconds
    end = "the person has it" if taken else "nobody took it"
    said.append(state(time, "done", message=end, **told))
    said.append(state(time + 0.01, "idle", message=end, handovers=number, taken=before + taken))
    return said


def markers(begin: float, end: float, rate: float, topic: str = "/sim/markers") -> list[Said]:
    """Return marker frames."""
    frame = messages().MarkerFrame()
    return [(begin + number / rate, topic, frame) for number in range(int((end - begin) * rate))]


def diagnostics(seconds: float, node: str, level: int, message: str) -> Said:
    """Return a node's verdict on itself."""
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

    status = DiagnosticStatus(name=node, level=bytes([level]), message=message)
    return seconds, "/diagnostics", DiagnosticArray(status=[status])


def log(seconds: float, node: str, level: int, message: str) -> Said:
    """Return a line of a node's log."""
    from rcl_interfaces.msg import Log

    return seconds, "/rosout", Log(name=node, level=level, msg=message)


def heartbeats(node: str, *spans: tuple[float, float]) -> list[Said]:
    """Return the heartbeats of a node that lives in some spans of time [s]."""
    beat = messages().Heartbeat(node=node, state=1)
    return [(b + 0.2 * n, "/cell/heartbeat", beat) for b, e in spans for n in range(int((e - b) / 0.2) + 1)]


def clock(begin: float, end: float, ros_begin: float, rate: float) -> list[Said]:
    """Return a clock that runs at a rate, ten times a second."""
    from rosgraph_msgs.msg import Clock

    said = []
    for number in range(int((end - begin) * 10) + 1):
        message = Clock()
        stamp = round((ros_begin + rate * number / 10) * 1e9)
        message.clock.sec, message.clock.nanosec = divmod(stamp, 10**9)
        said.append((begin + number / 10, "/clock", message))
    return said


def belief(seconds: float, person: str, answers: int, entropy: float) -> Said:
    """Return what is believed of a person."""
    message = messages().BeliefSummary(
        profile_id=person, observations=answers, entropy=entropy, joint_names=list(JOINTS),
        mean_neutral=[0.1 * answers, 1.0], mean_weights=[1.0, 0.5 + answers], surprise=float("nan"),
    )  # fmt: skip
    return seconds, "/preferences/belief", message


def whole_cell(handovers: int = 2, person: str = "anna") -> list[Said]:
    """Return a bag's content of a cell that hands objects over, a little of everything."""
    msg = messages()
    phases = [("planning", 0.5), ("fetching", 2.0), ("presenting", 1.0), ("waiting", 1.5), ("releasing", 0.2)]
    said: list[Said] = [
        *clock(0.0, 5.0 + 8.0 * handovers, 50.0, 2.0),
        *heartbeats("sim_node", (0.0, 4.0 + 8.0 * handovers)),
    ]
    said += markers(0.5, 5.0 + 8.0 * handovers, 50.0)
    said += [state(0.6, "idle", message="waiting"), belief(0.7, person, 0, 11.0)]
    said += [diagnostics(0.4, "executive_node", 1, "missing: sim_node"), diagnostics(1.4, "executive_node", 0, "idle")]
    said += [(0.65, "/calibration/active_profile", msg.ActiveProfile(info=msg.ProfileInfo(profile_id=person)))]
    taken = 0
    for number in range(1, handovers + 1):
        begin, name, well = 8.0 * number - 6.0, ("mug", "glass")[number % 2], number % 3 != 0
        said += handover(begin, number, name, phases, well, taken)
        taken += well
        plan = msg.HandoverPlan(
            plan_id=f"p{number}", object_name=name, scheme="personal", arm="left", planning_time=0.4
        )
        said.append((begin + 0.4, "/planner/plan", plan))
        if well:
            choice = msg.GraspChoice(
                handover_id=f"h{number}", plan_id=f"p{number}", profile_id=person, object_name=name, hand="right",
                grasp_region="handle",
            )  # fmt: skip
            event = {"object_name": name, "holder": "person:right"}
            said += [(begin + 5.1, "/handover/grasp_choice", choice), belief(begin + 5.2, person, taken, 11.0 - taken)]
            said += [(begin + 3.9, "/sim/events", msg.SimulationEvent(kind="taken", **event))]
            said += [(begin + 6.5, "/sim/events", msg.SimulationEvent(kind="placed", **event))]
        else:
            said.append(log(begin + 5.0, "executive_node", 40, "nobody took it"))
    return said


def write_session(folder: Path, said: Iterable[Said] | None, closed: bool = True, **changed: Any) -> Path:
    """Write a session's folder.

    Args:
        folder: Of it.
        said: Content of its bag; None: it has none.
        closed: Whether the bag was closed.
        changed: Entries of ``session.json``.
    """
    document = {
        "format": 1,
        "command": "demo",
        "arguments": {"handovers": 2, "scheme": "personal", "out": str(folder), "recording": None},
        "began": "2026-01-31T12:00:00+00:00",
        "ended": "2026-01-31T12:01:00+00:00",
        "outcome": "ok",
        "versions": {"handover_ros": "0.1.0", "numpy": "2.4.6"},
        "commit": "abc",
        "host": "lab",
        "nodes": {"recorder_node": {"bag": f"{folder}/bag"}},
        "metrics": {"ready_s": 5.5, "dropped": 0, "planning_s": None},
        **changed,
    }
    folder.mkdir(parents=True)
    (folder / "session.json").write_text(json.dumps(document))
    for name, content in {
        "executive_node": {"robot": "baxter", "pull_threshold": 5.5},
        "recorder_node": {"bag": f"{folder}/bag", "storage": "mcap"},
    }.items():
        file = folder / "parameters" / f"{name}.yaml"
        file.parent.mkdir(exist_ok=True)
        file.write_text(json.dumps({name: {"ros__parameters": content}}))  # JSON is YAML
    for part in ("start", "end"):
        (folder / part / "beliefs").mkdir(parents=True)
    (folder / "log").mkdir()
    (folder / "log" / "planner_node.log").write_text("[INFO] [1.5] [planner_node]: ready\n")
    if said is not None:
        write_bag(folder / "bag", said, closed=closed)
    return folder
