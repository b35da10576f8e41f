"""The motions a person makes for calibration: each arm joint through its range, three times (Bestick 2017, figure 2.4).

Whoever asks a person, and the simulated person who is asked, use the same names in the same order.
"""

from __future__ import annotations

from dataclasses import dataclass

from handover_ros.errors import UnknownNameError

REPETITIONS = 3
STILL = "still"
FINISHED = "That was all, thank you: stop the recording"


@dataclass(frozen=True)
class CalibrationPrompt:
    """A motion of both arms at once: how services name it, and what the person is told."""

    name: str
    text: str


PROMPTS = (
    CalibrationPrompt(STILL, "Stand still, arms hanging, palms to the body"),
    CalibrationPrompt(
        "shoulder_flexion", "Raise both straight arms forward and up as far as you can, then back behind you"
    ),
    CalibrationPrompt(
        "shoulder_abduction", "Raise both straight arms sideways and up as far as you can, then cross them before you"
    ),
    CalibrationPrompt(
        "shoulder_rotation", "Elbows bent and a little off the body: turn the forearms outward and inward"
    ),
    # With the palm turned differently each time: else the forearm may as well turn first and bend then.
    CalibrationPrompt("elbow_flexion", "Bend and stretch both elbows fully: palms up, then inward, then down"),
    CalibrationPrompt("forearm_pronation", "Elbows bent: turn the palms up and down"),
    # Each at three places of the other, and circles, not in figure 2.4: the angle between the two axes of the wrist
    # shows only where both are turned far.
    CalibrationPrompt(
        "wrist_flexion",
        "Elbows bent: bend the hands inward and outward: tilted to the thumb, then straight, then to the little finger",
    ),
    CalibrationPrompt(
        "wrist_deviation",
        "Elbows bent: tilt the hands to thumb and little finger: bent outward, then straight, then bent inward",
    ),
    CalibrationPrompt("wrist_circle", "Elbows bent: draw wide circles with both hands"),
)
MOTION_NAMES = tuple(prompt.name for prompt in PROMPTS)


def prompt_of(name: str) -> CalibrationPrompt:
    """Return the prompt of a motion.

    Raises:
        UnknownNameError: There is no such motion.
    """
    for prompt in PROMPTS:
        if prompt.name == name:
            return prompt
    raise UnknownNameError("calibration motion", name, MOTION_NAMES)


def prompt_at(seconds: float, motion_time: float) -> CalibrationPrompt | None:
    """Return the prompt due after ``seconds`` when each motion gets ``motion_time`` [s]; None when all are over."""
    index = int(max(seconds, 0.0) // motion_time)
    return PROMPTS[index] if index < len(PROMPTS) else None
