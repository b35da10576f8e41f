"""Whole handovers in the lab scene."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lab_cell import CATALOGUE, PATIENCE, PLANNER, ROBOT, SCENE, check_plan, snapshot, torso

from handover_ros.errors import ErrorCode, InfeasibleError, StaleDataError, UnknownNameError
from handover_ros.geometry import invert_transform, transform_from_xyz_rpy
from handover_ros.planning import HandoverRequest, TrackedPerson

STAGES = ["approach", "grasp", "lift", "present", "retract"]


def plan(name, cell=None, **fields):
    return PLANNER.plan(HandoverRequest(name, time_budget=PATIENCE, **fields), cell or snapshot())


@pytest.mark.parametrize("scheme", ["constant", "relative"])
@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_every_object_can_be_handed_over_from_its_place(name, scheme):
    """All shipped objects, at the scheme's own position, within all limits, with what leaves the person's hand free."""
    cell = snapshot()
    made = plan(name, cell, scheme=scheme)
    assert made.nominal
    assert made.scheme == scheme
    assert [stage.name for stage in made.stages] == STAGES
    check_plan(made, cell)
    apart = np.linalg.norm(made.world_from_gripper[:3, 3] - made.world_from_hand[:3, 3])
    assert apart >= PLANNER.motion.settings.hand_clearance


@given(st.floats(-0.1, 0.1), st.floats(-0.12, 0.12), st.floats(-0.4, 0.4), st.floats(1.25, 1.5))
@settings(max_examples=5, deadline=None)
def test_the_offer_follows_the_person(x, y, yaw, height):
    """Wherever the person stands within some decimetres, the mug comes in front of the torso, handle first, upright."""
    cell = snapshot(person=TrackedPerson(torso(x, y, yaw, height)))
    made = plan("mug", cell)
    check_plan(made, cell)
    seen = invert_transform(cell.world_from_torso) @ made.world_from_object
    np.testing.assert_allclose(seen[:2, 3], [0.5, 0.0], atol=0.12)
    assert made.world_from_object[2, 2] > 0.999
    assert made.facing_region.startswith("handle")


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_a_person_who_sways_a_little_is_always_handed_something(name):
    """The best offers lie at the edge of the robot's reach, where it must still be able to draw back."""
    draw = np.random.default_rng(3)
    for _ in range(5):
        shift, turns = draw.normal(0.0, 0.003, 3), draw.normal(0.0, 0.004, 3)
        world_from_torso = torso() @ transform_from_xyz_rpy(shift, turns)
        cell = snapshot(person=TrackedPerson(world_from_torso))
        made = plan(name, cell, scheme="expected_cost", world_from_goal=SCENE.goals.get(name))
        check_plan(made, cell)


@pytest.mark.parametrize("name", [name for name in sorted(CATALOGUE) if CATALOGUE[name].keep_upright])
def test_open_containers_stay_upright_on_the_way(name):
    """Lifted and presented, they lean no more than the limit, between the knots too."""
    made = plan(name)
    gripper_from_object = invert_transform(made.object_from_gripper)
    for stage in ("lift", "present"):
        trajectory = made.stage(stage).trajectory
        for point in trajectory.sample(np.linspace(0, trajectory.duration, 60))[0]:
            up = (ROBOT.gripper_pose(made.arm, point) @ gripper_from_object)[2, 2]
            assert np.arccos(np.clip(up, -1, 1)) <= PLANNER.motion.settings.tilt_limit + 0.05


def test_the_gripper_opens_before_and_closes_on_the_object():
    made = plan("mug")
    arm = ROBOT.arm(made.arm)
    width = next(g.width for g in CATALOGUE["mug"].robot_grasps if g.region.name == made.robot_grasp)
    assert made.stage("approach").opening == arm.opening[1]
    assert arm.opening[0] <= made.stage("grasp").opening < width
    assert np.isnan(made.stage("present").opening)


def test_the_same_request_gives_the_same_plan():
    """Search is seeded and limited by samples, not by time."""
    first, second = plan("u_lock"), plan("u_lock")
    for a, b in zip(first.stages, second.stages, strict=True):
        np.testing.assert_array_equal(a.trajectory.positions, b.trajectory.positions)


def test_goal_travels_along():
    goal = SCENE.goals["mug"]
    np.testing.assert_array_equal(plan("mug", world_from_goal=goal).world_from_goal, goal)


def test_an_object_in_the_gripper_is_not_fetched_again():
    """With the mug in the closed gripper above the table, the plan begins with presenting."""
    cell = snapshot()
    made = plan("mug", cell)
    lifted = made.stage("lift").trajectory.positions[-1]
    pose = ROBOT.gripper_pose(made.arm, lifted) @ invert_transform(made.object_from_gripper)
    holding = snapshot(
        arms={**cell.arms, made.arm: lifted},
        objects={**cell.objects, "mug": pose},
        gripping=frozenset([made.arm]),
    )
    again = plan("mug", holding)
    assert [stage.name for stage in again.stages] == ["present", "retract"]
    check_plan(again, holding)
    with pytest.raises(InfeasibleError, match="holds mug") as caught:
        plan("glass", holding, arm=made.arm)
    assert caught.value.code is ErrorCode.BUSY


def test_an_open_hand_at_the_object_draws_back_first():
    """From the grasp posture with open fingers the plan first leaves the object, then fetches it again."""
    cell = snapshot()
    made = plan("mug", cell)
    at_grasp = snapshot(arms={**cell.arms, made.arm: made.stage("grasp").trajectory.positions[-1]})
    again = plan("mug", at_grasp)
    assert [stage.name for stage in again.stages] == STAGES
    np.testing.assert_allclose(again.stages[0].trajectory.positions[0], at_grasp.arms[made.arm], atol=1e-9)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"object_name": "teapot"}, "mug"),
        ({"object_name": "mug", "scheme": "telepathic"}, "constant, expected_cost, .*, relative"),
        ({"object_name": "mug", "arm": "third"}, "left, right"),
    ],
)
def test_unknown_names_list_the_known(fields, words):
    with pytest.raises(UnknownNameError, match=words):
        PLANNER.plan(HandoverRequest(**fields), snapshot())


def test_what_is_not_seen_cannot_be_fetched():
    with pytest.raises(InfeasibleError, match="not seen; seen: plate") as caught:
        plan("mug", snapshot(objects={"plate": SCENE.placements["plate"]}))
    assert caught.value.code is ErrorCode.OBJECT_NOT_FOUND


def test_the_relative_scheme_needs_the_person():
    nobody = snapshot(person=None)
    with pytest.raises(StaleDataError, match="not tracked"):
        plan("mug", nobody)
    check = plan("mug", nobody, scheme="constant")
    assert check.nominal


def test_refusals_say_why():
    """A person out of reach, an object out of reach and a grasp too wide have each their own sentence."""
    with pytest.raises(InfeasibleError, match="out of reach") as far:
        plan("mug", snapshot(person=TrackedPerson(torso(x=-2.0))))
    assert far.value.code is ErrorCode.NOT_REACHABLE
    away = {**SCENE.placements, "mug": transform_from_xyz_rpy([3.0, 0.0, 0.72])}
    with pytest.raises(InfeasibleError, match="cannot pick up mug") as lost:
        plan("mug", snapshot(objects=away))
    assert lost.value.code is ErrorCode.NOT_REACHABLE
    with pytest.raises(InfeasibleError, match="opening"):
        plan("mug", arm="right")


def test_a_person_at_the_robot_is_not_touched():
    """When the person stands where the arm would have to go, the plan is refused for the collision."""
    with pytest.raises(InfeasibleError) as caught:
        plan("mug", snapshot(person=TrackedPerson(torso(x=0.75))), scheme="constant")
    assert caught.value.code in (ErrorCode.IN_COLLISION, ErrorCode.NO_PATH)
    assert "person" in str(caught.value)
