"""The optimiser: the online search against the grid that looks at every pose, and what any answer must hold."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from handover_ros.arm.model import load_arm
from handover_ros.ergonomics.arm_costs import Preference, SquaredDistance
from handover_ros.geometry import transform_from_xyz_rpy
from handover_ros.objects import load_object
from handover_ros.planning.candidate_pool import BEYOND_ARM, IN_THE_WAY
from handover_ros.planning.choice import MEAN, MEASURE, GoalCosts, person_model
from handover_ros.planning.feasible import Taker, statistics
from handover_ros.planning.grasp_set import grasp_set
from handover_ros.planning.gripper_blocks import free_grasps
from handover_ros.planning.objectives import OBJECTIVES
from handover_ros.planning.optimiser import SearchSettings, exhaustive, search, suggested
from handover_ros.planning.pose_space import PoseSpace
from handover_ros.planning.problem import FROM_PERSON, Problem
from handover_ros.robot import RobotGeometry, RobotModel
from handover_ros.robot.gripper_points import gripper_points

OBJECTS = ["mug", "glass", "pitcher", "plate"]
POINTS = gripper_points(RobotGeometry(RobotModel.load()), "left")
PREFERENCE = Preference()
GOALS = {
    "none": None,
    "ahead": transform_from_xyz_rpy([0.42, -0.15, -0.30], [0.0, 0.0, 0.0]),
    "turned": transform_from_xyz_rpy([0.40, -0.25, -0.30], [0.0, 0.0, 2.2]),
    "overhead": transform_from_xyz_rpy([0.35, -0.20, 0.20], [0.0, 0.0, -1.5]),
    "upside down": transform_from_xyz_rpy([0.40, -0.20, -0.15], [np.pi, 0.0, 0.5]),
}
GRIDS = {True: (0.09, 0.5), False: (0.18, 1.05)}  # upright: x, y, z, turn only [m, rad]
PATIENCE = 5.0  # [s] for what takes milliseconds


@dataclass
class Arm:
    """A robot whose length and reach are given functions; it counts what it is asked."""

    reaches: Callable = lambda pose, row: True
    within: Callable = lambda poses, rows: np.ones((len(poses), rows), dtype=bool)
    grasps: int = 0
    asked: list = field(default_factory=list)
    looked_at: list = field(default_factory=list)  # asked about kinematics only

    def stretches(self, torso_from_object):
        return np.where(self.within(torso_from_object, self.grasps), 0.0, np.inf)

    def kinematic(self, torso_from_object, robot_grasps):
        self.looked_at += list(zip(torso_from_object, robot_grasps.tolist(), strict=True))
        return np.ones(len(torso_from_object), dtype=bool)

    def reachable(self, torso_from_object, robot_grasp):
        self.asked.append((torso_from_object, robot_grasp))
        return self.reaches(torso_from_object, robot_grasp)


def arm_for(given, **functions):
    return Arm(grasps=len(given.object_from_gripper), **functions)


def problem(name, goal="none", person="MN", objective="expected_cost", sides=("right",), reject=None):
    """Return what is to be decided for a generic adult; ``reject``: grasps of the person that are left out."""
    model, arms = load_object(name), {side: load_arm(side=side) for side in sides}
    grippers = np.concatenate([grasp.region.grid(0.05, 0.6) for grasp in model.robot_grasps])
    grasps = grasp_set(model, sides)
    free = free_grasps(POINTS, grippers, grasps)
    kept = free.any(axis=0) if reject is None else free.any(axis=0) & ~reject(grasps)
    grasps, free = grasps.subset(kept), free[:, kept]
    taker = Taker(arms, {side: SquaredDistance(PREFERENCE) for side in sides})
    choice = person_model(person)
    goal_costs = GoalCosts()
    if GOALS[goal] is not None:
        table = statistics(taker, grasps, GOALS[goal], choice.rationality)[0]
        placing = table[:, MEASURE] > 0.0
        goal_costs = GoalCosts(table, 2.0 * float(table[placing, MEAN].max(initial=1.0)))
    return Problem(
        model=model,
        grasps=grasps,
        object_from_gripper=grippers,
        free=free,
        taker=taker,
        choice=choice,
        goal=goal_costs,
        objective=OBJECTIVES[objective],
        space=PoseSpace(),
        comfortable=tuple(arms[side].hand_pose(PREFERENCE.neutral) for side in sides),
    )


def check(given, report):
    """Assert what every candidate must hold."""
    space, model = given.space, given.model
    low, high = space.bounds(model)
    values = [candidate.value for candidate in report.candidates]
    assert values == sorted(values)
    places = {candidate.point.tobytes() for candidate in report.candidates}
    assert len(places) == len(values)
    for candidate in report.candidates:
        point, pose, grasp = candidate.point, candidate.torso_from_object, candidate.robot_grasp
        assert ((point >= low) & (point <= high)).all()
        np.testing.assert_allclose(space.transforms(model, point[None])[0], pose, atol=1e-12)
        assert space.allowed(model, pose[None])[0]
        assert (pose[:3, :3] @ given.object_from_gripper[grasp, :3, 2])[0] <= FROM_PERSON
        table = statistics(given.taker, given.grasps, pose, given.choice.hand_rationality)
        np.testing.assert_array_equal(table[0], candidate.table)
        value = given.objective(table, given.goal, given.choice, given.free[grasp][None])[0, 0]
        assert value == pytest.approx(candidate.value, rel=1e-12)
        assert np.isfinite(value)


@pytest.mark.parametrize(("name", "goal"), [(name, goal) for name in OBJECTS for goal in GOALS])
def test_search_is_at_least_as_good_as_every_pose_of_a_grid(name, goal):
    """The online mode, with some hundred poses, finds what a grid of thousands does not beat (MN, expected cost)."""
    given = problem(name, goal)
    found = search(given)
    oracle = exhaustive(given, None, *GRIDS[given.model.keep_upright])
    check(given, found)
    check(given, oracle)
    assert len(oracle.candidates) == 1
    assert found.poses < oracle.poses / 3
    assert found.candidates[0].value <= oracle.candidates[0].value + 1e-9


@pytest.mark.parametrize("person", ["MP", "GN", "GP"])
@pytest.mark.parametrize("objective", sorted(OBJECTIVES))
def test_answers_hold_for_every_person_and_objective(objective, person):
    """Every candidate's value is the objective of its table, pose and robot grasp, finite and allowed."""
    given = problem("mug", "ahead", person, objective)
    report = search(given)
    check(given, report)
    assert 1 <= len(report.candidates) <= 4


@pytest.mark.parametrize(("name", "sides"), [("mug", ("right", "left")), ("box", ("right", "left"))])
def test_two_hands_and_either_hand(name, sides):
    """Answers hold also where two arms may take part, or must."""
    given = problem(name, sides=sides)
    report = search(given)
    check(given, report)
    assert report.candidates


def test_a_hand_whose_grasps_are_all_blocked():
    """Where one hand has no grasp left the search goes on with the other."""
    both = problem("mug", sides=("right", "left"), reject=lambda grasps: grasps.hands[:, 1] >= 0)
    report = search(both)
    check(both, report)
    assert report.candidates[0].value == pytest.approx(search(problem("mug")).candidates[0].value, rel=0.05)


@pytest.mark.parametrize("name", ["mug", "plate"])
def test_the_same_seed_finds_the_same(name):
    """Searches are deterministic; another seed looks elsewhere."""
    given = problem(name, "ahead")
    first, second = search(given), search(given)
    assert [c.value for c in first.candidates] == [c.value for c in second.candidates]
    for a, b in zip(first.candidates, second.candidates, strict=True):
        np.testing.assert_array_equal(a.point, b.point)
        assert a.robot_grasp == b.robot_grasp
    assert first.poses == second.poses
    assert first.refused == second.refused
    other = search(given, settings=SearchSettings(seed=1))
    assert any(a.point.tolist() != b.point.tolist() for a, b in zip(first.candidates, other.candidates))


@pytest.mark.parametrize("mode", [search, exhaustive])
def test_a_robot_that_reaches_nothing_has_no_candidate(mode):
    """The counts say that it was the robot, and how often it was asked."""
    given = replace(problem("glass"), space=PoseSpace(lower=(0.4, -0.3, -0.3), upper=(0.5, -0.1, -0.2)))
    arm = arm_for(given, reaches=lambda pose, row: False)
    report = mode(given, arm)
    assert report.candidates == []
    assert report.robot_checks == len(arm.asked) + len(arm.looked_at) > 0
    assert 0 < report.refused[IN_THE_WAY] <= len(arm.asked)  # with each of the grasps to be tried


@pytest.mark.parametrize("mode", [search, exhaustive])
def test_a_robot_with_too_short_an_arm_is_not_asked(mode):
    """Where no grasp is within its length there is nothing to ask, and the counts say so."""
    given = problem("glass")
    arm = arm_for(given, within=lambda poses, rows: np.zeros((len(poses), rows), dtype=bool))
    report = mode(given, arm)
    assert report.candidates == []
    assert report.robot_checks == len(arm.asked) + len(arm.looked_at) == 0
    assert report.refused[BEYOND_ARM] > 0


HALVES = {
    "asked": {"reaches": lambda pose, row: bool(pose[1, 3] > -0.05)},
    "by length": {"within": lambda poses, rows: np.tile(poses[:, 1, 3:] > -0.05, (1, rows))},
}


@pytest.mark.parametrize("how", HALVES)
def test_a_robot_that_reaches_half_the_space_gets_candidates_there(how):
    """Only poses with the object to the left are taken, although the right is more comfortable."""
    given = problem("mug")
    free = search(given)
    assert free.candidates[0].point[1] < -0.05
    report = search(given, arm_for(given, **HALVES[how]))
    check(given, report)
    assert report.candidates
    assert all(c.torso_from_object[1, 3] > -0.05 for c in report.candidates)
    assert report.candidates[0].value >= free.candidates[0].value
    grid = exhaustive(given, arm_for(given, **HALVES[how]), *GRIDS[True])
    check(given, grid)
    assert grid.candidates[0].torso_from_object[1, 3] > -0.05


def test_half_the_space_within_its_length_is_searched_as_well_as_the_whole():
    """What the length tells needs no questions, so that the search is not worse than the grid there either."""
    given = problem("mug")
    found, grid = (mode(given, arm_for(given, **HALVES["by length"])) for mode in (search, exhaustive))
    assert found.candidates[0].value <= grid.candidates[0].value + 1e-9


def test_the_robot_is_asked_about_grasps_that_come_from_its_side():
    """Each question is a pose and a robot grasp within its length whose gripper does not come from the person."""
    given = problem("mug")
    arm = arm_for(given, within=lambda poses, rows: np.tile(np.arange(rows) % 2 == 0, (len(poses), 1)))
    arm.reaches = lambda pose, row: len(arm.asked) % 3 == 0
    report = search(given, arm)
    check(given, report)
    for pose, row in arm.asked + arm.looked_at:
        assert row % 2 == 0
        assert (pose[:3, :3] @ given.object_from_gripper[row, :3, 2])[0] <= FROM_PERSON
    assert report.robot_checks == len(arm.asked) + len(arm.looked_at)
    reached = {(pose.tobytes(), row) for pose, row in arm.asked}
    assert all((c.torso_from_object.tobytes(), c.robot_grasp) in reached for c in report.candidates)


@pytest.mark.parametrize("budget", [0.0, 1e-9, 0.02])
@pytest.mark.parametrize("reaches", [True, False, None])
def test_a_small_budget_answers_at_once(budget, reaches):
    """The best so far, or nothing where the robot reaches nothing; it does not hang, and says that it was stopped."""
    given = problem("plate", "ahead")
    search(given)  # compiled and cached
    started = time.monotonic()
    report = search(given, None if reaches is None else arm_for(given, reaches=lambda pose, row: reaches), budget)
    assert time.monotonic() - started < PATIENCE
    check(given, report)
    if budget < 0.01:
        assert report.stopped
    assert bool(report.candidates) == (reaches is not False)


def test_a_slow_robot_does_not_outlast_the_budget_by_more_than_one_question():
    """After the deadline each round of questions ends with the one under way."""
    given = problem("glass")
    started = time.monotonic()
    arm = arm_for(given, reaches=lambda pose, row: time.sleep(0.1))
    report = search(given, arm, budget=0.25)
    assert time.monotonic() - started < PATIENCE
    assert len(arm.asked) <= 12
    assert report.stopped


def test_more_candidates_begin_with_the_same():
    """wanted bounds their number; the first is the best of all."""
    given = problem("pitcher")
    few, many = search(given, wanted=1), search(given, wanted=30)
    assert len(few.candidates) == 1
    assert len(many.candidates) == 30
    assert few.candidates[0].value == many.candidates[0].value


def test_nobody_in_reach_gives_no_candidate():
    """Where the arm cannot reach any pose of the space the counts tell, and the search ends."""
    given = problem("glass")
    far = replace(given, space=PoseSpace(lower=(0.95, -0.1, -0.2), upper=(1.2, 0.1, -0.1)))
    report = search(far)
    assert report.candidates == []
    assert report.refused["no grasp in the person's reach"] > 0
    assert report.robot_checks == 0


def test_blocked_grasps_give_no_candidate_to_a_perfect_person():
    """A robot that leaves no grasp free has nothing to offer, to noisy and perfect persons alike."""
    for person in ("MN", "MP", "GP"):
        given = problem("glass", person=person)
        nothing = replace(given, free=np.zeros_like(given.free))
        assert search(nothing).candidates == []


@pytest.mark.parametrize("name", OBJECTS)
def test_suggested_poses_put_grasps_into_a_comfortable_hand(name):
    """Each grasp once, the hand where it is comfortable unless the bounds forbid; what may lean has its very pose."""
    given = problem(name)
    points = suggested(given)
    assert points.shape == (len(given.grasps), 6)
    low, high = given.space.bounds(given.model)
    assert ((points >= low) & (points <= high)).all()
    poses = given.space.transforms(given.model, points)
    hands = poses @ given.grasps.poses[0]
    inside = (points[:, :3] > low[:3]).all(axis=1) & (points[:, :3] < high[:3]).all(axis=1)
    assert inside.any()
    wanted = given.comfortable[0]
    np.testing.assert_allclose(hands[inside, :3, 3], np.tile(wanted[:3, 3], (inside.sum(), 1)), atol=1e-9)
    if not given.model.keep_upright:
        np.testing.assert_allclose(hands[inside], np.tile(wanted, (inside.sum(), 1, 1)), atol=1e-6)


def test_rounds_need_as_many_lengths_as_angles():
    """Settings that do not fit together are an error, not a shorter search."""
    with pytest.raises(ValueError, match="zip"):
        search(problem("glass"), settings=SearchSettings(lengths=(0.1, 0.05), angles=(0.5,)))
