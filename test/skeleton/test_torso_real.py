"""The torso in real recordings: seen nearly always, residuals of skin and clothing, upright, still seated."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from handover_ros.mocap.marker_sets import load_marker_set
from handover_ros.mocap.recordings import load_recording
from handover_ros.skeleton.torso import track_recording

pytestmark = pytest.mark.recordings
FOLDER = Path(os.environ.get("HANDOVER_RECORDINGS", Path(__file__).resolve().parents[2] / ".." / "shared" / "data"))


@pytest.mark.parametrize(
    ("name", "marker_set", "residual"),
    [
        ("pyomeca/markers_analogs.c3d", "pyomeca_daphnee", 0.009),
        ("UE_ADLdatabase/ADL006/ADL006_static.csv", "ue_adl", 0.001),
        ("UE_ADLdatabase/ADL006/ADL006DR1.csv", "ue_adl", 0.010),
        ("UE_ADLdatabase/ADL009/ADL009FL1.csv", "ue_adl", 0.013),
    ],
)
def test_the_torso_follows_the_markers(name: str, marker_set: str, residual: float) -> None:
    if not (FOLDER / name).is_file():
        pytest.skip(f"no real recording {FOLDER / name}")
    definition = load_marker_set(marker_set)
    recording = load_recording(FOLDER / name, definition)
    estimates = track_recording(definition.torso, recording, recording.frames)
    valid = [estimate for estimate in estimates if estimate.valid]
    assert len(valid) == recording.frames
    assert np.sqrt(np.mean([estimate.residual_rms**2 for estimate in valid])) < residual
    poses = np.array([estimate.world_from_torso for estimate in valid])
    assert poses[:, 2, 2].min() > np.cos(np.radians(30.0))  # upright
    assert np.linalg.norm(np.ptp(poses[:, :3, 3], axis=0)) < 0.2
    assert 0.9 < poses[:, 2, 3].mean() < 1.5  # shoulders of someone seated or standing
    sigma = np.sqrt([np.diag(estimate.covariance) for estimate in valid])
    assert np.isfinite(sigma).all()
    assert 1e-4 < np.median(sigma[:, :3]) < 0.02
