"""A posture in words, for the person who reads a plan."""

from __future__ import annotations

import numpy as np

from handover_ros.geometry import FloatArray

# Joint of an arm -> words for it, for a positive and for a negative angle.
WORDS = {
    "elbow_flexion": ("elbow", "", " backwards"),
    "shoulder_flexion": ("shoulder", " forward", " backward"),
    "shoulder_abduction": ("shoulder", " to the side", " across the body"),
}
LEAST_ANGLE = 5.0  # [deg]: a shoulder that turns less is not worth a word


def posture_words(names: tuple[str, ...], displacements: FloatArray, sides: tuple[str, ...]) -> str:
    """Return the posture of arms, e.g. ``right arm: elbow 75 deg, shoulder 20 deg forward``.

    Args:
        names: Of the displacements; those of an arm begin with its side.
        displacements: [rad], shape (n,).
        sides: Arms to speak of.
    """
    values = dict(zip(names, np.rad2deg(displacements).tolist(), strict=True))
    sentences = []
    for side in sides:
        parts = []
        for joint, (part, plus, minus) in WORDS.items():
            angle = values.get(f"{side}_{joint}")
            if angle is None or (part == "shoulder" and abs(angle) < LEAST_ANGLE):
                continue
            parts.append(f"{part} {abs(angle):.0f} deg{plus if angle >= 0.0 else minus}")
        sentences.append(f"{side} arm: {', '.join(parts) or 'hanging'}")
    return "; ".join(sentences)
