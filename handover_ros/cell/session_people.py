"""The people in a session's copies of the store: their profiles, and what was believed of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from handover_ros.bags.timeline_types import BeliefMark
from handover_ros.cell.belief_store import BeliefStore
from handover_ros.cell.store import ProfileStore
from handover_ros.errors import HandoverError


@dataclass(frozen=True)
class BeliefThen:
    """What was believed of a person's preference.

    Attributes:
        profile_id: Whose.
        observations: Answers taken in.
        entropy: [nat].
        joints: Of the numbers.
        neutral: Mean neutral posture [rad].
        weights: Mean joint weights [1/rad2].
    """

    profile_id: str
    observations: int
    entropy: float
    joints: tuple[str, ...]
    neutral: tuple[float, ...]
    weights: tuple[float, ...]


@dataclass(frozen=True)
class PersonThen:
    """A person as the store knew them at one time.

    Attributes:
        profile_id: Name of the profile.
        person: How the operator calls them.
        active: Whether theirs was the active profile.
        created: When the profile was fitted.
        fit_rms: Of the fit [m]; NaN: unknown.
        joints: Number of displacements.
        belief: What was believed of them; None: nothing yet.
        problem: Why profile or belief cannot be used; empty: they can.
    """

    profile_id: str
    person: str
    active: bool
    created: str
    fit_rms: float
    joints: int
    belief: BeliefThen | None
    problem: str


def people(folder: Path, notes: list[str]) -> tuple[PersonThen, ...]:
    """Return the people in a copy of the store; why something cannot be read goes to ``notes``."""
    try:
        stored = ProfileStore(folder).list()
    except HandoverError as error:
        notes.append(str(error))
        return ()
    beliefs = BeliefStore(folder)
    found = []
    for each in stored:
        belief, problem = None, each.problem
        try:
            if beliefs.exists(each.profile_id):
                belief = _stored_belief(beliefs, each.profile_id)
        except HandoverError as error:
            problem = problem or str(error)
        profile = each.profile
        found.append(
            PersonThen(
                profile_id=each.profile_id,
                person="" if profile is None else profile.person,
                active=each.active,
                created="" if profile is None else profile.created,
                fit_rms=math.nan if profile is None else profile.report.fit_rms,
                joints=0 if profile is None else len(profile.skeleton.displacement_names),
                belief=belief,
                problem=problem,
            )
        )
    return tuple(found)


def _stored_belief(beliefs: BeliefStore, profile_id: str) -> BeliefThen:
    belief = beliefs.load(profile_id).belief
    middle = belief.prior.space.people(belief.mean[None])
    return BeliefThen(
        profile_id,
        belief.observations,
        belief.entropy,
        belief.prior.space.joints,
        tuple(map(float, middle.neutral[0])),
        tuple(map(float, middle.weights[0])),
    )


def belief_of(mark: BeliefMark) -> BeliefThen:
    """Return a belief that was said in the graph."""
    return BeliefThen(
        mark.profile_id, mark.observations, mark.entropy, mark.joint_names, mark.mean_neutral, mark.mean_weights
    )


def joint_changes(before: BeliefThen, after: BeliefThen) -> list[tuple[str, float, float, float, float]]:
    """Return for each joint of both: its name, neutral before and after [deg], weight before and after [1/rad2]."""
    rows = []
    for number, joint in enumerate(before.joints):
        if joint in after.joints and max(len(before.neutral), len(before.weights)) > number:
            other = after.joints.index(joint)
            neutral = np.rad2deg([before.neutral[number], after.neutral[other]])
            rows.append((joint, float(neutral[0]), float(neutral[1]), before.weights[number], after.weights[other]))
    return rows
