"""``handover demo`` and ``handover up``: the graph as separate processes, and what an operator does with it."""

from __future__ import annotations

import itertools
import math
import statistics
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geometry_msgs.msg import PoseStamped
from handover_msgs.action import ExecuteHandover
from handover_msgs.srv import ResetSimulation
from rich.console import Console
from rich.table import Table
from std_msgs.msg import Header

from handover_ros.bags.reading import BAG
from handover_ros.cell.keeping import keeping
from handover_ros.cell.learning_curve import draw_learning, learning_table
from handover_ros.cell.marker_files import AUTO, matching
from handover_ros.cell.processes import NODES, RECORDER, CellProcesses, NodeLaunch, check_alive
from handover_ros.cell.report import (
    HandoverRecord,
    draw_phases,
    handover_table,
    output_folder,
    phase_table,
    write_json,
)
from handover_ros.cell.session import FAILED, INTERRUPTED, OK, Session, parameters_of
from handover_ros.cell.session_report import PAGE
from handover_ros.cell.store import default_directory
from handover_ros.errors import BadRequestError, UnknownNameError
from handover_ros.mocap.recordings import read_recording
from handover_ros.nodes.convert import WORLD, pose_message
from handover_ros.nodes.demo_calibration import calibrate_person
from handover_ros.nodes.demo_learning import Lesson
from handover_ros.nodes.operator import Interrupt, InterruptedByOperatorError, Operator, operating
from handover_ros.objects.catalogue import load_object
from handover_ros.objects.scene import load_scene
from handover_ros.planning.schemes import load_schemes
from handover_ros.preferences.strategies import STRATEGIES
from handover_ros.resources import config_directory, config_file

READY_LIMIT = 60.0  # [s] of wall time until the graph is ready; the first start compiles and converts meshes
HANDOVER_LIMIT = 240.0  # [s] of wall time for one handover
PLACE_LIMIT = 20.0  # [s] of simulated time for the person to bring the object to its goal
PROFILES = "profiles"  # folder of a demonstration's profiles, in its output folder
EXIT_FAILED = 1
EXIT_INTERRUPTED = 130


@dataclass(frozen=True)
class DemoRequest:
    """What ``handover demo`` was asked for."""

    handovers: int
    objects: tuple[str, ...]
    scheme: str
    person: str
    robot: str
    scene: str
    recording: Path | None
    marker_set: str
    speed: float
    pictures: bool
    calibrate: bool
    record: bool
    learn: str  # strategy of queries; empty: every object in turn, nothing is asked
    seed: int
    json_file: Path | None
    out: Path | None


@dataclass(frozen=True)
class UpRequest:
    """What ``handover up`` was asked for."""

    nodes: tuple[str, ...]
    person: str
    robot: str
    scene: str
    speed: float
    seed: int
    record: bool
    out: Path | None


def checked_objects(request: DemoRequest) -> tuple[str, ...]:
    """Return the objects to hand over, in turn.

    Raises:
        UnknownNameError: An object, person, robot, scene or scheme is not known, or the scene lacks the object.
    """
    config_file("people", request.person)
    config_file("robots", request.robot)
    schemes = tuple(load_schemes())
    if request.scheme not in schemes:
        raise UnknownNameError("scheme", request.scheme, schemes)
    placed = tuple(load_scene(request.scene).placements)
    if request.learn and request.learn not in STRATEGIES:
        raise UnknownNameError("strategy", request.learn, tuple(STRATEGIES))
    if request.learn and any(load_object(name).hands != 1 for name in request.objects):
        raise BadRequestError("--learn: preferences are learned from objects for one hand")
    if request.calibrate and request.recording is not None:
        raise BadRequestError("--calibrate: a recorded person cannot be asked to move; leave out --recording")
    for name in request.objects:
        load_object(name)
        if name not in placed:
            raise UnknownNameError(f"object in scene {request.scene}", name, placed)
    one_handed = tuple(name for name in placed if load_object(name).hands == 1)
    return request.objects or one_handed


def launches(
    nodes: tuple[str, ...], person: str, robot: str, scene: str, seed: int, speed: float, folder: Path
) -> dict[str, NodeLaunch]:
    """Return how to start each node of a simulated cell."""
    simulated: dict[str, object] = {"use_sim_time": "sim_node" in nodes}
    own: dict[str, dict[str, object]] = {
        "sim_node": {
            "scene": scene,
            "robot": robot,
            "person": person,
            "seed": seed,
            "realtime_factor": speed,
            "picture_directory": str(folder / "pictures"),
        },
        "planner_node": {"robot": robot, "scene": scene, **simulated},
        "executive_node": {"robot": robot, **simulated},
    }
    # Without the simulator nobody gives a clock: whatever the file says, the machine's own counts.
    return {node: NodeLaunch(node, own.get(node, simulated), config_directory() / f"{node}.yaml") for node in nodes}


def recording_parameters(request: DemoRequest) -> dict[str, object]:
    """Return the motion-capture node's parameters for a recording, after a look at it.

    Raises:
        BadRecordingError: The file cannot be read, or no marker set fits it.
    """
    assert request.recording is not None
    recording = read_recording(request.recording)
    name = matching(recording).name if request.marker_set == AUTO else request.marker_set
    return {
        "source": "recording",
        "recording": str(request.recording.resolve()),
        "marker_set": name,
        "placement": "auto",
        "loop": True,
    }


def run_demo(request: DemoRequest, console: Console, stop: threading.Event) -> int:
    """Run the demonstration and return the exit status: 0 when every object ended in the person's hand."""
    objects = checked_objects(request)
    mocap = recording_parameters(request) if request.recording is not None else {}
    folder = output_folder(request.out, "demo")
    plan = launches(NODES, request.person, request.robot, request.scene, request.seed, request.speed, folder)
    # A demonstration keeps its people to itself.
    own = {"profile_directory": str(folder / PROFILES)}
    more: dict[str, dict[str, object]] = {"calibration_node": {**own}, "preference_node": {**own, "seed": request.seed}}
    if mocap:
        more |= {"mocap_node": mocap, "sim_node": {"person_follows_torso": True}}
    for node, parameters in more.items():
        launch = plan[node]
        plan[node] = NodeLaunch(node, {**launch.parameters, **parameters}, launch.parameter_file)
    recorder = {RECORDER: recorder_launch(folder)} if request.record else {}
    session = Session.begin(folder, "demo", vars(request), [*recorder.values(), *plan.values()], folder / PROFILES)
    with keeping(session, console) as kept:
        try:
            shown = demonstrate(request, console, Interrupt(stop), folder, objects, {**recorder, **plan})
        except InterruptedByOperatorError:
            kept.outcome = INTERRUPTED
            console.print("interrupted; the nodes are stopped")
            return EXIT_INTERRUPTED
        kept.metrics, kept.outcome = shown.metrics, OK if shown.ok else FAILED
        tell(request, console, folder, shown)
    return 0 if shown.ok else EXIT_FAILED


@dataclass(frozen=True)
class Demonstrated:
    """How a demonstration went."""

    records: tuple[HandoverRecord, ...]
    metrics: dict[str, float]
    files: tuple[Path, ...]
    lesson: Lesson | None

    @property
    def ok(self) -> bool:
        """Whether every object was taken, none dropped, and no limit violated."""
        wrong = ("dropped", "joint_limit_violations", "velocity_limit_violations")
        return all(record.taken for record in self.records) and not any(self.metrics[name] for name in wrong)


def demonstrate(
    request: DemoRequest,
    console: Console,
    interrupt: Interrupt,
    folder: Path,
    objects: tuple[str, ...],
    plan: dict[str, NodeLaunch],
) -> Demonstrated:
    """Start the graph, calibrate, learn and hand over as asked, and stop it.

    Raises:
        InterruptedByOperatorError: Ctrl-C.
        HandoverError: A node ended, or the graph was not ready in time.
    """
    began = time.monotonic()
    files: list[Path] = []
    with CellProcesses(folder / "log") as processes:
        console.print(f"starting {len(plan)} nodes ...")
        for launch in plan.values():
            processes.start(launch)
        with operating(interrupt, lambda: check_alive(processes)) as operator:
            operator.wait_ready(tuple(plan), READY_LIMIT)
            ready = time.monotonic() - began
            console.print(f"the graph is ready after {ready:.1f} s")
            metrics: dict[str, float] = {"ready_s": ready}
            if request.calibrate:
                profile, figures = calibrate_person(request.person, operator, console, wait_simulated)
                metrics |= figures
                files.append(folder / PROFILES / f"{profile.profile_id}.json")
            lesson = None
            if request.learn:
                names = (request.person, request.robot, objects)
                lesson = Lesson(operator, console, *names, request.learn)
                records = list(
                    lesson.run(
                        request.handovers,
                        lambda number, name, goal: hand_over(number, name, goal, request, operator, console),
                    )
                )
                metrics |= lesson.metrics()
            else:
                records = list(hand_over_all(request, objects, operator, console))
            metrics |= measured(operator, records)
    files += dict.fromkeys(picture for record in records for picture in record.pictures)
    return Demonstrated(tuple(records), metrics, tuple(files), lesson)


def hand_over_all(
    request: DemoRequest, objects: tuple[str, ...], operator: Operator, console: Console
) -> Iterator[HandoverRecord]:
    """Run the handovers one after the other and give a record of each."""
    for number, name in zip(range(1, request.handovers + 1), itertools.cycle(objects), strict=False):
        if number > 1:
            # What was handed over goes back to its table, so that every handover starts alike.
            operator.call(ResetSimulation, "sim/reset", ResetSimulation.Request(seed=-1, objects_only=True))
        goal = ExecuteHandover.Goal(object_name=name, scheme=request.scheme)
        yield hand_over(number, name, goal, request, operator, console)[0]


def hand_over(
    number: int,
    name: str,
    goal: ExecuteHandover.Goal,
    request: DemoRequest,
    operator: Operator,
    console: Console,
) -> tuple[HandoverRecord, ExecuteHandover.Result]:
    """Run one handover, wait until the person has put the object down, and judge it by the true state."""
    pictures: list[str] = []
    events_before = len(operator.events)

    def on_phase(phase: str, message: str) -> None:
        console.print(
            f"  [dim]{number}/{request.handovers}[/dim] {phase:<10} {message}", highlight=False, soft_wrap=True
        )
        if request.pictures and phase in ("waiting", "retracting"):
            pictures.append(operator.render())

    place = load_scene(request.scene).goals.get(name)
    if place is not None:
        goal.has_goal = True
        goal.goal = PoseStamped(header=Header(frame_id=WORLD), pose=pose_message(place))
    result = operator.hand_over(goal, on_phase, HANDOVER_LIMIT)
    if not result.success:
        console.print(f"  [red]{result.message}[/red]", highlight=False, soft_wrap=True)

    def happened(*kinds: str) -> bool:
        return any(event.kind in kinds and event.object_name == name for event in operator.events[events_before:])

    # The true state: the hand held it at the end of the handover (it may have put it down already).
    taken = happened("taken") and not happened("dropped")
    if taken and place is not None:
        wait_simulated(operator, lambda: happened("placed", "dropped"), PLACE_LIMIT)
    record = HandoverRecord(
        number=number,
        object_name=name,
        scheme=result.plan.scheme or request.scheme,
        arm=result.plan.arm,
        success=result.success,
        taken=taken and not happened("dropped"),
        placed=happened("placed") and operator.holder_of(name) == "goal",
        message=result.message,
        phases=tuple(zip(result.phases, result.phase_durations, strict=True)),
        planning_time=result.plan.planning_time if result.plan.plan_id else math.nan,
        pictures=tuple(Path(picture) for picture in pictures if picture),
    )
    return record, result


def wait_simulated(operator: Operator, predicate: Callable[[], bool], limit: float) -> bool:
    """Wait for ``predicate`` at most ``limit`` [s] of simulated time; return whether it came true."""

    def now() -> float:
        stamp = operator.truth.header.stamp if operator.truth else None
        return stamp.sec + stamp.nanosec * 1e-9 if stamp else 0.0

    deadline = now() + limit
    operator.wait(lambda: predicate() or now() > deadline, 10.0 * limit, "the simulated time to pass")
    return bool(predicate())


def median(values: Iterable[float]) -> float:
    """Return the median of the finite values, NaN when there are none."""
    finite = [value for value in values if math.isfinite(value)]
    return statistics.median(finite) if finite else math.nan


def measured(operator: Operator, records: Sequence[HandoverRecord]) -> dict[str, float]:
    """Return the metrics of a demonstration."""
    truth = operator.truth
    mocap, metrics = operator.diagnostics.get("mocap_node", {}), {}
    for metric, key in (
        ("frames_read", "frames_read"),
        ("missing_fraction", "missing_fraction"),
        ("repaired_jumps", "repaired_jumps"),
        ("repaired_swaps", "repaired_swaps"),
        ("bridged_samples", "bridged_samples"),
    ):
        if key in mocap:
            value = float(mocap[key])
            metrics[metric] = int(value) if value.is_integer() and metric != "missing_fraction" else value
    factors = operator.realtime_factors
    residuals = operator.residuals
    return {
        "handovers": len(records),
        "taken": sum(record.taken for record in records),
        "placed": sum(record.placed for record in records),
        "dropped": sum(event.kind == "dropped" for event in operator.events),
        "joint_limit_violations": truth.joint_limit_violations if truth else math.nan,
        "velocity_limit_violations": truth.velocity_limit_violations if truth else math.nan,
        "realtime_factor": median(factors),
        "torso_fit_rms_mm": 1e3 * median(residuals),
        "planning_s": median(record.planning_time for record in records),
        **metrics,
    }


def tell(request: DemoRequest, console: Console, folder: Path, shown: Demonstrated) -> None:
    """Print the tables and the numbers, draw, and write the JSON."""
    files = [*shown.files, draw_phases(shown.records, folder / "phases.png")]
    lesson = shown.lesson
    if lesson is not None:
        console.print(learning_table(lesson.steps))
        files.append(draw_learning(lesson.steps, lesson.first_cost, folder / "learning.png"))
    console.print()
    console.print(handover_table(shown.records))
    console.print(phase_table(shown.records))
    numbers = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    for key, value in shown.metrics.items():
        numbers.add_row(key, f"{value:.4g}" if isinstance(value, float) else str(value))
    console.print(numbers)
    console.print(f"everything is in {folder}", highlight=False, soft_wrap=True)
    phases = [
        {
            "number": record.number,
            "object": record.object_name,
            "arm": record.arm,
            "taken": record.taken,
            "placed": record.placed,
            "message": record.message,
            "phases_s": dict(record.phases),
        }
        for record in shown.records
    ]
    files += [folder / BAG] if request.record else []
    files.append(folder / PAGE)
    for target in filter(None, (folder / "demo.json", request.json_file)):
        steps = [] if lesson is None else [step.document() for step in lesson.steps]
        more: dict[str, Any] = {"details": phases, "learning": steps, "folder": str(folder)}
        write_json(target, "demo", shown.ok, request.seed, shown.metrics, files=files, **more)


def recorder_launch(folder: Path) -> NodeLaunch:
    """Return how to start the recorder of a session."""
    return NodeLaunch(RECORDER, {"bag": str(folder / BAG)}, config_directory() / f"{RECORDER}.yaml")


def run_up(request: UpRequest, console: Console, stop: threading.Event) -> int:
    """Run the cell until it is told to stop; a node that ends is reported, the others go on."""
    if "sim_node" in request.nodes:
        config_file("people", request.person)
        load_scene(request.scene)
    config_file("robots", request.robot)
    folder = output_folder(request.out, "up")
    plan = launches(request.nodes, request.person, request.robot, request.scene, request.seed, request.speed, folder)
    if request.record:
        plan = {RECORDER: recorder_launch(folder), **plan}
    began = time.monotonic()
    given = parameters_of(plan["preference_node"]).get("profile_directory") if "preference_node" in plan else ""
    profiles = Path(str(given)).expanduser() if given else default_directory()
    session = Session.begin(folder, "up", vars(request), list(plan.values()), profiles)
    with keeping(session, console) as kept, CellProcesses(folder / "log") as processes:
        for launch in plan.values():
            processes.start(launch)
        try:
            with operating(Interrupt(stop), lambda: check_alive(processes)) as operator:
                operator.wait_ready(tuple(plan), READY_LIMIT)
        except InterruptedByOperatorError:
            kept.outcome = INTERRUPTED
            return 0
        kept.metrics = {"ready_s": time.monotonic() - began}
        console.print(f"the cell is ready after {kept.metrics['ready_s']:.1f} s; everything is in {folder}",
                      highlight=False, soft_wrap=True)  # fmt: skip
        console.print(
            "hand something over:  ros2 action send_goal /handover/execute handover_msgs/action/ExecuteHandover"
            ' "{object_name: mug}" --feedback',
            soft_wrap=True,
            highlight=False,
        )
        console.print("stop: Ctrl-C")
        while not stop.wait(0.5):
            for node in processes.ended():
                console.print(
                    f"[red]{node.launch.node} ended with status {node.status}:[/red] {node.last_line()}\n"
                    f"  start it again in another terminal: ./handover run {node.launch.node}",
                    highlight=False,
                )
        console.print("stopping ...")
        kept.outcome = OK
    return 0
