"""``handover COMMAND``: the everyday commands of the cell.

``doctor`` and ``test`` belong to the entry script ``./handover``, since they must work before anything is installed.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from handover_ros.cell.processes import EXTRA_NODES, NODES, NodeLaunch
from handover_ros.errors import HandoverError, UnknownNameError
from handover_ros.resources import config_directory

EXIT_BAD_INPUT = 2
PERSONAL = "personal"  # the scheme that needs a calibrated person
EXIT_INTERRUPTED = 130
# Newer typers carry a click of their own: this is the one in use.
USAGE_ERROR: Any = typer.BadParameter.__base__

app = typer.Typer(
    name="handover",
    help="A live handover cell: a robot hands objects to a person so that it suits that person.",
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
bag_app = typer.Typer(name="bag", help="Look at a bag, or save what is left of one.", no_args_is_help=True)
app.add_typer(bag_app)
console = Console()

JsonOption = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write the result as JSON.")]
OutOption = Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Folder of everything written.")]
SeedOption = Annotated[int, typer.Option(min=0, help="Seed of the simulation.")]
PersonOption = Annotated[str, typer.Option(help="Simulated person, a file of config/people.")]
RobotOption = Annotated[str, typer.Option(help="Robot, a file of config/robots.")]
SceneOption = Annotated[str, typer.Option(help="Scene, a file of config/scenes.")]
MarkerSetOption = Annotated[str, typer.Option(help="Marker set of the recording; auto: the one that fits.")]
RecordOption = Annotated[bool, typer.Option("--record/--no-record", help="Record everything said in the graph.")]
SpeedOption = Annotated[
    float, typer.Option(min=0.0, max=100.0, help="Simulated seconds per second; 0: as fast as the machine can.")
]


def interrupted_by_signals() -> threading.Event:
    """Return an event that SIGINT and SIGTERM set from now on."""
    event = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: event.set())
    return event


@app.command()
def demo(
    handovers: Annotated[int, typer.Option(min=1, max=1000, help="How many handovers.")] = 3,
    objects: Annotated[
        list[str] | None, typer.Option("--object", help="Object to hand over; repeat for a sequence.")
    ] = None,
    scheme: Annotated[
        str, typer.Option(help="How the handover pose is chosen, a file of config/schemes.")
    ] = "expected_cost",
    person: PersonOption = "adult",
    robot: RobotOption = "baxter",
    scene: Annotated[
        str, typer.Option(help="Scene, a file of config/scenes; default: lab, or with --learn learning.")
    ] = "",
    recording: Annotated[
        Path | None, typer.Option(metavar="FILE", help="C3D, TRC or Vicon CSV instead of the simulated cameras.")
    ] = None,
    marker_set: MarkerSetOption = "auto",
    speed: SpeedOption = 1.0,
    pictures: Annotated[bool, typer.Option(help="Render pictures of each handover.")] = True,
    calibrate: Annotated[
        bool | None,
        typer.Option(
            "--calibrate/--no-calibrate", help="Calibrate the person first; default: for scheme personal and --learn."
        ),
    ] = None,
    learn: Annotated[
        str,
        typer.Option(
            metavar="STRATEGY",
            help="Learn what the person finds comfortable; handovers are chosen by: active, active_value, passive, "
            "hybrid, random, active_grid, active_expected.",
        ),
    ] = "",
    record: RecordOption = True,
    seed: SeedOption = 1,
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Run the whole cell in simulation: hand objects over, end with a table and pictures."""
    from handover_ros.nodes.demo import DemoRequest, run_demo

    request = DemoRequest(
        handovers=handovers,
        objects=tuple(objects or ()),
        scheme=scheme,
        person=person,
        robot=robot,
        scene=scene or ("learning" if learn else "lab"),
        recording=recording,
        marker_set=marker_set,
        speed=speed,
        pictures=pictures,
        calibrate=(scheme == PERSONAL or bool(learn)) and recording is None if calibrate is None else calibrate,
        learn=learn,
        record=record,
        seed=seed,
        json_file=json_file,
        out=out,
    )
    raise typer.Exit(run_demo(request, console, interrupted_by_signals()))


@app.command()
def up(
    person: PersonOption = "adult",
    robot: RobotOption = "baxter",
    scene: SceneOption = "lab",
    speed: SpeedOption = 1.0,
    seed: SeedOption = 1,
    without: Annotated[
        list[str] | None, typer.Option(help="Node not to start, e.g. sim_node when a real robot's driver runs.")
    ] = None,
    record: RecordOption = True,
    out: OutOption = None,
) -> None:
    """Run the cell until Ctrl-C."""
    from handover_ros.nodes.demo import UpRequest, run_up

    for name in without or ():
        if name not in NODES:
            raise UnknownNameError("node", name, NODES)
    nodes = tuple(node for node in NODES if node not in (without or ()))
    request = UpRequest(
        nodes=nodes, person=person, robot=robot, scene=scene, speed=speed, seed=seed, record=record, out=out
    )
    raise typer.Exit(run_up(request, console, interrupted_by_signals()))


@app.command()
def calibrate(
    recordings: Annotated[
        list[Path], typer.Argument(metavar="RECORDING...", help="C3D, TRC or Vicon CSV of one person; joined in order.")
    ],
    template: Annotated[str, typer.Option(help="Skeleton, a file of config/skeletons; empty: the one that fits.")] = "",
    marker_set: MarkerSetOption = "auto",
    person: Annotated[str, typer.Option(help="How you call the person.")] = "",
    profile: Annotated[str, typer.Option(metavar="ID", help="Name of the profile; letters, digits, - and _.")] = "",
    store: Annotated[
        bool | None, typer.Option("--store/--no-store", help="Store the profile; default: when --profile names it.")
    ] = None,
    max_frames: Annotated[int, typer.Option(min=100, max=20000, help="Frames that enter the fit.")] = 6000,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the fit's starts.")] = 0,
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Fit a person's skeleton to recordings of calibration motions: report, picture, profile."""
    from handover_ros.cell.calibrate_command import CalibrateRequest, run_calibrate

    request = CalibrateRequest(
        recordings=tuple(recordings),
        template=template,
        marker_set=marker_set,
        person=person,
        profile_id=profile,
        store=store,
        max_frames=max_frames,
        seed=seed,
        json_file=json_file,
        out=out,
    )
    raise typer.Exit(run_calibrate(request, console))


@app.command()
def track(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="C3D, TRC or Vicon CSV.")],
    profile: Annotated[str, typer.Option(metavar="ID|FILE", help="Stored profile, or a profile's file.")] = "",
    marker_set: MarkerSetOption = "auto",
    smooth: Annotated[bool, typer.Option("--smooth", help="Use the frames after each frame too.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Written into the JSON; tracking draws no random numbers.")] = 0,
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Track a person in a recording with their profile: displacements as CSV, picture, numbers."""
    from handover_ros.cell.track_command import TrackRequest, run_track

    request = TrackRequest(
        recording=recording,
        profile=profile,
        marker_set=marker_set,
        smooth=smooth,
        seed=seed,
        json_file=json_file,
        out=out,
    )
    raise typer.Exit(run_track(request, console))


@app.command()
def plan(
    object_name: Annotated[str, typer.Argument(metavar="OBJECT", help="What to hand over, a file of config/objects.")],
    scheme: Annotated[str, typer.Option(help="How the pose is chosen, a file of config/schemes.")] = "expected_cost",
    person: Annotated[str, typer.Option(help="Who stands there, a file of config/people.")] = "adult",
    profile: Annotated[str, typer.Option(metavar="ID|FILE", help="Stored profile, or a profile's file.")] = "",
    person_model: Annotated[
        str, typer.Option(metavar="MN|MP|GN|GP", help="How the person chooses; default: the scheme's.")
    ] = "",
    goal: Annotated[
        tuple[float, float, float, float, float, float] | None,
        typer.Option(metavar="X Y Z ROLL PITCH YAW", help="Where the person brings it [m, rad]; default: the scene's."),
    ] = None,
    no_goal: Annotated[bool, typer.Option("--no-goal", help="The person brings it nowhere.")] = False,
    arm: Annotated[str, typer.Option(help="Arm of the robot; default: the one that suits.")] = "",
    scene: SceneOption = "lab",
    robot: RobotOption = "baxter",
    budget: Annotated[float, typer.Option(min=0.0, help="Seconds for one plan; 0: the planner's default.")] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the searches for motions.")] = 0,
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Plan one handover without a graph: likely grasps, what other schemes would give, picture."""
    from handover_ros.cell.plan_command import PlanRequest, run_plan

    request = PlanRequest(
        object_name=object_name,
        scheme=scheme,
        person=person,
        profile=profile,
        person_model=person_model,
        goal=goal,
        no_goal=no_goal,
        arm=arm,
        scene=scene,
        robot=robot,
        budget=budget,
        seed=seed,
        json_file=json_file,
        out=out,
    )
    raise typer.Exit(run_plan(request, console))


@app.command()
def objects(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME...]", help="Files of config/objects; default: all.")
    ] = None,
    robot: RobotOption = "baxter",
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Draw objects with the grasps of a hand and of the gripper: one picture an object."""
    from handover_ros.cell.objects_command import ObjectsRequest, run_objects

    request = ObjectsRequest(names=tuple(names or ()), robot=robot, json_file=json_file, out=out)
    raise typer.Exit(run_objects(request, console))


@app.command()
def study(
    name: Annotated[str, typer.Argument(metavar="STUDY", help="chapter2, chapter3, chapter4, beyond or all.")],
    quick: Annotated[bool, typer.Option("--quick", help="Fewer people and particles.")] = False,
    jobs: Annotated[int, typer.Option(min=1, max=256, help="Processes; the numbers are the same for any.")] = 2,
    seed: Annotated[int, typer.Option(min=0, help="Seed of people, menus and answers.")] = 1,
    json_file: JsonOption = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Folder of everything; an interrupted run goes on there."),
    ] = None,
) -> None:
    """Repeat the dissertation's experiments in simulation: tables, figures, and a verdict for every claim."""
    from handover_ros.studies.study_command import StudyRequest, run_study

    request = StudyRequest(name=name, quick=quick, jobs=jobs, seed=seed, json_file=json_file, out=out)
    raise typer.Exit(run_study(request, console))


@app.command()
def record(
    topics: Annotated[
        list[str] | None,
        typer.Argument(metavar="[TOPIC...]", help="Names or regular expressions; default: everything."),
    ] = None,
    bag: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder of the bag; must not exist.")] = None,
    storage: Annotated[str, typer.Option(help="mcap or sqlite3.")] = "mcap",
    exclude: Annotated[
        list[str] | None, typer.Option(metavar="TOPIC", help="What is left out; may be repeated.")
    ] = None,
) -> None:
    """Record what is said in the graph as a rosbag2 bag, until Ctrl-C."""
    given = {
        "bag": str(bag or ""),
        "storage": storage,
        "topics": " ".join(topics or ()),
        "exclude": " ".join(exclude or ()),
    }
    launch = NodeLaunch("recorder_node", given, config_directory() / "recorder_node.yaml")
    os.execv(sys.executable, launch.command())


@app.command()
def replay(
    bag: Annotated[Path, typer.Argument(metavar="BAG", help="Folder of a bag or of a session, or a file.")],
    node: Annotated[
        list[str] | None,
        typer.Option(help="Node to drive; may be repeated; default: those the bag has the inputs of."),
    ] = None,
    start_nodes: Annotated[
        bool, typer.Option("--start-nodes/--no-start-nodes", help="Start them; or play to nodes that run already.")
    ] = True,
    speed: Annotated[float, typer.Option(min=0.01, max=100.0, help="Recorded seconds per second.")] = 1.0,
    start: Annotated[float, typer.Option(min=0.0, help="Where to begin [s].")] = 0.0,
    duration: Annotated[float, typer.Option(min=0.0, help="How long [s]; 0: to the end.")] = 0.0,
    expect_same: Annotated[
        bool,
        typer.Option("--expect-same", help="End with status 1 unless states and beliefs are the same, bit for bit."),
    ] = False,
    topic: Annotated[
        list[str] | None, typer.Option(help="What is played, name or pattern; default: all but commands.")
    ] = None,
    exclude: Annotated[
        list[str] | None, typer.Option(metavar="TOPIC", help="What is left out; may be repeated.")
    ] = None,
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Drive the real nodes with a bag and hold what they give against what was recorded."""
    from handover_ros.nodes.replay import ReplayRequest, run_replay

    request = ReplayRequest(
        bag=bag,
        nodes=tuple(node or ()),
        start_nodes=start_nodes,
        speed=speed,
        start=start,
        duration=duration,
        expect_same=expect_same,
        topics=tuple(topic or ()),
        exclude=tuple(exclude or ()),
        json_file=json_file,
        out=out,
    )
    raise typer.Exit(run_replay(request, console, interrupted_by_signals()))


@app.command()
def compare(
    first: Annotated[Path, typer.Argument(metavar="SESSION", help="Folder that demo or up wrote.")],
    second: Annotated[Path, typer.Argument(metavar="SESSION", help="Another one.")],
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Hold two sessions side by side: versions, parameters, handovers, beliefs, numbers, and a picture of both."""
    from handover_ros.cell.compare_command import CompareRequest, run_compare

    raise typer.Exit(run_compare(CompareRequest(first=first, second=second, json_file=json_file, out=out), console))


BagArgument = Annotated[Path, typer.Argument(metavar="BAG", help="Folder of a bag or of a session, or a file.")]


@bag_app.command("info")
def bag_info(bag: BagArgument, json_file: JsonOption = None, out: OutOption = None) -> None:
    """Say what is in a bag and what happened in it, with a picture of its timeline."""
    from handover_ros.cell.bag_command import BagInfoRequest, run_bag_info

    raise typer.Exit(run_bag_info(BagInfoRequest(bag=bag, json_file=json_file, out=out), console))


@bag_app.command("rescue")
def bag_rescue(
    bag: BagArgument,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FOLDER", help="Of the new bag; default: BAG_rescued.")
    ] = None,
) -> None:
    """Make a whole bag of one that was cut short or whose recorder was killed."""
    from handover_ros.cell.bag_command import BagRescueRequest, run_bag_rescue

    raise typer.Exit(run_bag_rescue(BagRescueRequest(bag=bag, out=out), console))


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True})
def run(
    context: typer.Context,
    node: Annotated[str, typer.Argument(help=f"One of {', '.join((*NODES, *EXTRA_NODES))}.")],
) -> None:
    """Run one node; arguments after it go to ROS, e.g. --ros-args -p marker_set:=upper_body_24."""
    if node not in (*NODES, *EXTRA_NODES):
        raise UnknownNameError("node", node, (*NODES, *EXTRA_NODES))
    arguments = list(context.args)
    parameter_file = config_directory() / f"{node}.yaml"
    if "--params-file" not in arguments and parameter_file.is_file():
        # First, so that -p overrides win.
        arguments = ["--ros-args", "--params-file", str(parameter_file), *arguments]
    os.execv(sys.executable, [sys.executable, "-m", f"handover_ros.nodes.{node}", *arguments])


def guarded(command: Callable[[], object]) -> int:
    """Run a command and return its exit status; what the user can mend becomes one line on standard error."""
    try:
        result = command()
    except HandoverError as error:
        return complain(str(error))
    except USAGE_ERROR as error:
        return complain(error.format_message())
    except (typer.Abort, KeyboardInterrupt):
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        return 0
    return result if isinstance(result, int) else 0


def complain(message: str) -> int:
    """Print one line on standard error and return the exit status of bad input."""
    print(f"error: {' '.join(message.split())}", file=sys.stderr)
    return EXIT_BAD_INPUT


def main() -> None:
    """Entry point of ``handover``."""
    sys.exit(guarded(lambda: app(standalone_mode=False, prog_name="./handover")))


if __name__ == "__main__":
    main()
