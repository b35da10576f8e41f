"""planner_node on an isolated domain, with the rest of the cell played by the test."""

import time
from dataclasses import dataclass, field

import domain_coordinator
import numpy as np
import pytest
import yaml
from geometry_msgs.msg import PoseWithCovariance
from graph import FIRST_CONTACT, Graph, NodeProcess, wait_for
from handover_msgs.msg import (
    ActiveProfile,
    BeliefSummary,
    GripperState,
    HandoverPlan,
    Heartbeat,
    ObjectStates,
    SkeletonState,
)
from handover_msgs.srv import PlanHandover, PlanMenu, PlanMotion
from sensor_msgs.msg import JointState
from visualization_msgs.msg import MarkerArray

from handover_ros.arm.model import JOINT_NAMES
from handover_ros.errors import ErrorCode
from handover_ros.geometry import pose_from_transform
from handover_ros.nodes.convert import float_array, pose_message, trajectory_arrays, transform_from_message
from handover_ros.nodes.convert_profile import active_profile_message
from handover_ros.nodes.planner_node import PARAMETERS
from handover_ros.nodes.runtime import LATCHED, SENSOR_PUBLISHER
from handover_ros.objects import load_scene
from handover_ros.resources import config_directory
from handover_ros.robot import RobotModel
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.sim.person_spec import load_person
from handover_ros.skeleton.calibration_report import CalibrationReport
from handover_ros.skeleton.profile import Profile

pytestmark = pytest.mark.graph

PLANNING = 60.0  # [s] for a plan on a busy machine
STAGES = ["approach", "grasp", "lift", "present", "retract"]


@dataclass
class Cell:
    """Plays robot driver, perception and person; what is set to None falls silent."""

    graph: Graph
    robot: RobotModel = field(default_factory=RobotModel.load)
    torso: np.ndarray | None = None
    objects: dict[str, np.ndarray] | None = None
    arms: dict[str, np.ndarray] | None = None
    gripping: bool = False
    profile: Profile | None = None

    def __post_init__(self) -> None:
        scene = load_scene("lab")
        self.torso = scene.person_pose.copy()
        self.torso[2, 3] = 1.4
        self.objects = dict(scene.placements)
        self.arms = {name: np.array(self.robot.arm(name).home) for name in self.robot.arm_names}
        node = self.graph.node
        self.publishers = {
            topic: node.create_publisher(kind, topic, SENSOR_PUBLISHER)
            for topic, kind in (
                ("robot/joint_states", JointState),
                ("robot/gripper_state", GripperState),
                ("objects/states", ObjectStates),
                ("human/skeleton_state", SkeletonState),
            )
        }
        self.profile_publisher = node.create_publisher(ActiveProfile, "calibration/active_profile", LATCHED)
        node.create_timer(0.05, self.publish)

    def activate(self, profile: Profile | None) -> None:
        """Play the calibration node: somebody else is active now, or nobody."""
        self.profile = profile
        self.profile_publisher.publish(active_profile_message(profile))

    def publish(self) -> None:
        if self.arms is not None:
            names = [joint for arm in self.arms for joint in self.robot.arm(arm).joint_names]
            positions = float_array(np.concatenate(list(self.arms.values())))
            self.publishers["robot/joint_states"].publish(JointState(name=names, position=positions))
        if self.objects is not None:
            poses = [pose_from_transform(pose) for pose in self.objects.values()]
            states = ObjectStates(names=list(self.objects), poses=float_array(poses))
            self.publishers["objects/states"].publish(states)
        if self.torso is not None:
            pose = PoseWithCovariance(pose=pose_message(self.torso))
            state = SkeletonState(valid=True, torso=pose)
            if self.profile is not None:
                state.profile_id = self.profile.profile_id
                state.joint_names = list(self.profile.skeleton.displacement_names)
                state.displacements = float_array(self.profile.skeleton.middle)
            self.publishers["human/skeleton_state"].publish(state)
        arms = list(self.robot.arm_names)
        state = GripperState(arms=arms, gripping=[self.gripping and arm == "left" for arm in arms])
        self.publishers["robot/gripper_state"].publish(state)


@pytest.fixture(scope="module")
def cell():
    with domain_coordinator.domain_id() as domain:
        graph = Graph(domain)
        try:
            process = graph.start("planner_node")
            yield Cell(graph)
            assert process.stop() == 0, process.text()
        finally:
            graph.close()


@pytest.fixture(scope="module")
def clients(cell):
    node = cell.graph.node
    made = (
        node.create_client(PlanHandover, "planner/plan_handover"),
        node.create_client(PlanMotion, "planner/plan_motion"),
    )
    for client in made:
        wait_for(client.service_is_ready, FIRST_CONTACT, client.srv_name)
    return made


def ask(client, request):
    future = client.call_async(request)
    wait_for(future.done, PLANNING, f"an answer of {client.srv_name}")
    return future.result()


def plan(clients, **fields) -> PlanHandover.Response:
    return ask(clients[0], PlanHandover.Request(**fields))


def move(clients, **fields) -> PlanMotion.Response:
    return ask(clients[1], PlanMotion.Request(**fields))


def wait_until_plans(clients, **fields):
    """Plan until it works: the node first has to see the cell."""
    return wait_for(lambda: (a := plan(clients, **fields)).success and a, PLANNING, f"a plan of {fields}")


def test_plan_is_answered_published_and_drawn(cell, clients):
    """A plan carries all stages, starts where the robot is, and is latched with its picture."""
    latched, pictures = [], []
    node = cell.graph.node
    subscriptions = [
        node.create_subscription(HandoverPlan, "planner/plan", latched.append, LATCHED),
        node.create_subscription(MarkerArray, "planner/visual", pictures.append, LATCHED),
    ]
    answer = wait_until_plans(clients, object_name="mug")
    assert [stage.name for stage in answer.plan.stages] == STAGES
    assert answer.plan.object_name == "mug"
    assert answer.plan.plan_id
    positions = np.array(cell.arms[answer.plan.arm])
    for stage in answer.plan.stages:
        names, _, points, _ = trajectory_arrays(stage.trajectory)
        assert names == cell.robot.arm(answer.plan.arm).joint_names
        np.testing.assert_allclose(points[0], positions, atol=1e-6)
        positions = points[-1]
    wait_for(lambda: latched and pictures, FIRST_CONTACT, "planner/plan and planner/visual")
    assert latched[-1].plan_id == answer.plan.plan_id
    assert {marker.ns for marker in pictures[-1].markers} >= {"object", "gripper", "expected_hand", "torso"}
    for subscription in subscriptions:
        node.destroy_subscription(subscription)


def test_held_object_goes_back(cell, clients):
    """After a plan was carried out as far as the offer, posture put_back leads the object to where it came from."""
    answer = wait_until_plans(clients, object_name="mug")
    arms, objects = cell.arms, cell.objects
    present = next(stage for stage in answer.plan.stages if stage.name == "present")
    arm, place = answer.plan.arm, objects["mug"]
    offered = np.array(present.trajectory.points[-1].positions)
    moved = cell.robot.gripper_pose(arm, offered)
    object_from_gripper = transform_from_message(answer.plan.object_from_gripper)
    world_from_object = moved @ np.linalg.inv(object_from_gripper)
    try:
        cell.arms = {**arms, arm: offered}
        cell.objects = {**objects, "mug": world_from_object}
        cell.gripping = True
        back = wait_for(
            lambda: (
                (a := move(clients, arm=arm, posture="put_back", held_object="mug")).success
                and np.allclose(a.trajectory.points[0].positions, offered, atol=1e-6)
                and a
            ),
            PLANNING,
            "a way back",
        )
        end = cell.robot.gripper_pose(arm, np.array(back.trajectory.points[-1].positions))
        np.testing.assert_allclose(end @ np.linalg.inv(object_from_gripper), place, atol=1e-4)
        # And the same object can be planned again from the hand: nothing to fetch.
        again = wait_for(
            lambda: (a := plan(clients, object_name="mug")).success and a.plan.stages[0].name == "present" and a,
            PLANNING,
            "a plan with the mug in the hand",
        )
        assert [stage.name for stage in again.plan.stages] == ["present", "retract"]
    finally:
        cell.arms, cell.objects, cell.gripping = arms, objects, False


@pytest.mark.parametrize(
    ("fields", "code", "words"),
    [
        ({"object_name": "teapot"}, ErrorCode.UNKNOWN_NAME, "mug"),
        ({"object_name": "mug", "scheme": "telepathic"}, ErrorCode.UNKNOWN_NAME, "constant"),
        ({"object_name": "mug", "arm": "third"}, ErrorCode.UNKNOWN_NAME, "left"),
        ({"object_name": "mug", "time_budget": float("nan")}, ErrorCode.BAD_REQUEST, "time_budget"),
        ({"object_name": "mug", "time_budget": -1.0}, ErrorCode.BAD_REQUEST, "time_budget"),
    ],
)
def test_bad_requests_are_refused_with_the_reason(cell, clients, fields, code, words):
    """A request that cannot be used names the field or the known names, and the node stays up."""
    wait_until_plans(clients, object_name="mug")
    answer = plan(clients, **fields)
    assert not answer.success
    assert answer.error_code == code
    assert words in answer.message


def test_goal_must_be_a_pose(cell, clients):
    """A goal whose quaternion is not of unit length is refused."""
    request = PlanHandover.Request(object_name="mug", has_goal=True)
    request.goal.pose.orientation.w = 0.0
    answer = ask(clients[0], request)
    assert answer.error_code == ErrorCode.BAD_REQUEST
    assert "goal" in answer.message


def test_motion_requests_are_checked(cell, clients):
    """Unknown postures, wrong lengths and both goals at once are refused; home is planned."""
    wait_until_plans(clients, object_name="mug")
    assert move(clients, arm="left", posture="upside_down").error_code == ErrorCode.UNKNOWN_NAME
    assert move(clients, arm="left", displacements=[0.0]).error_code == ErrorCode.BAD_REQUEST
    assert move(clients, arm="left", displacements=[float("nan")] * 7).error_code == ErrorCode.BAD_REQUEST
    assert move(clients, arm="left", posture="home", displacements=[0.0] * 7).error_code == ErrorCode.BAD_REQUEST
    assert move(clients, arm="left", posture="rest").success


def test_unseen_object_and_lost_person_are_named(cell, clients):
    """What is not seen, or no longer, is said with its age; the constant scheme works without a person."""
    wait_until_plans(clients, object_name="mug")
    objects, torso, arms = cell.objects, cell.torso, cell.arms
    try:
        cell.torso = None
        answer = wait_for(
            lambda: not (a := plan(clients, object_name="mug", scheme="relative")).success and a, PLANNING, "a refusal"
        )
        assert answer.error_code == ErrorCode.PERSON_NOT_TRACKED
        assert " s ago" in answer.message
        assert plan(clients, object_name="mug", scheme="constant").success
        cell.objects = {"plate": objects["plate"]}
        answer = wait_for(
            lambda: not (a := plan(clients, object_name="mug", scheme="constant")).success and a, PLANNING, "a refusal"
        )
        assert answer.error_code == ErrorCode.OBJECT_NOT_FOUND
        cell.arms = None
        answer = wait_for(
            lambda: (a := plan(clients, object_name="mug")).error_code == ErrorCode.STALE_DATA and a, PLANNING, "stale"
        )
        assert "joint_states" in answer.message
    finally:
        cell.objects, cell.torso, cell.arms = objects, torso, arms


def profile_of(name: str) -> Profile:
    """Return the profile of a simulated person, as a perfect calibration would store it."""
    report = CalibrationReport(1200, 300, 0.0, 0.001, 0.001, 1.0, (), (), (), ())
    skeleton = skeleton_of(load_person(name))
    return Profile(name, name.title(), "2026-01-31T12:00:00Z", "upper_body_24", "upper_body", skeleton, report)


def test_personal_scheme_follows_the_active_profile(cell, clients):
    """Without a profile the scheme says what to do; with one the plan is that person's, for another one another."""
    wait_until_plans(clients, object_name="mug")
    refusal = plan(clients, object_name="mug", scheme="personal")
    assert refusal.error_code == ErrorCode.BAD_REQUEST
    assert "calibrate" in refusal.message
    assert "relative" in refusal.message
    node, pictures = cell.graph.node, []
    subscription = node.create_subscription(MarkerArray, "planner/visual", pictures.append, LATCHED)
    plans = {}
    try:
        for name in ("adult", "strapped"):
            cell.activate(profile_of(name))
            answer = wait_for(
                lambda name=name: (
                    (a := plan(clients, object_name="mug", scheme="personal")).success
                    and a.plan.person_model == name
                    and a
                ),
                PLANNING,
                f"a plan for {name}",
            )
            assert "arm: elbow" in answer.message
            assert np.isfinite(answer.plan.expected_cost)
            plans[name] = transform_from_message(answer.plan.handover_pose)
            assert plans[name][2, 2] > 1.0 - 1e-6
        assert np.linalg.norm(plans["adult"][:3, 3] - plans["strapped"][:3, 3]) > 0.05
        drawn = [marker for marker in pictures[-1].markers if marker.ns == "expected_posture"]
        assert [len(marker.points) for marker in drawn] == [4]
        relative = plan(clients, object_name="mug", scheme="relative")
        assert relative.plan.person_model == ""
        assert np.isnan(relative.plan.expected_cost)
    finally:
        cell.activate(None)
        node.destroy_subscription(subscription)


def test_a_menu_is_proposed_and_a_chosen_handover_planned(cell, clients):
    wait_until_plans(clients, object_name="mug")

    def menu(**fields):
        return cell.graph.call(PlanMenu, "planner/plan_menu", PlanMenu.Request(**fields), PLANNING)

    proposed = menu(object_names=["mug", "u_lock"], count=3)
    assert proposed.success, proposed.message
    assert {each.object_name for each in proposed.menu} <= {"mug", "u_lock"}
    assert len({each.plan_id for each in proposed.menu}) == len(proposed.menu) >= 3
    assert all(not each.stages and len(each.grasp_probabilities) for each in proposed.menu)
    for each in proposed.menu:  # P(q | g) of the likeliest grasps
        count = len(each.posture_grasps)
        assert len(each.posture_arms) == len(each.posture_probabilities) == len(each.postures) / 7 == count > 0
        shares = np.bincount(each.posture_grasps, each.posture_probabilities)
        np.testing.assert_allclose(shares, 1.0, atol=1e-9)
        assert len(shares) <= len(each.grasp_regions)
    answers = [plan(clients, object_name=o.object_name, has_offer=True, offer=o) for o in proposed.menu]
    planned = [(a, o) for a, o in zip(answers, proposed.menu, strict=True) if a.success]
    assert planned, [answer.message for answer in answers]
    for answer, offer in planned:
        poses = [transform_from_message(each.handover_pose) for each in (answer.plan, offer)]
        np.testing.assert_allclose(*poses, atol=1e-9)
        assert answer.plan.arm == offer.arm
        assert [stage.name for stage in answer.plan.stages] == STAGES
    assert "anvil" in menu(object_names=["anvil"]).message
    assert menu(count=10_000).error_code == ErrorCode.BAD_REQUEST
    broken = planned[0][1]
    broken.handover_pose.position.x = float("nan")
    refused = plan(clients, object_name=broken.object_name, has_offer=True, offer=broken)
    assert (refused.success, "handover_pose" in refused.message) == (False, True)


def test_what_is_believed_of_the_person_changes_the_plan(cell, clients):
    """Somebody who likes an outstretched arm is offered things elsewhere; only the active person's belief counts."""
    wait_until_plans(clients, object_name="mug")
    publisher = cell.graph.node.create_publisher(BeliefSummary, "preferences/belief", LATCHED)

    def believe(profile_id, neutral):
        for_all = {f"{kind}_neutral": float_array(neutral) for kind in ("mean", "mode", "expected")}
        for_all |= {f"{kind}_weights": float_array(np.ones(7)) for kind in ("mean", "mode", "expected")}
        names = list(JOINT_NAMES)
        publisher.publish(BeliefSummary(profile_id=profile_id, observations=3, joint_names=names, **for_all))

    def hand_of():
        answer = plan(clients, object_name="mug", scheme="expected_cost")
        assert answer.success, answer.message
        return transform_from_message(answer.plan.handover_pose)[:3, 3]

    try:
        cell.activate(profile_of("adult"))
        wait_for(
            lambda: plan(clients, object_name="mug", scheme="personal").success, PLANNING, "the profile to be active"
        )
        generic = hand_of()
        believe("somebody_else", [1.2, 0.6, 0.0, 0.3, 0.0, 0.0, 0.0])
        np.testing.assert_allclose(hand_of(), generic, atol=1e-9)
        believe("adult", [1.2, 0.6, 0.0, 0.3, 0.0, 0.0, 0.0])
        wait_for(lambda: np.linalg.norm(hand_of() - generic) > 0.05, PLANNING, "another plan for another preference")
    finally:
        cell.activate(None)
        cell.graph.node.destroy_publisher(publisher)


def test_a_bad_profile_leaves_the_node_up(cell, clients):
    """A document that cannot be used is named in heartbeat and refusal; other schemes go on; a good one mends it."""
    beats = []
    subscription = cell.graph.node.create_subscription(
        Heartbeat,
        "cell/heartbeat",
        lambda beat: beats.append(beat) if beat.node == "planner_node" else None,
        SENSOR_PUBLISHER,
    )
    try:
        cell.profile_publisher.publish(ActiveProfile(document='{"format": "handover_ros profile", "version": 1}'))
        wait_for(lambda: beats and beats[-1].state == Heartbeat.DEGRADED, FIRST_CONTACT, "the degraded sentence")
        assert "calibration/active_profile" in beats[-1].summary
        refusal = plan(clients, object_name="mug", scheme="personal")
        assert refusal.error_code == ErrorCode.BAD_REQUEST
        assert "calibration/active_profile" in refusal.message
        assert plan(clients, object_name="mug", scheme="relative").success
        cell.activate(None)
        wait_for(lambda: beats[-1].state == Heartbeat.READY, FIRST_CONTACT, "the node to be ready again")
    finally:
        cell.activate(None)
        cell.graph.node.destroy_subscription(subscription)


def test_heart_beats_while_it_plans_and_requests_queue(cell, clients):
    """While plans are made, heartbeats go on, and a request that comes meanwhile is answered after the first."""
    wait_until_plans(clients, object_name="mug")
    beats = []
    subscription = cell.graph.node.create_subscription(
        Heartbeat, "cell/heartbeat", lambda _: beats.append(time.monotonic()), SENSOR_PUBLISHER
    )
    wait_for(lambda: len(beats) > 2, FIRST_CONTACT, "heartbeats")
    names = ("u_lock", "glass", "handlebars")
    futures = [clients[0].call_async(PlanHandover.Request(object_name=name)) for name in names]
    before = len(beats)
    wait_for(lambda: all(future.done() for future in futures), PLANNING, "three plans")
    assert [future.result().plan.object_name for future in futures] == list(names)
    assert len(beats) > before
    cell.graph.node.destroy_subscription(subscription)


def test_parameter_file_names_declared_parameters_only():
    """config/planner_node.yaml holds every declared parameter, with its default, and no other."""
    content = yaml.safe_load((config_directory() / "planner_node.yaml").read_text())
    assert content["planner_node"]["ros__parameters"] == {spec.name: spec.default for spec in PARAMETERS}


@pytest.mark.parametrize(
    ("name", "value"), [("scene", "nowhere"), ("time_budget", "-1.0"), ("body_mass", "0.0"), ("no_such_parameter", "1")]
)
def test_bad_parameters_end_the_node_with_one_line(name, value):
    """A wrong parameter ends the node with status 2 and one line."""
    with domain_coordinator.domain_id() as domain:
        process = NodeProcess("planner_node", domain, {name: value})
        assert process.wait(FIRST_CONTACT) == 2
        assert "error: " in process.text()
        assert "Traceback" not in process.text()
