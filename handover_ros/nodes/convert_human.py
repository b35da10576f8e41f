"""Marker frames, marker sets and the skeleton's state to messages and back, cheap enough for 1000 frames a second.

Messages that travel at the frame rate are filled again and again instead of made anew: publishing copies them.
"""

from __future__ import annotations

import math
from array import array

import numpy as np
from geometry_msgs.msg import Point, Vector3
from handover_msgs.msg import MarkerFrame as MarkerFrameMessage
from handover_msgs.msg import MarkerSet as MarkerSetMessage
from handover_msgs.msg import SkeletonState
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from handover_ros.errors import BadRequestError
from handover_ros.geometry import FloatArray
from handover_ros.mocap.frames import MarkerFrame
from handover_ros.nodes.convert import NANOSECONDS, seconds_from_stamp, stamp_from_seconds
from handover_ros.skeleton.torso import TorsoEstimate

NAN_QUATERNION = (float("nan"),) * 4
AXIS_LENGTH, AXIS_WIDTH, MARKER_WIDTH = 0.25, 0.015, 0.018  # [m]
AXIS_COLOURS = ((0.9, 0.1, 0.1), (0.1, 0.7, 0.1), (0.1, 0.2, 0.9))


def fill_stamp(message: MarkerFrameMessage | SkeletonState, seconds: float) -> None:
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
    x, y, z = estimate.world_from_torso[:3, 3].tolist()
    qx, qy, qz, qw = quaternion_of(estimate.world_from_torso) if estimate.valid else NAN_QUATERNION
    position, orientation = message.torso.pose.position, message.torso.pose.orientation
    position.x, position.y, position.z = x, y, z
    orientation.x, orientation.y, orientation.z, orientation.w = qx, qy, qz, qw
    message.torso.covariance = estimate.covariance.ravel()
    message.torso_velocity = array("d", estimate.velocity.tobytes())
    message.markers_used = estimate.markers_used
    message.residual_rms = estimate.residual_rms
    message.consistency = estimate.consistency


def human_visual(estimate: TorsoEstimate, positions: FloatArray, frame_id: str) -> MarkerArray:
    """Return the torso's axes and the markers (n, 3) [m] as rviz markers."""
    spheres = Marker(ns="markers", type=Marker.SPHERE_LIST, action=Marker.ADD)
    spheres.scale = Vector3(x=MARKER_WIDTH, y=MARKER_WIDTH, z=MARKER_WIDTH)
    spheres.color = ColorRGBA(r=0.95, g=0.6, b=0.1, a=1.0)
    seen = positions[np.isfinite(positions).all(axis=1)]
    spheres.points = [Point(x=x, y=y, z=z) for x, y, z in seen.tolist()]
    markers = [spheres]
    for number, (red, green, blue) in enumerate(AXIS_COLOURS):
        arrow = Marker(ns="torso", id=number, type=Marker.ARROW)
        arrow.action = Marker.ADD if estimate.valid else Marker.DELETE
        arrow.scale = Vector3(x=AXIS_WIDTH, y=2 * AXIS_WIDTH, z=0.0)
        arrow.color = ColorRGBA(r=red, g=green, b=blue, a=1.0)
        if estimate.valid:
            start = estimate.world_from_torso[:3, 3]
            end = start + AXIS_LENGTH * estimate.world_from_torso[:3, number]
            arrow.points = [Point(x=x, y=y, z=z) for x, y, z in (start.tolist(), end.tolist())]
        markers.append(arrow)
    stamp = stamp_from_seconds(estimate.stamp)
    for marker in markers:
        marker.header.frame_id = frame_id
        marker.header.stamp = stamp
        marker.pose.orientation.w = 1.0
    return MarkerArray(markers=markers)
