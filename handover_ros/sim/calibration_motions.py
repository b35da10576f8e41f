"""How the simulated person makes the calibration motions of ``skeleton/prompts.py``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.sim.person_spec import ARM_JOINTS, ARM_SLICE, HANDS, PersonSpec
from handover_ros.skeleton.prompts import PROMPTS, REPETITIONS, CalibrationPrompt, prompt_of

RANGE_SHARE = 0.97
VARIED_SHARE = 0.7
ENTRY_TIME = 1.2
MEAN_SPEED = 1.9
SHORTEST_REPETITION = 1.6
STILL_TIME = 2.0
CIRCLE_TIME = 4.0  # [s] for one circle
CIRCLE_POINTS = 8


@dataclass(frozen=True)
class CalibrationMotion:
    """How the simulated person makes one motion, with both arms at once.

    Attributes:
        joint: Arm joint that goes through its range; empty: none.
        posture: Displacements [rad] of other arm joints meanwhile.
        second: Arm joint that goes through its range a quarter of a circle later; empty: none.
        varied: Arm joint that is at another place of its range in each repetition; empty: none.
    """

    joint: str
    posture: dict[str, float]
    second: str = ""
    varied: str = ""


MOTIONS = {
    "still": CalibrationMotion("", {}),
    "shoulder_flexion": CalibrationMotion("shoulder_flexion", {"elbow_flexion": 0.1}),
    "shoulder_abduction": CalibrationMotion("shoulder_abduction", {"elbow_flexion": 0.1, "shoulder_flexion": 0.35}),
    "shoulder_rotation": CalibrationMotion(
        "shoulder_rotation", {"elbow_flexion": 1.5, "shoulder_abduction": 0.6, "shoulder_flexion": 0.3}
    ),
    "elbow_flexion": CalibrationMotion("elbow_flexion", {"shoulder_flexion": 0.3}, varied="forearm_pronation"),
    "forearm_pronation": CalibrationMotion("forearm_pronation", {"elbow_flexion": 1.5, "shoulder_flexion": 0.2}),
    "wrist_flexion": CalibrationMotion(
        "wrist_flexion", {"elbow_flexion": 1.5, "shoulder_flexion": 0.2}, varied="wrist_deviation"
    ),
    "wrist_deviation": CalibrationMotion(
        "wrist_deviation", {"elbow_flexion": 1.5, "shoulder_flexion": 0.2}, varied="wrist_flexion"
    ),
    "wrist_circle": CalibrationMotion(
        "wrist_flexion", {"elbow_flexion": 1.5, "shoulder_flexion": 0.2}, second="wrist_deviation"
    ),
}


@dataclass(frozen=True, eq=False)
class MotionPlan:
    """Way points of a motion, to be joined smoothly: ``times`` (k,) [s] from its start, ``postures`` (k, 20)."""

    name: str
    prompt: str
    times: FloatArray
    postures: FloatArray

    @property
    def duration(self) -> float:
        """Length of the motion [s]."""
        return float(self.times[-1])


def calibration_plan(person: PersonSpec, name: str = "") -> tuple[MotionPlan, ...]:
    """Return the way points of one motion, or of all in order when ``name`` is empty.

    Every motion starts and ends in the standing posture and moves both arms.

    Raises:
        UnknownNameError: There is no such motion.
    """
    prompts = (prompt_of(name),) if name else PROMPTS
    return tuple(_plan(person, prompt) for prompt in prompts)


def calibration_duration(person: PersonSpec, name: str = "") -> float:
    """Return how long one motion, or all of them, take [s]."""
    return sum(plan.duration for plan in calibration_plan(person, name))


def _plan(person: PersonSpec, prompt: CalibrationPrompt) -> MotionPlan:
    """Return the way points of a motion for a person's range."""
    motion = MOTIONS[prompt.name]
    standing = person.standing
    if not motion.joint:
        return MotionPlan(prompt.name, prompt.text, np.array([0.0, STILL_TIME]), np.stack([standing, standing]))
    start = standing.copy()
    index = ARM_JOINTS.index(motion.joint)
    for hand in HANDS:
        for joint, angle in motion.posture.items():
            start[ARM_SLICE[hand].start + ARM_JOINTS.index(joint)] = angle
    start = np.clip(start, person.lower, person.upper)
    if motion.second:
        return _circle(person, prompt, start, (index, ARM_JOINTS.index(motion.second)))
    low, high = start.copy(), start.copy()
    swing = 0.0
    for hand in HANDS:
        column = ARM_SLICE[hand].start + index
        middle, half = _range(person.lower[column], person.upper[column])
        low[column], high[column] = middle - RANGE_SHARE * half, middle + RANGE_SHARE * half
        swing = max(swing, 2.0 * RANGE_SHARE * half)
    stroke = max(swing / MEAN_SPEED, SHORTEST_REPETITION / 2.0)
    strokes = [posture for number in range(REPETITIONS) for posture in _varied(person, motion, number, high, low)]
    postures = [standing, start, *strokes, start, standing]
    steps = [ENTRY_TIME, *[stroke] * (2 * REPETITIONS), 0.7 * stroke, ENTRY_TIME]
    return MotionPlan(prompt.name, prompt.text, np.concatenate([[0.0], np.cumsum(steps)]), np.stack(postures))


def _varied(person: PersonSpec, motion: CalibrationMotion, repetition: int, *postures: FloatArray) -> list[FloatArray]:
    """Return the postures (20,) of one repetition: the varied joint at the end, middle or start of its range."""
    found = [posture.copy() for posture in postures]
    if motion.varied:
        for hand in HANDS:
            column = ARM_SLICE[hand].start + ARM_JOINTS.index(motion.varied)
            middle, half = _range(person.lower[column], person.upper[column])
            place = 1.0 - 2.0 * repetition / (REPETITIONS - 1)
            for posture in found:
                posture[column] = middle + place * VARIED_SHARE * half
    return found


def _circle(person: PersonSpec, prompt: CalibrationPrompt, start: FloatArray, joints: tuple[int, int]) -> MotionPlan:
    """Return the way points of a motion of two joints (their numbers in an arm) through the edge of their ranges."""
    angles = np.linspace(0.0, 2.0 * np.pi * REPETITIONS, CIRCLE_POINTS * REPETITIONS + 1)
    ring = np.tile(start, (len(angles), 1))
    for hand in HANDS:
        for joint, wave in zip(joints, (np.cos(angles), np.sin(angles))):
            column = ARM_SLICE[hand].start + joint
            middle, half = _range(person.lower[column], person.upper[column])
            ring[:, column] = middle + RANGE_SHARE * half * wave
    steps = [ENTRY_TIME, ENTRY_TIME, *[CIRCLE_TIME / CIRCLE_POINTS] * (len(angles) - 1), ENTRY_TIME, ENTRY_TIME]
    postures = np.vstack([person.standing, start, ring, start, person.standing])
    return MotionPlan(prompt.name, prompt.text, np.concatenate([[0.0], np.cumsum(steps)]), postures)


def _range(lower: float, upper: float) -> tuple[float, float]:
    """Return middle and half width of a range [rad]."""
    return (lower + upper) / 2.0, (upper - lower) / 2.0
