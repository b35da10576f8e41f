"""Single motions: home, back to the table, out of tight places."""

import numpy as np
import pytest
from lab_cell import PATIENCE, PLANNER, ROBOT, SCENE, snapshot, torso

from handover_ros.errors import BadRequestError, ErrorCode, InfeasibleError, UnknownNameError
from handover_ros.geometry import invert_transform, make_transform
from handover_ros.planning import HandoverRequest, TrackedPerson
from handover_ros.robot import Reason

MOTION = PLANNER.motion
HOME = np.array(ROBOT.arm("left").home)


@pytest.fixture(scope="module")
def offered():
    """A plan for the mug, and the cell with the mug held at the offer."""
    cell = snapshot()
    made = PLANNER.plan(HandoverRequest("mug", time_budget=PATIENCE), cell)
    at_offer = made.stage("present").trajectory.positions[-1]
    return made, snapshot(
        arms={**cell.arms, made.arm: at_offer},
        objects={**cell.objects, "mug": made.world_from_object},
        gripping=frozenset([made.arm]),
    )


def distances(trajectory, arm, cell, checker):
    points = trajectory.sample(np.linspace(0, trajectory.duration, 60))[0]
    return [checker.distance(ROBOT.configuration({**cell.arms, arm: point})) for point in points]


def test_rest_and_home_are_reached_without_collision():
    cell = snapshot()
    trajectory = MOTION.motion("left", ROBOT.arm("left").posture("rest"), cell)
    np.testing.assert_allclose(trajectory.positions[[0, -1]], [HOME, ROBOT.arm("left").posture("rest")], atol=1e-9)
    assert min(distances(trajectory, "left", cell, MOTION.checker("left", cell))) > 0.0


def test_held_object_is_put_back_where_it_was(offered):
    """The way back ends with the object at its old place, and never hits anything but its support."""
    made, cell = offered
    trajectory = MOTION.put_back(made.arm, "mug", SCENE.placements["mug"], cell)
    end = ROBOT.gripper_pose(made.arm, trajectory.positions[-1])
    np.testing.assert_allclose(end @ invert_transform(made.object_from_gripper), SCENE.placements["mug"], atol=1e-4)
    checker = MOTION.checker(
        made.arm, cell, MOTION.held_object(made.arm, "mug", invert_transform(made.object_from_gripper))
    )
    whole = ROBOT.configuration({**cell.arms, made.arm: trajectory.positions[-1]})
    checker.ignore_support(whole)
    assert min(distances(trajectory, made.arm, cell, checker)) > 0.0


def test_after_putting_back_the_arm_draws_back_and_goes_home(offered):
    made, cell = offered
    down = MOTION.put_back(made.arm, "mug", SCENE.placements["mug"], cell).positions[-1]
    released = snapshot(arms={**cell.arms, made.arm: down})
    trajectory = MOTION.motion(made.arm, ROBOT.arm(made.arm).home, released)
    start, later = (ROBOT.gripper_pose(made.arm, trajectory.sample(t)[0]) for t in (0.0, 0.3))
    moved = later[:3, 3] - start[:3, 3]
    assert moved @ start[:3, 2] < 0.0
    assert np.linalg.norm(np.cross(moved, start[:3, 2])) < 0.02 * np.linalg.norm(moved) + 1e-3


def test_what_the_closed_gripper_holds_is_carried_along(offered):
    """A request that forgets the held object is planned with it all the same."""
    made, cell = offered
    assert MOTION.held_by(made.arm, cell) == "mug"
    other = next(arm for arm in ROBOT.arm_names if arm != made.arm)
    assert MOTION.held_by(other, cell) == ""
    assert MOTION.held_by(made.arm, snapshot(arms=cell.arms, objects=cell.objects)) == ""
    trajectory = MOTION.motion(made.arm, ROBOT.arm(made.arm).home, cell)
    held = MOTION.held_object(made.arm, "mug", invert_transform(made.object_from_gripper))
    assert min(distances(trajectory, made.arm, cell, MOTION.checker(made.arm, cell, held))) > 0.0


def test_an_arm_can_leave_a_person_who_came_close():
    """Within the keep-out distance at the start, the arm still moves away, and never nearer than it was."""
    reach = ROBOT.gripper_pose("left", HOME)[:3, 3]
    near = torso()
    near[:3, 3] = reach[0] + 0.36, reach[1], 1.4
    cell = snapshot(person=TrackedPerson(near))
    checker = MOTION.checker("left", cell)
    start = checker.distance(ROBOT.configuration(cell.arms), Reason.PERSON)
    assert 0.01 < start < MOTION.settings.person_distance
    goal = HOME.copy()
    goal[0] += 0.4
    trajectory = MOTION.motion("left", goal, cell)
    points = trajectory.sample(np.linspace(0, trajectory.duration, 40))[0]
    least = min(checker.distance(ROBOT.configuration({**cell.arms, "left": p}), Reason.PERSON) for p in points)
    assert least > start - 0.01


def test_goals_in_collision_are_refused_with_the_reason():
    into_table = MOTION.reaches["left"].inverse_kinematics.solve(
        make_transform(np.diag([1.0, -1.0, -1.0]), [0.55, 0.75, 0.70]), wanted=1
    )[0]
    with pytest.raises(InfeasibleError, match="left_table") as caught:
        MOTION.motion("left", into_table, snapshot(objects={}))
    assert caught.value.code is ErrorCode.IN_COLLISION


def test_goals_are_checked():
    with pytest.raises(BadRequestError, match="left_s0"):
        MOTION.motion("left", HOME + [9, 0, 0, 0, 0, 0, 0], snapshot())
    with pytest.raises(UnknownNameError):
        MOTION.motion("third", HOME, snapshot())
    with pytest.raises(UnknownNameError):
        MOTION.motion("left", HOME, snapshot(), "teapot")
    with pytest.raises(InfeasibleError, match="not seen"):
        MOTION.motion("left", HOME, snapshot(objects={}), "mug")
    with pytest.raises(BadRequestError, match="not known"):
        MOTION.motion("left", HOME, snapshot(arms={}))


def test_a_place_out_of_reach_is_refused(offered):
    made, cell = offered
    with pytest.raises(InfeasibleError, match="put mug back"):
        MOTION.put_back(made.arm, "mug", make_transform(np.eye(3), [4.0, 0.0, 0.7]), cell)
