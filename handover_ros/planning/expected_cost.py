"""Schemes that choose pose and robot grasp for the grasp the person will probably take (Bestick 2017, chapter 3)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from pydantic import AfterValidator, Field

from handover_ros.arm.inverse_kinematics import best_postures, feasible_sets
from handover_ros.arm.model import SIDES, Arm, Side, arm_of, load_arm
from handover_ros.ergonomics.arm_costs import ARM_COSTS, Preference, SquaredDistance, load_arm_cost
from handover_ros.errors import BadRequestError, ErrorCode, InfeasibleError
from handover_ros.geometry import FloatArray, invert_transform, transform_points
from handover_ros.objects.catalogue import ObjectModel
from handover_ros.planning.choice import MEAN, MEASURE, GoalCosts, grasp_probabilities, person_model
from handover_ros.planning.feasible import STEP, Taker, posture_probabilities, statistics
from handover_ros.planning.goal_stance import Box, Placing, placing_after_moving, placing_from
from handover_ros.planning.grasp_set import GraspSet, grasp_set
from handover_ros.planning.gripper_blocks import free_grasps
from handover_ros.planning.objectives import OBJECTIVES, expected_cost
from handover_ros.planning.obstacles import Obstacles, obstacles_of
from handover_ros.planning.offers import HandoverTask, Offer, RobotSide, levelled
from handover_ros.planning.optimiser import SearchSettings, search
from handover_ros.planning.pose_space import PoseSpace
from handover_ros.planning.problem import Candidate, Problem, SearchReport
from handover_ros.planning.types import PredictedChoice, PredictedGrasp, PredictedPostures, TrackedPerson
from handover_ros.skeleton.tree import Skeleton
from handover_ros.yaml_file import Schema, Vector3

DRAWN = 4  # most probable grasps whose postures are told
LEAST_PROBABILITY = 1e-4  # of a grasp worth telling
Seven = Annotated[tuple[float, ...], Field(min_length=7, max_length=7)]


def _known(names: Mapping[str, object], what: str) -> AfterValidator:
    """Return a check that a name is one of these."""

    def check(name: str) -> str:
        if name not in names:
            raise ValueError(f"unknown {what}; known: {', '.join(names)}")
        return name

    return AfterValidator(check)


class SpaceFile(Schema):
    """Where the object may be offered; see ``PoseSpace``."""

    lower: Vector3 = PoseSpace.lower
    upper: Vector3 = PoseSpace.upper
    most_lean: Annotated[float, Field(ge=0.0, le=np.pi)] = PoseSpace.most_lean
    clearance: Annotated[float, Field(ge=0.0, le=1.0)] = PoseSpace.clearance
    view: Annotated[float, Field(gt=0.0, le=np.pi)] = PoseSpace.view


class PreferenceFile(Schema):
    """What a person of whom nothing is known finds comfortable [rad], [1/rad2]."""

    neutral: Seven = tuple(Preference().neutral.tolist())
    weights: Seven = tuple(Preference().weights.tolist())


class ExpectedCostFile(Schema):
    """Content of a file of a scheme that looks at what the person may choose.

    Attributes:
        kind: The objective, as in ``objectives.OBJECTIVES``.
        person_model: How the person chooses: MN, MP, GN or GP.
        rationality: Of a noisy person [1/cost].
        cost: Of an arm posture, as in ``ergonomics.arm_costs.ARM_COSTS``.
        arm: Of a person without a profile, a file of ``config/arms``.
        hand: ``dominant`` or ``both``: with which hand an object for one hand is taken.
        preference: Of a person of whom nothing is known.
        regrasp: What it costs to take the object anew, times the greatest mean cost of a grasp at the goal.
        use_goal: Whether a goal that is given counts.
        moves_to_goal: Whether the person turns, steps and stoops to where placing is most comfortable.
        release_height: How high above the goal the hand lets go [m]: fingers under an object give way at the end.
        step: Density of the samples of feasible sets [rad].
        space: Where the object may be offered.
        time_budget: Wall time of the search [s].
        most_offers: Offers at most.
    """

    kind: Annotated[str, _known(OBJECTIVES, "objective")]
    person_model: Literal["MN", "MP", "GN", "GP"] = "MN"
    rationality: Annotated[float, Field(gt=0.0, le=1e4)] = 10.0
    cost: Annotated[str, _known(ARM_COSTS, "arm cost")] = "squared_distance"
    arm: str = "adult"
    hand: Literal["dominant", "both"] = "dominant"
    preference: PreferenceFile = PreferenceFile()
    regrasp: Annotated[float, Field(ge=1.0, le=100.0)] = 2.0
    use_goal: bool = True
    moves_to_goal: bool = True
    release_height: Annotated[float, Field(ge=0.0, le=0.5)] = 0.04
    step: Annotated[float, Field(gt=0.01, le=2.0)] = STEP
    space: SpaceFile = SpaceFile()
    time_budget: Annotated[float, Field(gt=0.0, le=3600.0)] = 2.0
    most_offers: Annotated[int, Field(ge=1, le=200)] = 3


@dataclass(frozen=True, eq=False)
class Situation:
    """A problem with what is needed to tell its answer.

    Attributes:
        problem: What is to be decided; its grasps are those some robot grasp leaves free.
        world_from_torso: Level. Shape (4, 4).
        placing: How the object is placed at the goal; None: there is none.
        world_from_goal: Object pose there when it is let go, or None. Shape (4, 4).
        boxes: What stands around there.
        blocked: Grasps that no robot grasp leaves free.
    """

    problem: Problem
    world_from_torso: FloatArray
    placing: Placing | None
    world_from_goal: FloatArray | None
    boxes: tuple[Box, ...]
    blocked: int


@dataclass(frozen=True)
class ExpectedCostScheme:
    """Offers where the chosen objective is best, robot grasp and pose together.

    Attributes:
        name: As in ``config/schemes``.
        content: What the file says.
    """

    name: str
    content: ExpectedCostFile
    needs_person: bool = True

    def offers(self, task: HandoverTask) -> list[Offer]:
        """Return the best offers for this person.

        Raises:
            StaleDataError: Nobody is tracked.
            BadRequestError: The robot's grasps or the hands that are needed are not known.
            BadModelError: The profile's skeleton cannot be used.
            InfeasibleError: There is no pose that suits both; the message counts why.
        """
        situation = self.situation(task)
        report = search(
            situation.problem,
            None if task.robot is None else RobotBeforeTorso(task.robot, situation.world_from_torso),
            min(task.budget, self.content.time_budget),
            SearchSettings(seed=task.seed),
            self.content.most_offers,
        )
        if not report.candidates:
            raise InfeasibleError(_refusal(task, situation, report), ErrorCode.NOT_FEASIBLE_FOR_PERSON)
        best = report.candidates[0].value
        return [self.offer(situation, candidate, candidate.value == best) for candidate in report.candidates]

    def situation(self, task: HandoverTask) -> Situation:
        """Return what is to be decided.

        Raises:
            StaleDataError: Nobody is tracked.
            BadRequestError: The robot's grasps or the hands that are needed are not known, or the person model is none.
            BadModelError: The profile's skeleton cannot be used.
            InfeasibleError: The object cannot be placed at the goal with any grasp.
        """
        model, person = task.model, task.tracked_person(self.name)
        if task.robot is None or not len(task.robot.object_from_gripper):
            raise BadRequestError(f"scheme {self.name!r} needs the robot's grasps on {model.name}; it has none")
        choice = person_model(task.person_model or self.content.person_model, self.content.rationality)
        taker = self.taker(model, person)
        whole = grasp_set(model, taker.sides)
        free = _free(model, taker.sides, task.robot.gripper.tobytes(), task.robot.object_from_gripper.tobytes())
        kept = np.asarray(free.any(axis=0))
        if not kept.any():
            raise InfeasibleError(
                f"the robot's gripper leaves no room for a hand on {model.name}; add robot or human grasps to its file",
                ErrorCode.NOT_FEASIBLE_FOR_PERSON,
            )
        grasps = whole.subset(kept)
        torso = levelled(person.world_from_torso)
        goal = None
        if self.content.use_goal and task.world_from_goal is not None:
            goal = task.world_from_goal.copy()
            goal[2, 3] += self.content.release_height
        placing: Placing | None = None
        if goal is not None:
            if self.content.moves_to_goal:
                placing = placing_after_moving(torso, goal, taker, grasps, model, task.boxes, choice.rationality)
            else:
                placing = placing_from(torso, goal, taker, grasps, task.boxes, choice.rationality)
            _check_goal(placing, whole, kept, taker, invert_transform(torso) @ goal, model)
        problem = Problem(
            model=model,
            grasps=grasps,
            object_from_gripper=task.robot.object_from_gripper,
            free=free[:, kept],
            taker=taker,
            choice=choice,
            goal=goal_costs(None if placing is None else placing.table, self.content.regrasp),
            objective=OBJECTIVES[self.content.kind],
            space=PoseSpace(**self.content.space.model_dump()),
            comfortable=tuple(taker.arms[side].hand_pose(self._preference(person).neutral) for side in grasps.sides),
        )
        return Situation(problem, torso, placing, goal, task.boxes, int((~kept).sum()))

    def taker(self, model: ObjectModel, person: TrackedPerson) -> Taker:
        """Return the person's arms that may take an object, and what their postures cost.

        Raises:
            BadModelError: The profile's skeleton cannot be used.
            BadRequestError: It lacks a hand that is needed.
        """
        arms = self._arms(person)
        first: Side = "left" if person.dominant == "left" else "right"
        if model.hands == 1 and self.content.hand == "dominant":
            side = first if first in arms else next(iter(arms))
            arms = {side: arms[side]}
        preference = self._preference(person)
        held = model.mass / model.hands
        costs = {
            side: load_arm_cost(self.content.cost, arm, preference, person.mass, held) for side, arm in arms.items()
        }
        return Taker(arms, costs, self.content.step)

    def _arms(self, person: TrackedPerson) -> dict[Side, Arm]:
        """Return the arms of a person, the right one first: of the profile, else generic ones."""
        if person.skeleton is None:
            return {side: load_arm(self.content.arm, side) for side in SIDES}
        return _profile_arms(person.skeleton)

    def _preference(self, person: TrackedPerson) -> Preference:
        """Return what the person finds comfortable, as far as it is known."""
        if person.preference is not None:
            return person.preference
        given = self.content.preference
        return Preference(np.array(given.neutral), np.array(given.weights))

    def offer(self, situation: Situation, candidate: Candidate, nominal: bool) -> Offer:
        """Return the offer of a candidate."""
        predicted = predict(situation, candidate, DRAWN if nominal else 1)
        world_from_object = situation.world_from_torso @ candidate.torso_from_object
        likely = predicted.grasps[0]
        hands = tuple(likely.hands.values())
        come = sum((limbs[3] - limbs[1] for limbs in likely.limbs.values()), np.zeros(3))
        if np.hypot(come[0], come[1]) < 0.05:
            come = situation.world_from_torso[:3, 0]
        reach = np.array([come[0], come[1], 0.0]) / np.hypot(come[0], come[1])
        return Offer(
            world_from_object,
            likely.region,
            hands[0],
            reach,
            nominal,
            hands[1] if len(hands) == 2 else None,
            robot_grasp=candidate.robot_grasp,
            predicted=predicted,
        )


def goal_costs(table: FloatArray | None, regrasp: float) -> GoalCosts:
    """Return what grasps with a table of statistics at the goal cost there; ``regrasp`` times the worst if infeasible.

    Args:
        table: Shape (grasps, 5), or None: there is no goal.
        regrasp: Times the greatest mean cost of a feasible grasp.
    """
    if table is None:
        return GoalCosts()
    placing = table[:, MEASURE] > 0.0
    return GoalCosts(table, regrasp * float(table[placing, MEAN].max(initial=0.0)))


@lru_cache(maxsize=64)
def _free(model: ObjectModel, sides: tuple[Side, ...], points: bytes, grasps: bytes) -> npt.NDArray[np.bool_]:
    """Return ``free_grasps``, remembered: the same object and gripper come again and again."""
    gripper, object_from_gripper = np.frombuffer(points).reshape(-1, 3), np.frombuffer(grasps).reshape(-1, 4, 4)
    free = free_grasps(gripper, object_from_gripper, grasp_set(model, sides))
    free.setflags(write=False)
    return free


@lru_cache(maxsize=8)
def _profile_arms(skeleton: Skeleton) -> dict[Side, Arm]:
    """Return the arms of a calibrated person, the right one first."""
    return {side: arm_of(skeleton, side) for side in SIDES if side in dict(skeleton.hands)}


@dataclass(frozen=True, eq=False)
class RobotBeforeTorso:
    """The robot with poses in the torso frame, as the optimiser asks it."""

    robot: RobotSide
    world_from_torso: FloatArray

    def stretches(self, torso_from_object: FloatArray) -> FloatArray:
        """Return how far grasps stretch the arm [m] at poses (n, 4, 4), shape (n, r); inf: too far."""
        return self.robot.stretches(self.world_from_torso @ torso_from_object)

    def kinematic(self, torso_from_object: FloatArray, robot_grasps: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
        """Return whether the arm can be at poses (n, 4, 4) with grasps (n,), collisions aside, shape (n,)."""
        return self.robot.kinematic(self.world_from_torso @ torso_from_object, robot_grasps)

    def reachable(self, torso_from_object: FloatArray, robot_grasp: int) -> bool:
        """Return whether the arm can be at a pose (4, 4) with a grasp, free of collisions."""
        return self.robot.reachable(self.world_from_torso @ torso_from_object, robot_grasp)


def predict(situation: Situation, candidate: Candidate, drawn: int = DRAWN) -> PredictedChoice:
    """Return how the person is expected to choose at a candidate, with the postures of the likeliest few grasps."""
    problem = situation.problem
    allowed = problem.free[candidate.robot_grasp]
    table, goal = candidate.table, problem.goal
    probabilities = grasp_probabilities(table, goal, problem.choice, allowed)
    placing = np.ones(len(table), dtype=bool) if goal.table is None else goal.table[:, MEASURE] > 0.0
    order = np.argsort(-probabilities, kind="stable")
    likely = [int(g) for g in order if probabilities[g] > 0.0]
    grasps = tuple(
        _predicted_grasp(situation, candidate, grasp, float(probabilities[grasp]), number < drawn)
        for number, grasp in enumerate(likely)
        if probabilities[grasp] >= LEAST_PROBABILITY or grasp == likely[0]
    )
    value = expected_cost(table[None], goal, problem.choice, allowed[None])
    return PredictedChoice(
        person_model=problem.choice.name,
        cost_name=next(iter(problem.taker.costs.values())).name,
        expected_cost=float(value[0, 0]),
        grasps=grasps,
        blocked=situation.blocked + int((~allowed).sum()),
        infeasible=int((allowed & ~(table[:, MEASURE] > 0.0)).sum()),
        goal_infeasible=float(probabilities[~placing].sum()),
        has_goal=goal.table is not None,
    )


def _predicted_grasp(
    situation: Situation, candidate: Candidate, grasp: int, probability: float, drawn: bool
) -> PredictedGrasp:
    """Return one grasp, with its best postures if it shall be drawn."""
    problem, here = situation.problem, situation.world_from_torso
    goal_cost, goal_limbs = float("nan"), {}
    placing, goal = situation.placing, situation.world_from_goal
    if placing is not None and goal is not None and placing.table[grasp, MEASURE] > 0.0:
        goal_cost = float(placing.table[grasp, MEAN])
    if drawn and np.isfinite(goal_cost) and placing is not None and goal is not None:
        there = placing.world_from_torso[grasp]
        obstacles = obstacles_of(situation.boxes, there)
        goal_limbs = _best_limbs(problem, invert_transform(there) @ goal, grasp, there, obstacles)
    return PredictedGrasp(
        region=problem.grasps.region(grasp),
        probability=probability,
        hands={
            side: here @ candidate.torso_from_object @ pose for side, pose in problem.grasps.hand_poses(grasp).items()
        },
        limbs=_best_limbs(problem, candidate.torso_from_object, grasp, here, None) if drawn else {},
        hand_cost=float(candidate.table[grasp, MEAN]),
        goal_cost=goal_cost,
        goal_limbs=goal_limbs,
        postures=_postures(problem, candidate.torso_from_object, grasp) if drawn else {},
    )


def _postures(problem: Problem, torso_from_object: FloatArray, grasp: int) -> dict[str, PredictedPostures]:
    """Return P(q | g) of each arm that takes a grasp, by side."""
    return {
        side: PredictedPostures(
            *posture_probabilities(problem.taker, side, torso_from_object @ pose, problem.choice.hand_rationality)
        )
        for side, pose in problem.grasps.hand_poses(grasp).items()
    }


def _best_limbs(
    problem: Problem, torso_from_object: FloatArray, grasp: int, world_from_torso: FloatArray, blocked: Obstacles | None
) -> dict[str, FloatArray]:
    """Return the limbs (4, 3) [m] of the best posture with a grasp, in the world, by side."""
    limbs: dict[str, FloatArray] = {}
    for side, pose in problem.grasps.hand_poses(grasp).items():
        found = _best_limb(problem.taker, side, (torso_from_object @ pose)[None], blocked)
        if found is not None:
            limbs[side] = transform_points(world_from_torso, found)
    return limbs


def _best_limb(taker: Taker, side: Side, torso_from_hand: FloatArray, blocked: Obstacles | None) -> FloatArray | None:
    """Return the limb (4, 3) [m] of the best posture of one hand at a pose (1, 4, 4), in the torso frame, if any."""
    arm, cost = taker.arms[side], taker.costs[side]
    if isinstance(cost, SquaredDistance):  # its minimum is found along the arcs, and is mostly free
        postures, costs = best_postures(arm, torso_from_hand, cost.preference.neutral, cost.preference.weights)
        if not np.isfinite(costs[0]):
            return None
        limb = arm.limbs(postures)
        if blocked is None or blocked.free(limb)[0]:
            return np.asarray(limb[0])
    postures = feasible_sets(arm, torso_from_hand, taker.step).postures
    limbs = arm.limbs(postures)
    if blocked is not None:
        free = blocked.free(limbs)
        postures, limbs = postures[free], limbs[free]
    return np.asarray(limbs[int(np.argmin(cost.evaluate(postures)))]) if len(postures) else None


def _check_goal(
    placing: Placing,
    whole: GraspSet,
    kept: npt.NDArray[np.bool_],
    taker: Taker,
    torso_from_goal: FloatArray,
    model: ObjectModel,
) -> None:
    """Refuse a goal at which no grasp that the robot leaves free can place the object.

    Raises:
        InfeasibleError: Says why, in counts.
    """
    if (placing.table[:, MEASURE] > 0.0).any():
        return
    clear = statistics(taker, whole, torso_from_goal, 1.0)[0, :, MEASURE] > 0.0
    place = np.round(torso_from_goal[:3, 3], 2).tolist()
    raise InfeasibleError(
        f"{model.name} cannot be placed at the goal, {place} m from between the person's shoulders: of {len(whole)} "
        f"grasps the gripper blocks {int((~kept).sum())}, {int((kept & ~clear).sum())} others are out of the person's "
        "reach or joint limits there, the rest meet what stands at the goal; move the goal or the person",
        ErrorCode.NOT_FEASIBLE_FOR_PERSON,
    )


def _refusal(task: HandoverTask, situation: Situation, report: SearchReport) -> str:
    """Return why nothing was found."""
    counts = ", ".join(f"{number} x {reason}" for reason, number in report.refused.most_common() if number)
    late = "; the time ran out" if report.stopped else ""
    return (
        f"no pose of {task.model.name} suits person and robot; looked at {report.poses}: {counts or 'none'}{late}; "
        f"the gripper blocks {situation.blocked} grasps whatever it does; let the person come nearer, or choose scheme "
        "relative"
    )
