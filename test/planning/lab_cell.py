"""The lab cell as the planner sees it, and checks of what it answers."""

import numpy as np

from handover_ros.geometry import invert_transform, transform_from_xyz_rpy
from handover_ros.objects import load_catalogue, load_scene
from handover_ros.planning import CellSnapshot, HandoverPlanner, TrackedPerson, load_schemes
from handover_ros.robot import Reason, RobotModel

ROBOT = RobotModel.load()
SCENE = load_scene("lab")
CATALOGUE = load_catalogue()
PLANNER = HandoverPlanner(ROBOT, SCENE, CATALOGUE, load_schemes())
SHOULDERS = 1.40  # [m]
PATIENCE = 120.0  # [s] of search on a busy machine: the limit that counts is the number of samples


def torso(x=0.0, y=0.0, yaw=0.0, height=SHOULDERS):
    """The torso of a person at the scene's place, moved and turned a little."""
    return SCENE.person_pose @ transform_from_xyz_rpy([x, y, height], [0.0, 0.0, yaw])


def snapshot(**fields):
    given = {
        "arms": {arm: np.array(ROBOT.arm(arm).home) for arm in ROBOT.arm_names},
        "objects": dict(SCENE.placements),
        "person": TrackedPerson(torso()),
    }
    return CellSnapshot(**{**given, **fields})


def stage_checks(plan, cell):
    """Yield (stage, checker made anew for it): what the arm may touch during that stage, and what it holds."""
    motion, name = PLANNER.motion, plan.object_name
    held = motion.held_object(plan.arm, name, invert_transform(plan.object_from_gripper))
    given = CellSnapshot(cell.arms, {**cell.objects, name: plan.world_from_object}, cell.person)
    for stage in plan.stages:
        yield (
            stage,
            {
                "approach": lambda: motion.checker(plan.arm, cell),
                "grasp": lambda: motion.checker(plan.arm, cell, touched=name),
                "lift": lambda: motion.checker(plan.arm, cell, held),
                "present": lambda: motion.checker(plan.arm, cell, held),
                "retract": lambda: motion.checker(plan.arm, given, touched=name),
            }[stage.name](),
        )


def check_plan(plan, cell):
    """Assert what every plan must keep: joined stages, limits, distances, the right ends."""
    arm = ROBOT.arm(plan.arm)
    position = cell.arms[plan.arm]
    for stage, checker in stage_checks(plan, cell):
        trajectory = stage.trajectory
        np.testing.assert_allclose(trajectory.positions[0], position, atol=1e-9, err_msg=stage.name)
        position = trajectory.positions[-1]
        points, velocities, accelerations = trajectory.sample(np.linspace(0.0, trajectory.duration, 300))
        assert np.all((points >= arm.lower - 1e-6) & (points <= arm.upper + 1e-6))
        assert np.all(np.abs(velocities) <= arm.planning_velocity * 1.001)
        assert np.all(np.abs(accelerations) <= arm.acceleration * 1.01)
        for point in points[::30]:
            whole = ROBOT.configuration({**cell.arms, plan.arm: point})
            for reason in (Reason.SELF, Reason.ENVIRONMENT, Reason.OBJECT):
                if stage.name != "lift" or reason is Reason.SELF:
                    assert checker.distance(whole, reason) > 0.0, (stage.name, reason)
            least = PLANNER.motion.settings.held_person_distance
            assert checker.distance(whole, Reason.PERSON) > least - 0.01, stage.name
    np.testing.assert_allclose(position, arm.home, atol=1e-6)
    offered = ROBOT.gripper_pose(plan.arm, plan.stage("present").trajectory.positions[-1])
    np.testing.assert_allclose(offered, plan.world_from_object @ plan.object_from_gripper, atol=1e-4)
    if plan.robot_grasp:
        taken = ROBOT.gripper_pose(plan.arm, plan.stage("grasp").trajectory.positions[-1])
        np.testing.assert_allclose(taken, cell.objects[plan.object_name] @ plan.object_from_gripper, atol=1e-4)
