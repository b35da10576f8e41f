"""Where a recording is put in the cell: as recorded, at a given place, or with its person at the cell's place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from handover_ros.geometry import FloatArray, transform_from_xyz_rpy, transform_points
from handover_ros.mocap.frames import Recording

PLACEMENTS = ("none", "explicit", "auto")


def planar_transform(x: float, y: float, yaw: float) -> FloatArray:
    """Return the 4x4 transform of a place on the floor: ``x``, ``y`` [m], ``yaw`` [rad] about the vertical."""
    return transform_from_xyz_rpy([x, y, 0.0], [0.0, 0.0, yaw])


def heading(rotation: FloatArray) -> float:
    """Return the yaw [rad] of the x axis of a rotation (3, 3) or transform (4, 4)."""
    return float(np.arctan2(rotation[1, 0], rotation[0, 0]))


def place_person(recording_from_torso: FloatArray, world_from_person: FloatArray) -> FloatArray:
    """Return ``world_from_recording`` (4, 4) that puts a recorded person at a place; heights above the floor stay.

    Args:
        recording_from_torso: Torso pose in the recording, (4, 4).
        world_from_person: Floor frame of the place, x forward, (4, 4).
    """
    yaw = heading(world_from_person) - heading(recording_from_torso)
    turn = planar_transform(0.0, 0.0, yaw)
    turn[:2, 3] = world_from_person[:2, 3] - (turn[:3, :3] @ recording_from_torso[:3, 3])[:2]
    return turn


def move_recording(recording: Recording, world_from_recording: FloatArray) -> Recording:
    """Return the recording with all positions moved by a 4x4 transform."""
    return replace(recording, positions=transform_points(world_from_recording, recording.positions))
