"""``sim_node``: the MuJoCo cell that stands in for robot, person and motion capture; owns ``/clock``."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from handover_msgs.msg import (
    GripperCommand,
    GripperState,
    MarkerFrame,
    MarkerSet,
    ObjectStates,
    SimulationEvent,
    SimulationTruth,
    SkeletonState,
)
from handover_msgs.srv import ResetSimulation, SetPersonBehaviour, SetSimulationFault
from rclpy.callback_groups import ReentrantCallbackGroup
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from handover_ros.errors import BadRequestError, HandoverError
from handover_ros.nodes.convert import (
    image_message,
    picture_from_image,
    stamp_from_seconds,
    trajectory_arrays,
    transform_from_message,
)
from handover_ros.nodes.convert_human import marker_set_message
from handover_ros.nodes.convert_simulation import (
    event_message,
    fill_truth,
    gripper_state_message,
    joint_state_message,
    marker_frame_message,
    object_states_message,
)
from handover_ros.nodes.parameters import ParameterSpec
from handover_ros.nodes.runtime import (
    LATCHED,
    RECORDER,
    SENSOR_CONSUMER,
    SENSOR_PUBLISHER,
    STREAM_PUBLISHER,
    HandoverNode,
    Worker,
    answer,
    main_of,
)
from handover_ros.objects.scene import load_scene
from handover_ros.sim.artist import Artist
from handover_ros.sim.options import SimulationOptions
from handover_ros.sim.person_spec import MARKER_SET, MARKERS
from handover_ros.sim.render import Picture, save_picture
from handover_ros.sim.runner import SimulationRunner
from handover_ros.sim.simulation import Simulation

FRAME = "world"
STATE_RATE = 100.0  # [Hz] of simulated time: clock, joints, grippers
OBJECT_RATE = 50.0  # [Hz] objects and truth
SILENCE = 0.5  # [s] of wall time without robot/enable before the robot holds
TORSO_SILENCE = 1.0  # [s] of wall time without a tracked torso before the person stands by itself again
ANSWER_LIMIT = 20.0  # [s] of wall time for a service's work; a first picture takes a few

PARAMETERS = (
    ParameterSpec("scene", "lab", "scene, as in config/scenes"),
    ParameterSpec("robot", "", "robot, as in config/robots; empty: the scene's"),
    ParameterSpec("person", "", "person, as in config/people; empty: the scene's; none: nobody"),
    ParameterSpec("seed", 1, "seed of all random numbers", 0, 2**31 - 1),
    ParameterSpec(
        "realtime_factor", 1.0, "simulated seconds per second; 0: as fast as possible", 0.0, 100.0, (), False
    ),
    ParameterSpec("start_time", -1.0, "[s] of the clock at the start; negative: the wall clock's", -1.0, 1e10),
    ParameterSpec("physics_rate", 500.0, "[Hz] physics steps, a multiple of 100", 300.0, 2000.0),
    ParameterSpec("mocap_rate", 240.0, "[Hz] marker frames", 50.0, 480.0),
    ParameterSpec("marker_noise", 0.0005, "[m] standard deviation of marker positions", 0.0, 0.05),
    ParameterSpec("occlusion", 0.0, "share of marker samples lost at random, besides line of sight", 0.0, 1.0),
    ParameterSpec("image_rate", 0.0, "[Hz] of simulated time of sim/image; 0: none", 0.0, 60.0, (), False),
    ParameterSpec("image_size", [640, 360], "width and height of sim/image [pixels]", 16, 1280),
    ParameterSpec("picture_directory", "handover_out/pictures", "folder of the pictures of sim/render"),
    ParameterSpec("picture_size", [1280, 720], "width and height of the pictures [pixels]", 16, 1280),
    ParameterSpec("camera", "overview", "camera of the scene for pictures and images", read_only=False),
    ParameterSpec("person_follows_torso", False, "the person's torso follows human/skeleton_state"),
)


class SimNode(HandoverNode):
    """Publishes what a real cell would, and takes the commands a real robot would."""

    def __init__(self) -> None:
        super().__init__("sim_node", PARAMETERS)
        parameters = self.parameters
        start = parameters["start_time"]
        options = SimulationOptions(
            robot=parameters["robot"],
            person=parameters["person"],
            physics_rate=parameters["physics_rate"],
            mocap_rate=parameters["mocap_rate"],
            marker_noise=parameters["marker_noise"],
            occlusion_fraction=parameters["occlusion"],
            start_time=time.time() if start < 0.0 else start,
        )
        for name in ("image_size", "picture_size"):
            if len(parameters[name]) != 2:
                raise BadRequestError(f"sim_node: parameter {name}: needs width and height, got {parameters[name]}")
        simulation = Simulation(load_scene(parameters["scene"]), parameters["seed"], options)
        if parameters["camera"] not in [camera.name for camera in simulation.scene.cameras]:
            known = ", ".join(camera.name for camera in simulation.scene.cameras)
            raise BadRequestError(f"sim_node: parameter camera: no camera {parameters['camera']!r}; known: {known}")
        self.image_rate, self.camera = parameters["image_rate"], parameters["camera"]
        self.artist = Artist(simulation.world)
        self.drawing: Future[Picture] | None = None
        self.pictures = 0
        self.refused = 0
        self.last_enable = -SILENCE
        self.last_torso = -TORSO_SILENCE
        self.follows_torso = False
        self.runner = SimulationRunner(simulation, parameters["realtime_factor"], self.after_slice)
        self.due = dict.fromkeys(("state", "objects", "image"), simulation.time)

        self.clock_publisher = self.create_publisher(Clock, "/clock", STREAM_PUBLISHER)
        self.marker_publisher = self.create_publisher(MarkerFrame, "sim/markers", STREAM_PUBLISHER)
        self.set_publisher = self.create_publisher(MarkerSet, "sim/marker_set", LATCHED)
        self.joint_publisher = self.create_publisher(JointState, "robot/joint_states", STREAM_PUBLISHER)
        self.gripper_publisher = self.create_publisher(GripperState, "robot/gripper_state", STREAM_PUBLISHER)
        self.object_publisher = self.create_publisher(ObjectStates, "objects/states", STREAM_PUBLISHER)
        self.truth_publisher = self.create_publisher(SimulationTruth, "sim/truth", STREAM_PUBLISHER)
        self.event_publisher = self.create_publisher(SimulationEvent, "sim/events", RECORDER)
        self.image_publisher = self.create_publisher(Image, "sim/image", SENSOR_PUBLISHER)

        self.create_subscription(JointTrajectory, "robot/joint_trajectory", self.on_trajectory, SENSOR_PUBLISHER)
        self.create_subscription(GripperCommand, "robot/gripper_command", self.on_gripper, SENSOR_PUBLISHER)
        self.create_subscription(Bool, "robot/enable", self.on_enable, SENSOR_PUBLISHER)
        self.create_subscription(Image, "robot/display", self.on_display, LATCHED)
        if parameters["person_follows_torso"]:
            self.create_subscription(SkeletonState, "human/skeleton_state", self.on_torso, SENSOR_CONSUMER)

        self.worker = Worker(self)
        # A group of their own: while they wait, the answers they wait for must get through.
        waiting = ReentrantCallbackGroup()
        self.create_service(SetSimulationFault, "sim/set_fault", self.on_set_fault, callback_group=waiting)
        self.create_service(SetPersonBehaviour, "sim/set_person", self.on_set_person, callback_group=waiting)
        self.create_service(Trigger, "sim/render", self.on_render, callback_group=waiting)
        self.parameters.on_change(self.apply_parameters)
        self.publish_marker_set(simulation)
        self.crash_guard = self.create_guard_condition(self.raise_crash)
        self.runner.start()
        # Last: its presence says that the cell runs.
        self.create_service(ResetSimulation, "sim/reset", self.on_reset, callback_group=waiting)
        self.artist.prepare(tuple(parameters["picture_size"]))
        self.ready(f"simulating scene {parameters['scene']}")

    # In the simulation's thread

    def after_slice(self, simulation: Simulation) -> None:
        """Publish what is due; stop the robot when nobody enables it."""
        now = time.monotonic()
        simulation.enable(now - self.last_enable <= SILENCE)
        if self.follows_torso and now - self.last_torso > TORSO_SILENCE:
            self.follows_torso = False
            simulation.set_torso_target(None)
        stamp = stamp_from_seconds(simulation.time)
        for captured_at, frame in simulation.frames():
            self.marker_publisher.publish(marker_frame_message(captured_at, frame, FRAME))
        if self.is_due("state", simulation.time, STATE_RATE):
            self.clock_publisher.publish(Clock(clock=stamp))
            self.joint_publisher.publish(joint_state_message(stamp, simulation.joint_state()))
            self.gripper_publisher.publish(gripper_state_message(stamp, simulation.gripper_state()))
        if self.is_due("objects", simulation.time, OBJECT_RATE):
            self.object_publisher.publish(object_states_message(stamp, simulation.object_poses(), FRAME))
            truth = SimulationTruth(realtime_factor=float(self.runner.realtime_factor))
            fill_truth(truth, simulation.truth(), FRAME)
            self.truth_publisher.publish(truth)
        for event in simulation.events():
            self.event_publisher.publish(event_message(event, FRAME))
            self.get_logger().info(f"{event.kind}: {event.message}")
        if self.image_rate > 0.0 and self.is_due("image", simulation.time, self.image_rate):
            self.publish_image(simulation)

    def is_due(self, what: str, now: float, rate: float) -> bool:
        """Return whether something is to be published now, at a rate [Hz] of simulated time."""
        if now < self.due[what] - 1e-9:
            return False
        self.due[what] = max(self.due[what] + 1.0 / rate, now - 1.0 / rate)
        return True

    def publish_image(self, simulation: Simulation) -> None:
        """Have ``sim/image`` drawn and published; when the last one is not ready yet, leave this one out."""
        if self.drawing is not None and not self.drawing.done():
            return
        captured_at = simulation.time
        self.drawing = self.artist.draw(simulation.snapshot(), self.camera, tuple(self.parameters["image_size"]))
        self.drawing.add_done_callback(lambda drawn: self.publish_drawn(drawn, captured_at))

    def publish_drawn(self, drawn: Future[Picture], captured_at: float) -> None:
        """Publish a finished image; without OpenGL say so once and go on without."""
        if drawn.cancelled() or not self.context.ok():
            return
        error = drawn.exception()
        if error is not None:
            self.image_rate = 0.0
            self.degraded(f"sim/image is off: {error}")
            return
        message = image_message(drawn.result(), self.camera)
        message.header.stamp = stamp_from_seconds(captured_at)
        self.image_publisher.publish(message)

    # In a thread of the worker

    def take_picture(self) -> Path:
        """Write a picture of the cell and return its file."""
        snapshot = self.runner.call(Simulation.snapshot, ANSWER_LIMIT)
        self.pictures += 1
        folder = Path(self.parameters["picture_directory"]).resolve()
        path = folder / f"{self.camera}_{self.pictures:03d}.png"
        save_picture(self.artist.draw(snapshot, self.camera, tuple(self.parameters["picture_size"])).result(), path)
        return path

    # In the executor's thread

    def publish_marker_set(self, simulation: Simulation) -> None:
        """Name the markers, when there is somebody to carry them."""
        person = simulation.world.person
        if person is None:
            return
        segments = tuple(person.markers[label].segment for label in MARKERS)
        message = marker_set_message(MARKER_SET, MARKERS, segments, self.parameters["mocap_rate"], FRAME, 1)
        message.header.stamp = stamp_from_seconds(simulation.time)
        self.set_publisher.publish(message)

    def command(self, function: Callable[[Simulation], object]) -> None:
        """Give a command to the simulation; when it is refused, say so in one line and in an event."""
        self.runner.submit(function).add_done_callback(self.note_refusal)

    def note_refusal(self, done: Future) -> None:
        """Report a refused command; any other error is the node's own and ends it."""
        error = done.exception()
        if isinstance(error, HandoverError):
            self.refuse(str(error))
        elif error is not None:
            self.runner.error = error
            self.crash_guard.trigger()

    def refuse(self, reason: str) -> None:
        """Report a refused message."""
        self.refused += 1
        self.runner.submit(lambda simulation: simulation.report("fault", f"refused: {reason}"))

    def on_trajectory(self, message: JointTrajectory) -> None:
        """Let the robot follow a joint trajectory."""
        try:
            trajectory = trajectory_arrays(message)
        except HandoverError as error:
            self.refuse(str(error))
            return
        self.command(lambda simulation: simulation.command_trajectory(*trajectory))

    def on_gripper(self, message: GripperCommand) -> None:
        """Move a gripper."""
        self.command(lambda simulation: simulation.command_gripper(message.arm, message.opening, message.max_force))

    def on_enable(self, message: Bool) -> None:
        """Note that the robot may move, or may not."""
        self.last_enable = time.monotonic() if message.data else -SILENCE

    def on_display(self, message: Image) -> None:
        """Show a picture on the robot's head."""
        try:
            picture = picture_from_image(message)
        except HandoverError as error:
            self.refuse(f"robot/display: {error}")
            return
        self.artist.show_on_display(picture.copy())

    def on_torso(self, message: SkeletonState) -> None:
        """Let the simulated person's torso follow the tracked one."""
        if not message.valid:
            return
        try:
            torso = transform_from_message(message.torso.pose, "human/skeleton_state: torso")
        except HandoverError as error:
            self.refuse(str(error))
            return
        self.last_torso, self.follows_torso = time.monotonic(), True
        self.command(lambda simulation: simulation.set_torso_target(torso))

    async def on_reset(
        self, request: ResetSimulation.Request, response: ResetSimulation.Response
    ) -> ResetSimulation.Response:
        """Put the cell back to its start."""

        async def work() -> None:
            seed = None if request.seed < 0 else int(request.seed)
            await self.simulated(lambda simulation: simulation.reset(seed, request.objects_only))
            response.success = True
            response.message = (
                "objects are back in their places" if request.objects_only else "the cell is at its start"
            )

        return await answer(response, work(), self)

    async def on_set_fault(
        self, request: SetSimulationFault.Request, response: SetSimulationFault.Response
    ) -> SetSimulationFault.Response:
        """Disturb the motion capture."""

        async def work() -> None:
            arguments = (request.kind, request.magnitude, request.duration)
            await self.simulated(lambda simulation: simulation.set_fault(*arguments))
            response.success, response.message = True, f"fault {request.kind} is set"

        return await answer(response, work(), self)

    async def on_set_person(
        self, request: SetPersonBehaviour.Request, response: SetPersonBehaviour.Response
    ) -> SetPersonBehaviour.Response:
        """Tell the person what to do."""

        async def work() -> None:
            behaviour, motion = request.behaviour, request.motion
            duration = await self.simulated(lambda simulation: simulation.set_behaviour(behaviour, motion))
            response.duration = float(duration)
            response.success, response.message = True, f"the person's behaviour is {behaviour}"

        return await answer(response, work(), self)

    async def on_render(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Draw a picture into the folder of pictures."""
        try:
            response.message = str(await self.worker.submit(self.take_picture))
            response.success = True
        except HandoverError as error:
            response.success, response.message = False, str(error)
        return response

    async def simulated(self, function: Callable[[Simulation], Any]) -> Any:
        """Await what ``function`` returns, called in the simulation's thread."""
        return await self.worker.submit(self.runner.call, function, ANSWER_LIMIT)

    def apply_parameters(self) -> None:
        """Take over the parameters that may change while the node runs."""
        self.runner.pace = self.parameters["realtime_factor"]
        self.image_rate, self.camera = self.parameters["image_rate"], self.parameters["camera"]

    def raise_crash(self) -> None:
        """End the node when the simulation ended by an error."""
        if self.runner.error is not None:
            raise self.runner.error

    def diagnose(self) -> tuple[bool, str, dict[str, object]]:
        """Return pace and refused commands."""
        if self.runner.error is not None:
            self.crash_guard.trigger()
        pace, factor = self.runner.pace, self.runner.realtime_factor
        values = {
            "realtime_factor": factor,
            "longest_slice_ms": 1e3 * self.runner.longest_slice,
            "refused_messages": self.refused,
            "pictures": self.pictures,
        }
        self.runner.longest_slice = 0.0
        slow = pace > 0.0 and 0.0 < factor < 0.9 * pace
        line = f"{factor:.2f} times real time" + (f", slower than the {pace:g} asked for" if slow else "")
        return not slow, line, values

    def on_stop(self) -> None:
        """Stop the simulation and free the graphics memory."""
        self.runner.stop()
        self.artist.close()


main = main_of(SimNode)

if __name__ == "__main__":
    main()
