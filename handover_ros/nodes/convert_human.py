"""Marker frames, marker sets and the skeleton's state to messages and back, cheap enough for 1000 frames a second.

Messages that travel at the frame rate are filled again and again instead of made anew: publishing copies them.
"""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass

import numpy as np
from geometry_msgs.msg import Point, Vector3
from handover_msgs.msg import MarkerFrame as MarkerFrameMessage
from handover_msgs.msg import MarkerSet as MarkerSetMessage
from handover_msgs.msg import SkeletonState
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from handover_ros.errors import BadRequestError
from handover_ros.geometry import FloatArray, make_transform, transform_points
from handover_ros.mocap.frames import MarkerFrame
from handover_ros.nodes.convert import NANOSECONDS, pose_message, seconds_from_stamp, stamp_from_seconds
from handover_ros.skeleton.jacobian import move_tree
from handover_ros.skeleton.landmarks import bones
from handover_ros.skeleton.torso import TorsoEstimate
from handover_ros.skeleton.tracking import SkeletonEstimate
from handover_ros.skeleton.tree import Skeleton
from handover_ros.skeleton.urdf import RADIUS_OF_LENGTH, THICKEST, THINNEST

NAN_QUATERNION = (float("nan"),) * 4
AXIS_LENGTH, AXIS_WIDTH, MARKER_WIDTH = 0.25, 0.015, 0.018  # [m]
AXIS_COLOURS = ((0.9, 0.1, 0.1), (0.1, 0.7, 0.1), (0.1, 0.2, 0.9))


def fill_stamp(message: MarkerFrameMessage | SkeletonState | JointState, seconds: float) -> None:
    """Set a header's stamp in place."""
    nanoseconds = round(seconds * NANOSECONDS)
    stamp = message.header.stamp
    stamp.sec, stamp.nanosec = nanoseconds // NANOSECONDS, nanoseconds % NANOSECONDS


def fill_marker_frame(message: MarkerFrameMessage, frame: MarkerFrame) -> None:
    """Write a marker frame into a message; frame_id and set_version stay."""
    fill_stamp(message, frame.stamp)
    message.device_frame = frame.device_frame
    message.device_time = frame.device_time
    message.positions = array("d", frame.positions.tobytes())
    message.status = array("B", frame.status.tobytes())


def marker_frame_from_message(message: MarkerFrameMessage, markers: int) -> MarkerFrame:
    """Return a marker frame; its arrays are views of the message.

    Raises:
        BadRequestError: The lengths do not fit ``markers``.
    """
    positions = np.frombuffer(message.positions, dtype=np.float64)
    status = np.frombuffer(message.status, dtype=np.uint8)
    if positions.size != 3 * markers or status.size != markers:
        raise BadRequestError(
            f"marker frame: {positions.size} numbers and {status.size} states, expected {3 * markers} and {markers}"
        )
    return MarkerFrame(
        seconds_from_stamp(message.header.stamp),
        message.device_frame,
        message.device_time,
        positions.reshape(markers, 3),
        status,
    )


def marker_set_message(
    name: str, names: tuple[str, ...], segments: tuple[str, ...], rate: float, frame_id: str, version: int
) -> MarkerSetMessage:
    """Return the message that names the markers of a stream."""
    message = MarkerSetMessage(name=name, version=version, rate=float(rate))
    message.header.frame_id = frame_id
    message.marker_names = list(names)
    message.segment_names = list(segments)
    return message


def quaternion_of(transform: FloatArray) -> tuple[float, float, float, float]:
    """Return the quaternion (x, y, z, w), w >= 0, of a 4x4 transform (Shepperd 1978), at a tenth of SciPy's time."""
    (a, b, c, _), (d, e, f, _), (g, h, i, _), _ = transform.tolist()
    # Four times the square of each component; the largest is safe to divide by.
    squares = (1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i, 1.0 + a + e + i)
    largest = squares.index(max(squares))
    products = (
        (squares[0], b + d, c + g, h - f),
        (b + d, squares[1], f + h, c - g),
        (c + g, f + h, squares[2], d - b),
        (h - f, c - g, d - b, squares[3]),
    )[largest]
    scale = math.copysign(0.5 / math.sqrt(squares[largest]), products[3])
    x, y, z, w = products
    return scale * x, scale * y, scale * z, scale * w


def fill_skeleton_state(message: SkeletonState, estimate: TorsoEstimate) -> None:
    """Write a torso estimate into a message; frame_id and the joint arrays stay."""
    fill_stamp(message, estimate.stamp)
    message.valid = estimate.valid
    fill_torso(message, estimate.valid, estimate.world_from_torso, estimate.covariance, estimate.velocity)
    message.markers_used = estimate.markers_used
    message.residual_rms = estimate.residual_rms
    message.consistency = estimate.consistency


def fill_torso(
    message: SkeletonState, valid: bool, world_from_torso: FloatArray, covariance: FloatArray, velocity: FloatArray
) -> None:
    """Write the torso's pose (4, 4), covariance (6, 6) and velocity (6,) into a message."""
    x, y, z = world_from_torso[:3, 3].tolist()
    qx, qy, qz, qw = quaternion_of(world_from_torso) if valid else NAN_QUATERNION
    position, orientation = message.torso.pose.position, message.torso.pose.orientation
    position.x, position.y, position.z = x, y, z
    orientation.x, orientation.y, orientation.z, orientation.w = qx, qy, qz, qw
    message.torso.covariance = covariance.ravel()
    message.torso_velocity = array("d", velocity.tobytes())


def fill_person_state(message: SkeletonState, estimate: SkeletonEstimate, torso: TorsoEstimate | None = None) -> None:
    """Write a whole person into a message; frame_id, profile and names stay.

    Args:
        message: What to fill.
        estimate: The person.
        torso: Where the torso is, for a skeleton whose root is something else.
    """
    fill_stamp(message, estimate.stamp)
    if torso is None:
        message.valid = estimate.valid
        covariance, velocity = estimate.torso_covariance, estimate.torso_velocity
        fill_torso(message, estimate.valid, estimate.world_from_torso, covariance, velocity)
    else:
        message.valid = estimate.valid and torso.valid
        fill_torso(message, torso.valid, torso.world_from_torso, torso.covariance, torso.velocity)
    message.displacements = array("d", estimate.displacements.tobytes())
    message.velocities = array("d", estimate.velocities.tobytes())
    message.covariance = array("d", estimate.covariance.tobytes())
    message.markers_used = int(estimate.markers_used)
    message.residual_rms = float(estimate.residual_rms)
    message.consistency = float(estimate.consistency)


def fill_joint_state(message: JointState, estimate: SkeletonEstimate) -> None:
    """Write displacements [rad] or [m] and their rates into a message; frame_id and names stay."""
    fill_stamp(message, estimate.stamp)
    message.position = array("d", estimate.displacements.tobytes())
    message.velocity = array("d", estimate.velocities.tobytes())


@dataclass(frozen=True)
class Looks:
    """What a person looks like in rviz: the skeleton's bones, as joint index, ends (zero frame), radius [m]."""

    skeleton: Skeleton
    bones: tuple[tuple[int, FloatArray, FloatArray, float], ...]

    @classmethod
    def of(cls, skeleton: Skeleton) -> Looks:
        """Return the looks of a skeleton."""
        limbs = []
        for segment, start, end in bones(skeleton):
            radius = RADIUS_OF_LENGTH * float(np.linalg.norm(end - start))
            limbs.append((skeleton.joint_carrying(segment), start, end, min(max(radius, THINNEST), THICKEST)))
        return cls(skeleton, tuple(limbs))


def human_visual(
    stamp: float,
    world_from_torso: FloatArray | None,
    positions: FloatArray,
    frame_id: str,
    person: tuple[Looks, SkeletonEstimate] | None = None,
    clear: bool = False,
) -> MarkerArray:
    """Return a person as rviz markers.

    Args:
        stamp: Time [s].
        world_from_torso: The torso (4, 4), shown as three arrows; None: not known.
        positions: The markers (n, 3) [m], NaN where not seen.
        frame_id: Frame of all.
        person: The skeleton and where it is, shown as limbs; None: not known.
        clear: Whether everything shown before is taken away first.
    """
    spheres = Marker(ns="markers", type=Marker.SPHERE_LIST, action=Marker.ADD)
    spheres.scale = Vector3(x=MARKER_WIDTH, y=MARKER_WIDTH, z=MARKER_WIDTH)
    spheres.color = ColorRGBA(r=0.95, g=0.6, b=0.1, a=1.0)
    seen = positions[np.isfinite(positions).all(axis=1)]
    spheres.points = [Point(x=x, y=y, z=z) for x, y, z in seen.tolist()]
    markers = [spheres]
    for number, (red, green, blue) in enumerate(AXIS_COLOURS):
        arrow = Marker(ns="torso", id=number, type=Marker.ARROW)
        arrow.action = Marker.DELETE if world_from_torso is None else Marker.ADD
        arrow.scale = Vector3(x=AXIS_WIDTH, y=2 * AXIS_WIDTH, z=0.0)
        arrow.color = ColorRGBA(r=red, g=green, b=blue, a=1.0)
        if world_from_torso is not None:
            start = world_from_torso[:3, 3]
            end = start + AXIS_LENGTH * world_from_torso[:3, number]
            arrow.points = [Point(x=x, y=y, z=z) for x, y, z in (start.tolist(), end.tolist())]
        markers.append(arrow)
    for marker in markers:
        marker.pose.orientation.w = 1.0
    if person is not None:
        markers += limb_markers(*person)
    if clear:
        markers.insert(0, Marker(action=Marker.DELETEALL))
    time = stamp_from_seconds(stamp)
    for marker in markers:
        marker.header.frame_id = frame_id
        marker.header.stamp = time
    return MarkerArray(markers=markers)


def limb_markers(looks: Looks, estimate: SkeletonEstimate) -> list[Marker]:
    """Return a capsule for each limb, as a cylinder and the balls at its ends; to be taken away while not valid."""
    action = Marker.ADD if estimate.valid else Marker.DELETE
    skeleton = looks.skeleton
    poses = None
    if estimate.valid:
        root = estimate.world_from_torso if skeleton.is_free else None
        poses = move_tree(skeleton, estimate.displacements, root).poses
    markers = []
    for number, (joint, start, end, radius) in enumerate(looks.bones):
        cylinder = Marker(ns="limbs", id=number, type=Marker.CYLINDER, action=action)
        balls = Marker(ns="joints", id=number, type=Marker.SPHERE_LIST, action=action)
        balls.pose.orientation.w = 1.0
        balls.scale = Vector3(x=2 * radius, y=2 * radius, z=2 * radius)
        balls.color = cylinder.color = ColorRGBA(r=0.45, g=0.55, b=0.68, a=0.85)
        if poses is not None:
            a, b = transform_points(poses[joint + 1], np.stack([start, end]))
            length = float(np.linalg.norm(b - a))
            turn = Rotation.align_vectors((b - a)[None], np.array([[0.0, 0.0, 1.0]]))[0].as_matrix()
            cylinder.pose = pose_message(make_transform(turn, 0.5 * (a + b)))
            cylinder.scale = Vector3(x=2 * radius, y=2 * radius, z=length)
            balls.points = [Point(x=x, y=y, z=z) for x, y, z in (a.tolist(), b.tolist())]
        markers += [cylinder, balls]
    return markers
