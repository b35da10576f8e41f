"""Which grasps a gripper leaves to a person."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from handover_ros.geometry import invert_transform, make_transform, transform_from_xyz_rpy, transform_points
from handover_ros.objects import load_catalogue
from handover_ros.planning.grasp_set import grasp_set
from handover_ros.planning.gripper_blocks import HAND_BOXES, free_grasps
from handover_ros.robot import RobotGeometry, RobotModel
from handover_ros.robot.gripper_points import gripper_points

CATALOGUE = load_catalogue()
BOTH = ("right", "left")
POINTS = gripper_points(RobotGeometry(RobotModel.load()), "left")
seeds = st.integers(0, 10**6)


def plain_free(points, grippers, grasps):
    """Return which grasps are free: every hand of a grasp, against every robot grasp."""
    free = np.ones((len(grippers), len(grasps)), dtype=bool)
    for row, gripper in enumerate(grippers):
        for column in range(len(grasps)):
            for hand in grasps.hand_poses(column).values():
                placed = transform_points(invert_transform(hand) @ gripper, points)
                for centre, half in HAND_BOXES:
                    if (np.abs(placed - centre) <= half).all(axis=1).any():
                        free[row, column] = False
    return free


def robot_grasps(model):
    return np.concatenate([grasp.region.grid(0.05, 0.6) for grasp in model.robot_grasps])


@given(st.sampled_from(sorted(CATALOGUE)), seeds)
@settings(max_examples=40, deadline=None)
def test_free_is_what_the_plain_loop_finds_free(name, seed):
    """Random points as a gripper at random poses on any object, hands of both sides."""
    rng = np.random.default_rng(seed)
    grasps = grasp_set(CATALOGUE[name], BOTH, 0.08, 1.2)
    points = rng.normal(0.0, 0.06, (30, 3))
    grippers = np.stack(
        [make_transform(r.as_matrix(), rng.normal(0.0, 0.1, 3)) for r in Rotation.random(3, random_state=rng)]
    )
    np.testing.assert_array_equal(free_grasps(points, grippers, grasps), plain_free(points, grippers, grasps))


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_the_robots_own_gripper_agrees_with_the_plain_loop(name):
    """The robot's grasps on the objects of the catalogue; each leaves the person a grasp, and none blocks nothing."""
    model = CATALOGUE[name]
    grasps, grippers = grasp_set(model, BOTH, 0.08, 1.2), robot_grasps(model)[::3]
    free = free_grasps(POINTS, grippers, grasps)
    np.testing.assert_array_equal(free, plain_free(POINTS, grippers, grasps))
    assert free.any(axis=1).all()


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_a_gripper_far_away_blocks_nothing(name):
    """Two metres off."""
    grasps = grasp_set(CATALOGUE[name], BOTH)
    assert free_grasps(POINTS, [transform_from_xyz_rpy([2.0, 0.0, 0.0])], grasps).all()


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_a_gripper_at_the_hand_blocks_it(name):
    """A gripper where the hand would be leaves no room for it; one hand of two is enough."""
    grasps = grasp_set(CATALOGUE[name], BOTH)
    for index in range(0, len(grasps), 7):
        for hand in grasps.hand_poses(index).values():
            assert not free_grasps(POINTS, [hand], grasps)[0, index]


def test_a_mug_held_from_the_top_leaves_the_handle():
    """Some handle grasps and some around the body are free, those from the top are not; the robot at the handle's side
    blocks the handle."""
    model = CATALOGUE["mug"]
    grasps = grasp_set(model, ("right",))
    top = next(grasp.region for grasp in model.robot_grasps if grasp.region.name == "top")
    free = free_grasps(POINTS, [top.centre()], grasps)[0]
    left = {name for name, is_free in zip(grasps.grasp_regions, free) if is_free}
    assert "top" not in left
    assert left & {"handle_thumb_up", "handle_thumb_down"}
    assert "bottom" in left
    handle = next(region for region in model.human_grasps if region.name == "handle_thumb_up").centre()
    blocked = free_grasps(POINTS, [handle], grasps)[0]
    assert not any(free for name, free in zip(grasps.grasp_regions, blocked) if name.startswith("handle"))


def test_more_points_never_free_a_grasp():
    """A larger gripper leaves fewer grasps; one without points blocks none."""
    model = CATALOGUE["pitcher"]
    grasps, grippers = grasp_set(model, BOTH), robot_grasps(model)
    fewer, all_points = free_grasps(POINTS[::5], grippers, grasps), free_grasps(POINTS, grippers, grasps)
    assert not (all_points & ~fewer).any()
    assert free_grasps(np.empty((0, 3)), grippers, grasps).all()


@pytest.mark.parametrize("side", BOTH)
def test_a_hand_without_a_grasp_left_is_no_matter(side):
    """A subset of grasps of one hand is free where these grasps were, also when the other hand has none."""
    grasps = grasp_set(CATALOGUE["mug"], BOTH)
    kept = grasps.hands[:, BOTH.index(side)] >= 0
    grippers = robot_grasps(CATALOGUE["mug"])[:5]
    whole = free_grasps(POINTS, grippers, grasps)
    np.testing.assert_array_equal(free_grasps(POINTS, grippers, grasps.subset(kept)), whole[:, kept])
