"""Learning: what handovers cost a person when planned with what tracking taught, against planning with the truth.

The loop of the cell without its physics (``studies.laboratory``): the planner's menus, choices by eq. 4.3 of Bestick
2017, the posture taken shown by noisy markers, tracked with a skeleton calibrated from markers too.
"""

from __future__ import annotations

import contextlib
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from handover_ros.cell.belief_store import BeliefStore
from handover_ros.cell.preference_learner import LearnerSettings, PreferenceLearner, point_estimates
from handover_ros.errors import HandoverError
from handover_ros.geometry import FloatArray
from handover_ros.sim.person_spec import load_person
from handover_ros.studies.laboratory import Laboratory, Participant
from handover_ros.studies.participants import with_taste

ASKED = ("mug", "glass", "u_lock", "pitcher", "plate", "handlebars")
JUDGED = ("mug", "glass", "u_lock")
HANDOVERS, PEOPLE = 10, 20
PER_OBJECT = 64  # offers in a menu
PARTICLES = 2000
STRATEGIES = ("active_value", "active", "passive")


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
    """Return the metrics; prints the curves."""
    people = 3 if quick else PEOPLE
    body = load_person("adult")
    laboratory = Laboratory(rationality=body.comfort.rationality or 1e3)
    guest = laboratory.invite(body, seed)
    metrics: dict[str, float] = {}
    for strategy in STRATEGIES:
        curves = []
        for number in range(people):
            rng = np.random.default_rng((seed, number))
            person = Participant(with_taste(body, rng), guest.skeleton, guest.profile, guest.world_from_torso)
            curves.append(teach(laboratory, person, strategy, number, rng))
        ratios = np.array([curve.ratios for curve in curves])
        costs, best = np.array([curve.costs for curve in curves]), sum(curve.best for curve in curves)
        answers = sum(curve.answers for curve in curves) / (people * HANDOVERS)
        print(f"  {strategy}: mean cost over truth {np.round(ratios.mean(axis=0), 3).tolist()}")
        print(f"  {strategy}: median              {np.round(np.median(ratios, axis=0), 3).tolist()}")
        print(f"  {strategy}: of all together     {np.round(costs.sum(axis=0) / best, 3).tolist()}", flush=True)
        metrics |= {
            f"learning_{strategy}_cost_over_truth_first": float(ratios[:, 0].mean()),
            f"learning_{strategy}_cost_over_truth": float(ratios[:, -1].mean()),
            f"learning_{strategy}_cost_over_truth_median": float(np.median(ratios[:, -1])),
            f"learning_{strategy}_cost_over_truth_of_all": float(costs[:, -1].sum() / best),
            f"learning_{strategy}_within_10_percent": float((ratios[:, -1] <= 1.10).mean()),
            f"learning_{strategy}_answers_share": answers,
        }
    return metrics


def teach(laboratory: Laboratory, person: Participant, strategy: str, number: int, rng: np.random.Generator) -> Curve:
    """Return how the planned handovers get better for one person, from an uninformed belief on."""
    preference = person.truth.preference
    best = sum(laboratory.judged(name, person, person.skeleton, preference).cost for name in JUDGED)
    settings = LearnerSettings(rationality=laboratory.rationality, particles=PARTICLES, seed=number)
    with tempfile.TemporaryDirectory() as folder:
        learner = PreferenceLearner(
            laboratory.catalogue, laboratory.planner.grippers, BeliefStore(Path(folder)), settings
        )
        learner.activate(person.profile)
        costs, answers = [believed_cost(laboratory, learner, person)], 0
        for handover in range(HANDOVERS):
            menu = laboratory.offers(person, ASKED, PER_OBJECT, handover)
            chosen = menu[learner.choose(menu, strategy).chosen]
            taken, _ = laboratory.taken(person, chosen, f"{handover}", rng)
            with contextlib.suppress(HandoverError):  # not an answer: the node would say so and go on
                answers += taken is not None and learner.add(taken)
            costs.append(believed_cost(laboratory, learner, person))
    return Curve(np.array(costs), best, answers)


def believed_cost(laboratory: Laboratory, learner: PreferenceLearner, person: Participant) -> float:
    """Return the true cost of what is planned with the belief, as the planner does: without answers, with anybody's."""
    assert learner.person is not None
    belief = learner.person.belief
    preference = point_estimates(belief)["expected"] if belief.observations else None
    return sum(laboratory.judged(name, person, person.profile.skeleton, preference).cost for name in JUDGED)
