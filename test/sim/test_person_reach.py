"""The person's choice of hand, grasp and posture."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from person_cell import WORLD_FROM_FEET

from handover_ros.geometry import transform_from_xyz_rpy
from handover_ros.objects import load_catalogue
from handover_ros.sim.person_kinematics import PersonKinematics
from handover_ros.sim.person_posture import PostureFinder
from handover_ros.sim.person_reach import GraspChooser, clearance
from handover_ros.sim.person_spec import ARM_SLICE, load_person

BASE = np.zeros(6)


@cache
def chooser(name: str):
    person = load_person(name)
    kinematics = PersonKinematics(person, WORLD_FROM_FEET)
    finder = PostureFinder(kinematics)
    return person, kinematics, finder, GraspChooser(finder)


@cache
def thing(name: str):
    return load_catalogue()[name]


@given(
    x=st.floats(0.9, 1.1),
    y=st.floats(-0.25, 0.25),
    z=st.floats(0.95, 1.3),
    yaw=st.floats(-3.1, 3.1),
    name=st.sampled_from(["mug", "glass", "u_lock", "handlebars"]),
)
@settings(max_examples=25, deadline=None)
def test_the_posture_puts_the_hand_into_a_region_within_the_limits(x, y, z, yaw, name):
    person, kinematics, _, choose = chooser("adult")
    pose = transform_from_xyz_rpy((x, y, z), (0.0, 0.0, yaw))
    taking = choose.choose(thing(name), pose, None, [], person.standing, BASE)
    assert taking is not None
    displacements = taking.posture.displacements
    assert np.all(displacements[6:] >= person.lower[6:])
    assert np.all(displacements[6:] <= person.upper[6:])
    reached = kinematics.forward(displacements)
    regions = {region.name: region for region in thing(name).human_grasps}
    for grasp in taking.grasps:
        hand = getattr(reached, f"{grasp.hand}_hand")
        assert np.allclose(hand, pose @ grasp.object_from_hand, atol=1e-6)
        as_right = grasp.object_from_hand @ (np.eye(4) if grasp.hand == "right" else np.diag([-1.0, -1.0, 1.0, 1.0]))
        metres, radians = regions[grasp.region].distance(as_right)
        assert metres < 1e-9
        assert radians < 1e-6


def test_two_hands_take_two_regions_apart():
    person, _kinematics, _, choose = chooser("adult")
    pose = transform_from_xyz_rpy((1.0, 0.0, 1.05))
    taking = choose.choose(thing("box"), pose, None, [], person.standing, BASE)
    assert taking is not None
    assert {grasp.hand for grasp in taking.grasps} == {"right", "left"}
    assert len({grasp.region for grasp in taking.grasps}) == 2


def test_a_gripper_in_the_way_changes_the_grasp():
    """The hand keeps clear of the gripper as long as another grasp is within reach."""
    person, _kinematics, _, choose = chooser("adult")
    pose = transform_from_xyz_rpy((1.0, 0.0, 1.1))
    for gripper in (
        pose @ transform_from_xyz_rpy((0.0, 0.0, 0.09), (np.pi, 0.0, 0.0)),
        pose @ transform_from_xyz_rpy((0.0, 0.0, 0.04), (0.0, np.pi / 2, 0.0)),
    ):
        taking = choose.choose(thing("mug"), pose, None, [gripper], person.standing, BASE)
        assert taking is not None
        hand = pose @ taking.grasps[0].object_from_hand
        assert clearance(hand[None], gripper)[0] >= 0.0


def test_the_strap_makes_the_trunk_turn():
    """Bestick 2017, section 2.2: with the arm strapped, an offer that fits a free arm costs rotation of the trunk."""
    side = transform_from_xyz_rpy((1.02, 0.32, 1.12))
    turned = {}
    for name in ("adult", "restricted"):
        person, _kinematics, finder, _ = chooser(name)
        hand = side @ transform_from_xyz_rpy((0, 0, 0), (-np.pi / 2, 0.0, 0.0))
        hand[:3, :3] = np.column_stack([[-1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, -1.0, 0.0]])
        posture = finder.best(person.standing, BASE, {"right": hand})
        turned[name] = np.inf if posture is None else abs(posture.torso_offset[3])
    assert turned["restricted"] > turned["adult"] + 0.1


def test_the_other_hand_is_used_when_the_dominant_one_cannot():
    person, _, _, choose = chooser("restricted")
    pose = transform_from_xyz_rpy((0.98, -0.15, 1.15))
    taking = choose.choose(thing("glass"), pose, None, [], person.standing, BASE)
    assert taking is not None
    assert taking.grasps[0].hand == "left"


def test_what_is_far_away_is_not_taken():
    person, _, _, choose = chooser("adult")
    far = transform_from_xyz_rpy((-0.5, 0.0, 1.1))
    assert choose.choose(thing("mug"), far, None, [], person.standing, BASE) is None


def test_the_choice_is_noisy_rational_and_repeats_with_the_seed():
    """The best grasp is the most frequent one; the same generator chooses the same."""
    person, _, _, choose = chooser("adult")
    pose = transform_from_xyz_rpy((1.0, 0.0, 1.1))

    def pick(rng):
        taking = choose.choose(thing("mug"), pose, None, [], person.standing, BASE, rng)
        return taking.grasps[0].hand, taking.grasps[0].region

    best = pick(None)
    first = [pick(np.random.default_rng(seed)) for seed in range(30)]
    assert first[:8] == [pick(np.random.default_rng(seed)) for seed in range(8)]
    counts = {option: first.count(option) for option in first}
    assert max(counts, key=lambda option: counts[option]) == best


@pytest.mark.parametrize("hand", ["right", "left"])
def test_following_a_path_stays_within_the_limits_and_on_it(hand):
    person, kinematics, finder, _ = chooser("adult")
    side = -1.0 if hand == "right" else 1.0
    neutral = kinematics.forward(person.neutral)
    start = getattr(neutral, f"{hand}_hand")
    path = np.tile(start, (10, 1, 1))
    path[:, 0, 3] -= np.linspace(0.0, 0.06, 10)
    path[:, 1, 3] -= side * np.linspace(0.0, 0.02, 10)
    swivel = kinematics.swivel(hand, person.neutral[ARM_SLICE[hand]])
    arms = finder.follow(hand, np.zeros((10, 6)), path, np.full(10, swivel))
    assert np.isfinite(arms).all()
    assert np.all(arms >= person.lower[ARM_SLICE[hand]])
    for arm, pose in zip(arms, path, strict=True):
        assert np.allclose(kinematics.torso_pose(np.zeros(6)) @ kinematics.arm_pose(hand, arm), pose, atol=1e-6)
