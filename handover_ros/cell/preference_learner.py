"""Learns the preference of whoever is active, answer by answer, and chooses what to ask next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from handover_ros.arm.model import JOINT_NAMES, SIDES, Arm, Side, arm_of
from handover_ros.arm.turns import turn_jacobian, turns
from handover_ros.cell.belief_store import BeliefStore
from handover_ros.ergonomics.arm_costs import Preference
from handover_ros.errors import BadModelError, BadRequestError, ErrorCode, HandoverError, UnknownNameError
from handover_ros.geometry import FloatArray, invert_transform
from handover_ros.objects.catalogue import ObjectModel
from handover_ros.preferences.belief import PARTICLES, Belief, first_belief
from handover_ros.preferences.belief_file import PersonBelief
from handover_ros.preferences.information import AnswerKind
from handover_ros.preferences.offered import free_for_hand, offered_query
from handover_ros.preferences.prior import Prior, population_prior, typical_prior
from handover_ros.preferences.query import Answer, Chart, Query, posture_answer, region_answer
from handover_ros.preferences.space import PreferenceSpace, arm_space
from handover_ros.preferences.strategies import Selection, select
from handover_ros.preferences.surprise import has_changed, unlikeliness
from handover_ros.skeleton.profile import Profile

LIMBS = Chart(turns, turn_jacobian)
SAME = 1e-9  # difference of bounds below which a stored belief is about the same things


@dataclass(frozen=True)
class LearnerSettings:
    """How preferences are learned.

    Attributes:
        learn: ``neutral``, ``weights`` or both.
        rationality: Of the person [1/cost].
        rationality_range: Factor by which it may be more or less and is averaged over; 1: it is known.
        particles: Their number.
        retention: What an answer still counts one answer later.
        prior: ``even`` over the bounds; ``typical``: around what is usual; ``population``: what the stored beliefs of
            others show, as long as there are none ``typical``.
        spread: Standard deviation [rad] between a posture as tracked and as modelled.
        answers: ``posture``, or ``region``: which of a choice counts.
        seed: Of all random draws.
    """

    learn: tuple[str, ...] = ("neutral", "weights")
    rationality: float = 10.0
    rationality_range: float = 1.0
    particles: int = PARTICLES
    retention: float = 1.0
    prior: str = "even"
    spread: float = 0.07
    answers: AnswerKind = "posture"
    seed: int = 0


@dataclass(frozen=True, eq=False)
class OfferedHandover:
    """A handover as a question.

    Attributes:
        object_name: The object.
        world_from_object: Where it is offered, shape (4, 4).
        world_from_torso: The person's torso, shape (4, 4).
        arm: The robot's arm; empty: not known, nothing is blocked.
        object_from_gripper: How the robot holds it, or None: nothing is blocked. Shape (4, 4).
    """

    object_name: str
    world_from_object: FloatArray
    world_from_torso: FloatArray
    arm: str = ""
    object_from_gripper: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class TakenHandover:
    """A handover and how the person took the object.

    Attributes:
        handover_id: One answer for each.
        offered: The question.
        hand: ``left`` or ``right``.
        region: Grasp region; empty: not known.
        posture: Of the arm [rad], shape (7,); None: not known.
        covariance: Of the posture [rad2], shape (7, 7); None: exact.
    """

    handover_id: str
    offered: OfferedHandover
    hand: Side
    region: str = ""
    posture: FloatArray | None = None
    covariance: FloatArray | None = None


@dataclass
class PreferenceLearner:
    """The belief about the active person; stored after every answer.

    Attributes:
        catalogue: Objects by name.
        grippers: Each robot arm's gripper as points in its own frame [m] (n, 3).
        store: Where beliefs are kept.
        settings: How it learns.
        person: The belief; None: nobody is active.
        arms: The person's arms.
        problem: Why the stored belief cannot be used; empty: it can.
    """

    catalogue: Mapping[str, ObjectModel]
    grippers: Mapping[str, FloatArray]
    store: BeliefStore
    settings: LearnerSettings = field(default_factory=LearnerSettings)
    person: PersonBelief | None = None
    arms: Mapping[Side, Arm] = field(default_factory=dict)
    problem: str = ""

    def activate(self, profile: Profile | None) -> None:
        """Learn about this person from now on; what is stored about them goes on.

        Raises:
            BadModelError: The profile has no arm that can be used; nobody is active then.
        """
        self.person, self.arms, self.problem = None, {}, ""
        if profile is None:
            return
        self.arms = _arms(profile)
        self.person = PersonBelief(profile.profile_id, self._first(profile.profile_id))
        try:
            if self.store.exists(profile.profile_id):
                self.person = self._stored(profile.profile_id)
        except HandoverError as error:
            self.problem = f"{error}; preferences/reset_belief starts anew and keeps the old file"

    def active(self, profile_id: str = "") -> PersonBelief:
        """Return the belief about a person; empty: the active one.

        Raises:
            BadRequestError: Nobody is active, or somebody else.
        """
        if self.person is None:
            raise BadRequestError(
                "no profile is active, so nobody's preference can be learned; calibrate and activate one first",
                ErrorCode.NOT_ENOUGH_DATA,
            )
        if profile_id and profile_id != self.person.profile_id:
            raise BadRequestError(f"profile_id {profile_id!r}: the active person is {self.person.profile_id!r}")
        return self.person

    def add(self, taken: TakenHandover, profile_id: str = "") -> bool:
        """Take an answer in and store the belief; return whether it was new.

        Raises:
            BadRequestError: It is not about the active person, cannot be an answer, or the stored belief is damaged.
            UnknownNameError: There is no such object.
            StoreError: It could not be stored; then it is not taken in either.
        """
        person = self.active(profile_id)
        if self.problem:
            raise BadModelError(self.problem)
        if not taken.handover_id:
            raise BadRequestError("handover_id: is empty; every answer needs the name of its handover")
        if taken.handover_id in person.handover_ids:
            return False
        query = self.query(taken.offered, taken.hand)
        answer = self._answer(query, taken)
        chance = unlikeliness(person.belief, query, answer)
        updated = PersonBelief(
            person.profile_id,
            person.belief.updated(query, answer),
            (*person.handover_ids, taken.handover_id),
            (*person.surprises, chance),
        )
        self.store.save(updated)
        self.person = updated
        return True

    def choose(
        self,
        menu: Sequence[OfferedHandover],
        strategy: str,
        information_weight: float = 0.5,
        hand: Side = "right",
        profile_id: str = "",
    ) -> Selection:
        """Return which of several handovers to make next; NaN for those the person cannot take.

        Raises:
            BadRequestError: The menu is empty, or the person can take none of it.
            UnknownNameError: There is no such strategy or object.
        """
        person = self.active(profile_id)
        queries: list[Query] = []
        places: list[int] = []
        reasons: list[str] = []
        for place, offered in enumerate(menu):
            try:
                queries.append(self.query(offered, hand))
                places.append(place)
            except UnknownNameError:
                raise
            except BadRequestError as error:
                reasons.append(str(error))
        if menu and not queries:
            raise BadRequestError(f"menu: the person can take none of {len(menu)} handovers; the first: {reasons[0]}")
        found = select(
            person.belief, queries, strategy, self.settings.answers, information_weight, seed=self.settings.seed
        )
        spread = [np.full(len(menu), np.nan) for _ in range(3)]
        for array, values in zip(spread, (found.values, found.information, found.cost)):
            array[places] = values
        return Selection(places[found.chosen], *spread)

    def query(self, offered: OfferedHandover, hand: Side) -> Query:
        """Return what the person can choose from.

        Raises:
            UnknownNameError: There is no such object or hand.
            BadRequestError: The person cannot take it there.
        """
        if offered.object_name not in self.catalogue:
            raise UnknownNameError("object", offered.object_name, tuple(self.catalogue))
        if hand not in self.arms:
            raise UnknownNameError("hand of this person", hand, tuple(self.arms))
        model, arm = self.catalogue[offered.object_name], self.arms[hand]
        free = None
        if offered.object_from_gripper is not None and offered.arm:
            if offered.arm not in self.grippers:
                raise UnknownNameError("robot arm", offered.arm, tuple(self.grippers))
            free = free_for_hand(model, arm, self.grippers[offered.arm], offered.object_from_gripper)
        torso_from_object = invert_transform(offered.world_from_torso) @ offered.world_from_object
        return offered_query(model, arm, torso_from_object, free)

    def save(self, profile_id: str = "") -> None:
        """Store the belief as it is.

        Raises:
            BadRequestError: It is not about the active person.
            StoreError: It could not be stored.
        """
        person = self.active(profile_id)
        if self.problem:
            raise BadModelError(self.problem)
        self.store.save(person)

    def load(self, profile_id: str = "") -> None:
        """Go back to the belief that is stored.

        Raises:
            BadRequestError: It is not about the active person, or nothing is stored.
            BadModelError: The file is damaged; the present belief stays.
        """
        person = self.active(profile_id)
        if not self.store.exists(person.profile_id):
            raise BadRequestError(f"nothing is stored about {person.profile_id!r} yet")
        self.person, self.problem = self._stored(person.profile_id), ""

    def reset(self, profile_id: str = "") -> None:
        """Believe nothing of the active person; what was stored is kept under another name.

        Raises:
            BadRequestError: It is not about the active person.
            StoreError: The store cannot be written to.
        """
        person = self.active(profile_id)
        self.store.set_aside(person.profile_id)
        self.person = PersonBelief(person.profile_id, self._first(person.profile_id))
        self.problem = ""

    @property
    def surprise(self) -> float:
        """``surprise.unlikeliness`` of the newest answer; NaN: there is none."""
        return self.person.surprises[-1] if self.person and self.person.surprises else float("nan")

    @property
    def changed(self) -> bool:
        """Whether the last answers are unlike the person's answers before."""
        return self.person is not None and has_changed(self.person.surprises)

    def _answer(self, query: Query, taken: TakenHandover) -> Answer:
        """Return the answer as it is to be counted."""
        if taken.posture is not None and self.settings.answers == "posture":
            return posture_answer(query, taken.posture, taken.covariance, spread=self.settings.spread, chart=LIMBS)
        if not taken.region:
            raise BadRequestError("grasp_region: neither posture nor region of the choice is known")
        return region_answer(query, taken.region)

    def _space(self) -> PreferenceSpace:
        """Return what is learned: within the limits of either arm."""
        settings, limits = self.settings, np.array([arm.limits for arm in self.arms.values()])
        wide = settings.rationality_range
        return arm_space(
            np.array([limits[:, 0].min(axis=0), limits[:, 1].max(axis=0)]),
            settings.learn,
            rationality=(settings.rationality / wide, settings.rationality * wide),
        )

    def _first(self, profile_id: str) -> Belief:
        """Return what is believed of somebody who has not answered yet."""
        settings, space = self.settings, self._space()
        prior = Prior(space) if settings.prior == "even" else typical_prior(space, Preference())
        if settings.prior == "population":
            size = space.bounds.shape[1]
            others = [
                (np.clip(each.belief.particles, *space.bounds), each.belief.log_weights)
                for each in self.store.others(profile_id)
                if each.belief.prior.space.names == space.names and each.belief.particles.shape[1] == size
            ]
            if others:
                prior = population_prior(space, others)
        return first_belief(prior, settings.particles, settings.retention, settings.seed)

    def _stored(self, profile_id: str) -> PersonBelief:
        """Return the stored belief.

        Raises:
            BadModelError: It is damaged, or about other things than are learned now.
        """
        person, space = self.store.load(profile_id), self._space()
        stored = person.belief.prior.space
        if stored.joints != JOINT_NAMES or stored.names != space.names:
            raise BadModelError(
                f"{self.store.path(profile_id)}: is about {', '.join(stored.names)}; now {', '.join(space.names)} are "
                "learned"
            )
        return person


def point_estimates(belief: Belief) -> Mapping[str, Preference]:
    """Return the belief as one preference: ``mean``, ``mode``, and ``expected``.

    The mean over the belief of the cost (4.2) is a quadratic again, up to a constant: with weights E[w] about
    E[w q*] / E[w]. That is ``expected``.
    """
    space, people, weights = belief.prior.space, belief.people, belief.weights
    middle, mode = space.people(belief.mean[None]), space.people(belief.mode[None])
    expected = weights @ people.weights
    return {
        "mean": Preference(middle.neutral[0], middle.weights[0]),
        "mode": Preference(mode.neutral[0], mode.weights[0]),
        "expected": Preference(weights @ (people.weights * people.neutral) / expected, expected),
    }


def _arms(profile: Profile) -> dict[Side, Arm]:
    """Return the arms of a person that can be used.

    Raises:
        BadModelError: There is none.
    """
    found: dict[Side, Arm] = {}
    problem: HandoverError | None = None
    for side in SIDES:
        if side in dict(profile.skeleton.hands):
            try:
                found[side] = arm_of(profile.skeleton, side)
            except HandoverError as error:
                problem = problem or error
    if not found:
        raise BadModelError(f"profile {profile.profile_id!r}: no arm can be used ({problem or 'it has no hands'})")
    return found
