"""The posture a person takes: the cheapest one within the joint limits that brings the hands where they should be.

Two stages. First a Gauss-Newton descent of many starting postures at once brings each onto the wanted hand poses; then
sequential quadratic programming (SLSQP) slides the cheapest few along them, with the Jacobians of ``jacobian.py``.
Everything is in the frame of the root (the torso), which stands still.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize
from scipy.stats import qmc

from handover_ros.ergonomics.costs import PostureCost, cost_gradient
from handover_ros.ergonomics.hand_targets import ANGLE_LENGTH, HandTarget, HandTask, hand_task
from handover_ros.errors import BadModelError, BadRequestError
from handover_ros.geometry import FloatArray
from handover_ros.skeleton.tree import Skeleton

POSITION_TOLERANCE, ROTATION_TOLERANCE = 1e-3, 1e-2  # [m], [rad]: what counts as reached
STARTS, FINALISTS = 64, 4
DESCENT_STEPS, DAMPING = 40, 1e-3
LONGEST_STEP = 0.6  # [rad] of the descent
SQP_STEPS, SQP_ACCURACY = 80, 1e-7
DISTINCT = 0.15  # [rad] apart, in some displacement, for two finalists to be different


@dataclass(frozen=True, eq=False)
class PredictedPosture:
    """The answer.

    Attributes:
        displacements: Within the limits [rad, m], shape (n,).
        cost: What the cost says of it.
        feasible: Whether the hands are where they should be.
        position_error: Largest distance of a hand from its target [m].
        rotation_error: Largest angle of a hand to its target, where that counts [rad].
    """

    displacements: FloatArray
    cost: float
    feasible: bool
    position_error: float
    rotation_error: float


def predict_posture(
    skeleton: Skeleton,
    cost: PostureCost,
    targets: Mapping[str, HandTarget],
    start: npt.ArrayLike | None = None,
    starts: int = STARTS,
    seed: int = 0,
) -> PredictedPosture:
    """Return the cheapest posture found that brings one or both hands to their targets.

    Displacements that move no targeted hand are free: the cost alone decides about them. If the targets are out of
    reach the answer is the posture that comes nearest, marked as not feasible.

    Args:
        skeleton: With limits of all displacements.
        cost: What to minimise.
        targets: By side, ``left`` or ``right``; may be empty.
        start: Where the person is before [rad, m], shape (n,); default: zero, arms hanging, as far as limits allow.
        starts: How many postures the search begins with.
        seed: Of those postures; the same seed gives the same answer.

    Raises:
        UnknownNameError: The skeleton has no hand on a side.
        BadModelError: A limit is unknown, or the grip of a hand cannot be derived.
        BadRequestError: A target is no pose or ``start`` has the wrong shape.
    """
    lower, upper = skeleton.lower, skeleton.upper
    _check_limits(skeleton)
    begin = np.zeros(len(lower)) if start is None else np.asarray(start, dtype=float)
    if begin.shape != lower.shape or not np.isfinite(begin).all():
        raise BadRequestError(f"start: needs {len(lower)} finite displacements, got {begin.tolist()}")
    begin = np.clip(begin, lower, upper)
    task = hand_task(skeleton, targets)
    postures = _starting_postures(skeleton, begin, starts, seed)
    if targets:
        postures = _descend(task, postures)
    finalists = _finalists(task, cost, begin, postures)
    polished = [_polish(task, cost, begin, posture) for posture in finalists]
    return min((_judge(task, cost, begin, each) for each in [*finalists, *polished]), key=_rank)


def preferred_posture(
    skeleton: Skeleton, cost: PostureCost, start: npt.ArrayLike | None = None, seed: int = 0
) -> PredictedPosture:
    """Return the cheapest posture of all within the limits, the hands being free: where a person likes to take things.

    Arguments and errors as of ``predict_posture``.
    """
    return predict_posture(skeleton, cost, {}, start, seed=seed)


def _check_limits(skeleton: Skeleton) -> None:
    """Refuse unknown limits."""
    known = np.isfinite(skeleton.lower) & np.isfinite(skeleton.upper)
    if not known.all():
        names = [name for name, is_known in zip(skeleton.displacement_names, known) if not is_known]
        raise BadModelError(
            f"skeleton {skeleton.name!r}: the limits of {', '.join(names)} are unknown; calibrate with motions that "
            "move these joints"
        )


def _starting_postures(skeleton: Skeleton, begin: FloatArray, count: int, seed: int) -> FloatArray:
    """Return postures (count, n): where the person is, the middle of the limits, and a low-discrepancy sequence."""
    sampler = qmc.Halton(len(begin), seed=seed)
    spread = skeleton.lower + sampler.random(max(count - 2, 0)) * (skeleton.upper - skeleton.lower)
    return np.concatenate([begin[None], skeleton.middle[None], spread])


def _descend(task: HandTask, postures: FloatArray) -> FloatArray:
    """Return postures (k, n) moved onto the targets: damped Gauss-Newton steps, clipped to the limits, all at once."""
    lower, upper = task.skeleton.lower, task.skeleton.upper
    held = np.zeros(postures.shape, dtype=bool)
    for _ in range(DESCENT_STEPS):
        errors, slopes = task.errors(postures)
        # Displacements that would leave their limits rest in this step, so that others take over.
        active = np.where(held[:, None, :], 0.0, slopes)
        normal = active @ np.swapaxes(active, 1, 2) + DAMPING**2 * np.eye(errors.shape[1])
        step = -(np.swapaxes(active, 1, 2) @ np.linalg.solve(normal, errors[..., None]))[..., 0]
        longest = np.abs(step).max(axis=1, keepdims=True)
        step *= np.minimum(1.0, LONGEST_STEP / np.maximum(longest, 1e-12))
        wanted = postures + step
        downhill = (np.swapaxes(slopes, 1, 2) @ errors[..., None])[..., 0]
        held = ((wanted <= lower) & (downhill > 0.0)) | ((wanted >= upper) & (downhill < 0.0))
        postures = np.clip(wanted, lower, upper)
    return postures


def _finalists(task: HandTask, cost: PostureCost, begin: FloatArray, postures: FloatArray) -> list[FloatArray]:
    """Return the few best, different from each other: the cheapest on the targets, else the nearest to them."""
    errors, _ = task.errors(postures)
    miss = np.linalg.norm(errors, axis=1)
    reached = miss < POSITION_TOLERANCE
    rank = np.where(reached, -1.0, miss)
    order = np.lexsort((cost.evaluate(begin, postures), rank))
    chosen: list[FloatArray] = []
    for index in order:
        if all(np.abs(postures[index] - other).max() > DISTINCT for other in chosen):
            chosen.append(postures[index])
        if len(chosen) == FINALISTS:
            break
    return chosen


def _polish(task: HandTask, cost: PostureCost, begin: FloatArray, posture: FloatArray) -> FloatArray:
    """Return a cheaper posture (n,) on the same targets."""
    lower, upper = task.skeleton.lower, task.skeleton.upper
    scale = 1.0 / max(float(cost.evaluate(begin, posture)), 1e-9)
    last: dict[bytes, tuple[FloatArray, FloatArray]] = {}

    def errors(theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return errors and slopes; SLSQP asks for both at one point in two calls."""
        key = theta.tobytes()
        if key not in last:
            last.clear()
            last[key] = task.errors(theta)
        return last[key]

    reach = {"type": "eq", "fun": lambda theta: errors(theta)[0], "jac": lambda theta: errors(theta)[1]}
    answer = minimize(
        lambda theta: scale * float(cost.evaluate(begin, theta)),
        posture,
        jac=lambda theta: scale * cost_gradient(cost, begin, theta),
        bounds=list(zip(lower, upper)),
        constraints=[reach] if task.targets else [],
        method="SLSQP",
        options={"maxiter": SQP_STEPS, "ftol": SQP_ACCURACY},
    )
    polished = np.asarray(answer.x, dtype=float)
    return np.clip(polished, lower, upper) if np.isfinite(polished).all() else posture


def _judge(task: HandTask, cost: PostureCost, begin: FloatArray, posture: FloatArray) -> PredictedPosture:
    """Return a posture with what there is to say about it."""
    position, rotation = task.misses(posture)
    feasible = position <= POSITION_TOLERANCE and rotation <= ROTATION_TOLERANCE
    return PredictedPosture(posture, float(cost.evaluate(begin, posture)), feasible, position, rotation)


def _rank(answer: PredictedPosture) -> tuple[bool, float]:
    """Order answers: feasible and cheap first; of those that are not, the nearest."""
    miss = answer.position_error + ANGLE_LENGTH * answer.rotation_error
    return not answer.feasible, answer.cost if answer.feasible else miss
