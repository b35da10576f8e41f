"""Placing a recorded person: at the place, facing as told, at the recorded height."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from handover_ros.geometry import transform_from_xyz_rpy
from handover_ros.mocap.frames import Recording
from handover_ros.mocap.placement import heading, move_recording, place_person, planar_transform

ANGLE = st.floats(-3.1, 3.1)
TILT = st.floats(-0.5, 0.5)
LENGTH = st.floats(-3.0, 3.0)


@given(x=LENGTH, y=LENGTH, yaw=ANGLE, roll=TILT, pitch=TILT, place_x=LENGTH, place_y=LENGTH, place_yaw=ANGLE)
def test_the_torso_comes_to_the_place_and_keeps_height_and_tilt(
    x: float, y: float, yaw: float, roll: float, pitch: float, place_x: float, place_y: float, place_yaw: float
) -> None:
    torso = transform_from_xyz_rpy([x, y, 1.3], [roll, pitch, yaw])
    place = planar_transform(place_x, place_y, place_yaw)
    moved = place_person(torso, place) @ torso
    np.testing.assert_allclose(moved[:3, 3], [place_x, place_y, 1.3], atol=1e-9)
    assert abs(np.angle(np.exp(1j * (heading(moved) - place_yaw)))) < 1e-9
    np.testing.assert_allclose(moved[2, :3], torso[2, :3], atol=1e-9)


def test_moving_a_recording_keeps_its_gaps() -> None:
    positions = np.zeros((2, 1, 3))
    positions[1] = np.nan
    recording = Recording(("A",), ("torso",), 100.0, positions, Path("test"))
    moved = move_recording(recording, planar_transform(1.0, 2.0, 0.3))
    np.testing.assert_allclose(moved.positions[0, 0], [1.0, 2.0, 0.0])
    assert np.isnan(moved.positions[1]).all()
