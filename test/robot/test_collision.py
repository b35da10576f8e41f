"""Collision checks: they find what is there, and nothing else."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.geometry import make_transform, transform_from_xyz_rpy
from handover_ros.robot import CollisionChecker, HeldObject, Reason, RobotGeometry, RobotModel, Solid, Surroundings
from handover_ros.robot.shapes import person_solids

ROBOT = RobotModel.load()
GEOMETRY = RobotGeometry(ROBOT)
HOME = ROBOT.configuration({})
SEEDS = st.integers(0, 2**32 - 1)


def box(name, size, xyz):
    return Solid(name, "box", size, make_transform(np.eye(3), xyz))


def random_configuration(seed):
    rng = np.random.default_rng(seed)
    arms = {a: rng.uniform(ROBOT.arm(a).lower, ROBOT.arm(a).upper) for a in ROBOT.arm_names}
    return ROBOT.configuration(arms)


@pytest.mark.parametrize("posture", ["home", "rest"])
def test_named_postures_are_free(posture):
    """The shipped postures collide with nothing and can be left in all directions."""
    checker = CollisionChecker(GEOMETRY, Surroundings())
    configuration = ROBOT.configuration({arm: ROBOT.arm(arm).posture(posture) for arm in ROBOT.arm_names})
    assert checker.why(configuration) is None
    assert checker.distance(configuration) > 0.02


def test_a_good_share_of_random_configurations_is_free():
    """No pair is left in that collides by the URDF's design."""
    checker = CollisionChecker(GEOMETRY, Surroundings())
    assert np.mean([checker.is_free(random_configuration(seed)) for seed in range(300)]) > 0.4


def test_crossed_arms_collide():
    """Both grippers at the same place is a self-collision."""
    checker = CollisionChecker(GEOMETRY, Surroundings())
    arms = {"left": np.array(ROBOT.arm("left").home), "right": np.array(ROBOT.arm("right").home)}
    arms["left"][0] -= 0.5
    arms["right"][0] += 0.5
    reason, label = checker.why(ROBOT.configuration(arms))
    assert reason is Reason.SELF
    assert "left" in label
    assert "right" in label


@given(SEEDS)
@settings(max_examples=30, deadline=None)
def test_checks_agree_with_distances(seed):
    """Free means that every distance is at least the margin; the answers of is_free and why agree."""
    table = box("table", (0.7, 0.9, 0.03), (0.55, -0.95, 0.7))
    checker = CollisionChecker(GEOMETRY, Surroundings(boxes=(table,)))
    configuration = random_configuration(seed)
    free, distance = checker.is_free(configuration), checker.distance(configuration)
    assert free == (checker.why(configuration) is None)
    if abs(distance - GEOMETRY.margin) > 1e-3:
        assert free == (distance > GEOMETRY.margin)


@given(SEEDS)
@settings(max_examples=30, deadline=None)
def test_one_arm_checks_equal_whole_checks_when_the_other_is_free(seed):
    """Leaving out what the moving arm does not change does not change the answer."""
    rng = np.random.default_rng(seed)
    configuration = ROBOT.configuration({"left": rng.uniform(ROBOT.arm("left").lower, ROBOT.arm("left").upper)})
    around = Surroundings(boxes=(box("table", (0.7, 0.9, 0.03), (0.55, 0.95, 0.7)),))
    whole, one = CollisionChecker(GEOMETRY, around), CollisionChecker(GEOMETRY, around, "left")
    assert one.pairs < whole.pairs
    assert one.is_free(configuration) == whole.is_free(configuration)


@pytest.mark.parametrize("arm", ROBOT.arm_names)
def test_a_box_at_the_gripper_is_found_and_named(arm):
    place = ROBOT.gripper_pose(arm, ROBOT.arm(arm).home)[:3, 3]
    checker = CollisionChecker(GEOMETRY, Surroundings(boxes=(box("shelf", (0.1, 0.1, 0.1), place),)))
    assert checker.why(HOME) == (Reason.ENVIRONMENT, "shelf")


def test_touched_object_may_touch_the_hand_but_not_the_elbow():
    gripper = ROBOT.gripper_pose("left", ROBOT.arm("left").home)[:3, 3]
    cup = {"cup": (box("cup", (0.04, 0.04, 0.04), gripper),)}
    assert CollisionChecker(GEOMETRY, Surroundings(objects=cup)).why(HOME) == (Reason.OBJECT, "cup")
    touching = Surroundings(objects=cup, touched="cup", touching_arm="left")
    assert CollisionChecker(GEOMETRY, touching).why(HOME) is None
    other = Surroundings(objects=cup, touched="cup", touching_arm="right")
    assert CollisionChecker(GEOMETRY, other).why(HOME) is not None
    wall = {"cup": (box("cup", (2.0, 2.0, 0.1), (0.5, 0.0, 1.5)),)}
    assert CollisionChecker(GEOMETRY, Surroundings(objects=wall, touched="cup", touching_arm="left")).why(HOME)


def test_the_person_is_kept_at_a_distance():
    """Nearer than the keep-out distance is refused, farther is free."""
    reach = max(ROBOT.gripper_pose(arm, ROBOT.arm(arm).home)[0, 3] for arm in ROBOT.arm_names)
    far = transform_from_xyz_rpy([reach + 0.7, 0.2, 1.4], [0.0, 0.0, np.pi])
    near = transform_from_xyz_rpy([reach + 0.35, 0.2, 1.4], [0.0, 0.0, np.pi])
    distances = {}
    for name, torso in (("far", far), ("near", near)):
        checker = CollisionChecker(GEOMETRY, Surroundings(person=person_solids(torso), person_distance=0.2))
        distances[name] = checker.distance(HOME, Reason.PERSON), checker.why(HOME)
    assert distances["far"][0] > 0.2
    assert distances["far"][1] is None
    assert 0.0 < distances["near"][0] < 0.2
    assert distances["near"][1] == (Reason.PERSON, "person")


def held_bar(length):
    bar = Solid("bar", "box", (0.02, 0.02, length), make_transform(np.eye(3), [0.0, 0.0, length / 2.0]))
    return HeldObject("left", "bar", (bar,))


def test_held_object_is_part_of_the_arm():
    """What the gripper holds is checked against the scene; its own hand may touch it."""
    height = ROBOT.gripper_pose("left", ROBOT.arm("left").home)[2, 3]
    floor = box("floor", (4.0, 4.0, 0.02), (0.0, 0.0, height - 0.3))
    table = Surroundings(boxes=(floor,), held=held_bar(0.1))
    assert CollisionChecker(GEOMETRY, table, "left").why(HOME) is None
    long = Surroundings(boxes=(floor,), held=held_bar(0.4))
    assert CollisionChecker(GEOMETRY, long, "left").why(HOME) == (Reason.ENVIRONMENT, "bar and floor")


def test_support_may_be_left_but_not_entered():
    """After ignore_support the touching surface no longer counts; another one does."""
    height = ROBOT.gripper_pose("left", ROBOT.arm("left").home)[2, 3]
    floor = box("floor", (4.0, 4.0, 0.02), (0.0, 0.0, height - 0.11))
    checker = CollisionChecker(GEOMETRY, Surroundings(boxes=(floor,), held=held_bar(0.1)), "left")
    assert checker.why(HOME) is not None
    checker.ignore_support(HOME)
    assert checker.why(HOME) is None


def test_a_start_within_the_margin_may_be_left():
    """tolerate_start accepts where the robot stands, and still refuses to come nearer."""
    place = ROBOT.gripper_pose("left", ROBOT.arm("left").home)[:3, 3]
    shelf = box("shelf", (0.2, 0.2, 0.02), place - [0.0, 0.0, 0.0245])
    checker = CollisionChecker(GEOMETRY, Surroundings(boxes=(shelf,)), "left")
    assert checker.why(HOME) is not None
    assert checker.distance(HOME, Reason.ENVIRONMENT) > 0.003
    checker.tolerate_start(HOME)
    assert checker.why(HOME) is None
    lower = np.array(ROBOT.arm("left").home)
    lower[1] += 0.03
    assert checker.why(ROBOT.configuration({"left": lower})) is not None


@given(SEEDS)
@settings(max_examples=40, deadline=None)
def test_looking_at_near_pairs_only_changes_no_answer(seed):
    """Free is what has no problems, pair by pair: also after the object is held anew and pairs were dropped."""
    rng = np.random.default_rng(seed)
    boxes = tuple(box(f"box{i}", tuple(rng.uniform(0.05, 0.5, 3)), rng.uniform(-1.0, 1.0, 3)) for i in range(6))
    held = HeldObject("left", "thing", (box("thing", (0.1, 0.1, 0.3), (0.0, 0.0, 0.1)),))
    person = person_solids(make_transform(np.eye(3), rng.uniform([0.6, -0.5, 1.2], [1.4, 0.5, 1.5])))
    arm = ("left", "")[int(rng.integers(2))]
    checker = CollisionChecker(GEOMETRY, Surroundings(boxes=boxes, held=held, person=person), arm)

    def agrees():
        for _ in range(5):
            configuration = HOME.copy() if arm else random_configuration(int(rng.integers(2**31)))
            left = ROBOT.arm("left")
            configuration[ROBOT.arm_indices("left")] = rng.uniform(left.lower, left.upper)
            assert checker.is_free(configuration) == (not checker.problems(configuration))
        return configuration

    checker.tolerate_start(agrees())
    checker.ignore_support(agrees())
    checker.hold([box("thing", (0.1, 0.1, 0.3), tuple(rng.uniform(-0.3, 0.3, 3)))])
    agrees()
