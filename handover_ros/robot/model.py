"""The robot: its joints, limits, gripper poses and Jacobians (pinocchio on the URDF)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from handover_ros.errors import BadModelError, BadRequestError, UnknownNameError
from handover_ros.geometry import FloatArray, transform_from_xyz_rpy
from handover_ros.robot.description import RobotDescription, read_description, share_directory

FORCE_DAMPING = 1e-3
#: [rad] that planned motions keep from the position limits: a servo overshoots, a person pulls.
LIMIT_MARGIN = 0.03


def _frozen(values: npt.ArrayLike) -> FloatArray:
    """Return the values as a read-only float array."""
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array


@dataclass(frozen=True)
class ArmModel:
    """One arm of the robot: names and limits, in the order of its joints (n of them, 7 for Baxter).

    Attributes:
        name: The arm's name, e.g. ``left``.
        joint_names: n names.
        lower, upper: Position limits [rad]. Shape (n,).
        velocity: Velocity limits of the URDF [rad/s]. Shape (n,).
        planning_velocity: The share of them that planned motions use [rad/s]. Shape (n,).
        acceleration: Acceleration limits [rad/s2]. Shape (n,).
        effort: Effort limits [N m]. Shape (n,).
        tip_frame: Gripper frame: origin between the finger tips, z approach, y closing direction.
        finger_joints: Names of the joints that move the fingers.
        opening: Distance of the finger tips [m], closed and open.
        postures: Named joint displacements [rad], at least ``home``.
    """

    name: str
    joint_names: tuple[str, ...]
    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    planning_velocity: FloatArray
    acceleration: FloatArray
    effort: FloatArray
    tip_frame: str
    finger_joints: tuple[str, ...]
    opening: tuple[float, float]
    postures: Mapping[str, FloatArray]

    @property
    def planning_lower(self) -> FloatArray:
        """Lower position limits of planned motions [rad]. Shape (n,)."""
        return self.lower + LIMIT_MARGIN

    @property
    def planning_upper(self) -> FloatArray:
        """Upper position limits of planned motions [rad]. Shape (n,)."""
        return self.upper - LIMIT_MARGIN

    @property
    def home(self) -> FloatArray:
        """Home posture [rad]. Shape (n,)."""
        return self.postures["home"]

    def posture(self, name: str) -> FloatArray:
        """Return the displacements [rad] of a named posture.

        Raises:
            UnknownNameError: There is no such posture.
        """
        if name not in self.postures:
            raise UnknownNameError(f"posture of the {self.name} arm", name, tuple(self.postures))
        return self.postures[name]

    def check(self, displacements: npt.ArrayLike, what: str = "displacements", tolerance: float = 0.0) -> FloatArray:
        """Return displacements as an array (n,) after checking them against shape and position limits.

        Raises:
            BadRequestError: Wrong length, not finite, or out of limits by more than ``tolerance`` [rad].
        """
        values = np.asarray(displacements, dtype=float)
        if values.shape != self.lower.shape or not np.all(np.isfinite(values)):
            raise BadRequestError(
                f"{what} of the {self.name} arm must be {len(self.joint_names)} finite numbers, got {values.tolist()}"
            )
        outside = (values < self.lower - tolerance) | (values > self.upper + tolerance)
        if outside.any():
            i = int(np.argmax(outside))
            raise BadRequestError(
                f"{what}: {self.joint_names[i]} = {values[i]:.3f} rad is outside "
                f"{self.lower[i]:.3f} to {self.upper[i]:.3f} rad"
            )
        return values


class RobotModel:
    """Kinematics of a robot with one or more arms on a fixed base.

    Not safe to share between threads: pinocchio keeps its intermediate results here.

    Attributes:
        name: The robot's name, as in ``config/robots``.
        description: The checked content of its file.
        urdf_path: The URDF.
        package_directory: Folder that ``package://`` addresses in the URDF start from.
        world_from_base: Transform of the URDF's root link. Shape (4, 4).
        joint_names: All movable joints, in the order of a whole configuration (nq of them).
        pinocchio_model: The model itself, placed in the world, for collision geometry.
    """

    def __init__(self, description: RobotDescription, urdf_path: Path, package_directory: Path) -> None:
        self.name = description.name
        self.description = description
        self.urdf_path = urdf_path
        self.package_directory = package_directory
        self.display_link = description.display_link
        self.world_from_base = _frozen(
            transform_from_xyz_rpy(description.world_from_base.xyz, description.world_from_base.rpy)
        )
        model = pin.buildModelFromUrdf(str(urdf_path))
        _place_in_world(model, self.world_from_base)
        self.pinocchio_model = model
        self._data = model.createData()
        self.joint_names: tuple[str, ...] = tuple(model.names)[1:]
        if model.nq != len(self.joint_names):
            raise BadModelError(
                f"{urdf_path}: joints must have one degree of freedom each (continuous ones are not read)"
            )
        self._arms = {name: self._make_arm(name) for name in description.arms}
        self._indices = {
            name: np.array([self._index(joint) for joint in arm.joint_names]) for name, arm in self._arms.items()
        }
        self._tips = {name: model.getFrameId(arm.tip_frame) for name, arm in self._arms.items()}
        self._fingers = {name: [self._index(joint) for joint in arm.finger_joints] for name, arm in self._arms.items()}

    @classmethod
    def load(cls, name: str = "baxter") -> RobotModel:
        """Return the robot of ``config/robots/<name>.yaml``.

        Raises:
            UnknownNameError: There is no such robot.
            BadModelError: Its file or its URDF cannot be used.
        """
        description, urdf = read_description(name)
        return cls(description, urdf, share_directory())

    @property
    def arm_names(self) -> tuple[str, ...]:
        """Names of the arms."""
        return tuple(self._arms)

    def arm(self, name: str) -> ArmModel:
        """Return an arm by name.

        Raises:
            UnknownNameError: There is no such arm.
        """
        if name not in self._arms:
            raise UnknownNameError("arm", name, self.arm_names)
        return self._arms[name]

    def arm_indices(self, arm: str) -> npt.NDArray[np.int64]:
        """Return the places of an arm's joints in a whole configuration. Shape (n,)."""
        self.arm(arm)
        return self._indices[arm]

    def configuration(self, arms: Mapping[str, FloatArray], openings: Mapping[str, float] | None = None) -> FloatArray:
        """Return the whole configuration (nq,) from displacements of some arms; the others are at home, fingers open.

        Args:
            arms: Displacements [rad] (n,) by arm.
            openings: Gripper openings [m] by arm; left out: fully open.
        """
        configuration: FloatArray = pin.neutral(self.pinocchio_model)
        for name, arm in self._arms.items():
            configuration[self._indices[name]] = arms.get(name, arm.home)
            opening = (openings or {}).get(name, arm.opening[1])
            configuration[self._fingers[name]] = self.finger_displacements(name, opening)
        return configuration

    def finger_displacements(self, arm: str, opening: float) -> FloatArray:
        """Return the displacements [m] of an arm's finger joints for a gripper opening [m], kept within its limits."""
        model = self.arm(arm)
        fraction = np.clip((opening - model.opening[0]) / (model.opening[1] - model.opening[0]), 0.0, 1.0)
        lower = self.pinocchio_model.lowerPositionLimit[self._fingers[arm]]
        upper = self.pinocchio_model.upperPositionLimit[self._fingers[arm]]
        return np.asarray(np.where(upper > -lower, upper, lower) * fraction)

    def gripper_pose(self, arm: str, displacements: npt.ArrayLike) -> FloatArray:
        """Return ``world_from_gripper`` (4, 4) of an arm at its displacements [rad] (n,)."""
        configuration = self._whole(arm, displacements)
        pin.forwardKinematics(self.pinocchio_model, self._data, configuration)
        placement = pin.updateFramePlacement(self.pinocchio_model, self._data, self._tips[arm])
        return np.array(placement.homogeneous)

    def jacobian(self, arm: str, displacements: npt.ArrayLike) -> FloatArray:
        """Return the Jacobian (6, n) of the gripper origin in world axes: rows linear, then angular velocity."""
        configuration = self._whole(arm, displacements)
        full = pin.computeFrameJacobian(
            self.pinocchio_model, self._data, configuration, self._tips[arm], pin.LOCAL_WORLD_ALIGNED
        )
        return np.array(full[:, self._indices[arm]])

    def external_force(self, arm: str, displacements: npt.ArrayLike, effort: npt.ArrayLike) -> FloatArray:
        """Return the force [N] that acts on the gripper, in world axes. Shape (3,).

        At rest the motors balance it: effort = -J_v^T f, solved by damped least squares.

        Args:
            arm: Name of the arm.
            displacements: Joint displacements [rad]. Shape (n,).
            effort: Motor torques without the part that carries the arm's own weight [N m]. Shape (n,).
        """
        linear = self.jacobian(arm, displacements)[:3]
        normal = linear @ linear.T + FORCE_DAMPING * np.eye(3)
        return np.asarray(-np.linalg.solve(normal, linear @ np.asarray(effort, dtype=float)))

    def chain(self, arm: str) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the arm as a product of exponentials (Bestick 2017, eq. 2.3), in the world at zero displacements.

        Returns:
            Joint axes (n, 3), joint origins [m] (n, 3) and ``world_from_gripper`` (4, 4).
        """
        model = self.pinocchio_model
        pin.framesForwardKinematics(model, self._data, pin.neutral(model))
        axes = pin.computeJointJacobians(model, self._data, pin.neutral(model))[3:, self._indices[arm]].T.copy()
        joints = [model.getJointId(name) for name in self.arm(arm).joint_names]
        points = np.array([self._data.oMi[joint].translation for joint in joints])
        return axes, points, np.array(self._data.oMf[self._tips[arm]].homogeneous)

    def _whole(self, arm: str, displacements: npt.ArrayLike) -> FloatArray:
        configuration: FloatArray = pin.neutral(self.pinocchio_model)
        configuration[self.arm_indices(arm)] = displacements
        return configuration

    def _index(self, joint: str) -> int:
        if joint not in self.joint_names:
            raise BadModelError(f"{self.urdf_path}: has no joint {joint!r}; it has {', '.join(self.joint_names)}")
        return int(self.pinocchio_model.joints[self.pinocchio_model.getJointId(joint)].idx_q)

    def _make_arm(self, name: str) -> ArmModel:
        given = self.description.arms[name]
        model = self.pinocchio_model
        if not model.existFrame(given.tip_frame):
            raise BadModelError(f"{self.urdf_path}: has no frame {given.tip_frame!r} (tip_frame of the {name} arm)")
        indices = [self._index(joint) for joint in given.joints]
        velocity = _frozen(model.velocityLimit[indices])
        arm = ArmModel(
            name=name,
            joint_names=tuple(given.joints),
            lower=_frozen(model.lowerPositionLimit[indices]),
            upper=_frozen(model.upperPositionLimit[indices]),
            velocity=velocity,
            planning_velocity=_frozen(velocity * self.description.velocity_scale),
            acceleration=_frozen(given.acceleration),
            effort=_frozen(model.effortLimit[indices]),
            tip_frame=given.tip_frame,
            finger_joints=tuple(given.finger_joints),
            opening=given.opening,
            postures=MappingProxyType({key: _frozen(value) for key, value in given.postures.items()}),
        )
        for posture, displacements in arm.postures.items():
            arm.check(displacements, f"posture {posture!r}")
        return arm


def _place_in_world(model: pin.Model, world_from_base: FloatArray) -> None:
    """Move the root of a pinocchio model, so that its frames come out in the world frame."""
    placement = pin.SE3(world_from_base)
    for joint in range(1, model.njoints):
        if model.parents[joint] == 0:
            model.jointPlacements[joint] = placement * model.jointPlacements[joint]
    for frame in model.frames:
        if frame.parentJoint == 0 and frame.name != "universe":
            frame.placement = placement * frame.placement
