"""Handover plans to messages, and how they are shown in rviz."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Vector3
from handover_msgs.msg import HandoverPlan as HandoverPlanMessage
from handover_msgs.msg import RobotStage
from std_msgs.msg import ColorRGBA, Header
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

from handover_ros.geometry import FloatArray
from handover_ros.nodes.convert import pose_message, trajectory_message
from handover_ros.objects.catalogue import ObjectModel, Primitive
from handover_ros.planning.types import HandoverPlan
from handover_ros.robot.trajectory import Trajectory

WORLD = "world"
AXIS_LENGTH, AXIS_WIDTH = 0.10, 0.008  # [m]
AXIS_COLOURS = ((0.9, 0.2, 0.2), (0.2, 0.8, 0.2), (0.2, 0.4, 0.95))
OFFER_OPACITY = 0.7
LIMB_WIDTH, LIMB_COLOUR = 0.03, (0.85, 0.65, 0.5)  # [m]


def trajectory_to_message(joint_names: tuple[str, ...], trajectory: Trajectory) -> JointTrajectory:
    """Return a trajectory as a message."""
    return trajectory_message(
        joint_names, trajectory.times, trajectory.positions, trajectory.velocities, trajectory.accelerations
    )


def plan_message(
    plan: HandoverPlan, joint_names: tuple[str, ...], plan_id: str, stamp: Time, person_model: str = ""
) -> HandoverPlanMessage:
    """Return a plan as a message.

    Args:
        plan: The plan.
        joint_names: Joints of its arm.
        plan_id: A name that no other plan has.
        stamp: When it was made.
        person_model: Profile it was made for; empty: none.
    """
    message = HandoverPlanMessage(
        header=Header(frame_id=WORLD, stamp=stamp),
        plan_id=plan_id,
        object_name=plan.object_name,
        scheme=plan.scheme,
        person_model=person_model,
        arm=plan.arm,
        robot_grasp=plan.robot_grasp,
        object_from_gripper=pose_message(plan.object_from_gripper),
        handover_pose=pose_message(plan.world_from_object),
        expected_cost=float("nan") if plan.expected is None else float(plan.expected.cost),
        planning_time=float(plan.planning_time),
        candidates=int(plan.candidates),
        explanation=plan.explanation,
    )
    if plan.world_from_goal is not None:
        message.goal_pose = pose_message(plan.world_from_goal)
    else:
        message.goal_pose.orientation.w = 0.0
    message.stages = [
        RobotStage(
            name=stage.name,
            trajectory=trajectory_to_message(joint_names, stage.trajectory),
            opening=float(stage.opening),
        )
        for stage in plan.stages
    ]
    return message


def plan_visual(
    plan: HandoverPlan, model: ObjectModel, world_from_torso: FloatArray | None, stamp: Time
) -> MarkerArray:
    """Return the offer as rviz markers that replace those before.

    They are the object, gripper, person's hand, torso, and the arms of the posture that is expected.
    """
    markers = [Marker(action=Marker.DELETEALL)]
    markers += [_solid(part, plan.world_from_object, number) for number, part in enumerate(model.primitives)]
    markers += _axes("gripper", plan.world_from_gripper)
    markers += _axes("expected_hand", plan.world_from_hand)
    if world_from_torso is not None:
        markers += _axes("torso", world_from_torso)
    if plan.expected is not None:
        markers += [_limb(number, points) for number, points in enumerate(plan.expected.limbs.values())]
    for marker in markers:
        marker.header = Header(frame_id=WORLD, stamp=stamp)
    return MarkerArray(markers=markers)


def _solid(part: Primitive, world_from_object: FloatArray, number: int) -> Marker:
    """Return one solid of the object; a capsule is drawn as a cylinder of its whole length."""
    marker = Marker(ns="object", id=number, action=Marker.ADD)
    marker.pose = pose_message(world_from_object @ part.object_from_primitive)
    if part.type == "box":
        marker.type, scale = Marker.CUBE, part.size
    elif part.type == "sphere":
        marker.type, scale = Marker.SPHERE, (2.0 * part.size[0],) * 3
    else:
        length = part.size[1] + (2.0 * part.size[0] if part.type == "capsule" else 0.0)
        marker.type, scale = Marker.CYLINDER, (2.0 * part.size[0], 2.0 * part.size[0], length)
    x, y, z = (float(value) for value in scale)
    marker.scale = Vector3(x=x, y=y, z=z)
    red, green, blue, opacity = (float(value) for value in part.colour)
    marker.color = ColorRGBA(r=red, g=green, b=blue, a=OFFER_OPACITY * opacity)
    return marker


def _limb(number: int, points: FloatArray) -> Marker:
    """Return an arm, points (k, 3) [m] from shoulder to grip, as a line."""
    line = Marker(ns="expected_posture", id=number, type=Marker.LINE_STRIP, action=Marker.ADD)
    line.pose.orientation.w = 1.0
    line.scale = Vector3(x=LIMB_WIDTH, y=0.0, z=0.0)
    red, green, blue = LIMB_COLOUR
    line.color = ColorRGBA(r=red, g=green, b=blue, a=OFFER_OPACITY)
    line.points = [Point(x=x, y=y, z=z) for x, y, z in points.tolist()]
    return line


def _axes(name: str, world_from_frame: FloatArray) -> list[Marker]:
    """Return a frame as three arrows."""
    arrows = []
    for number, (red, green, blue) in enumerate(AXIS_COLOURS):
        arrow = Marker(ns=name, id=number, type=Marker.ARROW, action=Marker.ADD)
        arrow.pose.orientation.w = 1.0
        arrow.scale = Vector3(x=AXIS_WIDTH, y=2.0 * AXIS_WIDTH, z=0.0)
        arrow.color = ColorRGBA(r=red, g=green, b=blue, a=1.0)
        start = world_from_frame[:3, 3]
        ends = (start.tolist(), (start + AXIS_LENGTH * world_from_frame[:3, number]).tolist())
        arrow.points = [Point(x=x, y=y, z=z) for x, y, z in ends]
        arrows.append(arrow)
    return arrows
