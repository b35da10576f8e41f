"""What is asked of the planner, what it knows of the cell at that moment, and what it answers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from handover_ros.ergonomics.arm_costs import Preference
from handover_ros.errors import BadRequestError, StaleDataError
from handover_ros.geometry import FloatArray
from handover_ros.robot.trajectory import Trajectory
from handover_ros.skeleton.tree import Skeleton

ROTATION_TOLERANCE = 2e-3
BODY_MASS = 75.0  # [kg] of a person of whom it is not known
FARTHEST = 1000.0  # [m] from the origin: nothing of the cell is farther away


class OutdatedSnapshotError(StaleDataError):
    """The cell changed while a plan was searched for; plan again from a new snapshot."""


@dataclass(frozen=True, eq=False)
class ChosenOffer:
    """A way to offer an object that was chosen before, e.g. from a menu.

    Attributes:
        world_from_object: Shape (4, 4).
        object_from_gripper: The robot's grasp, shape (4, 4).
    """

    world_from_object: FloatArray
    object_from_gripper: FloatArray

    def __post_init__(self) -> None:
        """Check the poses."""
        check_transform(self.world_from_object, "offer: handover_pose")
        check_transform(self.object_from_gripper, "offer: object_from_gripper")


@dataclass(frozen=True, eq=False)
class HandoverRequest:
    """A handover to be planned.

    Attributes:
        object_name: As in the object catalogue.
        scheme: As in ``config/schemes``; empty: the planner's default.
        arm: Arm of the robot; empty: the planner chooses.
        time_budget: Wall time for the search [s]; 0: the planner's default.
        world_from_goal: Object pose to which the person shall bring it, or None. Shape (4, 4).
        person_model: How the person chooses: MN, MP, GN or GP; empty: the scheme's default.
        offer: What was chosen before; None: the scheme chooses.
    """

    object_name: str
    scheme: str = ""
    arm: str = ""
    time_budget: float = 0.0
    world_from_goal: FloatArray | None = None
    person_model: str = ""
    offer: ChosenOffer | None = None

    def __post_init__(self) -> None:
        """Check the numbers."""
        if not np.isfinite(self.time_budget) or self.time_budget < 0.0:
            raise BadRequestError(f"time_budget: must be 0 (default) or positive seconds, got {self.time_budget}")
        if self.world_from_goal is not None:
            check_transform(self.world_from_goal, "goal")


@dataclass(frozen=True, eq=False)
class TrackedPerson:
    """What is known of the person at this moment.

    Attributes:
        world_from_torso: The torso frame (x forward, y left, z up; origin between the shoulders). Shape (4, 4).
        skeleton: The calibrated person; None: no profile is active.
        displacements: Where the joints of ``skeleton`` are [rad, m], shape (n,); None: not tracked.
        dominant: Hand the person likes to take things with, ``left`` or ``right``; None: not known.
        body_mass: [kg]; None: not known.
        profile: Name of the person's profile; empty: none is active.
        profile_problem: Why the active profile cannot be used; empty: it can, or none is active.
        preference: What the person finds comfortable; None: not known.
    """

    world_from_torso: FloatArray
    skeleton: Skeleton | None = None
    displacements: FloatArray | None = None
    dominant: str | None = None
    body_mass: float | None = None
    profile: str = ""
    profile_problem: str = ""
    preference: Preference | None = None

    @property
    def mass(self) -> float:
        """Body mass [kg], that of an average adult where it is not known."""
        return BODY_MASS if self.body_mass is None else self.body_mass

    def __post_init__(self) -> None:
        """Check pose, hand and shapes."""
        check_transform(self.world_from_torso, "torso pose")
        if self.dominant not in (None, "left", "right"):
            raise BadRequestError(f"dominant hand {self.dominant!r}: must be left or right")
        if self.displacements is None:
            return
        shape = None if self.skeleton is None else self.skeleton.lower.shape
        if np.shape(self.displacements) != shape or not np.all(np.isfinite(self.displacements)):
            raise BadRequestError(
                f"displacements of the person: must be finite, one for each of the skeleton's {shape}, "
                f"got {np.shape(self.displacements)}"
            )


@dataclass(frozen=True, eq=False)
class ExpectedPosture:
    """How the person is expected to stand when they take an object.

    Attributes:
        hands: ``world_from_hand`` (4, 4) of each hand that takes it, by side.
        limbs: Shoulder, elbow, wrist and grip of that arm in the world [m], shape (4, 3), by side.
        displacements: Of the person's skeleton [rad, m], shape (n,).
        cost: What the posture costs.
        cost_name: By which cost, as in ``ergonomics.costs.COSTS``.
        words: The posture for a person, e.g. ``right arm: elbow 75 deg, shoulder 20 deg forward``.
    """

    hands: Mapping[str, FloatArray]
    limbs: Mapping[str, FloatArray]
    displacements: FloatArray
    cost: float
    cost_name: str
    words: str


@dataclass(frozen=True, eq=False)
class PredictedPostures:
    """P(q | g): how one arm is expected to take a grasp.

    Attributes:
        displacements: Samples of the feasible set [rad], shape (k, 7), ordered as ``arm.model.JOINT_NAMES``.
        probabilities: Of each, sum 1, shape (k,).
    """

    displacements: FloatArray
    probabilities: FloatArray


@dataclass(frozen=True, eq=False)
class PredictedGrasp:
    """One grasp that the person may choose.

    Attributes:
        region: Name of the grasp region, or of both, joined by ``and``.
        probability: P(g).
        hands: ``world_from_hand`` (4, 4) of each hand, by side.
        limbs: Shoulder, elbow, wrist and grip [m] (4, 3) of each arm in its best posture, in the world, by side; empty
            for improbable grasps.
        hand_cost: Expected cost at the handover, given this grasp.
        goal_cost: The same at the goal; NaN: there is no goal, or the object cannot be placed with this grasp.
        goal_limbs: As ``limbs``, at the goal; empty: there is none.
        postures: P(q | g) of each arm, by side; empty for improbable grasps.
    """

    region: str
    probability: float
    hands: Mapping[str, FloatArray]
    limbs: Mapping[str, FloatArray]
    hand_cost: float
    goal_cost: float
    goal_limbs: Mapping[str, FloatArray] = field(default_factory=dict)
    postures: Mapping[str, PredictedPostures] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class PredictedChoice:
    """How the person is expected to take the object.

    Attributes:
        person_model: Name of the choice model.
        cost_name: The cost of a posture, as in ``ergonomics.arm_costs.ARM_COSTS``.
        expected_cost: (3.6), or with a goal (3.7).
        grasps: The grasps that are left and feasible, the most probable first.
        blocked: How many grasps the robot's gripper blocks.
        infeasible: How many others no posture of the person reaches.
        goal_infeasible: Probability of a grasp with which the object cannot be placed (OM5 of section 3.6).
        has_goal: Whether there is a goal.
    """

    person_model: str
    cost_name: str
    expected_cost: float
    grasps: tuple[PredictedGrasp, ...]
    blocked: int
    infeasible: int
    goal_infeasible: float
    has_goal: bool = False

    @property
    def hand_cost(self) -> float:
        """Expected cost at the handover."""
        return float(sum(grasp.probability * grasp.hand_cost for grasp in self.grasps))

    @property
    def goal_cost(self) -> float:
        """Expected cost at the goal, that of taking the object anew included; NaN without a goal."""
        return self.expected_cost - self.hand_cost if self.has_goal else float("nan")


@dataclass(frozen=True, eq=False)
class CellSnapshot:
    """The cell as it is when the plan is made.

    Attributes:
        arms: Displacements [rad] of each arm's joints. Shape (n,).
        objects: ``world_from_object`` of each object that is seen. Shape (4, 4).
        person: Who is tracked, or None.
        gripping: Arms with something between their closed fingers.
    """

    arms: Mapping[str, FloatArray]
    objects: Mapping[str, FloatArray] = field(default_factory=dict)
    person: TrackedPerson | None = None
    gripping: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        """Check the poses."""
        for name, pose in self.objects.items():
            check_transform(pose, f"pose of {name}")

    @property
    def world_from_torso(self) -> FloatArray | None:
        """The person's torso frame, or None when nobody is tracked. Shape (4, 4)."""
        return None if self.person is None else self.person.world_from_torso


@dataclass(frozen=True, eq=False)
class PlannedStage:
    """One piece of robot motion, then a gripper command.

    Attributes:
        name: approach, grasp, lift, present, retract.
        trajectory: The motion of the arm.
        opening: Gripper opening [m] commanded after the motion; NaN: leave it.
    """

    name: str
    trajectory: Trajectory
    opening: float = float("nan")


@dataclass(frozen=True, eq=False)
class HandoverPlan:
    """A planned handover.

    Attributes:
        object_name: The object.
        scheme: The scheme that chose the pose.
        arm: The robot's arm.
        robot_grasp: Name of the robot's grasp region; empty: the robot held the object already.
        object_from_gripper: Shape (4, 4).
        world_from_object: Object pose at which it is offered. Shape (4, 4).
        world_from_gripper: Gripper pose there. Shape (4, 4).
        world_from_goal: Where the person shall bring it, or None.
        facing_region: Human grasp region turned to the person; empty: none.
        world_from_hand: The person's hand there. Shape (4, 4).
        nominal: Whether the scheme's own position was reachable, not only one beside it.
        stages: approach, grasp, lift, present, retract (back off and home); without the first two or three when the
            robot holds the object already.
        planning_time: Wall time [s].
        candidates: Handover poses looked at.
        explanation: Sentences for a person.
        expected: The posture the person is expected to take; None: the scheme knows nothing of it.
        predicted: How the person is expected to choose; None: the scheme knows nothing of it.
    """

    object_name: str
    scheme: str
    arm: str
    robot_grasp: str
    object_from_gripper: FloatArray
    world_from_object: FloatArray
    world_from_gripper: FloatArray
    world_from_goal: FloatArray | None
    facing_region: str
    world_from_hand: FloatArray
    nominal: bool
    stages: tuple[PlannedStage, ...]
    planning_time: float
    candidates: int
    explanation: str
    expected: ExpectedPosture | None = None
    predicted: PredictedChoice | None = None

    def stage(self, name: str) -> PlannedStage:
        """Return the stage of a name; KeyError when there is none."""
        return {stage.name: stage for stage in self.stages}[name]


@dataclass(frozen=True)
class PlannerSettings:
    """How the planner works. Lengths [m], angles [rad], times [s].

    Attributes:
        default_scheme: Scheme of a request that names none.
        time_budget: Wall time of a search whose request names none.
        pregrasp_distance: From where the gripper comes straight along its approach direction.
        lift_height: How high the object is lifted straight up before it is carried.
        retreat_distance: How far the gripper backs off straight after it let go.
        person_distance: Distance every link of the robot keeps from the person's trunk and head.
        held_person_distance: Distance the object in the hand keeps from them.
        hand_clearance: Least distance from the robot's fingertips to where the person's hand is expected.
        tilt_limit: How far a carried object leans, if that is possible at all.
        squeeze: How much narrower than the object the gripper is commanded to close.
        blend: How far from the corners of a path the arm may pass [rad].
        present_speed: Share of the robot's planning speed while it brings the object to the person.
        careful_speed: The same for the straight pieces next to objects.
        seed: Of the random searches; the same request at the same state gives the same plan.
    """

    default_scheme: str = "relative"
    time_budget: float = 8.0
    pregrasp_distance: float = 0.10
    lift_height: float = 0.12
    retreat_distance: float = 0.12
    person_distance: float = 0.15
    held_person_distance: float = 0.10
    hand_clearance: float = 0.05
    tilt_limit: float = 0.5
    squeeze: float = 0.008
    blend: float = 0.06
    present_speed: float = 0.8
    careful_speed: float = 0.4
    seed: int = 0


def check_transform(transform: FloatArray, what: str) -> None:
    """Raise BadRequestError unless ``transform`` is a finite rigid transform (4, 4)."""
    array = np.asarray(transform, dtype=float)
    if array.shape != (4, 4) or not np.all(np.isfinite(array)):
        raise BadRequestError(f"{what}: must be a finite pose, got {array.tolist()}")
    if np.abs(array[:3, 3]).max() > FARTHEST or np.abs(array[:3, :3]).max() > 2.0 or (array[3] != (0, 0, 0, 1)).any():
        raise BadRequestError(
            f"{what}: must be a rigid transform at most {FARTHEST:g} m from the origin, got {array.tolist()}"
        )
    rotation = array[:3, :3]
    if np.max(np.abs(rotation @ rotation.T - np.eye(3))) > ROTATION_TOLERANCE or np.linalg.det(rotation) < 0.0:
        raise BadRequestError(f"{what}: the rotation is not orthonormal (a quaternion must have length 1)")
