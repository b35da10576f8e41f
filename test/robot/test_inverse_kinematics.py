"""Inverse kinematics: complete enough, exact, within limits, distinct, deterministic."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.errors import BadRequestError
from handover_ros.geometry import make_transform
from handover_ros.robot import InverseKinematics, RobotModel
from handover_ros.robot.inverse_kinematics import SEPARATION

ROBOT = RobotModel.load()
SOLVERS = {arm: InverseKinematics(ROBOT, arm) for arm in ROBOT.arm_names}
SEEDS = st.integers(0, 2**32 - 1)


def random_displacements(arm, rng):
    return rng.uniform(ROBOT.arm(arm).lower, ROBOT.arm(arm).upper)


def test_reachable_poses_are_solved():
    """Of poses that random configurations reach, 99.5 % are found."""
    rng = np.random.default_rng(7)
    tries = 1000
    missed = 0
    for i in range(tries):
        arm = ROBOT.arm_names[i % 2]
        missed += len(SOLVERS[arm].solve(ROBOT.gripper_pose(arm, random_displacements(arm, rng)))) == 0
    assert missed <= 0.005 * tries


@given(st.sampled_from(ROBOT.arm_names), SEEDS)
@settings(max_examples=60, deadline=None)
def test_solutions_are_exact_distinct_within_limits_and_sorted(arm, seed):
    rng = np.random.default_rng(seed)
    target = ROBOT.gripper_pose(arm, random_displacements(arm, rng))
    solver, model = SOLVERS[arm], ROBOT.arm(arm)
    solutions = solver.solve(target)
    for i, solution in enumerate(solutions):
        np.testing.assert_allclose(ROBOT.gripper_pose(arm, solution), target, atol=1e-5)
        assert np.all((solution >= model.lower) & (solution <= model.upper))
        assert all(np.max(np.abs(solution - other)) >= SEPARATION for other in solutions[:i])
    costs = solver.posture_cost(solutions, model.home)
    assert np.all(np.diff(costs) >= 0)
    np.testing.assert_array_equal(solutions, solver.solve(target))


@given(st.sampled_from(ROBOT.arm_names), SEEDS)
@settings(max_examples=40, deadline=None)
def test_a_pose_that_is_reached_is_never_called_too_far(arm, seed):
    """The quick test on the wrist's distance refuses no reachable pose."""
    q = random_displacements(arm, np.random.default_rng(seed))
    assert SOLVERS[arm].within_arm_length(ROBOT.gripper_pose(arm, q))


@given(st.sampled_from(ROBOT.arm_names), SEEDS)
@settings(max_examples=40, deadline=None)
def test_follow_stays_on_the_branch(arm, seed):
    """A small step of the pose gives a small step of the joints, away from limits and singularities."""
    rng = np.random.default_rng(seed)
    model = ROBOT.arm(arm)
    q = model.lower + rng.uniform(0.2, 0.8, 7) * (model.upper - model.lower)
    if np.linalg.svd(ROBOT.jacobian(arm, q))[1][-1] < 0.1:
        return
    target = ROBOT.gripper_pose(arm, q)
    target[:3, 3] += rng.uniform(-0.005, 0.005, 3)
    solution = SOLVERS[arm].follow(target, q)
    assert solution is not None
    assert np.max(np.abs(solution - q)) < 0.15


def test_poses_out_of_reach_have_no_solution():
    far = make_transform(np.eye(3), [3.0, 0.0, 1.0])
    assert SOLVERS["left"].solve(far).shape == (0, 7)
    assert not SOLVERS["left"].within_arm_length(far)


@pytest.mark.parametrize(
    "pose", [np.full((4, 4), np.nan), np.eye(3), np.diag([2.0, 1, 1, 1]), np.diag([-1.0, 1, 1, 1])]
)
def test_what_is_no_pose_is_refused(pose):
    with pytest.raises(BadRequestError, match="gripper pose"):
        SOLVERS["left"].solve(pose)
