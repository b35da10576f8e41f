"""The closed form of a seven-joint arm: exact where its wrist has no offset, near enough elsewhere, never wrong."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.robot import InverseKinematics, RobotModel
from handover_ros.robot.closed_form_kernels import KEPT, starts_of, wrist_and_shoulder
from handover_ros.robot.kinematics_kernels import forward

ROBOT = RobotModel.load()
SOLVERS = {arm: InverseKinematics(ROBOT, arm) for arm in ROBOT.arm_names}
ARMS = st.sampled_from(ROBOT.arm_names)
SEEDS = st.integers(0, 2**32 - 1)


def chain_of(arm):
    return tuple(np.ascontiguousarray(part) for part in ROBOT.chain(arm))


def random_displacements(arm, seed):
    model = ROBOT.arm(arm)
    return np.random.default_rng(seed).uniform(model.planning_lower, model.planning_upper)


@given(ARMS, SEEDS)
@settings(max_examples=60, deadline=None)
def test_with_axis_five_through_the_wrist_it_is_exact(arm, seed):
    """The posture a pose came from is among the starts, to rounding, when its first joint is looked at."""
    axes, points, tip = chain_of(arm)
    points = points.copy()
    points[4] = points[5]  # no offset
    places = wrist_and_shoulder(axes, points)
    np.testing.assert_allclose(places[1], places[2], atol=1e-12)
    q, model = random_displacements(arm, seed), ROBOT.arm(arm)
    target = forward(axes, points, tip, q, np.empty((6, 7)))
    starts, rates = np.empty((KEPT, 7)), np.empty(KEPT)
    limits = model.planning_lower, model.planning_upper
    starts_of(axes, points, tip, *limits, places, target, q, q[:1].copy(), starts, rates, np.empty((16, 3)))
    np.testing.assert_allclose(starts[0], q, atol=1e-5)
    for start in starts[np.isfinite(rates)]:
        np.testing.assert_allclose(forward(axes, points, tip, start, np.empty((6, 7))), target, atol=1e-5)


@given(ARMS, SEEDS)
@settings(max_examples=60, deadline=None)
def test_quick_solutions_are_exact_and_within_limits(arm, seed):
    rng = np.random.default_rng(seed)
    targets = np.stack([ROBOT.gripper_pose(arm, random_displacements(arm, seed + n)) for n in range(8)])
    targets[:, :3, 3] += rng.uniform(-0.3, 0.3, size=(8, 3))
    found, solutions = SOLVERS[arm].quick_solutions(targets)
    np.testing.assert_array_equal(found, SOLVERS[arm].quick_many(targets))
    for target, solution in zip(targets[found], solutions[found]):
        np.testing.assert_allclose(ROBOT.gripper_pose(arm, solution), target, atol=2e-6)
        ROBOT.arm(arm).check(solution)


def test_of_poses_the_full_search_solves_few_are_missed():
    """The plain twin: a search from many starts. One or two in a hundred are the price of being quick."""
    rng = np.random.default_rng(5)
    for arm, solver in SOLVERS.items():
        targets = np.stack([ROBOT.gripper_pose(arm, random_displacements(arm, n)) for n in range(400)])
        targets[:, :3, 3] += rng.uniform(-0.2, 0.2, size=(400, 3))
        found = solver.quick_many(targets)
        solved = np.array([len(solver.solve(target, wanted=1)) > 0 for target in targets])
        assert (solved & ~found).sum() <= 0.02 * solved.sum()
        assert (found & ~solved).sum() <= 0.02 * solved.sum()


@pytest.mark.parametrize("joint", [1, 4, 5])
def test_other_arms_are_left_to_the_search(joint):
    """An arm whose axes do not meet so has no closed form, and is still solved."""
    axes, points, _ = chain_of("left")
    points = points.copy()
    points[joint] += 0.1 * np.cross(axes[joint], [0.3, -0.5, 0.8])
    assert wrist_and_shoulder(axes, points) is None
    assert wrist_and_shoulder(axes[:6], points[:6]) is None
    solver = InverseKinematics(ROBOT, "left")
    solver._places = None
    targets = np.stack([ROBOT.gripper_pose("left", random_displacements("left", n)) for n in range(20)])
    found, solutions = solver.quick_solutions(targets)
    assert found.mean() > 0.7
    for target, solution in zip(targets[found], solutions[found]):
        np.testing.assert_allclose(ROBOT.gripper_pose("left", solution), target, atol=2e-6)
