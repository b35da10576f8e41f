"""preference_node alone: learns, stores, chooses; survives bad requests and kill -9."""

from dataclasses import dataclass, field
from pathlib import Path

import domain_coordinator
import numpy as np
import pytest
import yaml
from geometry_msgs.msg import PoseWithCovariance
from graph import ANSWER, FIRST_CONTACT, REPOSITORY, Graph, NodeProcess, wait_for
from handover_msgs.msg import ActiveProfile, BeliefSummary, GraspChoice, HandoverPlan, SkeletonState
from handover_msgs.srv import AddObservation, GetBelief, PlanMenu, SelectQuery
from profiles import report_of

from handover_ros.arm.model import JOINT_NAMES, arm_of
from handover_ros.errors import ErrorCode
from handover_ros.geometry import transform_from_xyz_rpy
from handover_ros.nodes.convert import float_array, pose_message
from handover_ros.nodes.convert_belief import preference_from_message
from handover_ros.nodes.convert_profile import active_profile_message
from handover_ros.nodes.preference_node import PARAMETERS
from handover_ros.nodes.runtime import LATCHED, SENSOR_PUBLISHER
from handover_ros.objects import load_object
from handover_ros.preferences.offered import offered_query
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.sim.person_spec import load_person
from handover_ros.skeleton.profile import Profile

pytestmark = pytest.mark.graph

TORSO = transform_from_xyz_rpy(np.array([1.0, 0.0, 1.4]), np.array([0.0, 0.0, np.pi]))
SKELETON = skeleton_of(load_person("adult"))
ARM = arm_of(SKELETON, "right")
GRIP = transform_from_xyz_rpy(np.array([0.0, 0.0, 0.25]), np.array([np.pi, 0.0, 0.0]))  # from above, far from the hand


def profile_named(name: str) -> Profile:
    return Profile(name, name, "2026-01-01T00:00:00Z", "simulated", "upper_body", SKELETON, report_of(SKELETON))


def pose_of(number: int) -> np.ndarray:
    """Return world_from_object of one of several offers."""
    place = np.array([0.45, -0.15 - 0.05 * (number % 3), -0.2])
    return TORSO @ transform_from_xyz_rpy(place, np.array([0.0, 0.0, 0.6 * number]))


def offer(number: int, name: str = "mug") -> HandoverPlan:
    return HandoverPlan(
        object_name=name,
        arm="left",
        handover_pose=pose_message(pose_of(number)),
        object_from_gripper=pose_message(GRIP),
    )


def choice(number: int, **fields) -> GraspChoice:
    """Return how somebody took the mug who always takes the first configuration."""
    query = offered_query(load_object("mug"), ARM, np.linalg.inv(TORSO) @ pose_of(number))
    given = {
        "handover_id": f"h{number}",
        "profile_id": "anna",
        "object_name": "mug",
        "hand": "right",
        "grasp_region": query.regions[query.region[0]],
        "handover_pose": pose_message(pose_of(number)),
        "torso": pose_message(TORSO),
        "joint_names": list(JOINT_NAMES),
        "displacements": float_array(query.configurations[0]),
        "covariance": float_array(np.ravel(1e-4 * np.eye(7))),
    }
    message = GraspChoice(**{**given, **fields})
    message.object_from_gripper.orientation.w = 0.0
    return message


@dataclass
class Bench:
    """The node under test, and who else it needs, played."""

    graph: Graph
    folder: Path
    node: NodeProcess | None = None
    beliefs: list[BeliefSummary] = field(default_factory=list)
    torso: np.ndarray | None = field(default_factory=lambda: TORSO)

    def __post_init__(self) -> None:
        own = self.graph.node
        self.profiles = own.create_publisher(ActiveProfile, "calibration/active_profile", LATCHED)
        self.choices = own.create_publisher(GraspChoice, "handover/grasp_choice", SENSOR_PUBLISHER)
        self.states = own.create_publisher(SkeletonState, "human/skeleton_state", SENSOR_PUBLISHER)
        own.create_subscription(BeliefSummary, "preferences/belief", self.beliefs.append, LATCHED)
        own.create_timer(0.05, self.publish)

    def publish(self) -> None:
        if self.torso is not None:
            state = SkeletonState(valid=True, torso=PoseWithCovariance(pose=pose_message(self.torso)))
            self.states.publish(state)

    def start(self) -> None:
        parameters = {"profile_directory": str(self.folder), "particles": 300}
        self.node = self.graph.start("preference_node", REPOSITORY / "config" / "preference_node.yaml", **parameters)
        self.beliefs.clear()
        wait_for(lambda: self.beliefs, FIRST_CONTACT, "the first belief")

    def activate(self, name: str | None) -> None:
        self.profiles.publish(active_profile_message(None if name is None else profile_named(name)))
        wait_for(
            lambda: self.beliefs and self.beliefs[-1].profile_id == (name or ""), FIRST_CONTACT, f"{name}'s belief"
        )

    def call(self, name: str, request):
        kind = {"add_observation": AddObservation, "select_query": SelectQuery}.get(name, GetBelief)
        return self.graph.call(kind, f"preferences/{name}", request)


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    with domain_coordinator.domain_id() as domain:
        graph = Graph(domain)
        try:
            made = Bench(graph, tmp_path_factory.mktemp("profiles"))
            made.start()
            yield made
            assert made.node.stop() == 0, made.node.text()
        finally:
            graph.close()


@pytest.fixture
def anna(bench):
    """Anna is active and nothing is believed of her."""
    bench.activate("anna")
    assert bench.call("reset_belief", GetBelief.Request()).success
    return bench


def test_without_a_person_everything_is_answered(bench):
    bench.activate(None)
    for name, request in (
        ("get_belief", GetBelief.Request()),
        ("save_belief", GetBelief.Request()),
        ("add_observation", AddObservation.Request(choice=choice(0))),
        ("select_query", SelectQuery.Request(menu=[offer(0)])),
    ):
        answer = bench.call(name, request)
        assert not answer.success
        assert "no profile is active" in answer.message


def test_an_answer_is_taken_in_once_and_published(anna):
    first = anna.call("get_belief", GetBelief.Request()).belief
    answer = anna.call("add_observation", AddObservation.Request(choice=choice(1)))
    assert answer.success, answer.message
    assert answer.belief.observations == 1
    assert answer.belief.entropy < first.entropy
    again = anna.call("add_observation", AddObservation.Request(choice=choice(1)))
    assert again.success
    assert "counted before" in again.message
    assert again.belief.observations == 1
    wait_for(lambda: anna.beliefs[-1].observations == 1, ANSWER, "the belief to be published")
    for kind in ("mean", "mode", "expected"):
        preference = preference_from_message(anna.beliefs[-1], kind)
        assert (preference.weights > 0.0).all()


def test_choices_of_the_executive_are_taken_in(anna):
    anna.choices.publish(choice(2))
    wait_for(lambda: anna.beliefs[-1].observations == 1, ANSWER, "the choice to be taken in")
    region_only = choice(3, joint_names=[], displacements=[], covariance=[])
    anna.choices.publish(region_only)
    wait_for(lambda: anna.beliefs[-1].observations == 2, ANSWER, "the region to be taken in")


def test_bad_answers_change_nothing(anna):
    assert anna.call("add_observation", AddObservation.Request(choice=choice(4))).success
    before = anna.call("get_belief", GetBelief.Request()).belief
    unknown = choice(5)
    unknown.torso.orientation.w = 0.0
    unknown.torso.orientation.z = 0.0
    for bad, words in (
        (choice(5, displacements=float_array(np.full(7, np.nan))), "finite"),
        (choice(5, displacements=float_array(np.full(7, 3.0))), "not an answer"),
        (choice(5, displacements=float_array(np.zeros(3))), "displacements|numbers|shape"),
        (choice(5, joint_names=["elbow"]), "joint_names"),
        (choice(5, hand="third"), "hand"),
        (choice(5, object_name="anvil"), "anvil"),
        (choice(5, object_name="box"), "two hands"),
        (choice(5, profile_id="bert"), "active person"),
        (choice(5, handover_id=""), "handover_id"),
        (unknown, "torso"),
    ):
        answer = anna.call("add_observation", AddObservation.Request(choice=bad))
        assert not answer.success
        assert answer.error_code
        assert any(word in answer.message for word in words.split("|")), answer.message
        anna.choices.publish(bad)
    after = anna.call("get_belief", GetBelief.Request()).belief
    assert after.observations == before.observations == 1
    assert after.mean == before.mean


def test_a_killed_node_has_every_accepted_answer(anna):
    for number in range(3):
        assert anna.call("add_observation", AddObservation.Request(choice=choice(number))).success
    before = anna.call("get_belief", GetBelief.Request()).belief
    anna.node.process.kill()
    anna.node.wait(10.0)
    anna.start()
    anna.activate("anna")
    after = anna.call("get_belief", GetBelief.Request()).belief
    assert (after.observations, after.mean, after.entropy) == (before.observations, before.mean, before.entropy)
    again = anna.call("add_observation", AddObservation.Request(choice=choice(0)))
    assert "counted before" in again.message


def test_a_damaged_file_is_said_and_kept(anna):
    assert anna.call("add_observation", AddObservation.Request(choice=choice(0))).success
    path = anna.folder / "beliefs" / "anna.npz"
    path.write_bytes(path.read_bytes()[:500])
    anna.activate("bert")
    anna.activate("anna")
    assert "cut short" in anna.beliefs[-1].problem
    answer = anna.call("add_observation", AddObservation.Request(choice=choice(1)))
    assert not answer.success
    assert answer.error_code == ErrorCode.BAD_MODEL
    assert path.stat().st_size == 500
    assert anna.call("reset_belief", GetBelief.Request()).success
    assert anna.call("add_observation", AddObservation.Request(choice=choice(1))).success


@pytest.mark.parametrize("strategy", ["", "active", "active_grid", "passive", "random", "hybrid"])
def test_a_menu_is_chosen_from(anna, strategy):
    menu = [offer(0), offer(1, "u_lock"), offer(2)]
    answer = anna.call("select_query", SelectQuery.Request(strategy=strategy, menu=menu, information_weight=0.5))
    assert answer.success, answer.message
    assert answer.plan == menu[answer.chosen]
    assert len(answer.expected_information) == len(answer.expected_cost) == 3
    assert np.isfinite(answer.expected_information[answer.chosen])


def test_bad_menus_are_refused(anna):
    broken = offer(0)
    broken.handover_pose.position.x = float("nan")
    for request, words in (
        (SelectQuery.Request(menu=[offer(0)], strategy="clever"), "strategy"),
        (SelectQuery.Request(menu=[broken]), "handover_pose"),
        (SelectQuery.Request(menu=[offer(0, "anvil")]), "anvil"),
        (SelectQuery.Request(menu=[offer(0)], strategy="hybrid", information_weight=2.0), "information_weight"),
        (SelectQuery.Request(menu=[offer(0)], profile_id="bert"), "active person"),
    ):
        answer = anna.call("select_query", request)
        assert not answer.success
        assert words in answer.message
    anna.torso = None
    try:
        answer = anna.call("select_query", SelectQuery.Request(menu=[offer(0)]))
        assert answer.error_code == ErrorCode.PERSON_NOT_TRACKED
    finally:
        anna.torso = TORSO


def test_an_empty_menu_is_the_planner_s(anna):
    """And without a planner there is a clear answer."""
    asked = []

    def propose(request, response):
        asked.append(request)
        response.success, response.menu = True, [offer(0), offer(1)]
        return response

    service = anna.graph.on_executor(anna.graph.node.create_service, PlanMenu, "planner/plan_menu", propose)
    answer = anna.call("select_query", SelectQuery.Request(object_names=["mug"], count=2))
    assert answer.success, answer.message
    assert len(answer.menu) == 2
    assert (list(asked[0].object_names), asked[0].count) == (["mug"], 2)
    anna.graph.on_executor(anna.graph.node.destroy_service, service)
    answer = anna.call("select_query", SelectQuery.Request(object_names=["mug"]))
    assert not answer.success
    assert "planner/plan_menu is not there" in answer.message


def test_the_yaml_names_every_parameter_with_its_default():
    written = yaml.safe_load((REPOSITORY / "config" / "preference_node.yaml").read_text())
    declared = {spec.name: spec.default for spec in PARAMETERS}
    assert written == {"preference_node": {"ros__parameters": declared}}
    assert all(spec.description for spec in PARAMETERS)
