"""The cell without its physics: people with bodies and tastes, handovers that ask them, and what plans truly cost them.

Menus and plans are the planner's; a person chooses by eq. 4.3 of Bestick 2017; the posture they take shows in noisy
markers only, which are tracked with a skeleton that was calibrated from markers too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from handover_ros.arm.model import JOINT_NAMES, arm_of
from handover_ros.cell.learning_curve import TruePerson
from handover_ros.cell.preference_learner import OfferedHandover, TakenHandover
from handover_ros.ergonomics.arm_costs import Preference
from handover_ros.errors import HandoverError, InfeasibleError
from handover_ros.geometry import FloatArray, invert_transform, transform_from_xyz_rpy
from handover_ros.mocap.frames import MarkerFrame, MarkerStatus
from handover_ros.mocap.marker_sets import load_marker_set
from handover_ros.objects.catalogue import load_catalogue
from handover_ros.objects.scene import load_scene
from handover_ros.planning import CellSnapshot, HandoverPlanner, HandoverRequest, TrackedPerson, load_schemes
from handover_ros.planning.expected_cost import ExpectedCostScheme
from handover_ros.planning.handover import Search
from handover_ros.planning.menu import Dish, menu
from handover_ros.planning.offered_scheme import OfferedScheme
from handover_ros.planning.types import ChosenOffer
from handover_ros.preferences.likelihood import choice_probabilities
from handover_ros.preferences.observed import observed_choice
from handover_ros.preferences.offered import free_for_hand, offered_query
from handover_ros.preferences.space import People
from handover_ros.robot import RobotModel
from handover_ros.sim.calibration_recording import calibration_recording
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.sim.person_spec import PersonSpec
from handover_ros.skeleton.calibration import CalibrationSettings, calibrate
from handover_ros.skeleton.kernels import forward
from handover_ros.skeleton.profile import Profile
from handover_ros.skeleton.templates import load_template
from handover_ros.skeleton.tracking import SkeletonTracker
from handover_ros.skeleton.tree import Skeleton

BUDGET = 30.0  # [s] of a search: no plan is cut short, so that results do not depend on the machine
RATE, NOISE, MISSING = 120.0, 0.001, 0.02  # [Hz], [m], share of the samples
REACH = 0.6  # [s] of the reach that is tracked
FRAMES = 1500  # that enter the calibration
FINEST = 5000  # configurations that a person chooses from


@dataclass(frozen=True, eq=False)
class Participant:
    """A simulated person who takes part.

    Attributes:
        truth: Body and taste.
        skeleton: The true one.
        profile: What calibration found.
        world_from_torso: Where the person stands, shape (4, 4).
    """

    truth: TruePerson
    skeleton: Skeleton
    profile: Profile
    world_from_torso: FloatArray


@dataclass(frozen=True, eq=False)
class Judgement:
    """What a planned handover truly costs.

    Attributes:
        cost: Expected total cost (3.7); NaN: the person cannot take it.
        believed: What the planner expected of it.
    """

    cost: float
    believed: float


class Laboratory:
    """A scene with a robot; people are invited to it.

    Args:
        scene: File of config/scenes.
        rationality: Of the people, as the planner assumes it [1/cost].
    """

    def __init__(self, scene: str = "lab", rationality: float = 20.0) -> None:
        self.rationality = rationality
        self.scene, self.catalogue = load_scene(scene), load_catalogue()
        self.planner = HandoverPlanner(RobotModel.load(), self.scene, self.catalogue, load_schemes())
        self.planner.warm_up()

    def invite(self, spec: PersonSpec, seed: int) -> Participant:
        """Return a person with the skeleton that calibration found from their noisy markers."""
        recording = calibration_recording(spec, seed, RATE, NOISE, MISSING)
        torso = load_marker_set("upper_body_24").torso
        settings = CalibrationSettings(seed=seed, max_frames=FRAMES)
        fitted = calibrate(recording, load_template("upper_body"), torso, settings)
        profile = Profile(
            "subject", "Subject", "2026-01-01T00:00:00Z", "upper_body_24", "upper_body", fitted.skeleton, fitted.report
        )
        shoulders = spec.lengths.lumbar_height + spec.lengths.trunk
        place = self.scene.person_pose @ transform_from_xyz_rpy([0.0, 0.0, shoulders], [0.0, 0.0, 0.0])
        return Participant(TruePerson(spec), skeleton_of(spec), profile, place)

    def scheme(self, name: str) -> ExpectedCostScheme:
        """Return a scheme that chooses pose and grasp by an objective."""
        scheme = self.planner.schemes[name]
        assert isinstance(scheme, ExpectedCostScheme)
        return replace(scheme, content=scheme.content.model_copy(update={"rationality": self.rationality}))

    def snapshot(self, person: Participant, skeleton: Skeleton | None, preference: Preference | None) -> CellSnapshot:
        """Return the cell as a planner sees it that knows this skeleton and preference; None: anybody's."""
        tracked = TrackedPerson(person.world_from_torso, skeleton=skeleton, dominant="right", preference=preference)
        arms = {arm: np.array(self.planner.motion.robot.arm(arm).home) for arm in self.planner.motion.robot.arm_names}
        return CellSnapshot(arms=arms, objects=dict(self.scene.placements), person=tracked)

    def judged(
        self,
        name: str,
        person: Participant,
        skeleton: Skeleton | None,
        preference: Preference | None,
        scheme: str = "expected_cost",
    ) -> Judgement:
        """Return what the handover of an object truly costs that is planned with this skeleton and preference.

        Raises:
            HandoverError: Nothing can be planned.
        """
        search, cell = Search(np.inf), self.snapshot(person, skeleton, preference)
        request = HandoverRequest(name, world_from_goal=self.scene.goals[name])
        model, chooser = self.planner.motion.object_model(name), self.scheme(scheme)
        for arm in self.planner.motion.robot.arm_names:
            _, ready, picking = self.planner.picking(arm, name, cell, search)
            if picking is None or not picking.grasps:
                continue
            task = replace(self.planner.task(request, model, picking, ready, search), budget=BUDGET)
            try:
                offer = chooser.offers(task)[0]
            except HandoverError:
                continue
            assert task.robot is not None
            assert offer.robot_grasp is not None
            assert offer.predicted is not None
            chosen = ChosenOffer(offer.world_from_object, task.robot.object_from_gripper[offer.robot_grasp])
            real = self.snapshot(person, person.skeleton, person.truth.preference).person
            try:
                predicted = OfferedScheme(self.scheme("expected_cost"), chosen).offers(replace(task, person=real))[0]
            except HandoverError:
                return Judgement(float("nan"), offer.predicted.expected_cost)
            assert predicted.predicted is not None
            return Judgement(predicted.predicted.expected_cost, offer.predicted.expected_cost)
        raise HandoverError(f"{name} cannot be planned for this person")

    def offers(self, person: Participant, objects: Sequence[str], count: int, seed: int) -> list[OfferedHandover]:
        """Return a menu: at most ``count`` handovers of each object that the planner thinks this person can take.

        Raises:
            HandoverError: There is none of any object.
        """
        cell, scheme = self.snapshot(person, person.profile.skeleton, None), self.scheme("expected_cost")
        dishes: list[Dish] = []
        refusals: list[str] = []
        for name in objects:
            try:
                dishes += menu(self.planner, scheme, name, cell, count, budget=BUDGET, seed=seed)
            except InfeasibleError as error:  # somebody of little motion may not take everything
                refusals.append(str(error))
        if not dishes:
            raise HandoverError(f"nothing can be offered to this person: {'; '.join(refusals)}")
        return [
            OfferedHandover(
                dish.object_name,
                dish.offer.world_from_object,
                person.world_from_torso,
                dish.arm,
                dish.object_from_gripper,
            )
            for dish in dishes
        ]

    def taken(
        self, person: Participant, offered: OfferedHandover, name: str, rng: np.random.Generator
    ) -> tuple[TakenHandover | None, float]:
        """Return what tracking shows of the person's choice, and its true cost; None: nothing that could be an answer.

        Args:
            person: Who takes it.
            offered: How it is offered.
            name: Of the handover.
            rng: Of choice and noise.
        """
        model, arm = self.catalogue[offered.object_name], arm_of(person.skeleton, "right")
        assert offered.object_from_gripper is not None
        free = free_for_hand(model, arm, self.planner.grippers[offered.arm], offered.object_from_gripper)
        pose = invert_transform(person.world_from_torso) @ offered.world_from_object
        taste = person.truth.preference
        try:
            query = offered_query(model, arm, pose, free, most=FINEST)
        except HandoverError:
            return None, float("nan")
        people = People(taste.neutral[None], taste.weights[None], np.array([self.rationality]))
        posture = query.configurations[rng.choice(len(query), p=choice_probabilities(people, query)[0])]
        cost = float(people.costs(posture[None])[0, 0])
        seen = self.tracked(person, posture, rng)
        if seen is None:
            return None, cost
        world_from_torso, displacements, covariance = seen
        try:
            choice = observed_choice(
                model,
                invert_transform(world_from_torso) @ offered.world_from_object,
                person.profile.skeleton,
                displacements,
                covariance,
            )
        except HandoverError:
            return None, cost
        question = replace(offered, world_from_torso=world_from_torso)
        return TakenHandover(name, question, choice.hand, choice.region, choice.posture, choice.covariance), cost

    def tracked(
        self, person: Participant, posture: FloatArray, rng: np.random.Generator
    ) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Return torso (4, 4), displacements (n,) and covariance (n, n) at the end of a reach, from markers; or None.

        Args:
            person: Whose right arm goes from hanging to a posture.
            posture: Of that arm [rad], shape (7,).
            rng: Of noise and missing markers.
        """
        skeleton = person.skeleton
        end = np.zeros(len(skeleton.lower))
        end[[skeleton.displacement_names.index(f"right_{name}") for name in JOINT_NAMES]] = posture
        count = int(REACH * RATE)
        share = np.linspace(0.0, 1.0, count)[:, None]
        way = np.vstack([(3.0 * share**2 - 2.0 * share**3) * end, np.tile(end, (count // 2, 1))])
        poses = np.tile(person.world_from_torso, (len(way), 1, 1))
        markers = forward(skeleton.tree, skeleton.coordinates(way, poses))
        markers = markers + NOISE * rng.normal(size=markers.shape)
        markers[rng.random(markers.shape[:2]) < MISSING] = np.nan
        tracker = SkeletonTracker(person.profile.skeleton, skeleton.marker_names)
        estimate = None
        for number, positions in enumerate(markers):
            seen = np.isfinite(positions[:, 0])
            status = np.where(seen, MarkerStatus.MEASURED, MarkerStatus.MISSING).astype(np.uint8)
            estimate = tracker.update(MarkerFrame(number / RATE, number, number / RATE, positions, status))
        if estimate is None or not estimate.valid:
            return None
        return estimate.world_from_torso, estimate.displacements, estimate.covariance


@lru_cache(maxsize=2)
def laboratory(scene: str, rationality: float) -> Laboratory:
    """Return the laboratory of a scene; made once in a process."""
    return Laboratory(scene, rationality)
