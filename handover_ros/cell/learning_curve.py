"""How learning went, judged by what only the simulator knows: the person's true preference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import matplotlib
import numpy as np
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from handover_ros.arm.model import JOINT_NAMES, Arm, Side, arm_of
from handover_ros.cell.report import finite
from handover_ros.ergonomics.arm_costs import Preference, SquaredDistance
from handover_ros.geometry import FloatArray
from handover_ros.objects.catalogue import ObjectModel
from handover_ros.preferences.likelihood import survey
from handover_ros.preferences.offered import free_for_hand, offered_query
from handover_ros.preferences.space import People
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.sim.person_spec import PersonSpec

BEST = 1e3  # [1/cost] rationality of a person who always takes the best


@dataclass(frozen=True)
class LearningStep:
    """One handover of a demonstration that learns.

    Attributes:
        number: 1, 2, ...
        object_name: What was handed over.
        information: Expected of it [nat].
        expected_cost: Expected of it, under the belief before.
        region: Grasp region that was seen.
        cost: True cost of the posture that the person took; NaN: not taken.
        entropy: Of the belief afterwards [nat].
        surprise: Predicted probability of answers no likelier.
        plan_cost: True expected cost of the handover that is planned with the belief afterwards.
        counted: Whether the answer was taken in.
    """

    number: int
    object_name: str
    information: float
    expected_cost: float
    region: str
    cost: float
    entropy: float
    surprise: float
    plan_cost: float
    counted: bool

    def document(self) -> dict[str, object]:
        """Return it for a JSON file."""
        return {name: finite(value) if isinstance(value, float) else value for name, value in asdict(self).items()}


@dataclass(frozen=True, eq=False)
class TruePerson:
    """What the simulator knows of a person's arms.

    Attributes:
        spec: The person.
    """

    spec: PersonSpec

    @property
    def preference(self) -> Preference:
        """What the person finds comfortable."""
        comfort = self.spec.comfort
        return Preference(
            np.array([getattr(comfort.neutral, name) for name in JOINT_NAMES]),
            np.array([getattr(comfort.weights, name) for name in JOINT_NAMES]),
        )

    @property
    def hand(self) -> Side:
        """The dominant one."""
        return "left" if self.spec.dominant == "left" else "right"

    def arm(self) -> Arm:
        """Return the dominant arm."""
        return arm_of(skeleton_of(self.spec), self.hand)

    def cost(self, joint_names: Sequence[str], displacements: Sequence[float]) -> float:
        """Return the true cost of the dominant arm's posture; NaN where it is not told.

        Args:
            joint_names: Names with the side before, as the simulator's true state has them.
            displacements: [rad].
        """
        values = dict(zip(joint_names, displacements))
        posture = [values.get(f"{self.hand}_{name}", np.nan) for name in JOINT_NAMES]
        return float(SquaredDistance(self.preference).evaluate(posture))

    def expected_cost(
        self, model: ObjectModel, torso_from_object: FloatArray, gripper: FloatArray, object_from_gripper: FloatArray
    ) -> float:
        """Return what this person's choice at an offer costs them on average.

        Args:
            model: The object.
            torso_from_object: The offer, shape (4, 4).
            gripper: The gripper as points in its own frame [m], shape (n, 3).
            object_from_gripper: The robot's grasp, shape (4, 4).

        Raises:
            BadRequestError: The person cannot take it there.
        """
        arm, preference = self.arm(), self.preference
        query = offered_query(model, arm, torso_from_object, free_for_hand(model, arm, gripper, object_from_gripper))
        rationality = self.spec.comfort.rationality or BEST
        people = People(preference.neutral[None], preference.weights[None], np.array([rationality]))
        return float(survey(people, np.ones(1), query).mean_cost[0])


def learning_table(steps: Sequence[LearningStep]) -> Table:
    """Return the table of what was learned, for a terminal of 80 columns."""
    table = Table(title="Learning", title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for heading in ("#", "object", "grasp"):
        table.add_column(heading)
    for heading in ("told [nat]", "entropy [nat]", "taken at cost", "plan's true cost"):
        table.add_column(escape(heading), justify="right")
    for step in steps:
        table.add_row(
            str(step.number),
            step.object_name,
            step.region or "not seen",
            f"{step.information:.2f}",
            f"{step.entropy:.2f}",
            f"{step.cost:.2f}" if np.isfinite(step.cost) else "",
            f"{step.plan_cost:.2f}" if np.isfinite(step.plan_cost) else "",
        )
    return table


def draw_learning(steps: Sequence[LearningStep], first_cost: float, path: Path) -> Path:
    """Draw entropy and true costs over the handovers and return the PNG's path.

    Args:
        steps: The handovers.
        first_cost: True expected cost of what was planned before the first answer.
        path: Of the picture.
    """
    matplotlib.use("Agg")
    from matplotlib import pyplot

    numbers = [step.number for step in steps]
    figure, (above, below) = pyplot.subplots(2, 1, figsize=(7.0, 5.2), sharex=True, layout="constrained")
    above.plot(numbers, [step.entropy for step in steps], marker="o", color="#4c78a8")
    above.set_ylabel("entropy of the belief [nat]")
    costs = [first_cost, *(step.plan_cost for step in steps)]
    below.plot([0, *numbers], costs, marker="o", color="#54a24b", label="planned with the belief: expected")
    below.plot(numbers, [step.cost for step in steps], "x", color="#e45756", label="asked: posture that was taken")
    below.set_ylabel("true cost for the person")
    below.set_ylim(bottom=0.0)
    below.set_xlabel("answers")
    below.set_xticks([0, *numbers])
    below.legend(frameon=False)
    for axes in (above, below):
        axes.spines[["top", "right"]].set_visible(False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)
    pyplot.close(figure)
    return path
