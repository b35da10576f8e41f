"""The personal scheme: this person's own preferred posture, wherever the person stands."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import ttest_rel
from upper_body import UpperBody

from handover_ros.arm.workspace import hand_workspace
from handover_ros.ergonomics.costs import COSTS, load_cost
from handover_ros.ergonomics.hand_targets import HandTarget
from handover_ros.ergonomics.posture import predict_posture
from handover_ros.errors import BadModelError, BadRequestError, ErrorCode, InfeasibleError, StaleDataError
from handover_ros.geometry import invert_transform, rotation_angle, transform_from_xyz_rpy, transform_points
from handover_ros.objects import load_catalogue, load_scene
from handover_ros.planning import PersonalScheme, TrackedPerson, load_scheme
from handover_ros.planning.facing import object_corners
from handover_ros.planning.offers import HandoverTask, levelled
from handover_ros.planning.personal import object_grasps
from handover_ros.planning.posture_words import posture_words
from handover_ros.planning.taking_postures import PostureSearch, body_distance
from handover_ros.robot import RobotModel
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.sim.person_spec import load_person
from handover_ros.skeleton.tree import WORLD

CATALOGUE = load_catalogue()
BASE = RobotModel.load().world_from_base
PERSONAL = load_scheme("personal")
ZONE = PERSONAL.zone
TORSO = transform_from_xyz_rpy([1.3, 0.1, 1.4], [0.0, 0.0, 3.0])
PEOPLE = {name: skeleton_of(load_person(name)) for name in ("adult", "restricted", "strapped")}
VOXEL = 0.04  # [m]


def stiff_elbow():
    """The adult, whose elbows bend little."""
    adult = PEOPLE["adult"]
    elbows = ["elbow" in name for name in adult.displacement_names]
    return adult.with_limits(adult.lower, np.where(elbows, 0.6, adult.upper))


PEOPLE["stiff"] = stiff_elbow()
WORKSPACES = {}


def workspace(name, side):
    if (name, side) not in WORKSPACES:
        WORKSPACES[name, side] = hand_workspace(PEOPLE[name], side, VOXEL)
    return WORKSPACES[name, side]


def with_content(**fields):
    return PersonalScheme("personal", PERSONAL.content.model_copy(update=fields))


def offers_for(name, thing, torso=TORSO, scheme=PERSONAL, **fields):
    return scheme.offers(HandoverTask(CATALOGUE[thing], BASE, TrackedPerson(torso, PEOPLE[name], **fields)))


def seen_from_torso(offer, torso=TORSO):
    return {side: invert_transform(torso) @ pose for side, pose in offer.expected.hands.items()}


@pytest.mark.parametrize("thing", sorted(CATALOGUE))
@pytest.mark.parametrize("name", sorted(PEOPLE))
def test_hands_are_in_the_workspace_in_front_of_the_body(name, thing):
    """Each expected hand is where that person's hand can be, at a sensible height, and nothing is near the body."""
    for offer in offers_for(name, thing)[::5]:
        for side, pose in seen_from_torso(offer).items():
            assert workspace(name, side).contains(pose[:3, 3]), (side, pose[:3, 3])
            assert ZONE.heights[0] - 1e-3 <= pose[2, 3] <= ZONE.heights[1] + 1e-3
            assert pose[0, 3] >= ZONE.in_front - 1e-3
        corners = transform_points(invert_transform(TORSO) @ offer.world_from_object, object_corners(CATALOGUE[thing]))
        assert body_distance(corners).min() >= ZONE.clearance - 1e-6


@pytest.mark.parametrize("thing", ["mug", "u_lock", "box"])
@pytest.mark.parametrize("name", sorted(PEOPLE))
def test_expected_posture_takes_the_object(name, thing):
    """The posture that is expected is within the limits and puts the hands on the object; posture prediction agrees."""
    skeleton = PEOPLE[name]
    first = offers_for(name, thing)[0]
    theta = first.expected.displacements
    assert np.all((theta >= skeleton.lower) & (theta <= skeleton.upper))
    targets = {side: HandTarget(pose) for side, pose in seen_from_torso(first).items()}
    cost = load_cost(PERSONAL.content.cost, skeleton, 75.0)
    answer = predict_posture(skeleton, cost, targets, start=theta, starts=6)
    assert answer.feasible
    assert answer.position_error < 1e-3
    assert answer.cost <= first.expected.cost + 2e-3
    # Prediction, free of the scheme's margin from the limits, finds nothing much cheaper on the same targets.
    assert answer.cost >= first.expected.cost - 0.05


def test_differently_limited_people_get_different_poses():
    """Adult, restricted, strapped and stiff-elbowed people are offered the mug and the box at other places."""
    for thing in ("mug", "box"):
        places = {name: offers_for(name, thing)[0].world_from_object[:3, 3] for name in PEOPLE}
        names = sorted(places)
        for row, name in enumerate(names):
            for other in names[row + 1 :]:
                assert np.linalg.norm(places[name] - places[other]) > 0.03, (thing, name, other)


@given(st.floats(0.5, 2.0), st.floats(-1.0, 1.0), st.floats(1.0, 1.6), st.floats(-np.pi, np.pi), st.floats(-0.3, 0.3))
@settings(deadline=None, max_examples=25)
def test_offers_move_with_the_person(x, y, z, yaw, lean):
    """Seen from the person's heading, the offers are the same wherever the person stands and however they lean."""
    moved = transform_from_xyz_rpy([x, y, z], [0.0, lean, yaw])
    for one, other in zip(offers_for("adult", "mug")[:20], offers_for("adult", "mug", moved)[:20], strict=True):
        frames = invert_transform(levelled(TORSO)), invert_transform(levelled(moved))
        np.testing.assert_allclose(frames[0] @ one.world_from_object, frames[1] @ other.world_from_object, atol=1e-9)
        np.testing.assert_allclose(frames[0] @ one.world_from_hand, frames[1] @ other.world_from_hand, atol=1e-9)
        assert one.expected.cost == other.expected.cost


@pytest.mark.parametrize("thing", [name for name in sorted(CATALOGUE) if CATALOGUE[name].keep_upright])
@pytest.mark.parametrize("name", ["adult", "strapped"])
def test_open_containers_are_upright(name, thing):
    assert all(offer.world_from_object[2, 2] > 1.0 - 1e-9 for offer in offers_for(name, thing))


@pytest.mark.parametrize("cost", sorted(COSTS))
@pytest.mark.parametrize("thing", ["mug", "box"])
def test_cheapest_first_under_every_cost(cost, thing):
    """Offers come in the order of their cost, and each cost is that of its posture."""
    offers = offers_for("adult", thing, scheme=with_content(cost=cost), body_mass=70.0)
    costs = [offer.expected.cost for offer in offers]
    assert costs == sorted(costs)
    assert offers[0].nominal
    judge = load_cost(cost, PEOPLE["adult"], 70.0)
    start = np.clip(np.zeros(14), PEOPLE["adult"].lower, PEOPLE["adult"].upper)
    for offer in offers[::10]:
        assert float(judge.evaluate(start, offer.expected.displacements)) == pytest.approx(
            offer.expected.cost, abs=1e-5
        )


def test_preferred_posture_itself_where_nothing_forbids_it():
    """An object that may lean, no zone: the hand is where the middle of the limits puts it (eq. 2.11), at no cost."""
    zone = PERSONAL.content.zone.model_copy(update={"heights": (-2.0, 2.0), "in_front": -2.0, "clearance": 0.0})
    skeleton = PEOPLE["adult"]
    first = offers_for("adult", "u_lock", scheme=with_content(zone=zone))[0]
    assert first.expected.cost == 0.0
    np.testing.assert_allclose(first.expected.displacements, skeleton.middle, atol=1e-9)


def test_two_hands_are_symmetric_for_a_symmetric_person():
    """Both palms are on the parcel's two ends, as mirror images for the adult, not for one whose arm is strapped."""
    box = CATALOGUE["box"]
    for name in ("adult", "strapped"):
        first = offers_for(name, "box")[0]
        hands = seen_from_torso(first)
        assert set(hands) == {"left", "right"}
        for side, pose in first.expected.hands.items():
            grip = invert_transform(first.world_from_object) @ pose
            ends = [region.centre()[:3, 3] for region in box.human_grasps]
            assert min(np.linalg.norm(grip[:3, 3] - end) for end in ends) < 1e-6
            # The palm looks to the other hand.
            other = first.expected.hands[{"left": "right", "right": "left"}[side]]
            assert pose[:3, 2] @ (other[:3, 3] - pose[:3, 3]) > 0.2
        mirrored = np.abs(hands["left"][:3, 3] * [1.0, -1.0, 1.0] - hands["right"][:3, 3]).max()
        assert (mirrored < 1e-3) == (name == "adult")


def test_hand_is_the_cheaper_or_the_dominant_one():
    """Equal arms: the dominant hand comes first. Scheme by dominant hand: that one as long as it can."""
    for dominant in ("left", "right"):
        assert set(offers_for("adult", "mug", dominant=dominant)[0].expected.hands) == {dominant}
    asked = offers_for("strapped", "plate", scheme=with_content(hand="dominant"), dominant="right")
    sides = [next(iter(offer.expected.hands)) for offer in asked]
    assert sides == sorted(sides, reverse=True)
    assert sides[0] == "right"


def test_the_same_person_gets_the_same_offers():
    """Nothing is random: another search of an equal skeleton finds the same."""
    again = replace(PEOPLE["restricted"])
    for thing in ("mug", "box"):
        first = offers_for("restricted", thing)
        second = PERSONAL.offers(HandoverTask(CATALOGUE[thing], BASE, TrackedPerson(TORSO, again)))
        assert len(first) == len(second)
        for one, other in zip(first, second, strict=True):
            np.testing.assert_array_equal(one.world_from_object, other.world_from_object)


def test_a_swaying_start_changes_nothing_and_another_start_does():
    """Where the arm is before matters to the costs of a reach, but not a few degrees."""
    scheme = with_content(cost="minimum_jerk")
    rest = np.zeros(14)
    rest[[3, 10]] = 0.2
    raised = rest.copy()
    raised[[0, 7]] = 1.0

    def first(start):
        return offers_for("adult", "mug", scheme=scheme, displacements=start)[0].world_from_object

    np.testing.assert_array_equal(first(rest), first(rest + 0.05))
    assert np.linalg.norm(first(rest)[:3, 3] - first(raised)[:3, 3]) > 0.05


def test_words_say_what_is_expected():
    names = PEOPLE["adult"].displacement_names
    theta = np.deg2rad([20.0, -12.0, 5.0, 75.0, 0.0, 0.0, 0.0, -30.0, 40.0, 0.0, 90.0, 0.0, 0.0, 0.0])
    assert (
        posture_words(names, theta, ("right", "left"))
        == "right arm: elbow 75 deg, shoulder 20 deg forward, shoulder 12 deg across the body; "
        "left arm: elbow 90 deg, shoulder 30 deg backward, shoulder 40 deg to the side"
    )
    assert offers_for("adult", "mug")[0].expected.words.startswith("right arm: elbow ")


def test_stick_figure_has_the_limbs_lengths():
    """Shoulder, elbow, wrist and grip are as far apart as the person's bones are long, the grip where the hand is."""
    lengths = load_person("adult").lengths
    for offer in offers_for("adult", "mug")[::20]:
        for side, points in offer.expected.limbs.items():
            bones = np.linalg.norm(np.diff(points, axis=0), axis=1)
            grip = np.hypot(lengths.grip_along, lengths.grip_out)
            np.testing.assert_allclose(bones, [lengths.upper_arm, lengths.forearm, grip], atol=1e-6)
            assert np.linalg.norm(points[3] - offer.expected.hands[side][:3, 3]) < 2e-3


# What cannot be


def test_nobody_and_nobody_calibrated_say_what_to_do():
    with pytest.raises(StaleDataError, match="not tracked") as caught:
        PERSONAL.offers(HandoverTask(CATALOGUE["mug"], BASE, None))
    assert caught.value.code is ErrorCode.PERSON_NOT_TRACKED
    with pytest.raises(BadRequestError, match=r"no profile is active: calibrate .* or choose scheme relative"):
        PERSONAL.offers(HandoverTask(CATALOGUE["mug"], BASE, TrackedPerson(TORSO)))
    with pytest.raises(BadRequestError, match="cut short"):
        PERSONAL.offers(HandoverTask(CATALOGUE["mug"], BASE, TrackedPerson(TORSO, profile_problem="it is cut short")))


def test_skeletons_that_cannot_be_used_are_named():
    adult = PEOPLE["adult"]
    hung = tuple(replace(joint, parent=WORLD) if joint.parent == "torso" else joint for joint in adult.joints[1:])
    fixed = replace(adult, joints=hung, marker_names=(), marker_segments=(), markers=np.zeros((0, 3)))
    unknown = adult.with_limits(adult.lower, np.where(np.arange(14) == 3, np.inf, adult.upper))
    for skeleton, words in (
        (replace(adult, hands=()), "no hands"),
        (fixed, "fixed to the world"),
        (unknown, "right_elbow_flexion"),
    ):
        with pytest.raises(BadModelError, match=words):
            PERSONAL.offers(HandoverTask(CATALOGUE["mug"], BASE, TrackedPerson(TORSO, skeleton)))
    one_handed = replace(adult, hands=adult.hands[:1])
    assert PERSONAL.offers(HandoverTask(CATALOGUE["mug"], BASE, TrackedPerson(TORSO, one_handed)))
    with pytest.raises(InfeasibleError, match="two hands") as caught:
        PERSONAL.offers(HandoverTask(CATALOGUE["box"], BASE, TrackedPerson(TORSO, one_handed)))
    assert caught.value.code is ErrorCode.NOT_FEASIBLE_FOR_PERSON


def test_a_person_who_cannot_raise_the_hands_is_told():
    adult = PEOPLE["adult"]
    hanging = adult.with_limits(np.zeros(14), np.full(14, 0.05))
    with pytest.raises(InfeasibleError, match="calibrate again") as caught:
        PERSONAL.offers(HandoverTask(CATALOGUE["mug"], BASE, TrackedPerson(TORSO, hanging)))
    assert caught.value.code is ErrorCode.NOT_FEASIBLE_FOR_PERSON


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"dominant": "third"}, "left or right"),
        ({"displacements": np.zeros(3)}, "displacements"),
        ({"displacements": np.full(14, np.nan)}, "displacements"),
    ],
)
def test_what_is_known_of_the_person_is_checked(fields, words):
    with pytest.raises(BadRequestError, match=words):
        TrackedPerson(TORSO, PEOPLE["adult"], **fields)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("cost: least_effort", "known: preferred_posture"),
        ("hand: third", "hand"),
        ("zone: {heights: [0.0, -0.5]}", "heights"),
        ("zone: {clearance: -1.0}", "zone.clearance"),
        ("alternatives: 0", "alternatives"),
    ],
)
def test_a_mistake_in_a_file_is_named(tmp_path, text, words):
    path = tmp_path / "mine.yaml"
    path.write_text(f"kind: personal\n{text}")
    with pytest.raises(BadModelError, match="mine") as caught:
        load_scheme(str(path))
    assert words in str(caught.value)


def test_a_two_handed_object_has_hands_of_both_sides():
    """Every way to hold the parcel has the right hand first, in one region, and the left in another."""
    grasps = object_grasps(CATALOGUE["box"], ("right", "left"), (0.0,))
    assert grasps
    assert {grasp.hold.sides for grasp in grasps} == {("right", "left")}
    assert {grasp.region for grasp in grasps} == {"left_end", "right_end"}
    search = PostureSearch(PEOPLE["adult"], "preferred_posture", 75.0, None, ZONE)
    for grasp, postures in zip(grasps, search.postures([g.hold for g in grasps], 5), strict=True):
        wanted = invert_transform(grasp.object_from_hands[0]) @ grasp.object_from_hands[1]
        for right, left in zip(postures.hands["right"], postures.hands["left"], strict=True):
            between = invert_transform(right) @ left
            assert np.linalg.norm(between[:3, 3] - wanted[:3, 3]) < 2e-3
            assert rotation_angle(between, wanted) < 5e-3


# The dissertation's claim, in the simulated people's own comfort

STANCES = ((0.0, 0.0, 0.0), (0.0, 0.1, -0.15), (0.0, -0.1, 0.15))  # x, y [m], yaw [rad] beside the scene's place


def torso_turns(name, scheme, things):
    """Return how far the torso turns [deg] for a scheme's first offers, taken with the dominant arm, or with both."""
    spec, place = load_person(name), load_scene("lab").person_pose
    body, turns = UpperBody(spec), []
    for x, y, yaw in STANCES:
        torso = place @ transform_from_xyz_rpy([x, y, spec.lengths.lumbar_height + spec.lengths.trunk], [0, 0, yaw])
        person = TrackedPerson(torso, PEOPLE[name], dominant=spec.dominant)
        for thing in things:
            model = CATALOGUE[thing]
            offer = scheme.offers(HandoverTask(model, BASE, person))[0]
            sides = ("right", "left") if model.hands == 2 else (spec.dominant,)
            taken = body.take(model, invert_transform(torso) @ offer.world_from_object, sides)
            assert taken.reached
            turns.append(taken.yaw)
    return np.array(turns)


def test_a_strapped_person_turns_less_for_personal_offers():
    """With the dominant arm strapped, the torso turns less for personal offers than for constant and relative ones;
    unrestricted there is no significant difference (paired t-tests, p < 0.05, as in the dissertation's section 2.3).
    """
    schemes = {
        "constant": load_scheme("constant"),
        "relative": load_scheme("relative"),
        "personal": with_content(hand="dominant"),
    }
    for name, differs in (("strapped", True), ("adult", False)):
        turns = {kind: torso_turns(name, scheme, sorted(CATALOGUE)) for kind, scheme in schemes.items()}
        for kind in ("constant", "relative"):
            assert (ttest_rel(turns[kind], turns["personal"]).pvalue < 0.05) == differs, (name, kind)
            assert not differs or turns[kind].mean() > turns["personal"].mean()
