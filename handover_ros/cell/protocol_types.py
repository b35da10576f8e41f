"""What goes into the protocol of a handover and what comes out of it: settings, plan, observations, commands."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from handover_ros.errors import ErrorCode
from handover_ros.geometry import FloatArray


class Phase(str, Enum):
    """Phases of a handover, in order; the values are the constants of ``ExecuteHandover``."""

    PLANNING = "planning"
    FETCHING = "fetching"
    PRESENTING = "presenting"
    WAITING = "waiting"
    RELEASING = "releasing"
    RETRACTING = "retracting"
    RETURNING = "returning"
    DONE = "done"


class ReleasePolicy(str, Enum):
    """When the robot lets go of the object."""

    GRASP = "grasp"  # when the person's pull is felt; otherwise the object goes back
    TIMER = "timer"  # after the waiting time, whatever happens, as in the dissertation
    EITHER = "either"  # whichever comes first


@dataclass(frozen=True)
class ProtocolSettings:
    """Times and limits of the protocol.

    Attributes:
        release_policy: When to let go.
        ready_time: [s] shown "Ready?" before a timed release; the dissertation's two seconds.
        take_limit: [s] without a grasp after which the object is taken back (policy grasp).
        settle_time: [s] a stage may take beyond its planned duration.
        goal_tolerance: [rad] largest joint error at the end of a stage.
        tracking_limit: [rad] largest joint error while moving; beyond it the robot is stopped.
        pull_hold: [s] the pull must last before it counts.
        grip_time: [s] the gripper may take to close on the object or to open.
        fall_distance: [m] the object may sink below where it was let go before it counts as dropped.
        confirm_time: [s] after the release in which a fall is still the robot's failure.
        plan_limit: [s] wall time the planner may take.
    """

    release_policy: ReleasePolicy = ReleasePolicy.GRASP
    ready_time: float = 2.0
    take_limit: float = 15.0
    settle_time: float = 3.0
    goal_tolerance: float = 0.03
    tracking_limit: float = 0.35
    pull_hold: float = 0.15
    grip_time: float = 2.0
    fall_distance: float = 0.25
    confirm_time: float = 1.0
    plan_limit: float = 60.0


@dataclass(frozen=True)
class Stage:
    """One piece of robot motion.

    Attributes:
        name: approach, grasp, lift, present, retract, ...
        times: (k,) [s]; empty for a stage that only moves the gripper.
        positions: (k, n) [rad].
        velocities: (k, n) [rad/s].
        opening: [m] gripper opening commanded after the motion; NaN: unchanged.
    """

    name: str
    times: FloatArray
    positions: FloatArray
    velocities: FloatArray
    opening: float = float("nan")

    @property
    def duration(self) -> float:
        """Planned duration [s]."""
        return float(self.times[-1]) if len(self.times) else 0.0


@dataclass(frozen=True)
class Plan:
    """What the executive needs of a plan: the arm, its joints and the stages up to the offer and after it."""

    arm: str
    joint_names: tuple[str, ...]
    stages: tuple[Stage, ...]
    held: bool = False  # the robot holds the object already: nothing to fetch

    def named(self, *names: str) -> tuple[Stage, ...]:
        """Return the stages of these names, in plan order."""
        return tuple(stage for stage in self.stages if stage.name in names)

    def release_stage(self) -> Stage:
        """Return the stage that opens the gripper as wide as it was opened for the grasp."""
        opening = max((stage.opening for stage in self.stages if np.isfinite(stage.opening)), default=0.0)
        return Stage("release", np.empty(0), np.empty((0, 0)), np.empty((0, 0)), opening)


@dataclass(frozen=True)
class Observation:
    """What is known at one instant.

    Attributes:
        time: [s] ROS time.
        positions: (n,) [rad] of the plan's arm; empty before there is a plan.
        velocities: (n,) [rad/s].
        state_time: [s] ROS time at which positions and velocities were measured; NaN: now.
        gripping: Something is between the fingers.
        opening: [m] of the gripper.
        pulled: The person's pull on the object is felt now.
        object_height: [m] above the floor; NaN when not seen.
        hand_distance: [m] from the nearest tracked hand to the object; NaN when not known.
        trouble: A sentence when the cell cannot go on (a node lost, data stale); empty otherwise.
        trouble_code: Its error code.
    """

    time: float
    positions: FloatArray = field(default_factory=lambda: np.empty(0))
    velocities: FloatArray = field(default_factory=lambda: np.empty(0))
    state_time: float = float("nan")
    gripping: bool = False
    opening: float = float("nan")
    pulled: bool = False
    object_height: float = float("nan")
    hand_distance: float = float("nan")
    trouble: str = ""
    trouble_code: ErrorCode = ErrorCode.NONE


@dataclass(frozen=True)
class RequestPlan:
    """Ask the planner for the handover."""


@dataclass(frozen=True)
class RequestReturn:
    """Ask the planner for the way back: with the object to where it came from, or the empty arm home."""

    holding: bool


@dataclass(frozen=True)
class Follow:
    """Send a stage's trajectory to the robot."""

    stage: Stage


@dataclass(frozen=True)
class MoveGripper:
    """Open or close the gripper of the plan's arm to an opening [m]."""

    opening: float


@dataclass(frozen=True)
class Show:
    """Show a text on the robot's head display."""

    text: str


@dataclass(frozen=True)
class Stop:
    """Stop the robot where it is."""


Command = RequestPlan | RequestReturn | Follow | MoveGripper | Show | Stop


@dataclass(frozen=True)
class Outcome:
    """How the handover ended."""

    success: bool
    code: ErrorCode
    message: str
    taken: bool
