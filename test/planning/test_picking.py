"""Picking up: grasps that fit the gripper, straight ways in and up."""

import numpy as np
import pytest
from lab_cell import CATALOGUE, PLANNER, ROBOT, SCENE, snapshot

from handover_ros.planning.picking import OPENING_CLEARANCE, Picking, grasp_poses
from handover_ros.robot import Reasons


@pytest.mark.parametrize("arm", ROBOT.arm_names)
@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_only_grasps_that_fit_are_offered_middles_first(name, arm):
    """Each grasp is narrower than the open gripper and inside its region; the regions' middles lead."""
    model, gripper = CATALOGUE[name], ROBOT.arm(arm)
    poses = grasp_poses(model, gripper)
    for grasp, pose in poses:
        assert grasp.width <= gripper.opening[1] - OPENING_CLEARANCE
        metres, radians = grasp.region.distance(pose)
        assert metres < 1e-9
        assert radians < 1e-6
    if poses:
        grasp, pose = poses[0]
        middle = grasp.region.centre()
        least = min(np.linalg.norm(other - middle) for g, other in poses if g is grasp)
        assert np.linalg.norm(pose - middle) == pytest.approx(least)


def test_a_pick_comes_straight_and_lifts_straight():
    """In along the gripper's approach, up along the vertical, joined at the grasp; each worked out once."""
    cell, reasons = snapshot(), Reasons()
    picking = Picking(PLANNER.motion, "left", "mug", cell, reasons)
    index = next(i for i in range(len(picking.grasps)) if picking[i] is not None)
    pick = picking[index]
    assert picking[index] is pick
    assert not picking.refused(index)
    before, at = (ROBOT.gripper_pose("left", pick.approach_line[i]) for i in (0, -1))
    np.testing.assert_allclose(at, SCENE.placements["mug"] @ pick.object_from_gripper, atol=1e-5)
    np.testing.assert_allclose(at[:3, 3] - before[:3, 3], 0.10 * at[:3, 2], atol=1e-4)
    up = ROBOT.gripper_pose("left", pick.lift_line[-1])[:3, 3] - at[:3, 3]
    np.testing.assert_allclose(up[:2], 0.0, atol=1e-4)
    assert up[2] > 0.05
    np.testing.assert_array_equal(pick.approach_line[-1], pick.lift_line[0])


def test_what_the_arm_cannot_reach_is_refused_and_counted():
    reasons = Reasons()
    picking = Picking(PLANNER.motion, "right", "handlebars", snapshot(), reasons)
    assert all(picking[i] is None for i in range(len(picking.grasps)))
    assert picking.refused(0)
    assert reasons.counts


@pytest.mark.parametrize("name", ["mug", "handlebars"])
def test_usable_grasps_are_in_reach_and_not_yet_refused(name):
    """A quick look at all grasps: each kept one has a solution at the object and before it; refused ones go."""
    picking = Picking(PLANNER.motion, "right" if name == "handlebars" else "left", name, snapshot(), Reasons())
    solver = PLANNER.motion.reaches[picking.arm].inverse_kinematics
    usable = picking.usable()
    assert usable.shape == (len(picking.grasps),)
    for index, pose in enumerate(picking.grasps):
        at_grasp = SCENE.placements[name] @ pose
        before = at_grasp.copy()
        before[:3, 3] -= PLANNER.motion.settings.pregrasp_distance * at_grasp[:3, 2]
        assert usable[index] == bool(len(solver.quick(at_grasp)) and len(solver.quick(before)))
    for index in range(len(picking.grasps)):
        if picking[index] is None:
            assert not picking.usable()[index]
