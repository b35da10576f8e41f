"""Recordings with mistakes as they happen in a laboratory, made from a synthetic person's calibration motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from people import NAMES, Motion, calibration_motion, random_person

from handover_ros.mocap.frames import Recording
from handover_ros.skeleton.kernels import forward
from handover_ros.skeleton.tree import Skeleton

FRAMES = 700


def recording_of(motion, measured=None) -> Recording:
    """Return what a motion is as a recording."""
    skeleton = motion.skeleton
    positions = motion.measured if measured is None else measured
    return Recording(skeleton.marker_names, skeleton.marker_segments, motion.rate, positions, Path("person.c3d"))


def good(seed: int = 0, frames: int = FRAMES) -> Motion:
    """Return the motion of a person without mistakes."""
    return calibration_motion(random_person(seed), frames=frames, seed=seed)


def remade(motion: Motion, skeleton: Skeleton, displacements: np.ndarray) -> Motion:
    """Return a motion with other displacements of the same root poses, with the same markers hidden."""
    coordinates = skeleton.coordinates(displacements, motion.skeleton.world_from_root(motion.coordinates))
    noise = 0.001 * np.random.default_rng(3).normal(size=motion.measured.shape)
    measured = forward(skeleton.tree, coordinates) + noise
    measured[np.isnan(motion.measured)] = np.nan
    return Motion(skeleton, displacements, coordinates, measured, motion.rate)


def motionless(motion: Motion, *names: str) -> Motion:
    """Return a motion in which some displacements stay where they were when standing."""
    displacements = motion.displacements.copy()
    for name in names:
        index = motion.skeleton.displacement_names.index(name)
        displacements[:, index] = displacements[0, index]
    return remade(motion, motion.skeleton, displacements)


def column(name: str) -> int:
    """Return the column of a marker."""
    return NAMES.index(name)


def exchanged(measured: np.ndarray, pairs, where=slice(None)) -> np.ndarray:
    """Return markers with pairs of labels exchanged in some frames."""
    result = measured.copy()
    for first, second in pairs:
        a, b = column(first), column(second)
        result[where, a], result[where, b] = measured[where, b], measured[where, a]
    return result


ARMS = [(f"RARM{i}", f"LARM{i}") for i in range(1, 9)]
TORSO = [(f"{side}{i}", f"{side}{i + 1}") for side in ("CHEST", "BACK") for i in (1, 3)]


def part(share: float, frames: int = FRAMES) -> slice:
    """Return the frames of a share of the time, from a third of it on."""
    return slice(frames // 3, frames // 3 + int(share * frames))


def scaled(measured: np.ndarray, factor: float, frames=slice(None), markers=slice(None)) -> np.ndarray:
    """Return markers of which some are in another unit."""
    result = measured.copy()
    result[frames, markers] *= factor
    return result


def hidden(measured: np.ndarray, *names: str) -> np.ndarray:
    """Return markers of which some are never seen."""
    result = measured.copy()
    result[:, [column(name) for name in names]] = np.nan
    return result


def on_segment_of(motion, name: str, other: str) -> np.ndarray:
    """Return the markers with one of them really attached to the segment of another marker, near it."""
    skeleton = motion.skeleton
    markers = skeleton.markers.copy()
    markers[column(name)] = skeleton.markers[column(other)] + [0.03, 0.02, 0.02]
    segments = list(skeleton.marker_segments)
    segments[column(name)] = skeleton.marker_segments[column(other)]
    tree = skeleton.tree._replace(marker=markers)
    joint = skeleton.tree.marker_joint.copy()
    joint[column(name)] = joint[column(other)]
    result = motion.measured.copy()
    noise = np.random.default_rng(0).normal(size=(len(result), 3))
    result[:, column(name)] = (
        forward(tree._replace(marker_joint=joint), motion.coordinates)[:, column(name)] + 0.001 * noise
    )
    return result


def stuck(measured: np.ndarray, name: str) -> np.ndarray:
    """Return markers of which one stays where it was, as a system that holds the last value makes it."""
    result = measured.copy()
    result[:, column(name)] = measured[np.isfinite(measured[:, column(name), 0])][0, column(name)]
    return result


def loose(measured: np.ndarray, name: str, at: float = 0.5) -> np.ndarray:
    """Return markers of which one slips by 8 cm halfway, as seen in the world."""
    result = measured.copy()
    result[int(at * len(measured)) :, column(name)] += [0.05, 0.05, 0.04]
    return result
