"""The simulated robot's controller: executes joint trajectories within the limits and counts what exceeds them."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from handover_ros.errors import BadRequestError
from handover_ros.geometry import FloatArray
from handover_ros.robot.model import ArmModel
from handover_ros.sim.joint_path import JointPath
from handover_ros.sim.world import World, joint_group

SERVO_SPEED = 0.95  # of the velocity limit, at which a servo catches up
POSITION_TOLERANCE = 1e-3  # [rad] beyond a limit before it counts
VELOCITY_TOLERANCE = 0.02  # share of a velocity limit before it counts (the servo's ripple)
COMMAND_TOLERANCE = 1e-3  # share of a velocity limit that a command may exceed by rounding
START_TOLERANCE = 0.05  # [rad] between a trajectory's point at time 0 and the present command
SATURATED = 0.999  # share of an effort limit


@dataclass(frozen=True, eq=False)
class JointState:
    """State of the robot's joints: names, positions [rad, m], velocities, efforts [N m, N] without gravity's part."""

    names: tuple[str, ...]
    positions: FloatArray
    velocities: FloatArray
    efforts: FloatArray


@dataclass(frozen=True)
class LimitCounts:
    """How often the robot left its limits since the start.

    Attributes:
        joint_limit_violations: Times a joint went beyond a position limit.
        velocity_limit_violations: Times a joint went beyond its velocity limit.
        effort_saturations: Physics steps in which a joint needed its whole effort.
    """

    joint_limit_violations: int = 0
    velocity_limit_violations: int = 0
    effort_saturations: int = 0


class RobotController:
    """Drives the arms along commanded paths through position-velocity servos.

    Args:
        world: The cell.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._arms: dict[str, ArmModel] = {name: world.robot.arm(name) for name in world.robot.arm_names}
        self._all = joint_group(world.model, world.robot.joint_names)
        model = world.model
        # ctrl = q + (damping / stiffness) v makes the servo's force stiffness (q - position) + damping (v - velocity).
        self._lead = {
            name: -model.actuator_biasprm[group.actuators, 2] / model.actuator_gainprm[group.actuators, 0]
            for name, group in world.arms.items()
        }
        # The target's distance at which the servo comes to rest at SERVO_SPEED of the velocity limit.
        self._reach = {name: SERVO_SPEED * self._lead[name] * arm.velocity for name, arm in self._arms.items()}
        self._watched = np.concatenate([group.positions for group in world.arms.values()])
        self._watched_speeds = np.concatenate([group.velocities for group in world.arms.values()])
        self._watched_actuators = np.concatenate([group.actuators for group in world.arms.values()])
        arms = self._arms.values()
        self._lower = np.concatenate([arm.lower for arm in arms]) - POSITION_TOLERANCE
        self._upper = np.concatenate([arm.upper for arm in arms]) + POSITION_TOLERANCE
        self._greatest_speed = np.concatenate([arm.velocity for arm in arms]) * (1.0 + VELOCITY_TOLERANCE)
        self._greatest_effort = np.concatenate([arm.effort for arm in arms]) * SATURATED
        self.enabled = True
        self.reset()

    def reset(self) -> None:
        """Forget all commands and counts: the arms stand at home."""
        self._paths = {name: JointPath.still(0.0, arm.home) for name, arm in self._arms.items()}
        self._wanted = {name: arm.home.copy() for name, arm in self._arms.items()}
        self._moving = dict.fromkeys(self._arms, True)
        self._counts = LimitCounts()
        self._outside = np.zeros(len(self._watched), dtype=bool)
        self._too_fast = np.zeros(len(self._watched), dtype=bool)

    @property
    def counts(self) -> LimitCounts:
        """Violations and saturations since the start."""
        return self._counts

    def place_at_home(self, data: mujoco.MjData) -> None:
        """Put the arms at their home postures at once, at rest."""
        for name, group in self._world.arms.items():
            data.qpos[group.positions] = self._arms[name].home
            data.qvel[group.velocities] = 0.0
            data.ctrl[group.actuators] = self._arms[name].home

    def command_trajectory(
        self,
        time: float,
        joint_names: tuple[str, ...] | list[str],
        times: npt.ArrayLike,
        positions: npt.ArrayLike,
        velocities: npt.ArrayLike,
    ) -> None:
        """Replace what one or more arms do by a trajectory that starts now, from the present command.

        Args:
            time: Now [s].
            joint_names: All joints of one arm or of several arms, n in any order.
            times: From the start of the trajectory [s], >= 0, increasing. Shape (k,).
            positions: [rad]. Shape (k, n).
            velocities: [rad/s]. Shape (k, n).

        Raises:
            BadRequestError: The robot is held, or a number, name, shape or limit is wrong; nothing is changed.
        """
        if not self.enabled:
            raise BadRequestError("joint trajectory: the robot is held; publish true on robot/enable at 5 Hz or faster")
        names = list(joint_names)
        knots, points, speeds = _checked_arrays(names, times, positions, velocities)
        paths = {}
        for arm, columns in self._columns(names).items():
            paths[arm] = self._checked_path(self._arms[arm], time, knots, points[:, columns], speeds[:, columns])
        self._paths.update(paths)
        self._moving.update(dict.fromkeys(paths, True))

    def hold(self, time: float, arm: str | None = None) -> None:
        """Bring an arm (None: all) to rest where it is, with its greatest acceleration."""
        for name in self._arms if arm is None else [self._world.robot.arm(arm).name]:
            model = self._arms[name]
            if time >= self._paths[name].end:
                continue
            position, velocity = self._paths[name].sample(time)
            path = JointPath.stopping(time, position, velocity, model.acceleration)
            np.clip(path.positions, model.lower, model.upper, out=path.positions)
            self._paths[name] = path
            self._moving[name] = True

    def enable(self, time: float, on: bool) -> None:
        """Accept commands, or hold: any motion is abandoned, the motors stay on."""
        if not on and self.enabled:
            self.hold(time)
        self.enabled = on

    def moving(self, time: float, arm: str) -> bool:
        """Return whether a commanded motion of an arm is under way."""
        return time < self._paths[arm].end

    def commanded(self, time: float, arm: str) -> tuple[FloatArray, FloatArray]:
        """Return commanded positions (n,) [rad] and velocities (n,) [rad/s] of an arm."""
        return self._paths[arm].sample(time)

    def update(self, data: mujoco.MjData, time: float) -> None:
        """Write the servo targets of this instant into ``data.ctrl``.

        As on the real robot, the servos never ask for more than the velocity limit: an arm that was held up catches up
        at that speed and does not leap.
        """
        for name, group in self._world.arms.items():
            if self._moving[name]:
                position, velocity = self._paths[name].sample(time)
                self._wanted[name] = position + self._lead[name] * velocity
                self._moving[name] = time < self._paths[name].end
            present = data.qpos[group.positions]
            data.ctrl[group.actuators] = present + np.clip(
                self._wanted[name] - present, -self._reach[name], self._reach[name]
            )

    def watch(self, data: mujoco.MjData) -> None:
        """Count what is beyond the limits after a physics step."""
        position = data.qpos[self._watched]
        outside = (position < self._lower) | (position > self._upper)
        too_fast = np.abs(data.qvel[self._watched_speeds]) > self._greatest_speed
        saturated = np.abs(data.actuator_force[self._watched_actuators]) > self._greatest_effort
        if outside.any() or too_fast.any() or saturated.any():
            self._counts = LimitCounts(
                self._counts.joint_limit_violations + int(np.count_nonzero(outside & ~self._outside)),
                self._counts.velocity_limit_violations + int(np.count_nonzero(too_fast & ~self._too_fast)),
                self._counts.effort_saturations + int(saturated.any()),
            )
        self._outside, self._too_fast = outside, too_fast

    def joint_state(self, data: mujoco.MjData) -> JointState:
        """Return the state of all joints of the robot."""
        group = self._all
        return JointState(
            group.names,
            data.qpos[group.positions].copy(),
            data.qvel[group.velocities].copy(),
            data.actuator_force[group.actuators].copy(),
        )

    def _columns(self, names: list[str]) -> dict[str, list[int]]:
        """Return, for each arm that is named, the columns of its joints in the arm's own order."""
        columns: dict[str, list[int]] = {}
        left_over = set(names)
        for arm, model in self._arms.items():
            present = [joint for joint in model.joint_names if joint in left_over]
            if not present:
                continue
            if len(present) < len(model.joint_names):
                missing = [joint for joint in model.joint_names if joint not in left_over]
                raise BadRequestError(
                    f"joint trajectory: misses {', '.join(missing)} of the {arm} arm; give all its joints"
                )
            columns[arm] = [names.index(joint) for joint in model.joint_names]
            left_over -= set(present)
        if left_over:
            known = ", ".join(joint for model in self._arms.values() for joint in model.joint_names)
            raise BadRequestError(f"joint trajectory: unknown joint {sorted(left_over)[0]!r}; known: {known}")
        return columns

    def _checked_path(
        self, arm: ArmModel, time: float, knots: FloatArray, points: FloatArray, speeds: FloatArray
    ) -> JointPath:
        """Return the path from the present command through the knots, after checking it against the arm's limits."""
        for row in points:
            arm.check(row, "joint trajectory", POSITION_TOLERANCE)
        position, velocity = self._paths[arm.name].sample(time)
        if knots[0] <= 0.0:
            gap = np.abs(points[0] - position)
            if gap.max() > START_TOLERANCE:
                worst = int(np.argmax(gap))
                raise BadRequestError(
                    f"joint trajectory: {arm.joint_names[worst]} starts at {points[0, worst]:.3f} rad, but its command "
                    f"is {position[worst]:.3f} rad now; start within {START_TOLERANCE} rad of it, or give the first "
                    "point a time_from_start above 0"
                )
            knots, points, speeds = knots[1:], points[1:], speeds[1:]
        if len(knots) == 0:
            raise BadRequestError("joint trajectory: needs a point with a time_from_start above 0")
        if np.any(np.abs(speeds[-1]) > COMMAND_TOLERANCE * arm.velocity):
            raise BadRequestError("joint trajectory: the velocities of the last point must be 0")
        path = JointPath(
            np.concatenate([[time], time + knots]),
            np.concatenate([position[None], points]),
            np.concatenate([velocity[None], speeds]),
        )
        fastest = path.fastest()
        over = fastest > arm.velocity * (1.0 + COMMAND_TOLERANCE)
        if over.any():
            worst = int(np.argmax(fastest / arm.velocity))
            raise BadRequestError(
                f"joint trajectory: {arm.joint_names[worst]} would move at {fastest[worst]:.2f} rad/s; its limit is "
                f"{arm.velocity[worst]:.2f} rad/s"
            )
        return path


def _checked_arrays(
    names: list[str], times: npt.ArrayLike, positions: npt.ArrayLike, velocities: npt.ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return times, positions and velocities of a trajectory as arrays that fit each other."""
    knots, points, speeds = (np.array(values, dtype=float) for values in (times, positions, velocities))
    if knots.ndim != 1 or len(knots) == 0 or not names:
        raise BadRequestError("joint trajectory: needs at least one point and one joint")
    if len(set(names)) != len(names):
        raise BadRequestError("joint trajectory: a joint is named twice")
    expected = (len(knots), len(names))
    if points.shape != expected or speeds.shape != expected:
        raise BadRequestError(
            f"joint trajectory: positions and velocities must have shape {expected}, "
            f"got {points.shape} and {speeds.shape}"
        )
    if not (np.isfinite(knots).all() and np.isfinite(points).all() and np.isfinite(speeds).all()):
        raise BadRequestError("joint trajectory: times, positions and velocities must be finite numbers")
    if knots[0] < 0.0 or np.any(np.diff(knots) <= 0.0):
        raise BadRequestError(
            "joint trajectory: time_from_start must start at or above 0 and increase from point to point"
        )
    return knots, points, speeds
