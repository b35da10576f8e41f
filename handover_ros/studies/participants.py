"""Simulated people who differ: in what they find comfortable, in their limbs, and in their ranges of motion."""

from __future__ import annotations

import numpy as np

from handover_ros.arm.model import JOINT_NAMES
from handover_ros.cell.learning_curve import TruePerson
from handover_ros.sim.person_spec import HANDS, ArmAngles, ArmWeights, PersonSpec

NEUTRAL_SPREAD = 0.35  # [rad] between people
WEIGHTS = (0.3, 2.0)  # [1/rad2], even in the logarithm
EDGE = 0.05  # [rad] of the neutral posture from the limits
LENGTH_SPREAD = 0.08  # share by which limbs differ
LIMIT_LOSS = 0.35  # largest share of a joint's range that somebody lacks at either end


def with_taste(body: PersonSpec, rng: np.random.Generator) -> TruePerson:
    """Return a person with this body, and a neutral posture and joint weights of their own."""
    limits = np.array([getattr(body.limits.right, name) for name in JOINT_NAMES]).T
    usual = np.array([getattr(body.comfort.neutral, name) for name in JOINT_NAMES])
    neutral = np.clip(usual + NEUTRAL_SPREAD * rng.standard_normal(7), limits[0] + EDGE, limits[1] - EDGE)
    weights = np.exp(rng.uniform(np.log(WEIGHTS[0]), np.log(WEIGHTS[1]), 7))
    comfort = body.comfort.model_copy(
        update={
            "neutral": ArmAngles(**dict(zip(JOINT_NAMES, neutral.tolist()))),
            "weights": ArmWeights(**dict(zip(JOINT_NAMES, weights.tolist()))),
        }
    )
    return TruePerson(body.model_copy(update={"comfort": comfort}))


def with_body(body: PersonSpec, rng: np.random.Generator) -> PersonSpec:
    """Return a person with other limbs and less range of motion than this one."""
    lengths = body.lengths.model_copy(
        update={
            name: float(getattr(body.lengths, name) * np.exp(LENGTH_SPREAD * rng.standard_normal()))
            for name in ("upper_arm", "forearm", "shoulder_half_width")
        }
    )
    limits = {}
    for hand in HANDS:
        own = getattr(body.limits, hand)
        changed = {}
        for name in JOINT_NAMES:
            low, high = getattr(own, name)
            lost = LIMIT_LOSS * (high - low) * rng.random(2) ** 2
            changed[name] = (max(low + lost[0], 0.0) if name == "elbow_flexion" else low + lost[0], high - lost[1])
        limits[hand] = own.model_copy(update=changed)
    return body.model_copy(update={"lengths": lengths, "limits": body.limits.model_copy(update=limits)})
