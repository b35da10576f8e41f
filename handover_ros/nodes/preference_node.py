"""``preference_node``: learns what the active person finds comfortable, and chooses what to hand over next."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from handover_msgs.msg import ActiveProfile, BeliefSummary, GraspChoice, HandoverPlan, SkeletonState
from handover_msgs.srv import AddObservation, GetBelief, PlanMenu, SelectQuery
from rclpy.callback_groups import ReentrantCallbackGroup

from handover_ros.cell.belief_store import BeliefStore
from handover_ros.cell.preference_learner import LearnerSettings, PreferenceLearner
from handover_ros.errors import ErrorCode, HandoverError, StaleDataError
from handover_ros.geometry import FloatArray
from handover_ros.nodes.convert import float_array, transform_from_message
from handover_ros.nodes.convert_belief import belief_message, offered_handover, taken_handover
from handover_ros.nodes.convert_profile import profile_from_message
from handover_ros.nodes.parameters import ParameterSpec
from handover_ros.nodes.runtime import (
    LATCHED,
    POLL_PERIOD,
    SENSOR_CONSUMER,
    SENSOR_PUBLISHER,
    HandoverNode,
    Worker,
    main_of,
)
from handover_ros.nodes.streams import Latest
from handover_ros.objects import load_catalogue
from handover_ros.preferences.strategies import STRATEGIES
from handover_ros.preferences.warm_up import warm_up_preferences
from handover_ros.robot import RobotModel
from handover_ros.robot.gripper_points import gripper_points
from handover_ros.robot.robot_geometry import RobotGeometry

FIRST_DATA = 3.0  # [s] of wall time the person may take to be seen
MENU_LIMIT = 60.0  # [s] of wall time the planner may take to propose handovers
DEFAULTS = LearnerSettings()

PARAMETERS = (
    ParameterSpec("robot", "baxter", "robot description in config/robots, for what its grippers are in the way of"),
    ParameterSpec("profile_directory", "", "folder of profiles; empty: $HANDOVER_PROFILES, or the user's data folder"),
    ParameterSpec("learn", "both", "what is learned", choices=("neutral", "weights", "both")),
    ParameterSpec("rationality", DEFAULTS.rationality, "[1/cost] of the person's choices", 0.01, 1e4),
    ParameterSpec(
        "rationality_range", 1.0, "factor by which it may be more or less, averaged over; 1: it is known", 1.0, 100.0
    ),
    ParameterSpec("particles", DEFAULTS.particles, "of the belief", 100, 100_000),
    ParameterSpec("retention", DEFAULTS.retention, "what an answer still counts one answer later", 0.1, 1.0),
    ParameterSpec(
        "prior",
        "typical",
        "first belief: even over what is possible, near what is typical, or what the beliefs of others show",
        choices=("even", "typical", "population"),
    ),
    ParameterSpec(
        "spread", DEFAULTS.spread, "[rad] standard deviation of a posture as tracked and modelled", 0.01, 1.0
    ),
    ParameterSpec("answers", DEFAULTS.answers, "which of a choice counts", choices=("posture", "region")),
    ParameterSpec("strategy", "active", "for requests that name none", choices=tuple(STRATEGIES), read_only=False),
    ParameterSpec("hand", "right", "hand the person takes things with", choices=("left", "right"), read_only=False),
    ParameterSpec("seed", 0, "of all random draws", 0, 2**31 - 1),
)


class PreferenceNode(HandoverNode):
    """Serves ``preferences/...``; publishes ``preferences/belief``, latched."""

    niceness = 10

    def __init__(self) -> None:
        super().__init__("preference_node", PARAMETERS)
        self.degraded("loading the robot")
        robot = RobotModel.load(self.parameters["robot"])
        geometry = RobotGeometry(robot)
        directory = self.parameters["profile_directory"]
        learn = self.parameters["learn"]
        names = ("rationality", "rationality_range", "particles", "retention", "prior", "spread", "answers", "seed")
        self.learner = PreferenceLearner(
            load_catalogue(),
            {arm: gripper_points(geometry, arm) for arm in robot.arm_names},
            BeliefStore(Path(directory).expanduser() if directory else None),
            LearnerSettings(
                learn=("neutral", "weights") if learn == "both" else (learn,),
                **{name: self.parameters[name] for name in names},
            ),
        )
        warm_up_preferences()
        self.counted, self.refused = 0, 0
        self.worker = Worker(self)
        self.belief_publisher = self.create_publisher(BeliefSummary, "preferences/belief", LATCHED)
        # Reentrant: what waits (for the planner, for the belief) holds up nothing, the worker's answer least of all.
        group = ReentrantCallbackGroup()
        self.create_subscription(
            ActiveProfile, "calibration/active_profile", self.on_profile, LATCHED, callback_group=group
        )
        self.create_subscription(
            GraspChoice, "handover/grasp_choice", self.on_choice, SENSOR_PUBLISHER, callback_group=group
        )
        self.states = Latest(self, SkeletonState, "human/skeleton_state", SENSOR_CONSUMER)
        self.menu_client = self.create_client(PlanMenu, "planner/plan_menu", callback_group=group)
        for service, name, work in (
            (AddObservation, "add_observation", self.add_observation),
            (SelectQuery, "select_query", self.select_query),
            (GetBelief, "get_belief", self.get_belief),
            (GetBelief, "save_belief", self.save_belief),
            (GetBelief, "load_belief", self.load_belief),
            (GetBelief, "reset_belief", self.reset_belief),
        ):
            self.serve(service, f"preferences/{name}", work, group)
        self.publish_belief()
        self.say_ready()

    # The person, and their answers

    async def on_profile(self, message: ActiveProfile) -> None:
        """Learn about this person from now on."""
        try:
            await self.worker.submit(self.learner.activate, profile_from_message(message))
        except HandoverError as error:
            self.last_problem = str(error)
            await self.worker.submit(self.learner.activate, None)
        self.publish_belief()
        self.say_ready()

    async def on_choice(self, message: GraspChoice) -> None:
        """Take in how the person took something, if that was seen."""
        try:
            await self.take_in(message)
        except HandoverError as error:
            self.refused, self.last_problem = self.refused + 1, f"handover/grasp_choice: {error}"
            self.get_logger().warning(self.last_problem)

    async def take_in(self, message: GraspChoice) -> bool:
        """Take one answer in and publish the belief; return whether it was new.

        Raises:
            HandoverError: It cannot be an answer, or could not be stored; the belief is as it was.
        """
        taken = taken_handover(message)
        new = await self.worker.submit(self.learner.add, taken, message.profile_id)
        if new:
            self.counted += 1
            self.publish_belief()
        return bool(new)

    def publish_belief(self) -> None:
        """Publish what is believed."""
        self.belief_publisher.publish(belief_message(self.learner, self.get_clock().now().to_msg()))

    def say_ready(self) -> None:
        """Say about whom something is learned."""
        learner = self.learner
        if learner.problem:
            self.degraded(learner.problem)
        elif learner.person is None:
            self.ready("no profile is active")
        else:
            self.ready(f"{learner.person.belief.observations} answers of {learner.person.profile_id}")

    # Services

    async def add_observation(self, request: AddObservation.Request, response: AddObservation.Response) -> None:
        """Take in an answer; it is stored before this returns."""
        new = await self.take_in(request.choice)
        self.fill_belief(response, "taken in" if new else f"{request.choice.handover_id} was counted before")

    async def get_belief(self, request: GetBelief.Request, response: GetBelief.Response) -> None:
        """Return what is believed."""
        self.learner.active(request.profile_id)
        self.fill_belief(response, "")

    async def save_belief(self, request: GetBelief.Request, response: GetBelief.Response) -> None:
        """Store the belief as it is."""
        await self.worker.submit(self.learner.save, request.profile_id)
        self.fill_belief(response, f"stored in {self.learner.store.directory}")

    async def load_belief(self, request: GetBelief.Request, response: GetBelief.Response) -> None:
        """Go back to the belief that is stored."""
        await self.worker.submit(self.learner.load, request.profile_id)
        self.changed(response, "loaded")

    async def reset_belief(self, request: GetBelief.Request, response: GetBelief.Response) -> None:
        """Believe nothing of the person; what was stored is kept under another name."""
        await self.worker.submit(self.learner.reset, request.profile_id)
        self.changed(response, "nothing is believed now; what was stored is kept beside it, with the suffix .aside")

    def changed(self, response: Any, message: str) -> None:
        """Publish another belief and answer."""
        self.publish_belief()
        self.say_ready()
        self.fill_belief(response, message)

    def fill_belief(self, response: Any, message: str) -> None:
        """Fill a response with the belief."""
        response.belief = belief_message(self.learner, self.get_clock().now().to_msg())
        response.success, response.message = True, message

    async def select_query(self, request: SelectQuery.Request, response: SelectQuery.Response) -> None:
        """Choose from a menu, or from what the planner proposes."""
        self.learner.active(request.profile_id)
        strategy = request.strategy or self.parameters["strategy"]
        menu = list(request.menu) or await self.proposals(request)
        torso = await self.world_from_torso()
        found = await self.worker.submit(self.work_on_choice, menu, torso, strategy, request)
        response.chosen, response.menu, response.plan = found.chosen, menu, menu[found.chosen]
        response.expected_information = float_array(found.information)
        response.expected_cost = float_array(found.cost)
        response.success = True
        response.message = (
            f"{strategy}: {response.plan.object_name}, handover {found.chosen + 1} of {len(menu)}; expected to tell "
            f"{found.information[found.chosen]:.2f} nat, at cost {found.cost[found.chosen]:.2f}"
        )

    def work_on_choice(
        self, menu: Sequence[HandoverPlan], torso: FloatArray, strategy: str, request: SelectQuery.Request
    ) -> Any:
        """Return the selection; runs in the worker thread."""
        offers = [offered_handover(plan, torso) for plan in menu]
        return self.learner.choose(
            offers, strategy, request.information_weight, self.parameters["hand"], request.profile_id
        )

    async def proposals(self, request: SelectQuery.Request) -> list[HandoverPlan]:
        """Return the planner's menu.

        Raises:
            HandoverError: It has none, or does not answer.
        """
        asked = PlanMenu.Request(object_names=request.object_names, count=request.count)
        person = self.learner.active()
        asked.seed = self.parameters["seed"] + person.belief.observations
        found = await self.call(self.menu_client, asked, MENU_LIMIT)
        if not found.success:
            raise HandoverError(found.message, ErrorCode(found.error_code))
        return list(found.menu)

    async def world_from_torso(self) -> FloatArray:
        """Return the person's torso frame now; its stream is looked at only for this, it is most of a node's work.

        Raises:
            StaleDataError: The person is not seen.
        """
        self.states.take()  # what came before does not count
        for _ in range(round(FIRST_DATA / POLL_PERIOD)):
            if (state := self.states.take()) is not None and state.valid:
                return transform_from_message(state.torso.pose, "torso")
            await self.pause(POLL_PERIOD)
        raise StaleDataError(
            "the person is not tracked (no valid human/skeleton_state): step into view of the cameras",
            ErrorCode.PERSON_NOT_TRACKED,
        )

    def diagnose(self) -> tuple[bool, str, dict[str, object]]:
        """Report the belief and what was refused."""
        learner = self.learner
        belief = learner.person.belief if learner.person else None
        values = {
            "profile": learner.person.profile_id if learner.person else "",
            "observations": belief.observations if belief else 0,
            "effective_particles": belief.effective_particles if belief else 0.0,
            "entropy_nat": belief.entropy if belief else float("nan"),
            "counted": self.counted,
            "refused": self.refused,
            "surprise": learner.surprise,
            "last_problem": self.last_problem,
        }
        if learner.problem:
            return False, learner.problem, values
        if learner.changed:
            return False, "the last answers are unlike this person's before: tired, or somebody else?", values
        return True, "ready", values


main = main_of(PreferenceNode)

if __name__ == "__main__":
    main()
