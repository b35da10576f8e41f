"""The simulated person: stands, makes calibration motions, takes what is offered and puts it where it belongs."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from handover_ros.geometry import FloatArray, transform_from_pose
from handover_ros.objects import load_catalogue
from handover_ros.sim.person_actuation import PersonActuation
from handover_ros.sim.person_behaviour import BEHAVIOURS, PersonBehaviour
from handover_ros.sim.person_kinematics import BodyPoses, PersonKinematics
from handover_ros.sim.person_model import PREFIX
from handover_ros.sim.person_plans import PathPlanner
from handover_ros.sim.person_posture import PostureFinder
from handover_ros.sim.person_reach import GraspChooser, Takeable, Taking
from handover_ros.sim.person_spec import PersonSpec
from handover_ros.sim.person_view import PersonView

__all__ = ["BEHAVIOURS", "Person", "PersonView"]


class Person:
    """A person in a simulation; call ``update`` at 100 Hz of simulated time before the physics steps.

    Args:
        model: Compiled model that ``add_person`` has added the person to.
        person: Who it is.
        rng: Source of sway and of the noise of choices.
        catalogue: Objects it can take; None: those of ``config/objects``.

    Attributes:
        person: Who it is.
        kinematics: Its geometry where it stands.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        person: PersonSpec,
        rng: np.random.Generator,
        catalogue: Mapping[str, Takeable] | None = None,
    ) -> None:
        self.person = person
        stance = model.body(f"{PREFIX}stance")
        self.kinematics = PersonKinematics(person, transform_from_pose([*stance.pos, *stance.quat[1:], stance.quat[0]]))
        self._model = model
        self._catalogue = load_catalogue() if catalogue is None else catalogue
        finder = PostureFinder(self.kinematics)
        self._chooser, self._planner = GraspChooser(finder), PathPlanner(finder)
        self._gripper_sites = {
            arm: index
            for arm in ("left", "right")
            if (index := mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, f"robot/{arm}_gripper")) >= 0
        }
        self.reset(rng)

    def reset(self, rng: np.random.Generator) -> None:
        """Stand at the start again, with nothing in the hands; the behaviour becomes ``take``."""
        self._body = PersonActuation(self._model, self.person, self.kinematics, rng)
        self._behaviour = PersonBehaviour(
            self.person, self._body, self._chooser, self._planner, self._catalogue, self._gripper_sites, rng
        )

    @property
    def behaviour(self) -> str:
        """What it was told to do, one of ``BEHAVIOURS``."""
        return self._behaviour.behaviour

    @property
    def phase(self) -> str:
        """What it is doing, e.g. ``standing``, ``reaching``, ``pulling``, ``moving``; see ``PersonBehaviour``."""
        return self._behaviour.phase

    @property
    def grip_request(self) -> dict[str, str | None]:
        """Hand to the object it wants to hold now, or None."""
        return self._behaviour.grip_request

    @property
    def taking(self) -> Taking | None:
        """The last decision how to take an object; None before the first one."""
        return self._behaviour.taking

    def set_behaviour(self, behaviour: str, motion: str = "") -> float:
        """Choose what the person does from now on; what it holds it first puts down.

        Args:
            behaviour: One of ``BEHAVIOURS``.
            motion: For ``calibrate``: one calibration motion, or all in order when empty.

        Returns:
            How long the calibration motions take [s]; 0 otherwise.

        Raises:
            UnknownNameError: There is no such behaviour or motion.
        """
        return self._behaviour.choose(behaviour, motion)

    def set_torso_target(self, world_from_torso: FloatArray | None) -> None:
        """Let the torso follow a pose (4, 4), or stand and sway again when None."""
        self._body.set_torso_target(world_from_torso)

    def place(self, data: mujoco.MjData) -> None:
        """Put the body into the standing posture at once."""
        self._body.place(data)

    @property
    def displacements(self) -> FloatArray:
        """Commanded displacements of all joints [m], [rad], shape (20,), within the limits."""
        return self._body.commanded

    def measured(self, data: mujoco.MjData) -> tuple[FloatArray, FloatArray]:
        """Return true displacements and velocities of all joints, each of shape (20,)."""
        return self._body.measured(data)

    def forward(self, displacements: FloatArray) -> BodyPoses:
        """Return the poses of torso and hands at displacements (20,)."""
        return self.kinematics.forward(displacements)

    def update(self, data: mujoco.MjData, time: float, view: PersonView) -> None:
        """Decide, move on, and write the commands of the person's actuators into ``data.ctrl``."""
        self._behaviour.update(data, time, view)
        self._body.update(data, time)
