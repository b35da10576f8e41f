"""The simulated person's body under command: what is planned, sway, sight, pull and load become servo targets."""

from __future__ import annotations

import mujoco
import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.sim.person_kinematics import PersonKinematics
from handover_ros.sim.person_model import PREFIX, servo_lag
from handover_ros.sim.person_motion import Movement, MovementSequence, Sway, WayPointPath
from handover_ros.sim.person_servo import GRAVITY, HandServo
from handover_ros.sim.person_spec import ARM_SLICE, HANDS, JOINTS, PersonSpec

AnyMovement = Movement | WayPointPath | MovementSequence
SHORTEST_MOVE = 0.4
FASTEST_JOINT = 2.4
TORSO_FOLLOWING = 14.0
LOAD_RISE = 0.3
FINGER_SPEED = 4.5
FINGERS_OPEN, FINGERS_CLOSED = (0.15, 0.0), (1.05, 0.75)
UPDATE_STEP = 0.01


class PersonActuation:
    """Turns planned movements into servo targets of one person.

    A command (20,) holds the torso's offset from where the person stands and the arms' displacements.

    Attributes:
        base: Torso coordinates where the person stands (sway, or a torso to follow), shape (6,).
        command: Last command, shape (20,), corrections by sight included.
        commanded: The same as displacements of all joints, shape (20,).
        standing: Command of standing.
    """

    def __init__(
        self, model: mujoco.MjModel, person: PersonSpec, kinematics: PersonKinematics, rng: np.random.Generator
    ) -> None:
        self._model, self._person, self._kinematics = model, person, kinematics
        joints = [model.joint(f"{PREFIX}{name}") for name in JOINTS]
        self._positions = np.array([int(joint.qposadr[0]) for joint in joints])
        self._velocities = np.array([int(joint.dofadr[0]) for joint in joints])
        self._actuators = np.array([model.actuator(f"{PREFIX}{name}").id for name in JOINTS])
        self._fingers = {
            hand: np.array([model.actuator(f"{PREFIX}{hand}_{part}").id for part in ("fingers", "thumb")])
            for hand in HANDS
        }
        self._lag = np.array([servo_lag(name) for name in JOINTS])
        self._servos = {hand: HandServo(model, person, hand) for hand in HANDS}
        self._sway = Sway(person, rng)
        self.standing = person.standing
        self.base = np.zeros(6)
        self.command = person.standing.copy()
        self.commanded = person.standing.copy()
        self._base_velocity = np.zeros(6)
        self._command_velocity = np.zeros(20)
        self._movement: AnyMovement | None = None
        self._fading: Movement | None = None
        self._torso_target: FloatArray | None = None
        self._finger_goal = dict.fromkeys(HANDS, np.array(FINGERS_OPEN))
        self._finger_now = dict.fromkeys(HANDS, np.array(FINGERS_OPEN))
        self._pull: dict[str, FloatArray] = {}
        self._load: tuple[int, tuple[str, ...], float] | None = None
        self._last_time: float | None = None

    def place(self, data: mujoco.MjData) -> None:
        """Put the body into its commanded posture at once, without velocity."""
        data.qpos[self._positions] = self.commanded
        data.qvel[self._velocities] = 0.0
        data.ctrl[self._actuators] = self.commanded
        for hand in HANDS:
            data.ctrl[self._fingers[hand]] = self._finger_now[hand]

    def measured(self, data: mujoco.MjData) -> tuple[FloatArray, FloatArray]:
        """Return true displacements and velocities, each of shape (20,)."""
        return data.qpos[self._positions].copy(), data.qvel[self._velocities].copy()

    def hand_pose(self, data: mujoco.MjData, hand: str) -> FloatArray:
        """Return world_from_hand (4, 4) as it is."""
        return self._servos[hand].pose(data)

    def posture(self) -> FloatArray:
        """Return the present displacements (20,) with the torso where the person stands."""
        posture = self.command.copy()
        posture[:6] += self.base
        return posture

    def set_torso_target(self, world_from_torso: FloatArray | None) -> None:
        """Let the torso follow a pose (4, 4), or sway again when None."""
        if world_from_torso is None:
            self._torso_target = None
            return
        target = self._kinematics.torso_coordinates(world_from_torso)
        target[3:] = self.base[3:] + (target[3:] - self.base[3:] + np.pi) % (2.0 * np.pi) - np.pi
        self._torso_target = target

    # Movements.

    def follow(self, movement: AnyMovement) -> None:
        """Follow a movement of commands from now on."""
        self._fold()
        self._movement = movement

    def move_to(self, time: float, duration: float, target: FloatArray) -> None:
        """Move from the present state to a command (20,) in ``duration`` [s], longer when a joint would be too fast."""
        self._fold()
        needed = 1.875 * float(np.abs(target - self.command).max()) / FASTEST_JOINT
        duration = max(duration, needed, SHORTEST_MOVE)
        self._movement = Movement(time, duration, self.command, self._command_velocity, target)

    def run(self, time: float, duration: float, points: FloatArray, overlapping: bool = False) -> None:
        """Run through commands (k, 20) in ``duration`` [s], longer when a joint would be too fast.

        Args:
            time: Now [s].
            duration: Wanted duration [s].
            points: Way points; the first one is where the present movement ends.
            overlapping: Whether the present movement is finished meanwhile; else the path begins where the person is.
        """
        present = self._movement
        self._fading = present if overlapping and isinstance(present, Movement) else None
        if not overlapping:
            self._fold()
            points = np.concatenate([self.command[None], points[1:]])
        travelled = np.abs(np.diff(points, axis=0)).sum(axis=0).max()
        duration = max(duration, 1.875 * float(travelled) / FASTEST_JOINT)
        lower = np.concatenate([np.full(6, -np.inf), self._person.lower[6:]])
        upper = np.concatenate([np.full(6, np.inf), self._person.upper[6:]])
        self._movement = WayPointPath(time, duration, points, lower, upper)

    def at_rest(self, time: float) -> bool:
        """Return whether the movement has ended."""
        return self._movement is None or time >= self._movement.end_time

    def done(self, time: float) -> float:
        """Return the share of the movement's time that is over."""
        if self._movement is None:
            return 1.0
        return (time - self._movement.start_time) / (self._movement.end_time - self._movement.start_time)

    def _fold(self) -> None:
        """Make the corrections by sight part of the command, so that nothing jumps."""
        self._fading = None
        for servo in self._servos.values():
            servo.correction = np.zeros(7)

    # Sight, force and fingers.

    def guide(self, data: mujoco.MjData, hands: dict[str, FloatArray]) -> FloatArray:
        """Correct the arms so that the hands come to poses (4, 4).

        Returns:
            The largest position [m] and angle [rad] error of the hands, shape (2,).
        """
        largest = np.zeros(2)
        for hand, pose in hands.items():
            servo = self._servos[hand]
            error = servo.error(data, pose)
            servo.correct(data, error, UPDATE_STEP)
            largest = np.maximum(largest, [np.sqrt(error[:3] @ error[:3]), np.sqrt(error[3:] @ error[3:])])
        return largest

    def pull(self, hands: dict[str, FloatArray], force: float) -> None:
        """Let hands pull towards the body with a force [N] each; no hands: no force."""
        torso = self._kinematics.torso_pose(self.base)[:3, 3]
        self._pull = {}
        for hand, pose in hands.items():
            towards = torso - pose[:3, 3]
            towards[2] = 0.0
            self._pull[hand] = towards * (force / (np.linalg.norm(towards) + 1e-9))

    def bear(self, object_name: str | None, hands: tuple[str, ...], time: float) -> None:
        """Bear the weight of an object with hands from now on; None: nothing."""
        body = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_BODY, f"object/{object_name}")
        self._load = None if object_name is None or body < 0 else (body, hands, time)

    def close(self, hand: str) -> None:
        """Close the fingers."""
        self._finger_goal[hand] = np.array(FINGERS_CLOSED)

    def open(self, hand: str) -> None:
        """Open the fingers."""
        self._finger_goal[hand] = np.array(FINGERS_OPEN)

    # Output.

    def update(self, data: mujoco.MjData, time: float) -> None:
        """Write the servo targets of this moment into ``data.ctrl``."""
        step = UPDATE_STEP if self._last_time is None else min(max(time - self._last_time, 1e-4), 0.1)
        self._last_time = time
        self._move_base(time, step)
        command = self.standing if self._movement is None else self._movement.position(time)
        if self._fading is not None and time < self._fading.end_time:
            command = command + self._fading.position(time) - self._fading.target
        command = command.copy()
        for hand, servo in self._servos.items():
            command[ARM_SLICE[hand]] += servo.correction
        command[6:] = np.minimum(np.maximum(command[6:], self._person.lower[6:]), self._person.upper[6:])
        self._command_velocity = (command - self.command) / step
        self.command = command
        commanded = command.copy()
        commanded[:6] += self.base
        # The servos lag behind a moving target by damping over stiffness: aim ahead by as much.
        velocity = self._command_velocity.copy()
        velocity[:6] += self._base_velocity
        self.commanded = commanded
        target = commanded + self._lag * velocity
        if self._pull or self._load is not None:
            self._add_forces(data, time, target)
        data.ctrl[self._actuators] = target
        for hand in HANDS:
            now, goal = self._finger_now[hand], self._finger_goal[hand]
            if now is not goal:
                limit = FINGER_SPEED * step
                now = now + np.minimum(np.maximum(goal - now, -limit), limit)
                self._finger_now[hand] = goal if np.array_equal(now, goal) else now
            data.ctrl[self._fingers[hand]] = self._finger_now[hand]

    def _move_base(self, time: float, step: float) -> None:
        """Let the base follow its target, critically damped."""
        target = self._sway.offset(time) if self._torso_target is None else self._torso_target
        acceleration = TORSO_FOLLOWING**2 * (target - self.base) - 2.0 * TORSO_FOLLOWING * self._base_velocity
        self._base_velocity = self._base_velocity + step * acceleration
        self.base = self.base + step * self._base_velocity

    def _add_forces(self, data: mujoco.MjData, time: float, target: FloatArray) -> None:
        """Add to the servo targets (20,) what makes the arms pull and bear."""
        for hand, force in self._pull.items():
            target[ARM_SLICE[hand]] += self._servos[hand].effort(data, force)
        if self._load is None:
            return
        body, hands, since = self._load
        share = min((time - since) / LOAD_RISE, 1.0) / len(hands)
        force = np.array([0.0, 0.0, share * GRAVITY * float(self._model.body_mass[body])])
        for hand in hands:
            target[ARM_SLICE[hand]] += self._servos[hand].effort(data, force, data.xipos[body])
