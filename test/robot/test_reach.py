"""Reach: what can be reached is; what cannot is counted by its reason."""

import numpy as np
import pytest

from handover_ros.errors import ErrorCode
from handover_ros.geometry import make_transform
from handover_ros.robot import (
    CollisionChecker,
    InverseKinematics,
    Reach,
    Reason,
    Reasons,
    RobotGeometry,
    RobotModel,
    Solid,
    Surroundings,
)

ROBOT = RobotModel.load()
GEOMETRY = RobotGeometry(ROBOT)
REACH = Reach(ROBOT, "left", InverseKinematics(ROBOT, "left"))
HOME = ROBOT.configuration({})
POSE = ROBOT.gripper_pose("left", ROBOT.arm("left").home)


def solutions(pose, surroundings=None):
    reasons = Reasons()
    checker = CollisionChecker(GEOMETRY, surroundings or Surroundings(), "left")
    return REACH.solutions(pose, checker, HOME, reasons), reasons


def test_home_can_be_reached():
    found, _ = solutions(POSE)
    np.testing.assert_allclose(found[0], ROBOT.arm("left").home, atol=1e-4)


@pytest.mark.parametrize(
    ("pose", "around", "reason", "code"),
    [
        (make_transform(np.eye(3), [4.0, 0.0, 1.0]), Surroundings(), Reason.OUT_OF_REACH, ErrorCode.NOT_REACHABLE),
        (
            POSE,
            Surroundings(boxes=(Solid("wall", "box", (0.2, 0.2, 0.2), POSE),)),
            Reason.ENVIRONMENT,
            ErrorCode.IN_COLLISION,
        ),
    ],
)
def test_refusals_are_counted(pose, around, reason, code):
    found, reasons = solutions(pose, around)
    assert not found
    assert reasons.totals()[reason] > 0
    assert reasons.code is code
    assert reason.value in reasons.sentence()


def test_validity_is_limits_and_collisions():
    """Displacements outside the limits or in collision are not valid; the robot's other joints stand still."""
    valid = REACH.validity(CollisionChecker(GEOMETRY, Surroundings(), "left"), HOME)
    home = np.array(ROBOT.arm("left").home)
    assert valid(home)
    assert not valid(home + [9.0, 0, 0, 0, 0, 0, 0])
    blocked = Surroundings(boxes=(Solid("wall", "box", (0.2, 0.2, 0.2), POSE),))
    assert not REACH.validity(CollisionChecker(GEOMETRY, blocked, "left"), HOME)(home)


def test_no_refusals_is_said():
    assert Reasons().sentence() == "none refused"
    assert Reasons().code is ErrorCode.NO_PATH
