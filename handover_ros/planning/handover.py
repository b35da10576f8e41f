"""Planning a whole handover: which arm, grasp and pose, and the motion from where the robot stands to home again."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from handover_ros.errors import BadRequestError, ErrorCode, HandoverError, InfeasibleError, UnknownNameError
from handover_ros.geometry import FloatArray, invert_transform, make_transform
from handover_ros.objects.catalogue import ObjectModel
from handover_ros.objects.scene import Scene
from handover_ros.planning.expected_cost import ExpectedCostScheme
from handover_ros.planning.explain import explain
from handover_ros.planning.motion import UPRIGHT_SEARCH, MotionPlanner
from handover_ros.planning.offered_scheme import OfferedScheme
from handover_ros.planning.offers import BoolArray, HandoverTask, IntArray, Offer, RobotSide, Scheme
from handover_ros.planning.picking import Holding, Pick, Picking, held_pick
from handover_ros.planning.types import (
    CellSnapshot,
    HandoverPlan,
    HandoverRequest,
    OutdatedSnapshotError,
    PlannedStage,
    PlannerSettings,
    TrackedPerson,
)
from handover_ros.robot.collision import Reason
from handover_ros.robot.gripper_points import gripper_points
from handover_ros.robot.model import RobotModel
from handover_ros.robot.path import Validity, straight_line
from handover_ros.robot.reach import Reasons
from handover_ros.robot.shapes import object_solids

POSTURES_TRIED = 2  # per pick and offer
PATHS_TRIED = 4  # per offer
ROUNDS = 4  # a scheme is asked
COMBINATIONS_KEPT = 8
PERSON_SIDE = (
    0.5  # cosine between gripper approach and the person's reach above which the robot would be in the person's way
)
TURN_WEIGHT = 0.4  # [rad] of joint motion that a gripper pointing to the person instead of across is worth


class Search:
    """What a search has seen so far; its sentence explains a plan that failed."""

    def __init__(self, deadline: float) -> None:
        self.deadline = deadline
        self.picking = Reasons()
        self.offering = Reasons()
        self.grasps = 0
        self.picks = 0
        self.offers = 0
        self.paths_failed = 0

    @property
    def out_of_time(self) -> bool:
        """Whether the time budget is used up."""
        return time.monotonic() > self.deadline


@dataclass(frozen=True, eq=False)
class Combination:
    """A pick and an offer that fit together: the arm's posture at the offer, and what it costs."""

    pick: Pick
    offer: Offer
    world_from_gripper: FloatArray
    posture: FloatArray
    cost: float


class HandoverPlanner:
    """Plans handovers of the objects of a scene.

    Attributes:
        motion: The planner of single motions, with robot, scene and catalogue.
        schemes: Known schemes by name.
    """

    def __init__(
        self,
        robot: RobotModel,
        scene: Scene,
        catalogue: Mapping[str, ObjectModel],
        schemes: Mapping[str, Scheme],
        settings: PlannerSettings | None = None,
    ) -> None:
        self.motion = MotionPlanner(robot, scene, catalogue, settings)
        self.schemes = schemes
        self.grippers = {arm: gripper_points(self.motion.geometry, arm) for arm in robot.arm_names}

    def plan(
        self, request: HandoverRequest, snapshot: CellSnapshot, outdated: Callable[[], bool] = lambda: False
    ) -> HandoverPlan:
        """Return a plan for a handover, from where the robot stands to its home posture.

        The offers of the scheme are tried in order, each with the grasps that can pick the object up; the first offer
        with a collision-free way wins, its cheapest combination first.

        Args:
            request: What is wanted.
            snapshot: The cell as it was seen.
            outdated: Asked before each offer and at the end: whether the snapshot no longer holds.

        Raises:
            OutdatedSnapshotError: It no longer holds.
            UnknownNameError: No such object, scheme or arm; the message lists those there are.
            StaleDataError: The scheme needs the person and nobody is tracked.
            InfeasibleError: The object is not seen, or nothing is reachable; the message counts why.
        """
        started = time.monotonic()
        settings = self.motion.settings
        search = Search(started + (request.time_budget or settings.time_budget))
        model = self.motion.object_model(request.object_name)
        scheme = self.scheme_for(request)
        world_from_object = self.motion.object_pose(snapshot, request.object_name)
        arms = self._arms(request, world_from_object, snapshot)
        refusal: InfeasibleError | None = None
        for arm in arms:
            lead, ready, picking = self.picking(arm, request.object_name, snapshot, search)
            search.grasps += 1 if picking is None else len(picking.grasps)
            if picking is None or not picking.grasps:
                continue
            task = self.task(request, model, picking, ready, search)
            for _ in range(ROUNDS):
                known = picking.refusals
                try:
                    offers = scheme.offers(task)
                except InfeasibleError as error:  # another arm may do better
                    refusal = refusal or error
                    break
                for offer in offers:
                    search.offers += 1
                    _refuse_outdated(outdated)
                    for combination in self._combinations(offer, picking, ready, search):
                        stages = self._stages(combination, lead, ready, search)
                        if stages is not None:
                            _refuse_outdated(outdated)
                            search.picks += picking.found
                            elapsed = time.monotonic() - started
                            return _plan(request, scheme, combination, stages, elapsed, search)
                    if search.out_of_time:
                        break
                # A scheme that chose grasps which turned out not to be picked up may choose others.
                chosen = any(offer.robot_grasp is not None for offer in offers)
                if search.out_of_time or not chosen or picking.refusals == known:
                    break
            search.picks += picking.found
        if refusal is not None and not search.offers:
            raise refusal
        raise self._refusal(request, search, arms)

    def task(
        self,
        request: HandoverRequest,
        model: ObjectModel,
        picking: Picking | Holding,
        snapshot: CellSnapshot,
        search: Search,
    ) -> HandoverTask:
        """Return what a scheme is asked for one arm."""
        return HandoverTask(
            model=model,
            world_from_base=self.motion.robot.world_from_base,
            person=snapshot.person,
            world_from_goal=request.world_from_goal,
            person_model=request.person_model,
            boxes=tuple((np.array(box.size), box.parent_from_solid) for box in self.motion.boxes),
            robot=self._robot_side(picking, snapshot, search),
            budget=max(0.0, search.deadline - time.monotonic()),
            seed=self.motion.settings.seed,
        )

    def _robot_side(self, picking: Picking | Holding, snapshot: CellSnapshot, search: Search) -> RobotSide:
        """Return what an arm can hold where: whether it picks the object up with a grasp and can be at a pose."""
        motion, name = self.motion, picking.name
        reach, standing = motion.reaches[picking.arm], motion.standing(snapshot)
        model = motion.object_model(name)
        ways = [invert_transform(pose) for pose in picking.grasps]
        checker = motion.checker(picking.arm, snapshot, motion.held_object(picking.arm, name, ways[0]))

        def reachable(world_from_object: FloatArray, index: int) -> bool:
            world_from_gripper = world_from_object @ picking.grasps[index]
            checker.hold(object_solids(model, ways[index]))
            return reach.quick_check(world_from_gripper, checker, standing, search.offering, leaves)

        def leaves(displacements: FloatArray) -> bool:
            return motion.draws_back(picking.arm, displacements)

        def stretches(world_from_object: FloatArray) -> FloatArray:
            found = reach.inverse_kinematics.stretches(world_from_object, grasps)
            found[:, ~picking.usable()] = np.inf
            return found

        def kinematic(world_from_object: FloatArray, indices: IntArray) -> BoolArray:
            found = reach.inverse_kinematics.quick_many(world_from_object @ grasps[indices])
            search.offering.counts[Reason.JOINT_LIMITS, ""] += int((~found).sum())
            return found

        grasps = np.array(picking.grasps)
        return RobotSide(grasps, self.grippers[picking.arm], stretches, kinematic, reachable)

    def warm_up(self) -> None:
        """Load (at the very first time: compile) what a plan runs, so that no request waits for it."""
        scheme = next((each for each in self.schemes.values() if isinstance(each, ExpectedCostScheme)), None)
        if scheme is None:
            return
        model = next(iter(self.motion.catalogue.values()))
        arm = self.motion.robot.arm_names[0]
        robot = RobotSide(
            object_from_gripper=np.eye(4)[None],
            gripper=self.grippers[arm],
            stretches=lambda poses: np.zeros((len(poses), 1)),
            kinematic=lambda poses, _: self.motion.reaches[arm].inverse_kinematics.quick_many(poses),
            reachable=lambda pose, index: True,
        )
        person = TrackedPerson(make_transform(np.eye(3), [0.0, 0.0, 1.4]))
        goal = make_transform(np.eye(3), [0.4, 0.0, 1.1])
        table = np.array([0.4, 0.4, 0.02]), make_transform(np.eye(3), [0.4, 0.0, 0.9])
        with contextlib.suppress(HandoverError):  # whether there is an answer does not matter
            scheme.offers(HandoverTask(model, np.eye(4), person, goal, boxes=(table,), robot=robot))

    def scheme_for(self, request: HandoverRequest) -> Scheme:
        """Return the scheme of a request; of one with an offer, that which offers it and nothing else.

        Raises:
            UnknownNameError: There is no such scheme.
            BadRequestError: The scheme does not say how a person takes what is offered.
        """
        if request.offer is None:
            return self.scheme(request.scheme)
        base = self.scheme(request.scheme or "expected_cost")
        if not isinstance(base, ExpectedCostScheme):
            raise BadRequestError(f"offer: scheme {base.name!r} cannot tell who takes it how; use expected_cost")
        return OfferedScheme(base, request.offer)

    def scheme(self, name: str) -> Scheme:
        """Return a scheme by name; the default one for an empty name.

        Raises:
            UnknownNameError: There is no such scheme.
        """
        chosen = name or self.motion.settings.default_scheme
        if chosen not in self.schemes:
            raise UnknownNameError("scheme", chosen, tuple(self.schemes))
        return self.schemes[chosen]

    def _arms(self, request: HandoverRequest, world_from_object: FloatArray, snapshot: CellSnapshot) -> list[str]:
        """Return the arms to try: the one that holds the object or is asked for; else all, the nearest first."""
        robot = self.motion.robot
        asked = [robot.arm(request.arm).name] if request.arm else list(robot.arm_names)
        held = {arm: self.motion.held_by(arm, snapshot) for arm in robot.arm_names}
        holding = [arm for arm, name in held.items() if name == request.object_name]
        free = [arm for arm in asked if not held[arm]]
        if holding or not free:
            if not set(holding) & set(asked):
                arm = (holding or asked)[0]
                raise InfeasibleError(f"the {arm} arm holds {held[arm]}; let it put that back first", ErrorCode.BUSY)
            return [arm for arm in holding if arm in asked]
        homes = {arm: robot.gripper_pose(arm, robot.arm(arm).home)[:3, 3] for arm in free}
        return sorted(free, key=lambda arm: float(np.linalg.norm(homes[arm] - world_from_object[:3, 3])))

    def picking(
        self, arm: str, name: str, snapshot: CellSnapshot, search: Search
    ) -> tuple[FloatArray, CellSnapshot, Picking | Holding | None]:
        """Return an arm's way from where it stands, the cell after that, and how it picks up the object (None: cannot).

        A hand that stands at an object without holding it first draws back.
        """
        start = self.motion.start_of(arm, snapshot)
        if self.motion.held_by(arm, snapshot) == name:
            pick = held_pick(self.motion, arm, name, snapshot)
            if pick is None:
                search.picking.add(Reason.BLOCKED, "straight way up with the object")
            return start[None], snapshot, None if pick is None else Holding(pick)
        lead = self.motion.leave(arm, start, snapshot)
        ready = replace(snapshot, arms={**snapshot.arms, arm: lead[-1]})
        return lead, ready, Picking(self.motion, arm, name, ready, search.picking)

    def _combinations(
        self, offer: Offer, picking: Picking | Holding, snapshot: CellSnapshot, search: Search
    ) -> list[Combination]:
        """Return the picks with which an arm can be at an offer, the cheapest first."""
        found: list[Combination] = []
        standing = self.motion.standing(snapshot)
        for index, world_from_gripper, towards in self._grasps_at(offer, picking):
            if search.out_of_time or len(found) >= COMBINATIONS_KEPT:
                break
            if picking.refused(index):
                continue
            reach = self.motion.reaches[picking.arm]
            if not reach.has_solution(world_from_gripper, search.offering):
                continue
            pick = picking[index]
            if pick is None:
                continue
            carried = pick.lift_line[-1]
            free = reach.solutions(world_from_gripper, pick.carrying, standing, search.offering, carried)
            leaving = filter(lambda posture: self.motion.draws_back(picking.arm, posture), free)
            for posture in islice(leaving, POSTURES_TRIED):
                cost = float(np.max(np.abs(posture - carried))) + TURN_WEIGHT * towards
                found.append(Combination(pick, offer, world_from_gripper, posture, cost))
        return sorted(found, key=lambda combination: combination.cost)[:PATHS_TRIED]

    def _grasps_at(self, offer: Offer, picking: Picking | Holding) -> list[tuple[int, FloatArray, float]]:
        """Return the grasps that leave the person's hand and side free at an offer, those pointing to the person first.

        Each with its place in ``picking``, ``world_from_gripper`` and the cosine between gripper and person's reach.
        """
        usable = []
        for index, object_from_gripper in enumerate(picking.grasps):
            world_from_gripper = offer.world_from_object @ object_from_gripper
            towards = float(world_from_gripper[:3, 2] @ offer.reach)
            if offer.robot_grasp is not None:  # the scheme has looked at hands and sides itself
                usable += [(index, world_from_gripper, towards)] if index == offer.robot_grasp else []
                continue
            apart = min(np.linalg.norm(world_from_gripper[:3, 3] - hand[:3, 3]) for hand in offer.hands)
            if towards <= PERSON_SIDE and apart >= self.motion.settings.hand_clearance:
                usable.append((index, world_from_gripper, towards))
        return sorted(usable, key=lambda entry: entry[2])

    def _stages(
        self, chosen: Combination, lead: FloatArray, snapshot: CellSnapshot, search: Search
    ) -> tuple[PlannedStage, ...] | None:
        """Return the stages of a combination, or None when one of its ways is blocked."""
        motion, pick, settings = self.motion, chosen.pick, self.motion.settings
        arm, reach = pick.arm, self.motion.reaches[pick.arm]
        standing = motion.standing(snapshot)
        carrying = reach.validity(pick.carrying, standing)
        present = self._present(chosen, carrying, search)
        if present is None:
            search.paths_failed += 1
            return None
        posture = present[-1]
        given = replace(snapshot, objects={**snapshot.objects, pick.held.name: chosen.offer.world_from_object})
        letting_go = reach.validity(motion.checker(arm, given, touched=pick.held.name), standing)
        back = motion.back_off(arm, posture, letting_go)
        away = reach.validity(motion.checker(arm, given), standing)
        home = motion.robot.arm(arm).home
        path_home = None
        if back is not None and away(back[-1]):
            home = motion.robot.arm(arm).home
            path_home = motion.free_path(arm, back[-1], home, away, search.deadline)
        fetch = self._fetch(pick, lead, snapshot, search)
        if back is None or path_home is None or fetch is None:
            search.paths_failed += 1
            return None
        # Back and home in one go: the person may move the object as soon as it is let go.
        retract = motion.timed(arm, np.vstack([back, path_home[1:]]), letting_go, settings.present_speed)
        return (
            *fetch,
            PlannedStage("present", motion.timed(arm, present, carrying, settings.present_speed)),
            PlannedStage("retract", retract, motion.robot.arm(arm).opening[1]),
        )

    def _fetch(
        self, pick: Pick, lead: FloatArray, snapshot: CellSnapshot, search: Search
    ) -> tuple[PlannedStage, ...] | None:
        """Return the stages until the object is in the gripper and off its support, or None when the way is blocked."""
        motion, arm, settings = self.motion, pick.arm, self.motion.settings
        lift = PlannedStage("lift", motion.timed(arm, pick.lift_line, None, settings.careful_speed))
        if pick.grasp is None:
            return (lift,) if len(pick.lift_line) > 1 else ()
        checker = motion.checker(arm, snapshot)
        standing = motion.standing(snapshot)
        checker.tolerate_start(standing)
        way = motion.reaches[arm].validity(checker, standing)
        path = motion.free_path(arm, lead[-1], pick.approach_line[0], way, search.deadline)
        if path is None:
            return None
        opening = motion.robot.arm(arm).opening
        closed = max(opening[0], pick.grasp.width - settings.squeeze)
        whole_path, corners = np.vstack([lead, path[1:]]), None if len(lead) > 1 else way
        return (
            PlannedStage("approach", motion.timed(arm, whole_path, corners), opening[1]),
            PlannedStage("grasp", motion.timed(arm, pick.approach_line, None, settings.careful_speed), closed),
            lift,
        )

    def _present(self, chosen: Combination, carrying: Validity, search: Search) -> FloatArray | None:
        """Return the path from the lifted object to the offer: upright if that is possible."""
        motion, pick = self.motion, chosen.pick
        start = pick.lift_line[-1]
        upright = motion.upright(pick.arm, pick.gripper_from_object, carrying)
        if motion.object_model(pick.held.name).keep_upright and upright(start) and upright(chosen.posture):
            path = motion.free_path(pick.arm, start, chosen.posture, upright, search.deadline, UPRIGHT_SEARCH)
            if path is not None:
                return path
            kinematics = motion.reaches[pick.arm].inverse_kinematics
            line = straight_line(kinematics, upright, start, kinematics.gripper_pose(start), chosen.world_from_gripper)
            if line is not None:
                return line
        return motion.free_path(pick.arm, start, chosen.posture, carrying, search.deadline)

    def _refusal(self, request: HandoverRequest, search: Search, arms: list[str]) -> InfeasibleError:
        """Return the error that says what stood in the way."""
        who = f"{request.object_name} with the {' or '.join(arms)} arm"
        spent = "; the time budget ran out" if search.out_of_time else ""
        if not search.grasps:
            return InfeasibleError(f"cannot pick up {who}: no grasp fits the gripper's opening; choose another arm")
        if search.picking.counts and not search.picks:
            return InfeasibleError(
                f"cannot pick up {who}: {search.picking.sentence()}{spent}; move it into reach, clear its surroundings",
                search.picking.code,
            )
        if search.paths_failed:
            return InfeasibleError(
                f"no collision-free way to hand over {who} was found among {search.paths_failed} tried{spent}; "
                f"refused at {search.offers} offers: {search.offering.sentence()}; allow more time or clear the way",
                ErrorCode.NO_PATH,
            )
        return InfeasibleError(
            f"cannot hold {who} at any of {search.offers} offers: {search.offering.sentence()}{spent}; let the person "
            "come into reach, or choose another scheme",
            search.offering.code,
        )


def _refuse_outdated(outdated: Callable[[], bool]) -> None:
    """Raise OutdatedSnapshotError when the snapshot no longer holds."""
    if outdated():
        raise OutdatedSnapshotError("the person moved while the handover was planned")


def _plan(
    request: HandoverRequest,
    scheme: Scheme,
    chosen: Combination,
    stages: tuple[PlannedStage, ...],
    elapsed: float,
    search: Search,
) -> HandoverPlan:
    """Return the plan of a combination with its stages."""
    offer, pick = chosen.offer, chosen.pick
    where = np.round(offer.world_from_object[:3, 3], 2).tolist()
    taken = f"takes {request.object_name} by {pick.grasp.region.name}" if pick.grasp else f"holds {request.object_name}"
    turned = f", {offer.region} turned to the person" if offer.region else ""
    place = "the scheme's own position" if offer.nominal else "beside the scheme's position, which was out of reach"
    refused = search.offering.sentence()
    expected = offer.expected
    expectation = ""
    if expected is not None:
        expectation = f"Expected posture: {expected.words}; {expected.cost_name} cost {expected.cost:.2f}. "
    if offer.predicted is not None:
        expectation = f"{explain(offer.predicted)} "
    text = (
        f"The {pick.arm} arm {taken} and offers it at {where} m ({place})"
        f"{turned}. {expectation}Looked at {search.offers} offers and {search.picks} grasps; refused: {refused}."
    )
    return HandoverPlan(
        object_name=request.object_name,
        scheme=scheme.name,
        arm=pick.arm,
        robot_grasp=pick.grasp.region.name if pick.grasp else "",
        object_from_gripper=pick.object_from_gripper,
        world_from_object=offer.world_from_object,
        world_from_gripper=chosen.world_from_gripper,
        world_from_goal=request.world_from_goal,
        facing_region=offer.region,
        world_from_hand=offer.world_from_hand,
        nominal=offer.nominal,
        stages=stages,
        planning_time=elapsed,
        candidates=search.offers,
        explanation=text,
        expected=expected,
        predicted=offer.predicted,
    )
