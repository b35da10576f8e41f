"""Handover plans to messages, and how they are shown in rviz."""

from __future__ import annotations

from array import array

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Vector3
from handover_msgs.msg import HandoverPlan as HandoverPlanMessage
from handover_msgs.msg import RobotStage
from std_msgs.msg import ColorRGBA, Header
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

from handover_ros.geometry import FloatArray, pose_from_transform
from handover_ros.nodes.convert import WORLD, pose_message, trajectory_message
from handover_ros.objects.catalogue import ObjectModel, Primitive
from handover_ros.planning.types import HandoverPlan, PredictedChoice
from handover_ros.robot.trajectory import Trajectory

AXIS_LENGTH, AXIS_WIDTH = 0.10, 0.008  # [m]
AXIS_COLOURS = ((0.9, 0.2, 0.2), (0.2, 0.8, 0.2), (0.2, 0.4, 0.95))
OFFER_OPACITY = 0.7
LIMBS_SHOWN = 8  # most probable grasps
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
        expected_cost=_cost(plan),
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
    if plan.predicted is not None:
        _fill_prediction(message, plan.predicted)
    return message


def _cost(plan: HandoverPlan) -> float:
    """Return the cost a plan expects; NaN when its scheme has none."""
    if plan.predicted is not None:
        return float(plan.predicted.expected_cost)
    return float("nan") if plan.expected is None else float(plan.expected.cost)


def _fill_prediction(message: HandoverPlanMessage, predicted: PredictedChoice) -> None:
    """Fill in how the person is expected to choose; the pose is that of the hand that comes first."""
    grasps = predicted.grasps
    total = sum(grasp.probability for grasp in grasps)  # what is too improbable to tell was left out
    message.person_model = message.person_model or predicted.person_model
    message.grasp_regions = [grasp.region for grasp in grasps]
    message.grasp_probabilities = array("d", [grasp.probability / total for grasp in grasps])
    poses = [pose_from_transform(next(iter(grasp.hands.values()))) for grasp in grasps]
    message.grasp_poses = array("d", [float(value) for pose in poses for value in pose])
    message.grasp_handover_costs = array("d", [grasp.hand_cost for grasp in grasps])
    message.grasp_goal_costs = array("d", [grasp.goal_cost for grasp in grasps])
    told = [(place, side, each) for place, grasp in enumerate(grasps) for side, each in grasp.postures.items()]
    message.posture_grasps = array("I", [place for place, _, each in told for _ in each.probabilities])
    message.posture_arms = [side for _, side, each in told for _ in each.probabilities]
    message.postures = array("d", [value for _, _, each in told for value in each.displacements.ravel().tolist()])
    message.posture_probabilities = array("d", [value for _, _, each in told for value in each.probabilities.tolist()])


def plan_visual(
    plan: HandoverPlan, model: ObjectModel, world_from_torso: FloatArray | None, stamp: Time
) -> MarkerArray:
    """Return the offer as rviz markers that replace those before.

    They are the object, gripper, person's hand, torso, the arms of the posture that is expected or of the likely
    choices (here and at the goal), and the object at its goal.
    """
    markers = [Marker(action=Marker.DELETEALL)]
    markers += [_solid(part, plan.world_from_object, number) for number, part in enumerate(model.primitives)]
    markers += _axes("gripper", plan.world_from_gripper)
    markers += _axes("expected_hand", plan.world_from_hand)
    if world_from_torso is not None:
        markers += _axes("torso", world_from_torso)
    if plan.expected is not None:
        markers += [_limb(number, points) for number, points in enumerate(plan.expected.limbs.values())]
    if plan.predicted is not None:
        markers += _prediction(plan.predicted)
        if plan.world_from_goal is not None:
            goal = [_solid(part, plan.world_from_goal, number) for number, part in enumerate(model.primitives)]
            for marker in goal:
                marker.ns, marker.color.a = "goal", 0.5 * marker.color.a
            markers += goal
    for marker in markers:
        marker.header = Header(frame_id=WORLD, stamp=stamp)
    return MarkerArray(markers=markers)


def _prediction(predicted: PredictedChoice) -> list[Marker]:
    """Return the arms of the likely grasps, the more probable the more opaque, and how they are at the goal."""
    markers = []
    for number, grasp in enumerate(predicted.grasps[:LIMBS_SHOWN]):
        for space, limbs in (("predicted_posture", grasp.limbs), ("goal_posture", grasp.goal_limbs)):
            for arm, points in enumerate(limbs.values()):
                line = _limb(2 * number + arm, points)
                line.ns, line.color.a = space, max(0.1, OFFER_OPACITY * grasp.probability)
                markers.append(line)
    return markers


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
