"""The person of the tracking benchmark: ten revolute axes, 24 markers, and motions of a human's speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handover_ros.skeleton.kernels import forward
from handover_ros.skeleton.tree import WORLD, Joint, JointKind, Skeleton

RATE = 100.0  # [Hz]
NOISE = 0.001  # [m] of each coordinate
SETTLING = 50  # frames before errors count
MARKERS_EACH = 6
# (name, parent, axis, point [m], lower, upper [rad]); pelvis fixed, trunk bends in three axes, right arm has seven.
JOINTS = (
    ("trunk_flexion", WORLD, (0.0, 1.0, 0.0), (0.0, 0.0, 0.0), -0.4, 1.2),
    ("trunk_bending", "trunk_flexion", (1.0, 0.0, 0.0), (0.0, 0.0, 0.0), -0.6, 0.6),
    ("trunk_rotation", "trunk_bending", (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), -0.8, 0.8),
    ("shoulder_elevation", "trunk_rotation", (0.0, -1.0, 0.0), (0.0, -0.18, 0.45), -0.9, 2.7),
    ("shoulder_abduction", "shoulder_elevation", (-1.0, 0.0, 0.0), (0.0, -0.18, 0.45), -0.5, 1.2),
    ("shoulder_rotation", "shoulder_abduction", (0.0, 0.0, 1.0), (0.0, -0.18, 0.45), -1.2, 1.4),
    ("elbow_flexion", "shoulder_rotation", (0.0, -0.98, 0.199), (0.0, -0.19, 0.15), -0.1, 2.4),
    ("forearm_rotation", "elbow_flexion", (0.06, 0.05, 0.9969), (0.0, -0.19, 0.15), -1.4, 1.4),
    ("wrist_flexion", "forearm_rotation", (0.0, -1.0, 0.0), (0.01, -0.20, -0.10), -1.1, 1.1),
    ("wrist_deviation", "wrist_flexion", (-1.0, 0.0, 0.0), (0.01, -0.20, -0.11), -0.5, 0.5),
)
# Middle of the markers of each marked segment [m] and their spread about it.
MARKED = {
    "trunk_rotation": ((0.0, 0.0, 0.30), (0.12, 0.12, 0.12)),
    "shoulder_rotation": ((0.0, -0.20, 0.30), (0.045, 0.045, 0.11)),
    "forearm_rotation": ((0.0, -0.20, 0.02), (0.04, 0.04, 0.10)),
    "wrist_deviation": ((0.01, -0.20, -0.17), (0.03, 0.045, 0.04)),
}


@dataclass(frozen=True, eq=False)
class TrackedMotion:
    """What the cameras saw, and the truth: displacements (frames, 10) [rad], markers (frames, 24, 3) [m]."""

    displacements: np.ndarray
    markers: np.ndarray


def person(seed: int = 0) -> Skeleton:
    """Return the skeleton; the seed moves its markers."""
    rng = np.random.default_rng(seed)
    joints = []
    for name, parent, axis, point, _, _ in JOINTS:
        direction = np.asarray(axis) / np.linalg.norm(axis)
        joints.append(
            Joint(name, JointKind.REVOLUTE, parent, name, (name,), direction[None], np.asarray(point, dtype=float))
        )
    segments = [segment for segment in MARKED for _ in range(MARKERS_EACH)]
    spots = [
        np.asarray(MARKED[segment][0]) + np.asarray(MARKED[segment][1]) * rng.uniform(-1.0, 1.0, 3)
        for segment in segments
    ]
    names = tuple(f"M{number:02d}" for number in range(len(segments)))
    lower, upper = (np.array([joint[column] for joint in JOINTS]) for column in (4, 5))
    return Skeleton("arm_on_trunk", tuple(joints), names, tuple(segments), np.array(spots), lower, upper)


def sines(skeleton: Skeleton, frames: int, seed: int) -> np.ndarray:
    """Return displacements (frames, 10): five sines a joint, 0.1 to 1.2 Hz, slower ones larger, 1 to 4 rad/s."""
    rng = np.random.default_rng([seed, 1])
    times = np.arange(frames)[:, None, None] / RATE
    joints = len(skeleton.lower)
    frequency = rng.uniform(0.1, 1.2, (joints, 5))
    phase = rng.uniform(0.0, 2.0 * np.pi, (joints, 5))
    weight = rng.uniform(0.5, 1.0, (joints, 5)) / (0.4 + frequency)
    curve = (weight * np.sin(2.0 * np.pi * frequency * times + phase)).sum(axis=2)
    curve /= np.abs(curve).max(axis=0)
    middle, half = 0.5 * (skeleton.upper + skeleton.lower), 0.5 * (skeleton.upper - skeleton.lower)
    return middle + half * rng.uniform(0.6, 0.95, joints) * curve


def reaches(skeleton: Skeleton, frames: int, seed: int) -> np.ndarray:
    """Return displacements (frames, 10): minimum-jerk movements of 0.4 to 1.2 s between random postures, with rests."""
    rng = np.random.default_rng([seed, 2])
    middle, half = 0.5 * (skeleton.upper + skeleton.lower), 0.5 * (skeleton.upper - skeleton.lower)
    here, motion = middle, np.empty((0, len(middle)))
    while len(motion) < frames:
        there = middle + half * rng.uniform(-0.9, 0.9, len(middle))
        fastest = rng.uniform(1.5, 4.0)  # [rad/s] peak of the joint that moves most
        duration = max(1.875 * np.abs(there - here).max() / fastest, 0.4)
        phase = np.linspace(0.0, 1.0, int(duration * RATE))[:, None]
        blend = phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2)
        rest = np.repeat(there[None], int(rng.uniform(0.0, 0.4) * RATE), axis=0)
        motion, here = np.vstack([motion, here + blend * (there - here), rest]), there
    return motion[:frames]


MOTIONS = {"sines": sines, "reaches": reaches}


def record(skeleton: Skeleton, kind: str, frames: int, seed: int, missing: float = 0.0) -> TrackedMotion:
    """Return a motion and its noisy markers; each is missing with a probability, NaN there."""
    displacements = MOTIONS[kind](skeleton, frames, seed)
    rng = np.random.default_rng([seed, 3])
    markers = forward(skeleton.tree, skeleton.coordinates(displacements))
    markers = markers + NOISE * rng.normal(size=markers.shape)
    markers[rng.random(markers.shape[:2]) < missing] = np.nan
    return TrackedMotion(displacements, markers)


def error_deg(estimate: np.ndarray, motion: TrackedMotion) -> float:
    """Return the root mean square error over all joints after settling [deg]; full turns do not count."""
    error = (estimate - motion.displacements)[SETTLING:]
    return float(np.degrees(np.sqrt(np.mean(np.angle(np.exp(1j * error)) ** 2))))
