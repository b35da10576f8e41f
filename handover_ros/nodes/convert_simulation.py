"""States of the simulated cell to messages."""

from __future__ import annotations

from array import array
from collections.abc import Mapping

import numpy as np
from builtin_interfaces.msg import Time
from handover_msgs.msg import GripperState as GripperStateMessage
from handover_msgs.msg import MarkerFrame, ObjectStates, SimulationTruth
from handover_msgs.msg import SimulationEvent as SimulationEventMessage
from sensor_msgs.msg import JointState as JointStateMessage

from handover_ros.geometry import FloatArray
from handover_ros.nodes.convert import float_array, pose_message, stamp_from_seconds
from handover_ros.nodes.convert_human import quaternion_of
from handover_ros.sim.cameras import CapturedFrame
from handover_ros.sim.grippers import GripperState
from handover_ros.sim.robot import JointState
from handover_ros.sim.truth import SimulationEvent, Truth

SET_VERSION = 1


def marker_frame_message(time: float, frame: CapturedFrame, frame_id: str) -> MarkerFrame:
    """Return a captured frame, captured at ``time`` [s], as a message."""
    message = MarkerFrame(set_version=SET_VERSION, device_frame=int(frame.device_frame))
    message.header.stamp = stamp_from_seconds(time)
    message.header.frame_id = frame_id
    message.device_time = float(frame.device_time)
    message.positions = float_array(frame.positions)
    missing = np.isnan(frame.positions[:, 0])
    message.status = array("B", np.where(missing, MarkerFrame.MISSING, MarkerFrame.MEASURED).astype(np.uint8).tobytes())
    return message


def joint_state_message(stamp: Time, state: JointState) -> JointStateMessage:
    """Return the state of the robot's joints as a message."""
    message = JointStateMessage(name=list(state.names))
    message.header.stamp = stamp
    message.position = float_array(state.positions)
    message.velocity = float_array(state.velocities)
    message.effort = float_array(state.efforts)
    return message


def gripper_state_message(stamp: Time, state: GripperState) -> GripperStateMessage:
    """Return the state of the grippers as a message."""
    message = GripperStateMessage(arms=list(state.arms), gripping=[bool(value) for value in state.gripping])
    message.header.stamp = stamp
    message.openings = float_array(state.openings)
    message.forces = float_array(state.forces)
    return message


def object_states_message(stamp: Time, poses: Mapping[str, FloatArray], frame_id: str) -> ObjectStates:
    """Return perceived poses world_from_object (4, 4) as a message."""
    message = ObjectStates(names=list(poses))
    message.header.stamp = stamp
    message.header.frame_id = frame_id
    message.poses = flat_poses(poses)
    return message


def fill_truth(message: SimulationTruth, truth: Truth, frame_id: str) -> None:
    """Write the true state of the cell into a message."""
    message.header.stamp = stamp_from_seconds(truth.time)
    message.header.frame_id = frame_id
    if truth.torso is not None:
        message.torso = pose_message(truth.torso)
    message.joint_names = list(truth.joint_names)
    message.displacements = float_array(truth.displacements)
    message.velocities = float_array(truth.velocities)
    message.object_names = list(truth.objects)
    message.object_poses = flat_poses(truth.objects)
    message.holders = [truth.holders[name] for name in truth.objects]
    message.joint_limit_violations = int(truth.counts.joint_limit_violations)
    message.velocity_limit_violations = int(truth.counts.velocity_limit_violations)
    message.effort_saturations = int(truth.counts.effort_saturations)


def event_message(event: SimulationEvent, frame_id: str) -> SimulationEventMessage:
    """Return an event as a message."""
    message = SimulationEventMessage(
        kind=event.kind, object_name=event.object_name, holder=event.holder, message=event.message
    )
    message.header.stamp = stamp_from_seconds(event.time)
    message.header.frame_id = frame_id
    return message


def flat_poses(poses: Mapping[str, FloatArray]) -> array:
    """Return transforms as 7 numbers each: x y z qx qy qz qw."""
    values = array("d")
    for pose in poses.values():
        values.extend((float(pose[0, 3]), float(pose[1, 3]), float(pose[2, 3]), *quaternion_of(pose)))
    return values
