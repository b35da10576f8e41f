"""The demonstration's learning part: every handover is a question, and the next plan knows the answer."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from handover_msgs.action import ExecuteHandover
from handover_msgs.msg import BeliefSummary, HandoverPlan
from handover_msgs.srv import PlanHandover, ResetSimulation, SelectQuery
from rich.console import Console

from handover_ros.cell.learning_curve import LearningStep, TruePerson
from handover_ros.cell.report import HandoverRecord
from handover_ros.errors import ErrorCode, HandoverError
from handover_ros.geometry import invert_transform
from handover_ros.nodes.convert import transform_from_message
from handover_ros.nodes.demo_calibration import checked
from handover_ros.nodes.operator import Operator
from handover_ros.nodes.runtime import LATCHED
from handover_ros.objects.catalogue import load_object
from handover_ros.robot.gripper_points import gripper_points
from handover_ros.robot.model import RobotModel
from handover_ros.robot.robot_geometry import RobotGeometry
from handover_ros.sim.person_spec import load_person

SELECT_LIMIT = 90.0  # [s] of wall time for a menu and a choice from it
BELIEF_LIMIT = 30.0  # [s] of wall time until an answer is taken in
TRIES = 6  # offers whose way may be blocked, before a handover is given up
PER_OBJECT = 16  # offers of each object in a menu
NO_WAY = (ErrorCode.NO_PATH, ErrorCode.NOT_REACHABLE, ErrorCode.IN_COLLISION)

HandOver = Callable[[int, str, ExecuteHandover.Goal], tuple[HandoverRecord, ExecuteHandover.Result]]


@dataclass
class Lesson:
    """Handovers that ask, with what they told.

    Attributes:
        operator: Whose graph it is.
        console: Where progress is printed.
        person: File of config/people, for the true costs.
        robot: File of config/robots.
        objects: What may be handed over.
        strategy: Chooses from the menus.
        steps: The handovers so far.
        first_cost: True expected cost of what is planned before any answer.
    """

    operator: Operator
    console: Console
    person: str
    robot: str
    objects: tuple[str, ...]
    strategy: str
    steps: list[LearningStep] = field(default_factory=list)
    first_cost: float = math.nan

    def __post_init__(self) -> None:
        """Watch the belief."""
        self.truth = TruePerson(load_person(self.person))
        robot = RobotModel.load(self.robot)
        geometry = RobotGeometry(robot)
        self.grippers = {arm: gripper_points(geometry, arm) for arm in robot.arm_names}
        self.beliefs: list[BeliefSummary] = []
        self.operator.node.create_subscription(BeliefSummary, "preferences/belief", self.beliefs.append, LATCHED)

    def run(self, count: int, hand_over: HandOver) -> Iterator[HandoverRecord]:
        """Make ``count`` handovers and give a record of each.

        Raises:
            HandoverError: A service refused.
        """
        operator = self.operator
        operator.wait(lambda: self.beliefs and self.beliefs[-1].profile_id, BELIEF_LIMIT, "a belief about the person")
        self.first_cost = self.plan_cost()
        for number in range(1, count + 1):
            yield self.ask(number, hand_over)

    def ask(self, number: int, hand_over: HandOver) -> HandoverRecord:
        """Choose a handover, make it, and wait until the answer is taken in."""
        request = SelectQuery.Request(
            strategy=self.strategy, information_weight=0.5, object_names=list(self.objects), count=PER_OBJECT
        )
        selected = checked(self.operator.call(SelectQuery, "preferences/select_query", request, SELECT_LIMIT))
        self.console.print(f"  [dim]{number}[/dim] {selected.message}", highlight=False, soft_wrap=True)
        before = self.beliefs[-1].observations
        for _ in range(TRIES):
            goal = ExecuteHandover.Goal(object_name=selected.plan.object_name, has_offer=True, offer=selected.plan)
            record, result = hand_over(number, selected.plan.object_name, goal)
            left = [plan for plan in selected.menu if plan.plan_id != selected.plan.plan_id]
            if result.success or result.error_code not in map(int, NO_WAY) or not left:
                break
            request.menu = left
            selected = checked(self.operator.call(SelectQuery, "preferences/select_query", request, SELECT_LIMIT))
        counted = False
        if result.taken and result.choice.hand:
            try:
                self.operator.wait(
                    lambda: self.beliefs[-1].observations > before, BELIEF_LIMIT, "the answer to be taken in"
                )
                counted = True
            except HandoverError as error:
                self.console.print(f"  [red]{error}[/red]", highlight=False, soft_wrap=True)
        belief, cost = self.beliefs[-1], self.taken_cost(record)
        # What was handed over goes back to its table, so that every handover starts alike and anything can be planned.
        self.operator.call(ResetSimulation, "sim/reset", ResetSimulation.Request(seed=-1, objects_only=True))
        self.steps.append(
            LearningStep(
                number=number,
                object_name=record.object_name,
                information=float(selected.expected_information[selected.chosen]),
                expected_cost=float(selected.expected_cost[selected.chosen]),
                region=result.choice.grasp_region,
                cost=cost,
                entropy=float(belief.entropy),
                surprise=float(belief.surprise),
                plan_cost=self.plan_cost(),
                counted=counted,
            )
        )
        return record

    def taken_cost(self, record: HandoverRecord) -> float:
        """Return the true cost of the posture in which the person took the object; NaN: not taken."""
        moment = self.operator.taken_truth if record.taken else None
        return math.nan if moment is None else self.truth.cost(moment.joint_names, list(moment.displacements))

    def plan_cost(self) -> float:
        """Return the true expected cost of what would be planned now, the mean over the objects."""
        found = [self.cost_of(name) for name in self.objects]
        finite = [cost for cost in found if math.isfinite(cost)]
        return float(np.mean(finite)) if finite else math.nan

    def cost_of(self, name: str) -> float:
        """Return the true expected cost of what would be planned now for one object; NaN: nothing."""
        request = PlanHandover.Request(object_name=name, scheme="expected_cost")
        answer = self.operator.call(PlanHandover, "planner/plan_handover", request, SELECT_LIMIT)
        if not answer.success or self.operator.skeleton is None:
            return math.nan
        return self.true_cost(answer.plan)

    def true_cost(self, plan: HandoverPlan) -> float:
        """Return what the person's choice at a planned handover truly costs them, on average."""
        assert self.operator.skeleton is not None
        torso = transform_from_message(self.operator.skeleton.torso.pose, "torso")
        offer = invert_transform(torso) @ transform_from_message(plan.handover_pose, "handover_pose")
        grip = transform_from_message(plan.object_from_gripper, "object_from_gripper")
        try:
            return self.truth.expected_cost(load_object(plan.object_name), offer, self.grippers[plan.arm], grip)
        except HandoverError:
            return math.nan

    def metrics(self) -> dict[str, float]:
        """Return the numbers of the lesson."""
        costs = [self.first_cost, *(step.plan_cost for step in self.steps)]
        taken = [step.cost for step in self.steps if math.isfinite(step.cost)]
        return {
            "answers": sum(step.counted for step in self.steps),
            "entropy_last_nat": self.steps[-1].entropy if self.steps else math.nan,
            "true_cost_first": costs[0],
            "true_cost_last": costs[-1],
            "true_cost_taken_mean": float(np.mean(taken)) if taken else math.nan,
        }
