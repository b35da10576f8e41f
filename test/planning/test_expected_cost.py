"""Schemes of expected cost in the lab cell: what they offer, what they say, what they refuse."""

from dataclasses import replace

import numpy as np
import pytest
from lab_cell import CATALOGUE, PATIENCE, PLANNER, SCENE, check_plan, snapshot, torso

from handover_ros.errors import BadRequestError, ErrorCode, InfeasibleError, StaleDataError, UnknownNameError
from handover_ros.geometry import invert_transform, make_transform, transform_from_xyz_rpy
from handover_ros.planning import HandoverRequest, TrackedPerson, load_scheme
from handover_ros.planning.explain import explain
from handover_ros.planning.goal_stance import placing_after_moving, placing_from
from handover_ros.planning.grasp_set import grasp_set
from handover_ros.planning.judge import judge
from handover_ros.planning.offers import HandoverTask, RobotSide
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.sim.person_spec import load_person

SCHEME = load_scheme("expected_cost")
BOXES = tuple((np.array(box.size), box.parent_from_solid) for box in PLANNER.motion.boxes)


def plan(name, goal="scene", **fields):
    where = SCENE.goals[name] if isinstance(goal, str) else goal
    request = HandoverRequest(name, "expected_cost", time_budget=PATIENCE, world_from_goal=where, **fields)
    return PLANNER.plan(request, snapshot())


def anywhere(name, goal=None, person=None, **fields):
    """A task with a robot that reaches everywhere."""
    grasps = np.concatenate([grasp.region.grid(0.05, 0.6) for grasp in CATALOGUE[name].robot_grasps])
    count = len(grasps)
    robot = RobotSide(
        grasps,
        PLANNER.grippers["left"],
        lambda poses: np.zeros((len(poses), count)),
        lambda poses, _: np.ones(len(poses), dtype=bool),
        lambda pose, index: True,
    )
    who = person or TrackedPerson(torso())
    return HandoverTask(CATALOGUE[name], np.eye(4), who, goal, boxes=BOXES, robot=robot, **fields)


@pytest.mark.parametrize("name", ["mug", "pitcher", "plate", "box"])
def test_plans_keep_every_promise_and_tell_how_the_person_chooses(name):
    """A plan of the scheme is a plan like any other, and its prediction is a distribution with finite costs."""
    found = plan(name)
    check_plan(found, snapshot())
    predicted = found.predicted
    assert predicted is not None
    total = sum(grasp.probability for grasp in predicted.grasps)
    assert total == pytest.approx(1.0, abs=1e-2)
    assert [g.probability for g in predicted.grasps] == sorted((g.probability for g in predicted.grasps), reverse=True)
    assert predicted.expected_cost == pytest.approx(predicted.hand_cost + predicted.goal_cost)
    assert np.isfinite(predicted.expected_cost)
    likely = predicted.grasps[0]
    assert set(likely.hands) == set(likely.limbs)
    assert len(likely.hands) == CATALOGUE[name].hands
    for side, hand in likely.hands.items():
        np.testing.assert_allclose(likely.limbs[side][3], hand[:3, 3], atol=1e-9)
    assert found.facing_region in found.explanation
    assert explain(predicted) in found.explanation


def test_the_same_request_gives_the_same_plan():
    first, second = plan("mug"), plan("mug")
    np.testing.assert_array_equal(first.world_from_object, second.world_from_object)
    assert first.predicted.expected_cost == second.predicted.expected_cost


@pytest.mark.parametrize("model", ["MN", "MP", "GN", "GP"])
def test_each_person_model_is_planned_for(model):
    found = SCHEME.offers(anywhere("mug", SCENE.goals["mug"], person_model=model))[0]
    assert found.predicted.person_model == model
    assert np.isfinite(found.predicted.expected_cost)


def test_what_a_scheme_chose_is_judged_as_it_was_chosen():
    """The judge, asked about the scheme's own offer, finds its expected cost; no other scheme's choice is cheaper."""
    task = anywhere("mug", SCENE.goals["mug"])
    offer = SCHEME.offers(task)[0]
    grasp = task.robot.object_from_gripper[offer.robot_grasp]
    assert judge(SCHEME, task, offer.world_from_object, grasp).expected_cost == pytest.approx(
        offer.predicted.expected_cost, rel=1e-9
    )
    for name in ("minimum_mean", "maximum_feasibility"):
        other = load_scheme(name).offers(task)[0]
        judged = judge(SCHEME, task, other.world_from_object, task.robot.object_from_gripper[other.robot_grasp])
        assert judged.expected_cost >= offer.predicted.expected_cost


def test_moving_everything_changes_no_cost():
    """Person, goal and tables moved together are the same problem."""
    moved = transform_from_xyz_rpy([0.7, -1.3, 0.2], [0.0, 0.0, 2.0])
    here = SCHEME.offers(anywhere("glass", SCENE.goals["glass"]))[0].predicted.expected_cost
    task = anywhere("glass", moved @ SCENE.goals["glass"], TrackedPerson(moved @ torso()))
    there = SCHEME.offers(replace(task, boxes=tuple((size, moved @ pose) for size, pose in BOXES)))[0]
    assert there.predicted.expected_cost == pytest.approx(here, rel=1e-3)


def test_a_shelf_at_the_goal_takes_grasps_away():
    """With a board close above the goal the object cannot be placed from above, but from the side."""
    goal = torso() @ transform_from_xyz_rpy([0.40, -0.15, -0.35], [0.0, 0.0, np.pi / 2.0])
    person = TrackedPerson(torso())
    taker, grasps = SCHEME.taker(CATALOGUE["mug"], person), grasp_set(CATALOGUE["mug"], ("right",))
    board = np.array([0.5, 0.5, 0.02]), goal @ make_transform(np.eye(3), [0.0, 0.0, 0.15])
    free, under = (placing_from(torso(), goal, taker, grasps, boxes, 10.0).table[:, 0] for boxes in ((), (board,)))
    top = np.array(grasps.grasp_regions) == "top"
    assert (free[top] > 0.0).any()
    assert not (under[top] > 0.0).any()
    assert (under <= free + 1e-9).all()


def test_moving_to_the_goal_makes_more_grasps_possible_and_none_impossible():
    goal = SCENE.goals["mug"]
    taker, grasps = SCHEME.taker(CATALOGUE["mug"], TrackedPerson(torso())), grasp_set(CATALOGUE["mug"], ("right",))
    staying = placing_from(torso(), goal, taker, grasps, BOXES, 10.0)
    moving = placing_after_moving(torso(), goal, taker, grasps, CATALOGUE["mug"], BOXES, 10.0)
    can_stay, can_move = staying.table[:, 0] > 0.0, moving.table[:, 0] > 0.0
    assert can_move.sum() > can_stay.sum()
    assert can_move[can_stay].all()


def test_the_calibrated_arm_and_the_dominant_hand_count():
    """A person with a profile is planned for with their own arms; a left-hander takes it with the left hand."""
    skeleton = skeleton_of(load_person("small"))
    costs = set()
    for person in (
        TrackedPerson(torso()),
        TrackedPerson(torso(), skeleton=skeleton, displacements=skeleton.middle),
        TrackedPerson(torso(), dominant="left"),
    ):
        predicted = SCHEME.offers(anywhere("glass", person=person))[0].predicted
        side = person.dominant or "right"
        assert all(set(grasp.hands) == {side} for grasp in predicted.grasps)
        costs.add(round(predicted.expected_cost, 6))
    assert len(costs) >= 2


def test_the_offer_keeps_its_distance_and_is_in_front():
    for offer in SCHEME.offers(anywhere("pitcher", SCENE.goals["pitcher"])):
        place = (invert_transform(torso()) @ offer.world_from_object)[:3, 3]
        assert 0.1 < place[0] < 0.9
        assert offer.world_from_object[2, 2] > 1.0 - 1e-9


def test_bad_requests_are_answered_in_words():
    with pytest.raises(StaleDataError, match="not tracked") as stale:
        SCHEME.offers(replace(anywhere("mug"), person=None))
    assert stale.value.code is ErrorCode.PERSON_NOT_TRACKED
    with pytest.raises(BadRequestError, match="robot's grasps"):
        SCHEME.offers(replace(anywhere("mug"), robot=None))
    with pytest.raises(UnknownNameError, match="GN, GP, MN, MP"):
        SCHEME.offers(anywhere("mug", person_model="XX"))
    far = torso() @ transform_from_xyz_rpy([0.3, 0.0, 3.0])
    with pytest.raises(InfeasibleError, match=r"of 60 grasps the gripper blocks .* out of the person's reach"):
        SCHEME.offers(anywhere("mug", far))
    task = anywhere("mug")
    deaf = replace(task.robot, reachable=lambda pose, index: False)
    with pytest.raises(InfeasibleError, match="the robot would collide there"):
        SCHEME.offers(replace(task, robot=deaf))
