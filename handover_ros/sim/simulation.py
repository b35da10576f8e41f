"""The simulated cell: physics at a fixed rate, robot, person, cameras and objects, the same again for the same seed."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from handover_ros.errors import BadRequestError
from handover_ros.geometry import FloatArray, make_transform
from handover_ros.objects.catalogue import load_catalogue
from handover_ros.objects.scene import Scene
from handover_ros.robot.model import RobotModel
from handover_ros.sim.cameras import CapturedFrame, MotionCapture, ring_of_cameras
from handover_ros.sim.grasping import GraspChange, Grasping
from handover_ros.sim.grippers import Grippers, GripperState
from handover_ros.sim.offer import OfferWatch
from handover_ros.sim.options import PERSON_RATE, SimulationOptions
from handover_ros.sim.person import Person, PersonView
from handover_ros.sim.person_model import PREFIX as PERSON_PREFIX
from handover_ros.sim.person_model import PersonSpec, load_person
from handover_ros.sim.person_spec import JOINTS, MARKERS
from handover_ros.sim.robot import JointState, RobotController
from handover_ros.sim.truth import ObjectWatch, SimulationEvent, Truth, grasp_event, object_poses
from handover_ros.sim.world import World, build_world

WATCH_RATE = 50.0  # [Hz] of looking where objects lie
POSITION_NOISE = 0.0005  # [m] of perceived object poses, standard deviation along each axis
ANGLE_NOISE = 0.003  # [rad] about each axis
DEFAULT_FORCE = 20.0  # [N]


class Simulation:
    """A cell that can be commanded and looked at, one physics step at a time.

    The same seed and the same commands at the same steps give the same state, bit for bit.

    Args:
        scene: Tables, placements, goals and who stands where.
        seed: Of all random numbers.
        options: Rates, noise, who is there.

    Raises:
        UnknownNameError: An object, robot or person of the scene is unknown.
        BadModelError: A file of theirs cannot be used, or a rate is out of range.
    """

    def __init__(self, scene: Scene, seed: int = 0, options: SimulationOptions | None = None) -> None:
        self.scene = scene
        self.options = options or SimulationOptions()
        rate = self.options.physics_rate
        self.timestep = 1.0 / rate
        catalogue = load_catalogue()
        robot = RobotModel.load(self.options.robot or scene.robot)
        self.world: World = build_world(scene, robot, catalogue, self._person_spec(), self.timestep)
        self.model = self.world.model
        self.data = mujoco.MjData(self.model)
        self.robot = RobotController(self.world)
        self.grippers = Grippers(self.world)
        self.grasping = Grasping(self.world, self.grippers)
        self._watch = ObjectWatch(self.world)
        self._offers = OfferWatch(scene)
        self._person_every = round(rate / PERSON_RATE)
        self._watch_every = round(rate / WATCH_RATE)
        self._epoch = self.options.start_time
        self._events: list[SimulationEvent] = []
        self._captures, self._next_capture = 0, 0.0
        self._frames: list[tuple[float, CapturedFrame]] = []
        self.person: Person | None = None
        self.mocap: MotionCapture | None = None
        self._start(seed)

    # Running

    @property
    def time(self) -> float:
        """Simulated time [s]; it goes on over a reset."""
        return self._epoch + self._now

    @property
    def clock_offset(self) -> float:
        """What the clock showed at the last reset [s]."""
        return self._epoch

    @property
    def _now(self) -> float:
        """Time since the last reset [s]: what happens depends on this one only."""
        return self._steps * self.timestep

    def step(self) -> None:
        """Advance by one physics step.

        The positions of all bodies (first half of MuJoCo's step) are those of ``time`` whenever this is not running.
        """
        data, now = self.data, self._now
        if self._steps % self._person_every == 0:
            self._update_person(now)
        self.robot.update(data, now)
        self.grippers.update(data, self.timestep)
        mujoco.mj_step2(self.model, data)
        mujoco.mj_step1(self.model, data)
        self._steps += 1
        self.robot.watch(data)
        self._note(self.grasping.update_grippers(data))
        if self._steps % self._watch_every == 0:
            self._events += self._watch.update(data, self.grasping, self.time)
        if self.mocap is not None and self._now >= self._next_capture - 1e-9:
            self._frames.append((self.time, self.mocap.capture(data, self.time)))
            self._captures += 1
            self._next_capture = self._captures / self.options.mocap_rate

    def run(self, seconds: float) -> None:
        """Advance by a time [s], in whole steps."""
        for _ in range(round(seconds / self.timestep)):
            self.step()

    def reset(self, seed: int | None = None, objects_only: bool = False) -> None:
        """Put the cell back to its start; the clock goes on.

        Args:
            seed: New seed; None: the one it had.
            objects_only: Objects back to where they were placed; robot and person stay.
        """
        if objects_only:
            self.grasping.reset(self.data)
            self._watch.reset()
            self._offers.reset()
            for position, velocity in self.world.object_joints.values():
                self.data.qpos[position : position + 7] = self.model.qpos0[position : position + 7]
                self.data.qvel[velocity : velocity + 6] = 0.0
            mujoco.mj_forward(self.model, self.data)
            self._event("reset", "all objects are back in their places")
            return
        self._epoch = self.time
        if seed is not None:
            self.mocap = None  # a new seed is a new device; otherwise it goes on as its clock does
        self._start(self.seed if seed is None else seed)
        self._event("reset", f"the cell is back at its start, seed {self.seed}")

    # Commands

    def command_trajectory(
        self,
        joint_names: tuple[str, ...] | list[str],
        times: npt.ArrayLike,
        positions: npt.ArrayLike,
        velocities: npt.ArrayLike,
    ) -> None:
        """Let the robot follow a joint trajectory from now on; see ``RobotController.command_trajectory``.

        Raises:
            BadRequestError: The robot is held, or the trajectory cannot be followed.
        """
        self.robot.command_trajectory(self._now, joint_names, times, positions, velocities)

    def hold(self, arm: str | None = None) -> None:
        """Bring one arm, or all, to rest where they are."""
        self.robot.hold(self._now, arm)

    def enable(self, on: bool) -> None:
        """Accept robot commands, or hold the robot where it is."""
        self.robot.enable(self._now, on)

    def command_gripper(self, arm: str, opening: float, max_force: float = DEFAULT_FORCE) -> None:
        """Move a gripper to an opening [m] with at most ``max_force`` [N] at the finger tips.

        Raises:
            UnknownNameError: There is no such arm.
            BadRequestError: A number is out of range, or the robot is held.
        """
        if not self.robot.enabled:
            raise BadRequestError("gripper command: the robot is held; publish true on robot/enable at 5 Hz or faster")
        self.grippers.command(arm, opening, max_force)

    def set_behaviour(self, behaviour: str, motion: str = "") -> float:
        """Tell the person what to do; returns the duration of calibration motions [s].

        Raises:
            BadRequestError: There is no person.
            UnknownNameError: There is no such behaviour or motion.
        """
        duration = self._someone().set_behaviour(behaviour, motion)
        self._event("person", f"the person's behaviour is now {behaviour}" + (f": {motion}" if motion else ""))
        return duration

    def set_fault(self, kind: str, magnitude: float = 0.0, duration: float = 0.0) -> None:
        """Disturb the motion capture; see ``Faults.set``.

        Raises:
            BadRequestError: There is no person to capture, or a number is out of range.
            UnknownNameError: There is no such fault.
        """
        if self.mocap is None:
            raise BadRequestError("set_fault: there is no person, so no motion capture")
        self.mocap.faults.set(kind, self.time, magnitude, duration)
        until = f"for {duration:g} s" if duration else "until none"
        self._event("fault", f"motion capture fault {kind}, magnitude {magnitude:g}, {until}")

    def set_torso_target(self, world_from_torso: FloatArray | None) -> None:
        """Let the person's torso follow a pose (4, 4); None: stand by itself again.

        Raises:
            BadRequestError: There is no person.
        """
        self._someone().set_torso_target(world_from_torso)

    def report(self, kind: str, message: str) -> None:
        """Add an event of the caller's own, e.g. a refused command."""
        self._event(kind, message)

    # State

    def joint_state(self) -> JointState:
        """Return the state of the robot's joints."""
        return self.robot.joint_state(self.data)

    def gripper_state(self) -> GripperState:
        """Return the state of the grippers."""
        arms = tuple(self.world.fingers)
        holding = set(self.grasping.held_by_robot.values())
        return GripperState(
            arms,
            np.array([self.grippers.opening(self.data, arm) for arm in arms]),
            np.array([self.grippers.force(self.data, arm) for arm in arms]),
            tuple(arm in holding for arm in arms),
        )

    def object_poses(self) -> dict[str, FloatArray]:
        """Return the perceived world_from_object (4, 4) of all objects, with a little noise."""
        poses = object_poses(self.world, self.data)
        if not poses:
            return poses
        noise = self._perception.standard_normal((len(poses), 6))
        turns = Rotation.from_rotvec(ANGLE_NOISE * noise[:, 3:]).as_matrix()
        for pose, turn, shift in zip(poses.values(), turns, noise[:, :3], strict=True):
            pose[:3, :3] = turn @ pose[:3, :3]
            pose[:3, 3] += POSITION_NOISE * shift
        return poses

    def events(self) -> list[SimulationEvent]:
        """Return what happened since the last call."""
        events, self._events = self._events, []
        return events

    def frames(self) -> list[tuple[float, CapturedFrame]]:
        """Return the marker frames captured since the last call, each with its time of capture [s]."""
        frames, self._frames = self._frames, []
        return frames

    def truth(self) -> Truth:
        """Return the true state of the cell."""
        torso: FloatArray | None = None
        names: tuple[str, ...] = ()
        displacements, velocities = np.empty(0), np.empty(0)
        if self.person is not None:
            site = self.data.site(f"{PERSON_PREFIX}torso")
            torso = make_transform(site.xmat.reshape(3, 3), site.xpos)
            names = JOINTS
            displacements, velocities = self.person.measured(self.data)
        return Truth(
            time=self.time,
            torso=torso,
            joint_names=names,
            displacements=displacements,
            velocities=velocities,
            objects=object_poses(self.world, self.data),
            holders={name: self._watch.holder(name, self.grasping) for name in self.world.objects},
            counts=self.robot.counts,
        )

    def snapshot(self) -> mujoco.MjData:
        """Return a copy of the present state, e.g. to draw it in another thread."""
        return copy.copy(self.data)

    # Inside

    def _person_spec(self) -> PersonSpec | None:
        name = self.options.person or self.scene.person
        return load_person(name) if name and name != "none" else None

    def _start(self, seed: int) -> None:
        """Put everything to its start, with fresh random numbers."""
        self.seed = seed
        person_seed, mocap_seed, perception_seed = np.random.SeedSequence(abs(seed)).spawn(3)
        self._perception = np.random.default_rng(perception_seed)
        self._steps = 0
        self._captures, self._next_capture = 0, 0.0
        mujoco.mj_resetData(self.model, self.data)
        self.robot.reset()
        self.grippers.reset()
        self.grasping.reset(self.data)
        self._watch.reset()
        self._offers.reset()
        self.robot.place_at_home(self.data)
        self.grippers.place_open(self.data)
        if self.world.person is not None:
            rng = np.random.default_rng(person_seed)
            if self.person is None:
                self.person = Person(self.model, self.world.person, rng, self.world.objects)
            else:
                self.person.reset(rng)
            self.person.place(self.data)
            if self.mocap is None:
                self.mocap = self._motion_capture(int(mocap_seed.generate_state(1)[0]))
        mujoco.mj_forward(self.model, self.data)

    def _motion_capture(self, seed: int) -> MotionCapture:
        return MotionCapture(
            self.model,
            [f"{PERSON_PREFIX}marker/{label}" for label in MARKERS],
            ring_of_cameras(),
            rate=self.options.mocap_rate,
            noise=self.options.marker_noise,
            seed=seed,
            occlusion=self.options.occlusion_fraction,
        )

    def _update_person(self, now: float) -> None:
        """Let the person see, decide and move; close and open its hands."""
        if self.person is None:
            return
        poses = object_poses(self.world, self.data)
        speeds = self._watch.speeds(self.data)
        held = self.grasping.held_by_robot
        view = PersonView(
            objects=poses,
            held_by_robot=dict(held),
            held_by_hand=dict(self.grasping.held_by_hand),
            object_speed=speeds,
            offered=self._offers.update(now, held, poses, speeds),
            goals=self.scene.goals,
        )
        self.person.update(self.data, now, view)
        self._note(self.grasping.update_hands(self.data, self.person.grip_request))

    def _note(self, changes: list[GraspChange]) -> None:
        """Turn changes of hold into events."""
        for change in changes:
            self._events.append(grasp_event(change, self.time))
            if not change.held and not self.grasping.holders(change.object_name):
                self._watch.let_go(change.object_name, change.holder)

    def _event(self, kind: str, message: str) -> None:
        self._events.append(SimulationEvent(self.time, kind, message))

    def _someone(self) -> Person:
        if self.person is None:
            raise BadRequestError("there is no person in the cell; start it with one (parameter person)")
        return self.person
