"""How the simulated person's arms follow the world: corrections by sight, a pull at the object, bearing its weight."""

from __future__ import annotations

import mujoco
import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.sim.person_model import ARM_SERVO, PREFIX, REFERENCE_MASS
from handover_ros.sim.person_spec import ARM_JOINTS, PersonSpec

DAMPING = 0.01
GAIN = 14.0
LARGEST_CORRECTION = 0.35
LARGEST_SPEED = 1.2
GRAVITY = 9.81


class HandServo:
    """Corrections to one arm's commanded displacements from what the person sees and feels of its hand.

    Attributes:
        correction: Added to the planned displacements [rad], shape (7,).
    """

    def __init__(self, model: mujoco.MjModel, person: PersonSpec, hand: str) -> None:
        self._model = model
        self.site = model.site(f"{PREFIX}{hand}_hand_grip").id
        self._body = int(model.site_bodyid[self.site])
        joints = [model.joint(f"{PREFIX}{hand}_{joint}") for joint in ARM_JOINTS]
        self._columns = np.array([int(joint.dofadr[0]) for joint in joints])
        stiffness = np.array([servo[0] for servo in ARM_SERVO]) * person.mass / REFERENCE_MASS
        self._compliance = 1.0 / stiffness
        self._linear, self._angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        self.correction = np.zeros(7)

    def pose(self, data: mujoco.MjData) -> FloatArray:
        """Return world_from_hand (4, 4) as it is."""
        pose = np.eye(4)
        pose[:3, :3] = data.site_xmat[self.site].reshape(3, 3)
        pose[:3, 3] = data.site_xpos[self.site]
        return pose

    def error(self, data: mujoco.MjData, world_from_hand: FloatArray) -> FloatArray:
        """Return the displacement (6,) still to go to a hand pose: linear [m], angular [rad] (for small angles)."""
        turn = world_from_hand[:3, :3] @ data.site_xmat[self.site].reshape(3, 3).T
        error = np.empty(6)
        error[:3] = world_from_hand[:3, 3] - data.site_xpos[self.site]
        error[3] = 0.5 * (turn[2, 1] - turn[1, 2])
        error[4] = 0.5 * (turn[0, 2] - turn[2, 0])
        error[5] = 0.5 * (turn[1, 0] - turn[0, 1])
        return error

    def correct(self, data: mujoco.MjData, error: FloatArray, step: float) -> None:
        """Move the correction so that the error (6,) shrinks, by damped least squares; ``step`` [s] has passed."""
        mujoco.mj_jacSite(self._model, data, self._linear, self._angular, self.site)
        jacobian = np.concatenate([self._linear[:, self._columns], self._angular[:, self._columns]])
        system = jacobian @ jacobian.T
        system.flat[::7] += DAMPING**2
        change = (GAIN * step) * (jacobian.T @ np.linalg.solve(system, error))
        largest = np.abs(change).max()
        if largest > LARGEST_SPEED * step:
            change *= LARGEST_SPEED * step / largest
        self.correction = np.minimum(np.maximum(self.correction + change, -LARGEST_CORRECTION), LARGEST_CORRECTION)

    def effort(self, data: mujoco.MjData, force: FloatArray, point: FloatArray | None = None) -> FloatArray:
        """Return the displacements (7,) to add to the command so that the hand pushes with a force [N] (world).

        Args:
            data: State of the simulation.
            force: Force on what is held, shape (3,).
            point: Where it acts, in world; None: at the grip.
        """
        mujoco.mj_jac(
            self._model, data, self._linear, None, data.site_xpos[self.site] if point is None else point, self._body
        )
        return (force @ self._linear[:, self._columns]) * self._compliance
