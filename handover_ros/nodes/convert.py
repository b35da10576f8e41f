"""Messages to arrays and back; the only module that knows both sides.

rclpy does not check message fields by default, so every value put into a message here has the exact Python type the
field wants: ``array.array('d')`` for float64[], built-in floats, ints and bools elsewhere.
"""

from __future__ import annotations

import time
from array import array

import numpy as np
import numpy.typing as npt
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Point, Pose, Quaternion
from handover_msgs.msg import HandoverPlan
from sensor_msgs.msg import Image
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from handover_ros.cell.protocol_types import Plan, Stage
from handover_ros.errors import BadRequestError
from handover_ros.geometry import FloatArray, pose_from_transform, transform_from_pose

NANOSECONDS = 1_000_000_000
WORLD = "world"  # the frame of everything planned; REP-105


def seconds_from_stamp(stamp: Time) -> float:
    """Return a stamp or duration as seconds."""
    return stamp.sec + stamp.nanosec * 1e-9


def stamp_from_seconds(seconds: float) -> Time:
    """Return seconds (>= 0) as a stamp, to the nanosecond."""
    nanoseconds = round(seconds * NANOSECONDS)
    return Time(sec=nanoseconds // NANOSECONDS, nanosec=nanoseconds % NANOSECONDS)


def duration_from_seconds(seconds: float) -> Duration:
    """Return seconds as a duration message."""
    nanoseconds = round(seconds * NANOSECONDS)
    return Duration(sec=nanoseconds // NANOSECONDS, nanosec=nanoseconds % NANOSECONDS)


def wall_time() -> Time:
    """Return the wall clock as a stamp."""
    nanoseconds = time.time_ns()
    return Time(sec=nanoseconds // NANOSECONDS, nanosec=nanoseconds % NANOSECONDS)


def float_array(values: npt.ArrayLike) -> array:
    """Return numbers of any shape as the flat ``array('d')`` of a float64[] field."""
    return array("d", np.ascontiguousarray(values, dtype=np.float64).tobytes())


def numpy_array(field: array, *shape: int) -> FloatArray:
    """Return a float64[] field as a NumPy array of ``shape`` (a view; copy before keeping).

    Raises:
        BadRequestError: The number of values does not fit the shape.
    """
    values = np.frombuffer(field, dtype=np.float64)
    if not shape:
        return values
    try:
        return values.reshape(shape)
    except ValueError:
        raise BadRequestError(f"{len(values)} numbers do not fit the shape {shape}") from None


def pose_message(transform: FloatArray) -> Pose:
    """Return a 4x4 transform as a pose message."""
    x, y, z, qx, qy, qz, qw = (float(value) for value in pose_from_transform(transform))
    return Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def transform_from_message(pose: Pose, field: str = "pose") -> FloatArray:
    """Return a pose message as a 4x4 transform.

    Raises:
        BadRequestError: Not finite, or the quaternion is not of unit length; names ``field``.
    """
    position, orientation = pose.position, pose.orientation
    values = [position.x, position.y, position.z, orientation.x, orientation.y, orientation.z, orientation.w]
    try:
        return transform_from_pose(values)
    except ValueError as error:
        raise BadRequestError(f"{field}: {error}") from None


def check_frame(frame: str, field: str) -> None:
    """Refuse poses in another frame than the world; empty: the world.

    Raises:
        BadRequestError: Names the field and the frame.
    """
    if frame not in ("", WORLD):
        raise BadRequestError(f"{field}: frame {frame!r} is not known; give it in {WORLD!r}")


def is_unset(pose: Pose) -> bool:
    """Return whether a pose message was left at "all zero", which stands for unknown."""
    orientation = pose.orientation
    return orientation.x == orientation.y == orientation.z == orientation.w == 0.0


def trajectory_message(
    joint_names: list[str] | tuple[str, ...],
    times: FloatArray,
    positions: FloatArray,
    velocities: FloatArray,
    accelerations: FloatArray | None = None,
) -> JointTrajectory:
    """Return a joint trajectory message.

    Args:
        joint_names: n names.
        times: (k,) [s] from the start.
        positions: (k, n) [rad] or [m].
        velocities: (k, n).
        accelerations: (k, n) or None.
    """
    message = JointTrajectory(joint_names=list(joint_names))
    for index, seconds in enumerate(times):
        point = JointTrajectoryPoint(time_from_start=duration_from_seconds(float(seconds)))
        point.positions = float_array(positions[index])
        point.velocities = float_array(velocities[index])
        if accelerations is not None:
            point.accelerations = float_array(accelerations[index])
        message.points.append(point)
    return message


def trajectory_arrays(message: JointTrajectory) -> tuple[tuple[str, ...], FloatArray, FloatArray, FloatArray]:
    """Return (joint names, times (k,), positions (k, n), velocities (k, n)) of a joint trajectory message.

    Velocities left out are taken as zero at the ends and as finite differences between.

    Raises:
        BadRequestError: No points, ragged points, numbers that are not finite, or times that do not increase.
    """
    names, points = tuple(message.joint_names), message.points
    if not names or not points:
        raise BadRequestError("joint trajectory: needs at least one joint and one point")
    times = np.array([seconds_from_stamp(point.time_from_start) for point in points])
    positions = [np.array(point.positions, dtype=float) for point in points]
    velocities = [np.array(point.velocities, dtype=float) for point in points]
    if any(row.shape != (len(names),) for row in positions):
        raise BadRequestError(f"joint trajectory: every point needs {len(names)} positions")
    position_array = np.stack(positions)
    if all(row.shape == (len(names),) for row in velocities):
        velocity_array = np.stack(velocities)
    elif all(row.size == 0 for row in velocities):
        velocity_array = np.zeros_like(position_array)
        if len(points) > 2:
            velocity_array[1:-1] = (position_array[2:] - position_array[:-2]) / (times[2:] - times[:-2])[:, None]
    else:
        raise BadRequestError(f"joint trajectory: every point needs {len(names)} velocities, or none has any")
    if not (np.isfinite(position_array).all() and np.isfinite(velocity_array).all()):
        raise BadRequestError("joint trajectory: positions and velocities must be finite")
    if times[0] < 0.0 or np.any(np.diff(times) <= 0.0):
        raise BadRequestError("joint trajectory: time_from_start must start at or after 0 and increase")
    return names, times, position_array, velocity_array


def stage_from_message(name: str, trajectory: JointTrajectory, opening: float = float("nan")) -> Stage:
    """Return a stage of robot motion; a trajectory without points is a stage without motion.

    Raises:
        BadRequestError: The trajectory is not valid.
    """
    if not trajectory.points:
        return Stage(name, np.empty(0), np.empty((0, 0)), np.empty((0, 0)), opening)
    _, times, positions, velocities = trajectory_arrays(trajectory)
    return Stage(name, times, positions, velocities, opening)


def plan_from_message(message: HandoverPlan) -> Plan:
    """Return what the executive needs of a plan.

    Raises:
        BadRequestError: A trajectory is not valid.
    """
    stages = tuple(stage_from_message(stage.name, stage.trajectory, stage.opening) for stage in message.stages)
    joint_names = next((tuple(s.trajectory.joint_names) for s in message.stages if s.trajectory.points), ())
    held = not any(stage.name == "grasp" for stage in stages)
    return Plan(message.arm, joint_names, stages, held)


def image_message(picture: npt.NDArray[np.uint8], frame_id: str) -> Image:
    """Return an RGB picture (height, width, 3) as an image message."""
    height, width, _ = picture.shape
    message = Image(height=height, width=width, encoding="rgb8", is_bigendian=0, step=3 * width)
    message.header.frame_id = frame_id
    message.data = array("B", np.ascontiguousarray(picture).tobytes())
    return message


def picture_from_image(message: Image) -> npt.NDArray[np.uint8]:
    """Return an rgb8 image message as an array (height, width, 3).

    Raises:
        BadRequestError: Another encoding, or the size does not fit the data.
    """
    if message.encoding != "rgb8":
        raise BadRequestError(f"image encoding {message.encoding!r}; only 'rgb8' is shown")
    data = np.frombuffer(message.data, dtype=np.uint8)
    if data.size != message.height * message.width * 3:
        raise BadRequestError(f"image of {message.width} x {message.height} carries {data.size} bytes")
    return data.reshape(message.height, message.width, 3)
