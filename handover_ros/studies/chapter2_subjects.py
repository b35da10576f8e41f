"""Simulated subjects of chapter 2: bodies that differ in limbs, limits, handedness and comfort, free and strapped."""

from __future__ import annotations

from functools import lru_cache
from typing import Literal

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.sim.person_spec import ARM_JOINTS, HANDS, ArmAngles, ArmLimits, Hand, PersonSpec, load_person
from handover_ros.studies.chapter2_settings import Chapter2Settings, SubjectSettings
from handover_ros.studies.seeds import generator

Condition = Literal["free", "strapped"]
CONDITIONS: tuple[Condition, ...] = ("free", "strapped")
LIMBS = ("shoulder_half_width", "upper_arm", "forearm", "hand", "grip_along")
# Which length a marker's place along its segment goes with.
ALONG = {"torso": "trunk", "upper_arm": "upper_arm", "forearm": "forearm", "hand": "hand"}
# A joint keeps at least this range on both sides of standing [rad], so that every subject can stand with hanging arms.
AROUND_STANDING = 0.15


def subject(settings: Chapter2Settings, number: int, seed: int, condition: Condition) -> PersonSpec:
    """Return a subject's body; the same one, but for the dominant arm's limits, in both conditions."""
    return _subject(settings.like, settings.strap, settings.subject, number, seed, condition)


@lru_cache(maxsize=64)
def _subject(like: str, strap: str, given: SubjectSettings, number: int, seed: int, condition: Condition) -> PersonSpec:
    """Return a subject's body."""
    usual, rng = load_person(like), generator(seed, "chapter2 subject", number)
    dominant: Hand = "left" if rng.random() < given.left_handed else "right"
    body = _with_limits(_with_limbs(usual, given, rng), given, rng)
    neutral = np.array(list(body.comfort.neutral.__dict__.values()))
    neutral = np.clip(neutral + given.neutral * rng.standard_normal(len(neutral)), -np.pi, np.pi)
    comfort = body.comfort.model_copy(update={"neutral": ArmAngles(**dict(zip(ARM_JOINTS, neutral.tolist())))})
    shifts = rng.uniform(-given.strap_shift, given.strap_shift, len(ARM_JOINTS))
    free = body.model_copy(update={"dominant": dominant, "comfort": comfort})
    if condition == "free":
        return free
    whose = load_person(strap)
    strapped = _shifted(getattr(whose.limits, whose.dominant), shifts, getattr(free.limits, dominant))
    return free.model_copy(update={"limits": free.limits.model_copy(update={dominant: strapped})})


def _with_limbs(usual: PersonSpec, given: SubjectSettings, rng: np.random.Generator) -> PersonSpec:
    """Return a body of another stature and other proportions, with its markers not quite where they should be."""
    stature = float(rng.uniform(*given.stature))
    scale = stature / usual.stature
    own = {name: 1.0 for name in usual.lengths.__dict__}
    for name in LIMBS:
        own[name] = 1.0 + float(rng.uniform(-given.proportion, given.proportion))
    own["hand"] = own["grip_along"]
    lengths = usual.lengths.model_copy(
        update={name: scale * own[name] * value for name, value in usual.lengths.__dict__.items()}
    )
    markers = {}
    for name, marker in usual.markers.items():
        along = ALONG[marker.segment.removeprefix("right_").removeprefix("left_")]
        stretched = np.array(marker.position) * scale * [1.0, 1.0, own[along]]
        placed = stretched + given.placement * rng.standard_normal(3)
        markers[name] = marker.model_copy(update={"position": tuple(placed.tolist())})
    return usual.model_copy(
        update={"stature": stature, "mass": usual.mass * scale**2, "lengths": lengths, "markers": markers}
    )


def _with_limits(body: PersonSpec, given: SubjectSettings, rng: np.random.Generator) -> PersonSpec:
    """Return the body with another range of motion, the same in both arms, and with feet that stay where they are."""
    shares = rng.uniform(*given.range, (len(ARM_JOINTS), 2))
    limits = {hand: getattr(body.limits, hand) for hand in HANDS}
    usual = np.array(list(limits["right"].__dict__.values()))
    standing = body.standing[6:13]
    ends = np.column_stack(
        [
            np.minimum(shares[:, 0] * usual[:, 0], standing - AROUND_STANDING),
            np.maximum(shares[:, 1] * usual[:, 1], standing + AROUND_STANDING),
        ]
    )
    ends[ARM_JOINTS.index("elbow_flexion"), 0] = usual[ARM_JOINTS.index("elbow_flexion"), 0]
    own = _limits(np.clip(ends, -np.pi, np.pi))
    feet = (-given.feet, given.feet)
    torso = body.limits.torso.model_copy(update={"torso_x": feet, "torso_y": feet})
    return body.model_copy(
        update={"limits": body.limits.model_copy(update={"torso": torso, **dict.fromkeys(HANDS, own)})}
    )


def _shifted(strap: ArmLimits, shifts: FloatArray, free: ArmLimits) -> ArmLimits:
    """Return a strapped arm's limits: the strap's, each range shifted [rad] (7,), within those of the free arm."""
    ends = np.array(list(strap.__dict__.values())) + shifts[:, None]
    bounds = np.array(list(free.__dict__.values()))
    width = np.minimum(np.ptp(ends, axis=1), np.ptp(bounds, axis=1))
    lower = np.clip(ends[:, 0], bounds[:, 0], bounds[:, 1] - width)
    return _limits(np.column_stack([lower, lower + width]))


def _limits(ends: FloatArray) -> ArmLimits:
    """Return limits (7, 2) [rad] by name."""
    return ArmLimits(**dict(zip(ARM_JOINTS, map(tuple, ends.tolist()))))
