"""Runs one handover at a time: fetch, "Please wait", present, "Ready?", wait, release, retract."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from datetime import datetime, timezone

import numpy as np
from handover_msgs.action import ExecuteHandover
from handover_msgs.msg import (
    CellState,
    GraspChoice,
    GripperCommand,
    HandoverPlan,
    Heartbeat,
)
from handover_msgs.srv import PlanHandover, PlanMotion
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future
from sensor_msgs.msg import Image
from std_msgs.msg import Bool
from trajectory_msgs.msg import JointTrajectory

from handover_ros.cell.display import text_picture
from handover_ros.cell.protocol import HandoverProtocol
from handover_ros.cell.protocol_types import (
    Command,
    Follow,
    MoveGripper,
    Observation,
    Phase,
    ProtocolSettings,
    ReleasePolicy,
    RequestPlan,
    RequestReturn,
    Show,
    Stop,
)
from handover_ros.cell.safety import LivenessMonitor
from handover_ros.cell.touch import PullDetector
from handover_ros.errors import ErrorCode, HandoverError, StaleDataError
from handover_ros.nodes.convert import (
    image_message,
    plan_from_message,
    stage_from_message,
    trajectory_message,
)
from handover_ros.nodes.executive_view import ExecutiveView
from handover_ros.nodes.parameters import ParameterSpec
from handover_ros.nodes.runtime import (
    DISCOVERY_LIMIT,
    LATCHED,
    POLL_PERIOD,
    SENSOR_PUBLISHER,
    HandoverNode,
    main_of,
    monotonic,
)
from handover_ros.nodes.scheduling import PRIORITY, come_first
from handover_ros.robot.model import RobotModel

RESULT_TIMEOUT = 60  # [s] for which the result of a handover can be asked for
RATE = 50.0  # [Hz] of wall time at which the protocol is stepped
ENABLE_PERIOD = 0.1  # [s] of wall time between two signs of life to the robot
FEEDBACK_PERIOD = 0.2  # [s] of wall time
STOPPED_TIME = 0.5  # [s] of wall time the robot is told to stop before a way back may move it again
JUMP_BACK = 0.5  # [s] the clock may go back without being called a jump
NODE_WAIT = 5.0  # [s] of wall time after the goal in which a node not heard so far may still come up
HANDS_MATTER = (Phase.PRESENTING, Phase.WAITING, Phase.RELEASING, Phase.RETRACTING)
BASELINE_SAMPLES = 30  # joint states that settle what "no pull" feels like

PARAMETERS = (
    ParameterSpec("robot", "baxter", "robot description in config/robots"),
    ParameterSpec("scheme", "relative", "default scheme when a goal names none", read_only=False),
    ParameterSpec(
        "release_policy",
        "grasp",
        "let go when the person's pull is felt (grasp), after ready_time (timer), or at the first of both (either)",
        choices=tuple(policy.value for policy in ReleasePolicy),
        read_only=False,
    ),
    ParameterSpec("ready_time", 2.0, "[s] of 'Ready?' before a timed release", 0.1, 60.0, read_only=False),
    ParameterSpec("take_limit", 15.0, "[s] without a grasp until the object goes back", 1.0, 600.0, read_only=False),
    ParameterSpec("pull_threshold", 4.0, "[N] change of force at the gripper that is a pull", 0.5, 50.0),
    ParameterSpec("gripper_force", 30.0, "[N] closing force", 1.0, 100.0),
    ParameterSpec(
        "required_nodes",
        ["sim_node", "mocap_node", "skeleton_node", "planner_node"],
        "nodes whose silence ends a handover (sim_node: the robot's driver)",
    ),
    ParameterSpec("lost_after", 1.5, "[s] of wall time without a heartbeat after which a node is lost", 0.5, 10.0),
    replace(PRIORITY, default=5),  # below the streams
)


@dataclass
class Run:
    """The handover under way."""

    handover_id: str
    goal: ServerGoalHandle
    protocol: HandoverProtocol
    done: Future
    began: float  # [s] steady wall time
    awaited: set[str]  # required nodes that were silent when the goal came
    plan: HandoverPlan | None = None
    last_feedback: float = 0.0
    last_phase: Phase | None = None
    cancelled: bool = False


class ExecutiveNode(HandoverNode):
    """Action ``handover/execute``; commands the robot, watches the graph."""

    def __init__(self) -> None:
        super().__init__("executive_node", PARAMETERS)
        self.robot = RobotModel.load(self.parameters["robot"])
        self.liveness = LivenessMonitor(tuple(self.parameters["required_nodes"]), self.parameters["lost_after"])
        pull = PullDetector(self.parameters["pull_threshold"], BASELINE_SAMPLES)
        self.view = ExecutiveView(self, self.robot, pull)
        self.run: Run | None = None
        self.numbers = itertools.count(1)
        self.handovers, self.taken = 0, 0
        self.limited: dict[str, str] = {}  # node -> what limits it, as it says itself
        self.said = CellState(phase="idle")
        self.last_time = 0.0
        self.stopped_until = float("-inf")
        self.last_enable = 0.0

        self.trajectory_publisher = self.create_publisher(JointTrajectory, "robot/joint_trajectory", SENSOR_PUBLISHER)
        self.gripper_publisher = self.create_publisher(GripperCommand, "robot/gripper_command", SENSOR_PUBLISHER)
        self.enable_publisher = self.create_publisher(Bool, "robot/enable", SENSOR_PUBLISHER)
        self.display_publisher = self.create_publisher(Image, "robot/display", LATCHED)
        self.state_publisher = self.create_publisher(CellState, "cell/state", LATCHED)
        self.choice_publisher = self.create_publisher(GraspChoice, "handover/grasp_choice", SENSOR_PUBLISHER)

        self.create_subscription(Heartbeat, "cell/heartbeat", self.on_heartbeat, SENSOR_PUBLISHER)

        awaiting = ReentrantCallbackGroup()
        self.plan_client = self.create_client(PlanHandover, "planner/plan_handover", callback_group=awaiting)
        self.motion_client = self.create_client(PlanMotion, "planner/plan_motion", callback_group=awaiting)
        self.create_timer(1.0 / RATE, self.tick, clock=self.steady_clock)
        self.show("Ready when you are")
        self.publish_state("idle", "waiting for a handover/execute goal")
        self.action_server = ActionServer(
            self,
            ExecuteHandover,
            "handover/execute",
            execute_callback=self.execute,
            goal_callback=lambda _: GoalResponse.ACCEPT,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=awaiting,
            result_timeout=RESULT_TIMEOUT,
        )
        self.scheduling = come_first(self.parameters["realtime_priority"])
        self.ready("ready for handovers")

    # What is observed

    def on_heartbeat(self, message: Heartbeat) -> None:
        """Note a sign of life, and how the node is."""
        self.liveness.beat(message.node, monotonic())
        limited = "" if message.state == Heartbeat.READY else message.summary or "starting"
        if limited != self.limited.get(message.node, ""):
            self.limited[message.node] = limited
            self.publish_state(self.said.phase, self.said.message, self.run)

    def problems(self) -> list[str]:
        """Return what is wrong or limited in the cell, a sentence a node."""
        silent = {node: "no heartbeat" for node in self.liveness.missing(monotonic())}
        limited = {node: words for node, words in self.limited.items() if words and node not in silent}
        return [f"{node}: {words}" for node, words in sorted({**limited, **silent}.items())]

    def trouble(self, run: Run, now: float, wall: float) -> tuple[str, ErrorCode]:
        """Return why the handover cannot go on, if so: a node that does not beat, old data, a clock that jumped."""
        silent = set(self.liveness.missing(wall))
        # Nodes that were silent when the goal came (just being started) get a moment to be heard.
        run.awaited &= silent
        if gone := sorted(silent - run.awaited):
            return f"lost {', '.join(gone)}: no heartbeat for {self.liveness.lost_after:g} s", ErrorCode.NODE_LOST
        if run.awaited and wall - run.began > NODE_WAIT:
            return f"not running: {', '.join(sorted(run.awaited))}; start it and try again", ErrorCode.NODE_LOST
        fresh_start = run.protocol.phase is Phase.PLANNING and wall - run.began <= NODE_WAIT
        if not fresh_start and (problem := self.view.robot_state.problem(wall)):
            return problem, ErrorCode.STALE_DATA
        if now < self.last_time - JUMP_BACK:
            return f"the clock jumped back by {self.last_time - now:.1f} s", ErrorCode.STALE_DATA
        return "", ErrorCode.NONE

    def observe(self, run: Run) -> Observation:
        """Return what the protocol needs to know now."""
        now, wall = self.seconds_now(), monotonic()
        trouble, code = self.trouble(run, now, wall)
        self.last_time = now
        arm = run.plan.arm if run.plan else ""
        positions, velocities, state_time = self.view.joints.get(arm, (np.empty(0), np.empty(0), float("nan")))
        opening, gripping = self.view.grippers.get(arm, (float("nan"), False))
        name = run.protocol.object_name
        pose = self.view.objects.get(name)
        return Observation(
            time=now,
            positions=positions,
            velocities=velocities,
            state_time=state_time,
            gripping=gripping,
            opening=opening,
            pulled=self.view.pulled,
            object_height=float(pose[2]) if pose is not None else float("nan"),
            hand_distance=self.view.hand_distance(name),
            trouble=trouble,
            trouble_code=code,
        )

    # The action

    async def execute(self, goal: ServerGoalHandle) -> ExecuteHandover.Result:
        """Run one handover; a second goal meanwhile is answered BUSY."""
        request = goal.request
        if self.run is not None:
            goal.abort()
            busy = f"busy with handover {self.run.handover_id} of {self.run.protocol.object_name}"
            return ExecuteHandover.Result(success=False, error_code=int(ErrorCode.BUSY), message=busy)
        now = self.seconds_now()
        settings = ProtocolSettings(
            release_policy=ReleasePolicy(self.parameters["release_policy"]),
            ready_time=self.parameters["ready_time"],
            take_limit=self.parameters["take_limit"],
        )
        # Unlike any of another day too: an answer is counted once for each name.
        handover_id = f"{datetime.now(timezone.utc):%Y%m%dT%H%M%S}-{now:.3f}-{next(self.numbers)}"
        protocol, wall = HandoverProtocol(request.object_name, settings, now), monotonic()
        run = Run(handover_id, goal, protocol, Future(), wall, set(self.liveness.missing(wall)))
        self.last_time = now
        self.view.begin_feeling()
        self.stopped_until = float("-inf")
        self.run = run
        # At once, and not at the next turn: the robot must have it well before the first trajectory.
        self.enable(True)
        try:
            await run.done
        finally:
            self.run = None
        return self.result_of(run)

    def result_of(self, run: Run) -> ExecuteHandover.Result:
        """Close the goal and return its result."""
        outcome = run.protocol.outcome
        assert outcome is not None
        self.handovers += 1
        self.taken += outcome.taken
        phases = [(phase, duration) for phase, duration in run.protocol.phases if phase is not Phase.DONE]
        result = ExecuteHandover.Result(
            success=outcome.success,
            error_code=int(outcome.code),
            message=outcome.message,
            handover_id=run.handover_id,
            taken=outcome.taken,
            phases=[phase.value for phase, _ in phases],
            phase_durations=[float(duration) for _, duration in phases],
        )
        if run.plan is not None:
            result.plan = run.plan
            result.choice = self.view.taken_choice(run.handover_id, run.plan.plan_id)
        if outcome.taken:
            self.choice_publisher.publish(result.choice)
        self.publish_state("idle", outcome.message)
        if outcome.success:
            run.goal.succeed()
        elif outcome.code is ErrorCode.CANCELLED:
            run.goal.canceled()
        else:
            self.get_logger().error(outcome.message)
            run.goal.abort()
        return result

    # Stepping

    def tick(self) -> None:
        """Step the protocol and keep the robot enabled while a handover is under way."""
        wall, run = monotonic(), self.run
        self.liveness.lost(wall)  # asked at every turn, so that the monitor knows when this process itself stalled
        if run is not None and not run.done.done():
            if run.goal.is_cancel_requested and not run.cancelled:
                run.cancelled = True
                run.protocol.cancel()
            self.view.look()
            for command in run.protocol.step(self.observe(run)):
                self.carry_out(command, run)
            self.report(run, wall)
            if run.protocol.finished:
                run.done.set_result(None)
        if wall - self.last_enable >= ENABLE_PERIOD:
            self.enable(run is not None and not run.protocol.finished and wall > self.stopped_until)

    def enable(self, value: bool) -> None:
        """Tell the robot that it may move (true) or must hold (false)."""
        self.last_enable = monotonic()
        self.enable_publisher.publish(Bool(data=bool(value)))

    def report(self, run: Run, wall: float) -> None:
        """Publish feedback now and then, and the cell's state when the phase changes."""
        protocol = run.protocol
        changed = protocol.phase is not run.last_phase
        if changed:
            run.last_phase = protocol.phase
            self.view.watch_hands(protocol.phase in HANDS_MATTER)
            if protocol.phase is Phase.WAITING:
                self.view.begin_feeling()
            self.view.feeling = run.plan.arm if run.plan and protocol.phase is Phase.WAITING else ""
            if protocol.phase is Phase.RELEASING and run.plan is not None:
                # Now: both hold the object where it was offered, the person as they chose.
                self.view.note_taking(run.handover_id, run.plan)
            self.publish_state(protocol.phase.value, protocol.message, run)
        if (changed or wall - run.last_feedback >= FEEDBACK_PERIOD) and not protocol.finished:
            run.last_feedback = wall
            run.goal.publish_feedback(
                ExecuteHandover.Feedback(
                    phase=protocol.phase.value,
                    phase_time=float(self.seconds_now() - protocol.phase_start),
                    message=protocol.message,
                )
            )

    def carry_out(self, command: Command, run: Run) -> None:
        """Carry out one command of the protocol."""
        match command:
            case Show(text):
                self.show(text)
            case Stop():
                self.stopped_until = monotonic() + STOPPED_TIME
                self.enable(False)
            case Follow(stage):
                names = self.robot.arm(run.plan.arm).joint_names
                self.trajectory_publisher.publish(
                    trajectory_message(names, stage.times, stage.positions, stage.velocities)
                )
            case MoveGripper(opening):
                self.gripper_publisher.publish(
                    GripperCommand(
                        arm=run.plan.arm, opening=float(opening), max_force=float(self.parameters["gripper_force"])
                    )
                )
            case RequestPlan():
                self.executor.create_task(self.request_plan(run))
            case RequestReturn(holding):
                self.executor.create_task(self.request_return(run, holding))

    async def request_plan(self, run: Run) -> None:
        """Ask the planner for the handover and hand its answer to the protocol."""
        goal = run.goal.request
        request = PlanHandover.Request(
            object_name=goal.object_name,
            scheme=goal.scheme or ("" if goal.has_offer else self.parameters["scheme"]),
            arm=goal.arm,
            person_model=goal.person_model,
            has_goal=goal.has_goal,
            goal=goal.goal,
            has_offer=goal.has_offer,
            offer=goal.offer,
        )
        try:
            answer = await self.call(self.plan_client, request, run.protocol.settings.plan_limit)
            if not answer.success:
                raise HandoverError(answer.message, ErrorCode(answer.error_code))
            await self.until_robot_listens()
            await self.until_robot_is_enabled()
            run.plan = answer.plan
            run.protocol.plan_ready(plan_from_message(answer.plan))
        except HandoverError as error:
            run.protocol.plan_failed(error.code, str(error))

    async def until_robot_listens(self) -> None:
        """Wait until somebody receives the commands: one sent before its receiver was discovered is lost.

        Raises:
            StaleDataError: Nobody does within a few seconds.
        """
        commands = (self.trajectory_publisher, self.gripper_publisher, self.enable_publisher)
        for _ in range(round(DISCOVERY_LIMIT / POLL_PERIOD)):
            deaf = [publisher.topic_name for publisher in commands if publisher.get_subscription_count() == 0]
            if not deaf:
                return
            await self.pause(POLL_PERIOD)
        raise StaleDataError(f"nobody listens to {', '.join(deaf)}: is the robot's driver (sim_node) running?")

    async def until_robot_is_enabled(self) -> None:
        """Let the robot hear that it may move before a motion reaches it: topics keep no order among them."""
        self.stopped_until = float("-inf")
        self.enable(True)
        await self.pause(2.0 * ENABLE_PERIOD)

    async def request_return(self, run: Run, holding: bool) -> None:
        """Ask the planner for the way back and hand it to the protocol."""
        request = PlanMotion.Request(arm=run.plan.arm, posture="put_back" if holding else "home")
        if holding:
            request.held_object = run.protocol.object_name
        # Planned from where the arm has come to rest.
        await self.pause(STOPPED_TIME)
        try:
            answer = await self.call(self.motion_client, request, run.protocol.settings.plan_limit)
            if not answer.success:
                raise HandoverError(answer.message, ErrorCode(answer.error_code))
            await self.until_robot_is_enabled()
            opening = self.robot.arm(run.plan.arm).opening[1] if holding else float("nan")
            run.protocol.return_ready((stage_from_message(request.posture, answer.trajectory, opening),))
        except HandoverError as error:
            run.protocol.plan_failed(error.code, str(error))

    # What is shown

    def show(self, text: str) -> None:
        """Show a text on the head display."""
        self.display_publisher.publish(image_message(text_picture(text), "display"))

    def publish_state(self, phase: str, message: str, run: Run | None = None) -> None:
        """Publish the cell's state, latched."""
        state = CellState(phase=phase, message=message, handovers=self.handovers, taken=self.taken)
        state.header.stamp = self.get_clock().now().to_msg()
        state.lost_nodes = list(self.liveness.lost(monotonic()))
        state.problems = self.problems()
        if run is not None:
            state.handover_id, state.object_name = run.handover_id, run.protocol.object_name
        self.said = state
        self.state_publisher.publish(state)

    def diagnose(self) -> tuple[bool, str, dict[str, object]]:
        """Report the phase and who is missing; tell the cell's state anew when somebody fell silent or came back."""
        if self.problems() != list(self.said.problems):
            self.publish_state(self.said.phase, self.said.message, self.run)
        missing = self.liveness.missing(monotonic())
        phase = self.run.protocol.phase.value if self.run else "idle"
        line = f"missing: {', '.join(missing)}" if missing else phase
        return (
            not missing,
            line,
            {
                "phase": phase,
                "handovers": self.handovers,
                "taken": self.taken,
                "pull_N": self.view.pull.pull,
                "scheduling": self.scheduling,
                "joint_state_age_s": self.view.robot_state.age(monotonic()),
            },
        )

    def on_stop(self) -> None:
        """Stop the robot."""
        self.enable(False)


main = main_of(ExecutiveNode)

if __name__ == "__main__":
    main()
