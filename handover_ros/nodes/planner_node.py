"""``planner_node``: plans handovers and single motions of the robot on request."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from handover_msgs.msg import HandoverPlan
from handover_msgs.srv import PlanHandover, PlanMenu, PlanMotion
from rclpy.callback_groups import ReentrantCallbackGroup
from visualization_msgs.msg import MarkerArray

from handover_ros.ergonomics.anthropometry import HEAVIEST, LIGHTEST
from handover_ros.errors import BadRequestError, ErrorCode, HandoverError, InfeasibleError
from handover_ros.geometry import FloatArray, rotation_angle
from handover_ros.nodes.convert import check_frame, transform_from_message
from handover_ros.nodes.convert_belief import chosen_offer
from handover_ros.nodes.convert_plan import plan_message, plan_visual, trajectory_to_message
from handover_ros.nodes.parameters import ParameterSpec
from handover_ros.nodes.planner_view import CellView
from handover_ros.nodes.runtime import (
    LATCHED,
    POLL_PERIOD,
    HandoverNode,
    Worker,
    main_of,
    monotonic,
)
from handover_ros.objects import load_catalogue, load_scene
from handover_ros.planning import (
    CellSnapshot,
    HandoverPlanner,
    HandoverRequest,
    PersonalScheme,
    PlannerSettings,
    load_schemes,
)
from handover_ros.planning.expected_cost import ExpectedCostScheme
from handover_ros.planning.menu import Dish, menu
from handover_ros.planning.offers import HandoverTask
from handover_ros.planning.types import BODY_MASS, OutdatedSnapshotError
from handover_ros.robot import RobotModel, Trajectory
from handover_ros.skeleton.profile import Profile

MOVED_DISTANCE, MOVED_ANGLE = 0.08, 0.17  # [m], [rad] of the torso that make a plan be made anew
FIRST_DATA = 2.0  # [s] of wall time the first samples may take to come in
STILL_POLL = 0.05  # [s] of wall time between two looks whether the person stands still
PUT_BACK = "put_back"  # PlanMotion.posture: bring the held object back to where it was planned to be taken from
DEFAULTS = PlannerSettings()
HANDS = ("", "left", "right")
PROPOSED, MOST_PROPOSED = 8, 200  # handovers of one object in a menu
LONGEST_SEARCH = 600.0  # [s]
AGE = "[s] of wall time after which it is too old to plan with"

PARAMETERS = (
    ParameterSpec("robot", "baxter", "robot description in config/robots"),
    ParameterSpec("scene", "lab", "scene in config/scenes"),
    ParameterSpec("scheme", DEFAULTS.default_scheme, "scheme in config/schemes for requests that name none"),
    ParameterSpec("time_budget", DEFAULTS.time_budget, "[s] wall time of one search", 0.1, 600.0),
    ParameterSpec("person_distance", DEFAULTS.person_distance, "[m] robot to trunk and head", 0.0, 2.0),
    ParameterSpec("held_person_distance", DEFAULTS.held_person_distance, "[m] held object to trunk and head", 0.0, 2.0),
    ParameterSpec("hand_clearance", DEFAULTS.hand_clearance, "[m] fingertips to the person's hand", 0.0, 0.5),
    ParameterSpec("lift_height", DEFAULTS.lift_height, "[m] straight up from the support", 0.02, 0.5),
    ParameterSpec("retreat_distance", DEFAULTS.retreat_distance, "[m] straight back after the release", 0.02, 0.5),
    ParameterSpec("present_speed", DEFAULTS.present_speed, "share of the planning speed towards the person", 0.05, 1.0),
    ParameterSpec("joint_state_age", 1.0, f"robot/joint_states: {AGE}", 0.1, 60.0),
    ParameterSpec("torso_age", 1.0, f"the person's torso: {AGE}", 0.1, 60.0),
    ParameterSpec("object_age", 2.0, f"an object's pose: {AGE}", 0.1, 600.0),
    ParameterSpec("still_wait", 10.0, "[s] of ROS time a moving person gets to come to rest", 0.0, 60.0),
    ParameterSpec("body_mass", BODY_MASS, "[kg] of the person, for posture costs with torques", LIGHTEST, HEAVIEST),
    ParameterSpec("dominant_hand", "", "hand the person likes to take things with; empty: not known", choices=HANDS),
    ParameterSpec(
        "preference",
        "expected",
        "what is planned with of preferences/belief: mean, mode, expected (the mean cost over the belief), or none",
        choices=("mean", "mode", "expected", "none"),
    ),
    ParameterSpec("seed", 0, "of the random searches", 0, 2**31 - 1),
)
SETTINGS = (
    "time_budget",
    "person_distance",
    "held_person_distance",
    "hand_clearance",
    "lift_height",
    "retreat_distance",
    "present_speed",
    "seed",
)


class PlannerNode(HandoverNode):
    """Serves ``planner/plan_handover`` and ``planner/plan_motion``; publishes ``planner/plan``, ``planner/visual``."""

    niceness = 10

    def __init__(self) -> None:
        super().__init__("planner_node", PARAMETERS)
        self.degraded("loading the robot")
        robot = RobotModel.load(self.parameters["robot"])
        chosen = {name: self.parameters[name] for name in SETTINGS}
        settings = PlannerSettings(default_scheme=self.parameters["scheme"], **chosen)
        schemes = load_schemes()
        self.planner = HandoverPlanner(robot, load_scene(self.parameters["scene"]), load_catalogue(), schemes, settings)
        self.planner.warm_up()
        self.robot = robot
        self.prepared: Profile | None = None
        self.taken_from: dict[str, FloatArray] = {}  # object -> world_from_object when it was planned to be fetched
        self.numbers = itertools.count(1)
        self.plans, self.refusals = 0, 0
        self.planning_time = float("nan")  # [s] of the newest plan

        self.worker = Worker(self)
        self.plan_publisher = self.create_publisher(HandoverPlan, "planner/plan", LATCHED)
        self.visual_publisher = self.create_publisher(MarkerArray, "planner/visual", LATCHED)
        self.view = CellView(self, robot, self.on_person)
        # Reentrant: a request waits for the one before it, while callbacks go on.
        group = ReentrantCallbackGroup()
        self.serve(PlanMotion, "planner/plan_motion", self.plan_motion, group)
        self.serve(PlanMenu, "planner/plan_menu", self.plan_menu, group)
        self.serve(PlanHandover, "planner/plan_handover", self.plan_handover, group)
        self.say_ready()

    # The person

    def on_person(self) -> None:
        """Say for whom is planned, and prepare what takes long."""
        self.say_ready()
        profile = self.view.profile
        if profile is None or profile is self.prepared:
            return
        self.prepared = profile
        self.executor.create_task(self.prepare_all, profile)

    async def prepare_all(self, profile: Profile) -> None:
        """Prepare object by object, so that a request waits for one of them at most."""
        for scheme in self.planner.schemes.values():
            if isinstance(scheme, PersonalScheme):
                for name in self.planner.motion.catalogue:
                    await self.worker.submit(self.prepare, scheme, name, profile)

    def prepare(self, scheme: PersonalScheme, name: str, profile: Profile) -> None:
        """Find the postures of a person with an object before they are asked for; runs in the worker thread."""
        if profile is not self.view.profile:
            return  # another one came meanwhile
        try:
            model, person = self.planner.motion.object_model(name), self.view.person(np.eye(4), profile, None)
            scheme.offers(HandoverTask(model, np.eye(4), person))
        except HandoverError as error:
            self.last_problem = str(error)

    def say_ready(self) -> None:
        """Say what can be planned, and for whom."""
        if self.view.profile_problem:
            self.degraded(f"no scheme of a person's own: {self.view.profile_problem}")
            return
        profile = self.view.profile
        person = f" for {profile.person or profile.profile_id}" if profile else ""
        person += ", with what is believed of their preference" if self.view.preference else ""
        self.ready(f"plans for {self.robot.name} with the schemes {', '.join(self.planner.schemes)}{person}")

    # Services

    async def plan_handover(self, request: PlanHandover.Request, response: PlanHandover.Response) -> None:
        """Plan in the worker thread, publish the plan and fill the response."""
        wanted = HandoverRequest(
            object_name=request.object_name,
            scheme=request.scheme,
            arm=request.offer.arm if request.has_offer else request.arm,
            time_budget=request.time_budget,
            world_from_goal=goal_of(request.goal) if request.has_goal else None,
            person_model=request.person_model,
            offer=chosen_offer(request.offer, request.object_name) if request.has_offer else None,
        )
        await self.until_first_data()
        give_up = self.seconds_now() + self.parameters["still_wait"]
        try:
            while True:
                await self.until_person_is_still(give_up)
                patient = self.seconds_now() < give_up
                try:
                    snapshot, plan = await self.worker.submit(self.work_on_handover, wanted, patient)
                    break
                except OutdatedSnapshotError as error:
                    self.last_problem = str(error)
        except Exception:
            self.refusals += 1
            raise
        self.plans += 1
        self.planning_time = plan.planning_time
        stamp = self.get_clock().now().to_msg()
        names = self.robot.arm(plan.arm).joint_names
        plan_id = f"{plan.object_name}-{stamp.sec}.{stamp.nanosec // 1000000:03d}-{next(self.numbers)}"
        profile = snapshot.person.profile if snapshot.person and plan.expected else ""
        response.plan = plan_message(plan, names, plan_id, stamp, profile)
        response.success = True
        response.message = plan.explanation
        if plan.robot_grasp:
            self.taken_from[plan.object_name] = snapshot.objects[plan.object_name]
        self.plan_publisher.publish(response.plan)
        model = self.planner.motion.object_model(plan.object_name)
        self.visual_publisher.publish(plan_visual(plan, model, snapshot.world_from_torso, stamp))

    async def plan_menu(self, request: PlanMenu.Request, response: PlanMenu.Response) -> None:
        """Look for handovers in the worker thread and fill the response."""
        if request.count > MOST_PROPOSED or not 0.0 <= request.time_budget <= LONGEST_SEARCH:
            raise BadRequestError(
                f"count {request.count}, time_budget {request.time_budget}: at most {MOST_PROPOSED} handovers of an "
                f"object, in 0 to {LONGEST_SEARCH:g} s"
            )
        await self.until_first_data()
        await self.until_person_is_still(self.seconds_now() + self.parameters["still_wait"])
        dishes, refusals = await self.worker.submit(self.work_on_menu, request)
        if not dishes:
            raise InfeasibleError("; ".join(refusals) or "no object for one hand is seen", ErrorCode.NOT_REACHABLE)
        stamp = self.get_clock().now().to_msg()
        number = next(self.numbers)
        response.menu = [
            plan_message(dish.plan(), (), f"menu-{number}-{place}", stamp) for place, dish in enumerate(dishes)
        ]
        response.success = True
        response.message = f"{len(dishes)} handovers{'; ' if refusals else ''}{'; '.join(refusals)}"

    def work_on_menu(self, request: PlanMenu.Request) -> tuple[list[Dish], list[str]]:
        """Return the handovers found, and why there are none of some objects; runs in the worker thread."""
        scheme = self.planner.scheme(request.scheme or "expected_cost")
        if not isinstance(scheme, ExpectedCostScheme):
            raise BadRequestError(f"scheme {scheme.name!r} cannot tell who takes what how; use expected_cost")
        snapshot = self.view.snapshot(needs_person=True)
        names = list(request.object_names)
        if not names:
            names = [name for name in snapshot.objects if self.planner.motion.object_model(name).hands == 1]
        budget = request.time_budget or self.parameters["time_budget"]
        dishes: list[Dish] = []
        refusals: list[str] = []
        for name in names:
            try:
                dishes += menu(
                    self.planner,
                    scheme,
                    name,
                    snapshot,
                    request.count or PROPOSED,
                    request.arm,
                    budget / len(names),
                    int(request.seed),
                )
            except InfeasibleError as error:
                refusals.append(str(error))
        return dishes, refusals

    async def until_first_data(self) -> None:
        """Give a node that just started a moment to hear of the robot and the person."""
        for _ in range(round(FIRST_DATA / POLL_PERIOD)):
            if self.view.torso is not None and self.view.objects and len(self.view.joints) == len(self.robot.arm_names):
                return
            await self.pause(POLL_PERIOD)

    async def until_person_is_still(self, give_up: float) -> None:
        """Let a person who moves come to rest before planning for where they stand, until ``give_up`` [s] at most."""
        wall = monotonic()
        while (
            self.view.torso is not None
            and wall - self.view.torso[0] <= self.parameters["torso_age"]
            and not self.view.stillness.still()
            and self.seconds_now() < give_up
        ):
            await self.pause(STILL_POLL)
            wall = monotonic()

    def work_on_handover(self, wanted: HandoverRequest, patient: bool) -> tuple[CellSnapshot, Any]:
        """Return the snapshot and the plan made from it; runs in the worker thread.

        While ``patient``, a person who moves meanwhile ends the search, to be started anew.
        """
        scheme = self.planner.scheme(wanted.scheme)
        self.planner.motion.object_model(wanted.object_name)
        snapshot = self.view.snapshot(scheme.needs_person)

        def outdated() -> bool:
            now, then = self.view.torso, snapshot.world_from_torso
            if not (patient and scheme.needs_person) or now is None or then is None:
                return False
            moved = np.linalg.norm(now[1][:3, 3] - then[:3, 3])
            return bool(moved > MOVED_DISTANCE) or rotation_angle(now[1], then) > MOVED_ANGLE

        return snapshot, self.planner.plan(wanted, snapshot, outdated)

    async def plan_motion(self, request: PlanMotion.Request, response: PlanMotion.Response) -> None:
        """Plan in the worker thread and fill the response."""
        await self.until_first_data()
        try:
            trajectory = await self.worker.submit(self.work_on_motion, request)
        except Exception:
            self.refusals += 1
            raise
        response.trajectory = trajectory_to_message(self.robot.arm(request.arm).joint_names, trajectory)
        response.success = True
        response.message = f"{trajectory.duration:.1f} s of motion"

    def work_on_motion(self, request: PlanMotion.Request) -> Trajectory:
        """Return the trajectory asked for; runs in the worker thread."""
        motion, arm = self.planner.motion, self.robot.arm(request.arm)
        if request.posture and len(request.displacements):
            raise BadRequestError("give either posture or displacements, not both")
        if request.held_object:
            motion.object_model(request.held_object)
        if request.posture == PUT_BACK:
            name = request.held_object
            place = self.taken_from.get(name, motion.scene.placements.get(name))
            if place is None:
                raise BadRequestError(f"posture {PUT_BACK!r} needs held_object, and a plan that fetched it before")
            return motion.put_back(arm.name, name, place, self.view.snapshot(needs_person=False))
        goal = arm.posture(request.posture) if request.posture else np.array(request.displacements)
        return motion.motion(arm.name, goal, self.view.snapshot(needs_person=False), request.held_object)

    def diagnose(self) -> tuple[bool, str, dict[str, object]]:
        """Report what is known and how planning went."""
        now, torso = monotonic(), self.view.torso
        values = {
            "plans": self.plans,
            "refusals": self.refusals,
            "last_planning_s": self.planning_time,
            "profile": self.view.profile.profile_id if self.view.profile else "",
            "last_problem": self.last_problem or self.view.last_problem,
            "preference": "believed" if self.view.preference else "generic",
            "torso_age_s": now - torso[0] if torso else float("nan"),
            "objects": len(self.view.objects),
        }
        missing = [arm for arm in self.robot.arm_names if arm not in self.view.joints]
        return not missing, "no robot/joint_states" if missing else "ready", values


def goal_of(stamped: PoseStamped) -> FloatArray:
    """Return the goal pose (4, 4) of a request.

    Raises:
        BadRequestError: Not finite, no unit quaternion, or not in the world frame.
    """
    check_frame(stamped.header.frame_id, "goal")
    return transform_from_message(stamped.pose, "goal")


main = main_of(PlannerNode)

if __name__ == "__main__":
    main()
