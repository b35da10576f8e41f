"""The robot's grippers: fingers that move to an opening with a limited force."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from handover_ros.errors import BadRequestError
from handover_ros.geometry import FloatArray
from handover_ros.sim.world import World

SPEED = 0.10  # [m/s] of the opening
DEFAULT_FORCE = 20.0  # [N]
LEAST_FORCE = 1.0  # [N] that still moves the fingers
OPENING_TOLERANCE = 0.002  # [m] that a command may lie outside the gripper's range


@dataclass(frozen=True, eq=False)
class GripperState:
    """State of all grippers, in the order of ``arms``: openings [m], forces [N] (closing positive), holding or not."""

    arms: tuple[str, ...]
    openings: FloatArray
    forces: FloatArray
    gripping: tuple[bool, ...]


class Grippers:
    """Moves the fingers of all arms.

    Args:
        world: The cell.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._robot = world.robot
        self._force_limits = {
            arm: world.model.actuator_forcerange[group.actuators].copy() for arm, group in world.fingers.items()
        }
        travel = {arm: self._robot.finger_displacements(arm, self.range(arm)[1]) for arm in world.fingers}
        self._travel = {arm: np.abs(values) for arm, values in travel.items()}
        self._signs = {arm: np.sign(values) for arm, values in travel.items()}
        self._targets: dict[str, float] = {}
        self._commands: dict[str, float] = {}
        self.reset()

    def reset(self) -> None:
        """Forget all commands: the grippers stand open, at their default force."""
        for arm in self._world.fingers:
            self._commands[arm] = self._targets[arm] = self.range(arm)[1]
            self._set_force(arm, DEFAULT_FORCE)

    def range(self, arm: str) -> tuple[float, float]:
        """Return the opening of a gripper [m], closed and open."""
        return self._robot.arm(arm).opening

    def place_open(self, data: mujoco.MjData) -> None:
        """Put the fingers at their widest opening at once."""
        for arm, group in self._world.fingers.items():
            displacements = self._robot.finger_displacements(arm, self.range(arm)[1])
            data.qpos[group.positions] = displacements
            data.qvel[group.velocities] = 0.0
            data.ctrl[group.actuators] = displacements

    def command(self, arm: str, opening: float, max_force: float) -> None:
        """Move the fingers of an arm to an opening [m] with at most ``max_force`` [N] at the tips.

        Raises:
            UnknownNameError: There is no such arm.
            BadRequestError: The opening or the force is not finite or out of range.
        """
        closed, widest = self.range(arm)
        if not (closed - OPENING_TOLERANCE <= opening <= widest + OPENING_TOLERANCE):
            raise BadRequestError(
                f"gripper command: opening {opening} m of the {arm} gripper is outside {closed:.4f} to {widest:.4f} m"
            )
        if not (np.isfinite(max_force) and max_force > 0.0):
            raise BadRequestError(f"gripper command: max_force must be above 0 N, got {max_force}")
        self._commands[arm] = float(np.clip(opening, closed, widest))
        self._set_force(arm, max_force)

    def update(self, data: mujoco.MjData, timestep: float) -> None:
        """Move the servo targets one time step [s] towards the commanded openings."""
        for arm, group in self._world.fingers.items():
            gap = self._commands[arm] - self._targets[arm]
            if gap == 0.0:
                continue
            step = float(np.clip(gap, -SPEED * timestep, SPEED * timestep))
            self._targets[arm] = self._commands[arm] if abs(gap) <= SPEED * timestep else self._targets[arm] + step
            data.ctrl[group.actuators] = self._robot.finger_displacements(arm, self._targets[arm])

    def commanded(self, arm: str) -> float:
        """Return the commanded opening of a gripper [m]."""
        return self._commands[arm]

    def opening(self, data: mujoco.MjData, arm: str) -> float:
        """Return the present opening of a gripper [m]."""
        closed, widest = self.range(arm)
        displaced = np.abs(data.qpos[self._world.fingers[arm].positions]).sum()
        return closed + (widest - closed) * float(displaced / self._travel[arm].sum())

    def force(self, data: mujoco.MjData, arm: str) -> float:
        """Return the force at the finger tips of a gripper [N], closing positive, the mean of its fingers."""
        efforts = data.actuator_force[self._world.fingers[arm].actuators]
        return float(-np.mean(self._signs[arm] * efforts))

    def _set_force(self, arm: str, force: float) -> None:
        limits = self._force_limits[arm]
        greatest = np.minimum(np.abs(limits), max(force, LEAST_FORCE))
        self._world.model.actuator_forcerange[self._world.fingers[arm].actuators] = np.sign(limits) * greatest
