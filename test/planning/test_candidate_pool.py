"""The pool of candidates: neighbours struck out as plainly told, doubtful poses kept if the robot gets there."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.arm.model import load_arm
from handover_ros.ergonomics.arm_costs import Preference, SquaredDistance
from handover_ros.objects.catalogue import load_object
from handover_ros.planning.candidate_pool import CandidatePool
from handover_ros.planning.choice import GoalCosts, person_model
from handover_ros.planning.feasible import Taker
from handover_ros.planning.grasp_set import grasp_set
from handover_ros.planning.neighbour_kernels import strike
from handover_ros.planning.objectives import OBJECTIVES
from handover_ros.planning.pose_space import PoseSpace
from handover_ros.planning.problem import Problem, SearchReport

SEEDS = st.integers(0, 2**32 - 1)
PREFERENCE = Preference()


@given(SEEDS, st.floats(0.0, 0.5), st.floats(0.0, 3.5), st.integers(-1, 2))
@settings(max_examples=80, deadline=None)
def test_what_lies_beside_a_pose_is_struck_out(seed, apart, turned, kind):
    """Row by row: every coordinate within its bound, angles the short way round; one column or all."""
    rng = np.random.default_rng(seed)
    points = np.concatenate([rng.uniform(-0.5, 0.5, (40, 3)), rng.uniform(-np.pi, np.pi, (40, 3))], axis=1)
    left = rng.random((40, 3)) < 0.7
    expected = left.copy()
    for row, point in enumerate(points):
        steps = [abs(a - b) for a, b in zip(point, points[0])]
        turns = [min(step, 2.0 * np.pi - step) for step in steps[3:]]
        if max(steps[:3]) <= apart and max(turns) <= turned:
            expected[row, slice(None) if kind < 0 else kind] = False
    strike(points, points[0], apart, turned, kind, left)
    np.testing.assert_array_equal(left, expected)


class LeftArm:
    """A robot that gets to poses to the left of the person with every third grasp only."""

    def __init__(self, grasps):
        self.grasps = grasps

    def stretches(self, torso_from_object):
        return np.tile(np.arange(self.grasps, dtype=float), (len(torso_from_object), 1))

    def kinematic(self, torso_from_object, robot_grasps):
        return (torso_from_object[:, 1, 3] > 0.0) & (robot_grasps % 3 == 0)

    def reachable(self, torso_from_object, robot_grasp):
        return bool(robot_grasp == 6)  # the others collide


@pytest.fixture(scope="module")
def problem():
    model, arm = load_object("glass"), load_arm()
    grasps = grasp_set(model, ("right",))
    grippers = np.concatenate([grasp.region.grid(0.05, 0.6) for grasp in model.robot_grasps])
    return Problem(
        model=model,
        grasps=grasps,
        object_from_gripper=grippers,
        free=np.ones((len(grippers), len(grasps)), dtype=bool),
        taker=Taker({"right": arm}, {"right": SquaredDistance(PREFERENCE)}),
        choice=person_model("MN"),
        goal=GoalCosts(),
        objective=OBJECTIVES["expected_cost"],
        space=PoseSpace(),
        comfortable=(arm.hand_pose(PREFERENCE.neutral),),
    )


def test_of_doubtful_poses_the_first_few_that_are_reached_are_looked_at(problem):
    robot = LeftArm(len(problem.object_from_gripper))
    points = problem.space.spread(problem.model, 128, 0)
    sure, doubtful = points[:10], points[10:]
    report = SearchReport()
    pool = CandidatePool(problem, robot, 3, report)
    pool.add(sure, doubtful, 20)
    assert report.poses == 30
    kept = [tuple(pool.point(entry)) for entry in range(len(pool._points))]
    poses = problem.space.transforms(problem.model, np.array(kept))
    asked = {tuple(point) for point in sure}
    assert all(pose[1, 3] > 0.0 for point, pose in zip(kept, poses) if point not in asked)
    nothing = CandidatePool(problem, robot, 3, SearchReport())
    nothing.add(np.empty((0, 6)), doubtful[:0], 20)
    assert not nothing.best(1, np.inf, 10)


def test_a_grasp_that_collides_leaves_the_others_to_be_tried(problem):
    """With all grasps alike the robot takes the one that is free, if it is among those to be tried."""
    robot = LeftArm(len(problem.object_from_gripper))
    robot.kinematic = lambda poses, rows: np.ones(len(poses), dtype=bool)
    for attempts in (3, len(problem.object_from_gripper)):
        pool = CandidatePool(problem, robot, attempts, SearchReport())
        pool.add(problem.space.spread(problem.model, 32, 0))
        entries = pool.best(3, np.inf, 100)
        assert all(pool.candidate(entry).robot_grasp == 6 for entry in entries)
        assert bool(entries) == (attempts > 6)
