"""The motions a person makes for calibration: each arm joint through its range, three times (Bestick 2017, figure 2.4).

Names and prompts are shared by the simulated person and by whoever asks a real one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handover_ros.errors import UnknownNameError
from handover_ros.geometry import FloatArray
from handover_ros.sim.person_spec import ARM_JOINTS, ARM_SLICE, HANDS, PersonSpec

REPETITIONS = 3
RANGE_SHARE = 0.97
ENTRY_TIME = 1.2
MEAN_SPEED = 1.9
SHORTEST_REPETITION = 1.6
STILL_TIME = 2.0


@dataclass(frozen=True)
class CalibrationMotion:
    """A motion of both arms at once.

    Attributes:
        name: How services name it.
        prompt: What the person is told.
        joint: Arm joint that goes through its range; empty: none.
        posture: Displacements [rad] of other arm joints meanwhile.
    """

    name: str
    prompt: str
    joint: str
    posture: dict[str, float]


MOTIONS = (
    CalibrationMotion("still", "Stand still, arms hanging, palms to the body", "", {}),
    CalibrationMotion(
        "shoulder_flexion",
        "Raise both straight arms forward and up as far as you can, then back behind you",
        "shoulder_flexion",
        {"elbow_flexion": 0.1},
    ),
    CalibrationMotion(
        "shoulder_abduction",
        "Raise both straight arms sideways and up as far as you can, then cross them before you",
        "shoulder_abduction",
        {"elbow_flexion": 0.1, "shoulder_flexion": 0.35},
    ),
    CalibrationMotion(
        "shoulder_rotation",
        "Elbows bent and a little off the body: turn the forearms outward and inward",
        "shoulder_rotation",
        {"elbow_flexion": 1.5, "shoulder_abduction": 0.6, "shoulder_flexion": 0.3},
    ),
    CalibrationMotion(
        "elbow_flexion", "Bend and stretch both elbows fully", "elbow_flexion", {"shoulder_flexion": 0.3}
    ),
    CalibrationMotion(
        "forearm_pronation",
        "Elbows bent: turn the palms up and down",
        "forearm_pronation",
        {"elbow_flexion": 1.5, "shoulder_flexion": 0.2},
    ),
    CalibrationMotion(
        "wrist_flexion",
        "Elbows bent: bend the hands inward and outward",
        "wrist_flexion",
        {"elbow_flexion": 1.5, "shoulder_flexion": 0.2},
    ),
    CalibrationMotion(
        "wrist_deviation",
        "Elbows bent: tilt the hands towards the thumb and the little finger",
        "wrist_deviation",
        {"elbow_flexion": 1.5, "shoulder_flexion": 0.2},
    ),
)
MOTION_NAMES = tuple(motion.name for motion in MOTIONS)


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
    if name and name not in MOTION_NAMES:
        raise UnknownNameError("calibration motion", name, MOTION_NAMES)
    return tuple(_plan(person, motion) for motion in MOTIONS if name in ("", motion.name))


def calibration_duration(person: PersonSpec, name: str = "") -> float:
    """Return how long one motion, or all of them, take [s]."""
    return sum(plan.duration for plan in calibration_plan(person, name))


def _plan(person: PersonSpec, motion: CalibrationMotion) -> MotionPlan:
    """Return the way points of a motion for a person's range."""
    standing = person.standing
    if not motion.joint:
        return MotionPlan(motion.name, motion.prompt, np.array([0.0, STILL_TIME]), np.stack([standing, standing]))
    start = standing.copy()
    index = ARM_JOINTS.index(motion.joint)
    for hand in HANDS:
        for joint, angle in motion.posture.items():
            start[ARM_SLICE[hand].start + ARM_JOINTS.index(joint)] = angle
    start = np.clip(start, person.lower, person.upper)
    low, high = start.copy(), start.copy()
    swing = 0.0
    for hand in HANDS:
        column = ARM_SLICE[hand].start + index
        middle, half = _range(person.lower[column], person.upper[column])
        low[column], high[column] = middle - RANGE_SHARE * half, middle + RANGE_SHARE * half
        swing = max(swing, 2.0 * RANGE_SHARE * half)
    stroke = max(swing / MEAN_SPEED, SHORTEST_REPETITION / 2.0)
    postures = [standing, start, *[high, low] * REPETITIONS, start, standing]
    steps = [ENTRY_TIME, *[stroke] * (2 * REPETITIONS), 0.7 * stroke, ENTRY_TIME]
    return MotionPlan(motion.name, motion.prompt, np.concatenate([[0.0], np.cumsum(steps)]), np.stack(postures))


def _range(lower: float, upper: float) -> tuple[float, float]:
    """Return middle and half width of a range [rad]."""
    return (lower + upper) / 2.0, (upper - lower) / 2.0
