"""The repair on real recordings with disturbances injected: how much is found, how much is harmed."""

from __future__ import annotations

import numpy as np
import pytest
from recorded import C3D, CSV_TRIALS, frame_of, real_recording

from handover_ros.mocap.frames import MarkerStatus, Recording
from handover_ros.mocap.repair import MarkerRepair

pytestmark = pytest.mark.recordings
FILES = (C3D, *CSV_TRIALS)


def repaired(recording: Recording, positions: np.ndarray, rate: float) -> tuple[np.ndarray, np.ndarray]:
    repair = MarkerRepair(recording.segments)
    frames = [repair.process(frame_of(sample, k, rate)) for k, sample in enumerate(positions)]
    return np.array([f.positions for f in frames]), np.array([f.status for f in frames])


@pytest.mark.parametrize("every", [1, 2])
@pytest.mark.parametrize("name", FILES)
def test_undisturbed_recordings_raise_no_alarm(name: str, every: int) -> None:
    """At 100 Hz and at 50 Hz: nothing measured is dropped or relabelled."""
    recording = real_recording(name)
    output, status = repaired(recording, recording.positions[::every], recording.rate / every)
    assert not ((status == MarkerStatus.DROPPED) | (status == MarkerStatus.RELABELLED)).any()
    measured = np.isfinite(recording.positions[::every, :, 0])
    np.testing.assert_array_equal(output[measured], recording.positions[::every][measured])


@pytest.mark.parametrize("every", [1, 2])
def test_injected_swaps_are_undone(every: int) -> None:
    """Measured: 1260 of 1260 swapped samples put back, no alarm in 129,000 others; the bounds leave room."""
    rng = np.random.default_rng(1)
    swapped = undone = alarms = clean = 0
    for name in FILES:
        recording = real_recording(name)
        truth, rate = recording.positions[::every], recording.rate / every
        positions, touched = truth.copy(), np.zeros(truth.shape[:2], dtype=bool)
        segments = np.array(recording.segments)
        seen = np.flatnonzero(np.isfinite(truth[:, :, 0]).any(axis=0))
        start = 40
        while start < len(truth) - 40:
            length = int(rng.integers(1, 20))
            pool = seen
            if rng.random() < 0.6:
                pool = seen[segments[seen] == rng.choice(segments[seen])]
            if len(pool) >= 2:
                rows = slice(start, start + length)
                first, second = rng.choice(pool, 2, replace=False)
                positions[rows, first], positions[rows, second] = truth[rows, second], truth[rows, first]
                touched[rows, [[first], [second]]] = True
            start += length + int(rng.integers(20, 60))
        output, status = repaired(recording, positions, rate)
        measured = np.isfinite(truth[:, :, 0])
        right = np.abs(output - truth).max(axis=2) < 1e-9
        swapped += (touched & measured).sum()
        undone += (touched & measured & right).sum()
        flagged = (status == MarkerStatus.RELABELLED) | (status == MarkerStatus.DROPPED)
        clean += (measured & ~touched).sum()
        alarms += (measured & ~touched & flagged).sum()
    assert swapped > 200
    assert undone >= 0.98 * swapped
    assert alarms <= 1e-4 * clean


@pytest.mark.parametrize("name", FILES)
def test_injected_gaps_are_bridged_within_millimetres(name: str) -> None:
    """Gaps of up to 0.19 s; measured medians 0.1 to 0.4 mm, 95th percentiles 0.7 to 3.4 mm."""
    rng = np.random.default_rng(2)
    recording = real_recording(name)
    truth = recording.positions
    positions = truth.copy()
    for marker in np.flatnonzero(np.isfinite(truth[:, :, 0]).any(axis=0)):
        for start in range(20 + int(rng.integers(0, 40)), len(truth) - 30, 60):
            if rng.random() < 0.3:
                positions[start : start + int(rng.integers(1, 20)), marker] = np.nan
    output, status = repaired(recording, positions, recording.rate)
    hidden = np.isnan(positions[:, :, 0]) & np.isfinite(truth[:, :, 0])
    bridged = hidden & (status == MarkerStatus.BRIDGED)
    error = np.linalg.norm(output - truth, axis=2)[bridged]
    assert bridged.sum() > 0.9 * hidden.sum()
    assert np.median(error) < 0.0015
    assert np.percentile(error, 95) < 0.012
    assert not (status > MarkerStatus.BRIDGED).any()


@pytest.mark.parametrize("name", FILES)
def test_injected_jumps_are_dropped(name: str) -> None:
    """One marker thrown 0.1 to 1 m off every seventh frame."""
    rng = np.random.default_rng(3)
    recording = real_recording(name)
    positions = recording.positions.copy()
    thrown = np.zeros(positions.shape[:2], dtype=bool)
    seen = np.flatnonzero(np.isfinite(positions[:, :, 0]).any(axis=0))
    for index in range(30, len(positions) - 5, 7):
        direction = rng.normal(size=3)
        marker = rng.choice(seen)
        positions[index, marker] += direction / np.linalg.norm(direction) * rng.uniform(0.1, 1.0)
        thrown[index, marker] = np.isfinite(positions[index, marker, 0])
    _, status = repaired(recording, positions, recording.rate)
    dropped = status == MarkerStatus.DROPPED
    assert (dropped & thrown).sum() >= 0.97 * thrown.sum()
    assert (status[~thrown] > MarkerStatus.BRIDGED).sum() <= 0.02 * thrown.sum()
