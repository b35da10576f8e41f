"""Learning: what handovers cost a person when planned with what tracking taught, against planning with the truth.

The loop of the cell without its physics: menus of the planner, choices by the true person (Bestick 2017, eq. 4.3), the
posture taken shown by noisy markers, tracked with a skeleton calibrated from markers too, the label from that alone.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from handover_ros.arm.model import JOINT_NAMES, arm_of
from handover_ros.cell.belief_store import BeliefStore
from handover_ros.cell.learning_curve import TruePerson
from handover_ros.cell.preference_learner import (
    LearnerSettings,
    OfferedHandover,
    PreferenceLearner,
    TakenHandover,
    point_estimates,
)
from handover_ros.ergonomics.arm_costs import Preference
from handover_ros.errors import HandoverError
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
from handover_ros.sim.person_spec import ArmAngles, ArmWeights, PersonSpec, load_person
from handover_ros.skeleton.calibration import CalibrationSettings, calibrate
from handover_ros.skeleton.kernels import forward
from handover_ros.skeleton.profile import Profile
from handover_ros.skeleton.templates import load_template
from handover_ros.skeleton.tracking import SkeletonTracker

ASKED = ("mug", "glass", "u_lock", "pitcher", "plate", "handlebars")
JUDGED = ("mug", "glass", "u_lock")
HANDOVERS, PEOPLE = 10, 20
PER_OBJECT = 64
BUDGET = 10.0  # [s] of a search: no plan is cut short
RATE, NOISE, MISSING = 120.0, 0.001, 0.02  # [Hz], [m], share of the samples
REACH = 0.6  # [s] of the reach that is tracked
RATIONALITY = 10.0
SHOULDERS = 1.40  # [m]


@dataclass(frozen=True, eq=False)
class Curve:
    """True expected cost of the planned handovers, after 0, 1, ... answers.

    Attributes:
        costs: Shape (handovers + 1,).
        best: Of planning with the truth.
        answers: Number of answers that were taken in.
    """

    costs: FloatArray
    best: float
    answers: int

    @property
    def ratios(self) -> FloatArray:
        """Over that of planning with the truth, shape (handovers + 1,)."""
        return self.costs / self.best


def measure(seed: int, quick: bool) -> dict[str, float]:
    """Return the metrics; prints the curve."""
    people = 3 if quick else PEOPLE
    laboratory = Laboratory(seed)
    metrics: dict[str, float] = {}
    for strategy in ("active_value", "active", "passive"):
        curves = [laboratory.teach(seed, person, strategy) for person in range(people)]
        ratios = np.array([curve.ratios for curve in curves])
        costs, best = np.array([curve.costs for curve in curves]), sum(curve.best for curve in curves)
        print(f"  {strategy}: mean cost over truth {np.round(ratios.mean(axis=0), 3).tolist()}")
        print(f"  {strategy}: median              {np.round(np.median(ratios, axis=0), 3).tolist()}")
        print(f"  {strategy}: answers taken in    {sum(curve.answers for curve in curves)} of {people * HANDOVERS}")
        metrics |= {
            f"learning_{strategy}_cost_over_truth_first": float(ratios[:, 0].mean()),
            f"learning_{strategy}_cost_over_truth": float(ratios[:, -1].mean()),
            f"learning_{strategy}_cost_over_truth_median": float(np.median(ratios[:, -1])),
            f"learning_{strategy}_cost_over_truth_of_all": float(costs[:, -1].sum() / best),
            f"learning_{strategy}_within_10_percent": float((ratios[:, -1] <= 1.10).mean()),
            f"learning_{strategy}_answers_share": sum(curve.answers for curve in curves) / (people * HANDOVERS),
        }
    return metrics


class Laboratory:
    """A cell without physics, a person's body in it, and that body's calibrated skeleton."""

    def __init__(self, seed: int) -> None:
        self.scene, self.catalogue = load_scene("lab"), load_catalogue()
        self.planner = HandoverPlanner(RobotModel.load(), self.scene, self.catalogue, load_schemes())
        self.planner.warm_up()
        scheme = self.planner.schemes["expected_cost"]
        assert isinstance(scheme, ExpectedCostScheme)
        self.scheme = scheme
        self.body = load_person("adult")
        self.skeleton = skeleton_of(self.body)
        recording = calibration_recording(self.body, seed, RATE, NOISE, MISSING)
        torso = load_marker_set("upper_body_24").torso
        fitted = calibrate(recording, load_template("upper_body"), torso, CalibrationSettings(seed=seed))
        self.profile = Profile(
            "bench", "Bench", "2026-01-01T00:00:00Z", "upper_body_24", "upper_body", fitted.skeleton, fitted.report
        )
        self.world_from_torso = self.scene.person_pose @ transform_from_xyz_rpy([0.0, 0.0, SHOULDERS], [0.0, 0.0, 0.0])

    def teach(self, seed: int, number: int, strategy: str) -> Curve:
        """Return how the planned handovers get better for one person."""
        rng = np.random.default_rng((seed, number))
        person = TruePerson(random_taste(self.body, rng))
        best = sum(self.planned_cost(name, person, person.preference) for name in JUDGED)
        settings = LearnerSettings(rationality=RATIONALITY, particles=2000, seed=number)
        with tempfile.TemporaryDirectory() as folder:
            learner = PreferenceLearner(self.catalogue, self.planner.grippers, BeliefStore(Path(folder)), settings)
            learner.activate(self.profile)
            costs, answers = [self.believed_cost(learner, person)], 0
            for handover in range(HANDOVERS):
                answers += self.ask(learner, person, strategy, handover, rng)
                costs.append(self.believed_cost(learner, person))
        return Curve(np.array(costs), best, answers)

    def believed_cost(self, learner: PreferenceLearner, person: TruePerson) -> float:
        """Return the true cost of what is planned with the belief."""
        assert learner.person is not None
        believed = None
        if learner.person.belief.observations:
            believed = point_estimates(learner.person.belief)["expected"]
        return sum(self.planned_cost(name, person, believed) for name in JUDGED)

    def planned_cost(self, name: str, person: TruePerson, preference: Preference | None) -> float:
        """Return the true expected total cost (3.7) of the handover planned for a preference; None: nobody's."""
        search = Search(np.inf)
        cell = self.snapshot(preference)
        request = HandoverRequest(name, world_from_goal=self.scene.goals[name])
        model = self.planner.motion.object_model(name)
        for arm in self.planner.motion.robot.arm_names:
            _, ready, picking = self.planner.picking(arm, name, cell, search)
            if picking is None or not picking.grasps:
                continue
            task = replace(self.planner.task(request, model, picking, ready, search), budget=BUDGET)
            try:
                offer = self.scheme.offers(task)[0]
            except HandoverError:
                continue
            assert task.robot is not None
            assert offer.robot_grasp is not None
            chosen = ChosenOffer(offer.world_from_object, task.robot.object_from_gripper[offer.robot_grasp])
            judged = replace(task, person=self.snapshot(person.preference).person)
            predicted = OfferedScheme(self.scheme, chosen).offers(judged)[0].predicted
            assert predicted is not None
            return predicted.expected_cost
        raise HandoverError(f"{name} cannot be planned for this person")

    def snapshot(self, preference: Preference | None) -> CellSnapshot:
        """Return the cell as the planner sees it."""
        person = TrackedPerson(
            self.world_from_torso, skeleton=self.profile.skeleton, dominant="right", preference=preference
        )
        arms = {arm: np.array(self.planner.motion.robot.arm(arm).home) for arm in self.planner.motion.robot.arm_names}
        return CellSnapshot(arms=arms, objects=dict(self.scene.placements), person=person)

    def ask(
        self, learner: PreferenceLearner, person: TruePerson, strategy: str, handover: int, rng: np.random.Generator
    ) -> bool:
        """Make one handover, and return whether its answer was taken in."""
        cell = self.snapshot(None)
        dishes: list[Dish] = []
        for name in ASKED:
            dishes += menu(self.planner, self.scheme, name, cell, PER_OBJECT, budget=BUDGET, seed=handover)
        offers = [
            OfferedHandover(
                dish.object_name,
                dish.offer.world_from_object,
                self.world_from_torso,
                dish.arm,
                dish.object_from_gripper,
            )
            for dish in dishes
        ]
        chosen = offers[learner.choose(offers, strategy).chosen]
        taken = self.take(person, chosen, f"{handover}", rng)
        try:
            return taken is not None and learner.add(taken)
        except HandoverError:
            return False

    def take(
        self, person: TruePerson, offered: OfferedHandover, name: str, rng: np.random.Generator
    ) -> TakenHandover | None:
        """Return what tracking shows of the person's choice; None: nothing that could be an answer."""
        model, arm = self.catalogue[offered.object_name], arm_of(self.skeleton, "right")
        assert offered.object_from_gripper is not None
        free = free_for_hand(model, arm, self.planner.grippers[offered.arm], offered.object_from_gripper)
        pose = invert_transform(self.world_from_torso) @ offered.world_from_object
        try:
            query = offered_query(model, arm, pose, free, most=5000)
        except HandoverError:
            return None
        taste = person.preference
        people = People(taste.neutral[None], taste.weights[None], np.array([RATIONALITY]))
        posture = query.configurations[rng.choice(len(query), p=choice_probabilities(people, query)[0])]
        seen = self.tracked(posture, rng)
        if seen is None:
            return None
        world_from_torso, displacements, covariance = seen
        own = self.profile.skeleton
        try:
            choice = observed_choice(
                model, invert_transform(world_from_torso) @ offered.world_from_object, own, displacements, covariance
            )
        except HandoverError:
            return None
        question = replace(offered, world_from_torso=world_from_torso)
        return TakenHandover(name, question, choice.hand, choice.region, choice.posture, choice.covariance)

    def tracked(
        self, posture: FloatArray, rng: np.random.Generator
    ) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Return torso, displacements and covariance at the end of a reach, from markers."""
        columns = [self.skeleton.displacement_names.index(f"right_{name}") for name in JOINT_NAMES]
        end = np.zeros(len(self.skeleton.lower))
        end[columns] = posture
        count = int(REACH * RATE)
        share = np.linspace(0.0, 1.0, count)[:, None]
        way = np.vstack([(3.0 * share**2 - 2.0 * share**3) * end, np.tile(end, (count // 2, 1))])
        poses = np.tile(self.world_from_torso, (len(way), 1, 1))
        markers = forward(self.skeleton.tree, self.skeleton.coordinates(way, poses))
        markers = markers + NOISE * rng.normal(size=markers.shape)
        markers[rng.random(markers.shape[:2]) < MISSING] = np.nan
        tracker = SkeletonTracker(self.profile.skeleton, self.skeleton.marker_names)
        estimate = None
        for number, positions in enumerate(markers):
            seen = np.isfinite(positions[:, 0])
            status = np.where(seen, MarkerStatus.MEASURED, MarkerStatus.MISSING).astype(np.uint8)
            estimate = tracker.update(MarkerFrame(number / RATE, number, number / RATE, positions, status))
        if estimate is None or not estimate.valid:
            return None
        return estimate.world_from_torso, estimate.displacements, estimate.covariance


def random_taste(body: PersonSpec, rng: np.random.Generator) -> PersonSpec:
    """Return the same body with another neutral posture and other weights."""
    limits = np.array([getattr(body.limits.right, name) for name in JOINT_NAMES]).T
    usual = np.array([getattr(body.comfort.neutral, name) for name in JOINT_NAMES])
    neutral = np.clip(usual + 0.35 * rng.standard_normal(7), limits[0] + 0.05, limits[1] - 0.05)
    weights = np.exp(rng.uniform(np.log(0.3), np.log(2.0), 7))
    comfort = body.comfort.model_copy(
        update={
            "neutral": ArmAngles(**dict(zip(JOINT_NAMES, neutral.tolist()))),
            "weights": ArmWeights(**dict(zip(JOINT_NAMES, weights.tolist()))),
            "rationality": RATIONALITY,
        }
    )
    return body.model_copy(update={"comfort": comfort})
