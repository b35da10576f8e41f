"""``planner_node``: plans handovers and single motions of the robot on request."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from handover_msgs.msg import ActiveProfile, GripperState, HandoverPlan, ObjectStates, SkeletonState
from handover_msgs.srv import PlanHandover, PlanMotion
from rclpy.callback_groups import ReentrantCallbackGroup
from sensor_msgs.msg import JointState
from visualization_msgs.msg import MarkerArray

from handover_ros.ergonomics.anthropometry import HEAVIEST, LIGHTEST
from handover_ros.errors import BadRequestError, ErrorCode, HandoverError, StaleDataError
from handover_ros.geometry import FloatArray, rotation_angle, transform_from_pose
from handover_ros.nodes.convert import numpy_array, seconds_from_stamp, transform_from_message
from handover_ros.nodes.convert_plan import WORLD, plan_message, plan_visual, trajectory_to_message
from handover_ros.nodes.convert_profile import profile_from_message
from handover_ros.nodes.parameters import ParameterSpec
from handover_ros.nodes.runtime import (
    LATCHED,
    POLL_PERIOD,
    SENSOR_CONSUMER,
    HandoverNode,
    Worker,
    answer,
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
    TrackedPerson,
    load_schemes,
)
from handover_ros.planning.offers import HandoverTask
from handover_ros.planning.types import BODY_MASS, OutdatedSnapshotError
from handover_ros.robot import RobotModel, Trajectory
from handover_ros.skeleton.profile import Profile
from handover_ros.skeleton.stillness import Stillness

MOVED_DISTANCE, MOVED_ANGLE = 0.08, 0.17  # [m], [rad] of the torso that make a plan be made anew
FIRST_DATA = 2.0  # [s] of wall time the first samples may take to come in
STILL_POLL = 0.05  # [s] of wall time between two looks whether the person stands still
PUT_BACK = "put_back"  # PlanMotion.posture: bring the held object back to where it was planned to be taken from
DEFAULTS = PlannerSettings()
HANDS = ("", "left", "right")
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
        # Latest values with the wall time of their arrival.
        self.joints: dict[str, tuple[float, FloatArray]] = {}
        self.objects: dict[str, tuple[float, FloatArray]] = {}
        self.torso: tuple[float, FloatArray] | None = None
        self.stillness = Stillness()
        self.profile: Profile | None = None
        self.profile_problem = ""
        self.posture: tuple[float, FloatArray] | None = None  # displacements of the profile's skeleton
        self.gripping: frozenset[str] = frozenset()
        self.taken_from: dict[str, FloatArray] = {}  # object -> world_from_object when it was planned to be fetched
        self.numbers = itertools.count(1)
        self.plans, self.refusals, self.last_problem = 0, 0, ""

        self.worker = Worker(self)
        self.plan_publisher = self.create_publisher(HandoverPlan, "planner/plan", LATCHED)
        self.visual_publisher = self.create_publisher(MarkerArray, "planner/visual", LATCHED)
        self.create_subscription(JointState, "robot/joint_states", self.on_joints, SENSOR_CONSUMER)
        self.create_subscription(GripperState, "robot/gripper_state", self.on_grippers, SENSOR_CONSUMER)
        self.create_subscription(ObjectStates, "objects/states", self.on_objects, SENSOR_CONSUMER)
        self.create_subscription(SkeletonState, "human/skeleton_state", self.on_skeleton, SENSOR_CONSUMER)
        self.create_subscription(ActiveProfile, "calibration/active_profile", self.on_profile, LATCHED)
        # Reentrant: a request waits for the one before it, while callbacks go on.
        group = ReentrantCallbackGroup()
        self.create_service(PlanMotion, "planner/plan_motion", self.plan_motion, callback_group=group)
        self.create_service(PlanHandover, "planner/plan_handover", self.plan_handover, callback_group=group)
        self.say_ready()

    # What is known of the cell

    def on_joints(self, message: JointState) -> None:
        """Keep the arms' displacements."""
        values = dict(zip(message.name, message.position, strict=False))
        for arm in self.robot.arm_names:
            names = self.robot.arm(arm).joint_names
            if all(name in values for name in names):
                self.joints[arm] = monotonic(), np.array([values[name] for name in names])

    def on_grippers(self, message: GripperState) -> None:
        """Keep which grippers hold something."""
        self.gripping = frozenset(
            arm for arm, gripping in zip(message.arms, message.gripping, strict=False) if gripping
        )

    def on_objects(self, message: ObjectStates) -> None:
        """Keep the poses of the objects that are seen."""
        try:
            poses = numpy_array(message.poses, len(message.names), 7)
            seen = {
                name: (monotonic(), transform_from_pose(pose))
                for name, pose in zip(message.names, poses, strict=True)
                if not np.isnan(pose).any()
            }
        except (BadRequestError, ValueError) as error:
            self.last_problem = f"objects/states: {error}"
            return
        self.objects = {**self.objects, **seen}

    def on_skeleton(self, message: SkeletonState) -> None:
        """Keep the torso when it is valid."""
        if not message.valid:
            return
        try:
            torso = transform_from_message(message.torso.pose, "torso")
            self.torso = monotonic(), torso
            self.stillness.update(seconds_from_stamp(message.header.stamp), torso)
            self.keep_posture(message)
        except BadRequestError as error:
            self.last_problem = f"human/skeleton_state: {error}"

    def keep_posture(self, message: SkeletonState) -> None:
        """Keep where the joints of the active profile's skeleton are, if it is that one that is tracked."""
        if self.profile is None or message.profile_id != self.profile.profile_id:
            return
        names = self.profile.skeleton.displacement_names
        values = dict(zip(message.joint_names, message.displacements, strict=False))
        displacements = np.array([values.get(name, np.nan) for name in names])
        if np.isfinite(displacements).all():
            self.posture = monotonic(), displacements

    def on_profile(self, message: ActiveProfile) -> None:
        """Plan for this person from now on; one whose profile cannot be used is offered things like anybody."""
        self.profile, self.profile_problem, self.posture = None, "", None
        try:
            self.profile = profile_from_message(message)
        except HandoverError as error:
            self.profile_problem = self.last_problem = str(error)
        self.say_ready()
        if self.profile is not None:
            for scheme in self.planner.schemes.values():
                if isinstance(scheme, PersonalScheme):
                    for name in self.planner.motion.catalogue:
                        self.worker.submit(self.prepare, scheme, name, self.profile)

    def prepare(self, scheme: PersonalScheme, name: str, profile: Profile) -> None:
        """Find the postures of a person with an object before they are asked for; runs in the worker thread."""
        if profile is not self.profile:
            return  # another one came meanwhile
        try:
            model, person = self.planner.motion.object_model(name), self.person(np.eye(4), profile, None)
            scheme.offers(HandoverTask(model, np.eye(4), person))
        except HandoverError as error:
            self.last_problem = str(error)

    def say_ready(self) -> None:
        """Say what can be planned, and for whom."""
        if self.profile_problem:
            self.degraded(f"no scheme of a person's own: {self.profile_problem}")
            return
        person = f" for {self.profile.person or self.profile.profile_id}" if self.profile else ""
        self.ready(f"plans for {self.robot.name} with the schemes {', '.join(self.planner.schemes)}{person}")

    def person(self, torso: FloatArray, profile: Profile | None, posture: FloatArray | None) -> TrackedPerson:
        """Return what is known of the person."""
        return TrackedPerson(
            torso,
            skeleton=profile.skeleton if profile else None,
            displacements=posture,
            dominant=self.parameters["dominant_hand"] or None,
            body_mass=self.parameters["body_mass"],
            profile=profile.profile_id if profile else "",
            profile_problem=self.profile_problem,
        )

    def snapshot(self, needs_person: bool) -> CellSnapshot:
        """Return the cell as it is now.

        Raises:
            StaleDataError: Robot or, if needed, person is not known or too old.
        """
        now = monotonic()
        for arm in self.robot.arm_names:
            limit = self.parameters["joint_state_age"]
            if arm not in self.joints:
                raise StaleDataError(f"no robot/joint_states of the {arm} arm yet: is the robot's driver running?")
            if (age := now - self.joints[arm][0]) > limit:
                raise StaleDataError(f"robot/joint_states are {age:.1f} s old (limit {limit:g} s): did the robot stop?")
        torso, limit = self.torso, self.parameters["torso_age"]
        fresh = torso is not None and now - torso[0] <= limit
        if needs_person and not fresh:
            how = "has not been tracked yet" if torso is None else f"was last tracked {now - torso[0]:.1f} s ago"
            raise StaleDataError(
                f"the person {how} (limit {limit:g} s): step into view of the cameras", ErrorCode.PERSON_NOT_TRACKED
            )
        age_limit = self.parameters["object_age"]
        profile, posture = self.profile, self.posture
        known = posture is not None and profile is not None and now - posture[0] <= limit
        person = None
        if fresh and torso is not None:
            person = self.person(torso[1], profile, posture[1] if known and posture is not None else None)
        return CellSnapshot(
            arms={arm: positions for arm, (_, positions) in self.joints.items()},
            objects={name: pose for name, (seen, pose) in self.objects.items() if now - seen <= age_limit},
            person=person,
            gripping=self.gripping,
        )

    # Services

    async def plan_handover(self, request: PlanHandover.Request, response: PlanHandover.Response) -> Any:
        """Plan a handover."""
        return await answer(response, self.fill_handover(request, response), self)

    async def plan_motion(self, request: PlanMotion.Request, response: PlanMotion.Response) -> Any:
        """Plan a motion of one arm."""
        return await answer(response, self.fill_motion(request, response), self)

    async def fill_handover(self, request: PlanHandover.Request, response: PlanHandover.Response) -> None:
        """Plan in the worker thread, publish the plan and fill the response."""
        wanted = HandoverRequest(
            object_name=request.object_name,
            scheme=request.scheme,
            arm=request.arm,
            time_budget=request.time_budget,
            world_from_goal=goal_of(request.goal) if request.has_goal else None,
            person_model=request.person_model,
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
        except Exception as error:
            self.refusals, self.last_problem = self.refusals + 1, str(error)
            raise
        self.plans += 1
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

    async def until_first_data(self) -> None:
        """Give a node that just started a moment to hear of the robot and the person."""
        for _ in range(round(FIRST_DATA / POLL_PERIOD)):
            if self.torso is not None and self.objects and len(self.joints) == len(self.robot.arm_names):
                return
            await self.pause(POLL_PERIOD)

    async def until_person_is_still(self, give_up: float) -> None:
        """Let a person who moves come to rest before planning for where they stand, until ``give_up`` [s] at most."""
        wall = monotonic()
        while (
            self.torso is not None
            and wall - self.torso[0] <= self.parameters["torso_age"]
            and not self.stillness.still()
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
        snapshot = self.snapshot(scheme.needs_person)

        def outdated() -> bool:
            now, then = self.torso, snapshot.world_from_torso
            if not (patient and scheme.needs_person) or now is None or then is None:
                return False
            moved = np.linalg.norm(now[1][:3, 3] - then[:3, 3])
            return bool(moved > MOVED_DISTANCE) or rotation_angle(now[1], then) > MOVED_ANGLE

        return snapshot, self.planner.plan(wanted, snapshot, outdated)

    async def fill_motion(self, request: PlanMotion.Request, response: PlanMotion.Response) -> None:
        """Plan in the worker thread and fill the response."""
        await self.until_first_data()
        try:
            trajectory = await self.worker.submit(self.work_on_motion, request)
        except Exception as error:
            self.refusals, self.last_problem = self.refusals + 1, str(error)
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
            return motion.put_back(arm.name, name, place, self.snapshot(needs_person=False))
        goal = arm.posture(request.posture) if request.posture else np.array(request.displacements)
        return motion.motion(arm.name, goal, self.snapshot(needs_person=False), request.held_object)

    def diagnose(self) -> tuple[bool, str, dict[str, object]]:
        """Report what is known and how planning went."""
        now, torso = monotonic(), self.torso
        values = {
            "plans": self.plans,
            "refusals": self.refusals,
            "profile": self.profile.profile_id if self.profile else "",
            "last_problem": self.last_problem,
            "torso_age_s": now - torso[0] if torso else float("nan"),
            "objects": len(self.objects),
        }
        missing = [arm for arm in self.robot.arm_names if arm not in self.joints]
        return not missing, "no robot/joint_states" if missing else "ready", values


def goal_of(stamped: PoseStamped) -> FloatArray:
    """Return the goal pose (4, 4) of a request.

    Raises:
        BadRequestError: Not finite, no unit quaternion, or not in the world frame.
    """
    if stamped.header.frame_id not in ("", WORLD):
        raise BadRequestError(f"goal: frame {stamped.header.frame_id!r} is not known; give it in {WORLD!r}")
    return transform_from_message(stamped.pose, "goal")


main = main_of(PlannerNode)

if __name__ == "__main__":
    main()
