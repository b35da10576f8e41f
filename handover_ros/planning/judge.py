"""What a handover that somebody else chose would cost this person: the same measure for every scheme."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from handover_ros.errors import BadRequestError, InfeasibleError
from handover_ros.geometry import FloatArray, invert_transform
from handover_ros.planning.expected_cost import ExpectedCostScheme, predict
from handover_ros.planning.feasible import statistics
from handover_ros.planning.offers import HandoverTask
from handover_ros.planning.problem import Candidate
from handover_ros.planning.types import PredictedChoice


def judge(
    scheme: ExpectedCostScheme, task: HandoverTask, world_from_object: FloatArray, object_from_gripper: FloatArray
) -> PredictedChoice | None:
    """Return how the person would choose at a pose with a robot grasp, by a scheme's model; None: nothing is feasible.

    Args:
        scheme: Whose model of the person and whose costs count.
        task: The object, the person and the goal; of the robot the gripper and its grasps are used.
        world_from_object: Where the object is offered. Shape (4, 4).
        object_from_gripper: How the robot holds it. Shape (4, 4).

    Raises:
        StaleDataError: Nobody is tracked.
        BadRequestError: The gripper is not known.
    """
    if task.robot is None:
        raise BadRequestError(f"what a handover of {task.model.name} costs depends on the gripper, which is not known")
    # The other grasps stay in: which are good at the goal, and what it costs to take it anew, is told by all of them.
    all_of_them = np.concatenate([object_from_gripper[None], task.robot.object_from_gripper])
    robot = replace(task.robot, object_from_gripper=all_of_them)
    try:
        situation = scheme.situation(replace(task, robot=robot))
    except InfeasibleError:
        return None
    problem = situation.problem
    torso_from_object = invert_transform(situation.world_from_torso) @ world_from_object
    table = statistics(problem.taker, problem.grasps, torso_from_object, problem.choice.hand_rationality)[0]
    if not (table[problem.free[0], 0] > 0.0).any():
        return None
    return predict(situation, Candidate(float("nan"), np.full(6, np.nan), torso_from_object, 0, table))
