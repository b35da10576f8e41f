"""The repair on synthetic bodies: gaps, swaps, jumps, ghosts and relocations have the promised outcome."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded import frame_of

from handover_ros.geometry import transform_from_xyz_rpy, transform_points
from handover_ros.mocap.frames import MarkerStatus
from handover_ros.mocap.repair import MarkerRepair
from handover_ros.mocap.repair_types import RepairSettings

RATE = 100.0
BODY = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.02], [0.0, 0.12, 0.0], [0.09, 0.1, 0.05], [0.05, 0.05, 0.1]])
SEGMENTS = ("torso",) * 5 + ("hand",)


def motion(frames: int, noise: float = 0.0003, seed: int = 0) -> np.ndarray:
    """Return a rigid torso that sways and turns and a lone hand marker that swings, (frames, 6, 3)."""
    rng = np.random.default_rng(seed)
    positions = np.empty((frames, 6, 3))
    for k in range(frames):
        t = k / RATE
        pose = transform_from_xyz_rpy([0.2 * np.sin(t), 0.1 * np.sin(2 * t), 1.2], [0.0, 0.1 * np.sin(3 * t), 0.5 * t])
        positions[k, :5] = transform_points(pose, BODY)
        positions[k, 5] = [0.5 + 0.3 * np.sin(4 * t), 0.4, 1.0]
    return positions + rng.normal(size=positions.shape) * noise


def repaired(
    positions: np.ndarray, settings: RepairSettings | None = None
) -> tuple[MarkerRepair, np.ndarray, np.ndarray]:
    """Return the repair, its positions and its states."""
    repair = MarkerRepair(SEGMENTS[: positions.shape[1]], settings)
    frames = [repair.process(frame_of(sample, k, RATE)) for k, sample in enumerate(positions)]
    return repair, np.array([f.positions for f in frames]), np.array([f.status for f in frames])


def test_clean_frames_pass_unchanged() -> None:
    positions = motion(100)
    repair, output, status = repaired(positions)
    np.testing.assert_array_equal(output, positions)
    assert not status.any()
    assert repair.counters.as_dict() == {**dict.fromkeys(repair.counters.as_dict(), 0), "frames": 100, "samples": 600}


def test_a_short_gap_is_bridged_by_the_segment_and_flagged() -> None:
    truth = motion(120)
    positions = truth.copy()
    positions[60:75, 1] = np.nan
    _, output, status = repaired(positions)
    assert (status[60:75, 1] == MarkerStatus.BRIDGED).all()
    assert np.linalg.norm(output - truth, axis=2).max() < 0.003


def test_a_lone_marker_is_bridged_by_its_velocity_for_a_moment_only() -> None:
    truth = motion(120)
    positions = truth.copy()
    positions[60:90, 5] = np.nan
    _, output, status = repaired(positions)
    assert (status[60:63, 5] == MarkerStatus.BRIDGED).all()
    assert np.linalg.norm(output[60:63, 5] - truth[60:63, 5], axis=1).max() < 0.01
    assert (status[75:90, 5] == MarkerStatus.MISSING).all()
    assert np.isnan(output[75:90, 5]).all()
    assert not status[90:].any()


@given(gap=st.integers(1, 60), limit=st.floats(0.0, 0.4), marker=st.integers(0, 4))
@settings(max_examples=40, deadline=None)
def test_no_gap_is_bridged_longer_than_allowed(gap: int, limit: float, marker: int) -> None:
    positions = motion(100)
    positions[30 : 30 + gap, marker] = np.nan
    _, output, status = repaired(positions, RepairSettings(max_gap=limit))
    bridged = status[30 : 30 + gap, marker] == MarkerStatus.BRIDGED
    assert bridged.sum() == min(gap, int(limit * RATE + 1e-3))
    assert np.isnan(output[30 : 30 + gap, marker, 0]).tolist() == (~bridged).tolist()


@given(
    first=st.integers(0, 5),
    second=st.integers(0, 5),
    start=st.integers(25, 60),
    length=st.integers(1, 30),
)
@settings(max_examples=60, deadline=None)
def test_a_swap_of_any_two_markers_is_undone(first: int, second: int, start: int, length: int) -> None:
    truth = motion(100)
    positions = truth.copy()
    positions[start : start + length, [first, second]] = truth[start : start + length, [second, first]]
    repair, output, status = repaired(positions)
    np.testing.assert_array_equal(output, truth)
    if first != second:
        assert repair.counters.swaps == 1
        assert (status[start : start + length, [first, second]] == MarkerStatus.RELABELLED).all()


def test_a_sample_under_a_hidden_marker_s_label_is_put_back() -> None:
    truth = motion(100)
    positions = truth.copy()
    positions[50:60, 0] = truth[50:60, 2]
    positions[50:60, 2] = np.nan
    _, output, status = repaired(positions)
    np.testing.assert_array_equal(output[50:60, 2], truth[50:60, 2])
    assert (status[50:60, 2] == MarkerStatus.RELABELLED).all()
    assert (status[50:60, 0] == MarkerStatus.BRIDGED).all()


def test_jumps_and_ghosts_are_dropped_and_counted_once() -> None:
    truth = motion(120)
    positions = truth.copy()
    positions[50:53, 1] += [0.3, 0.0, 0.2]
    positions[70:80, 3] = np.nan
    positions[80:90, 3] = [2.0, 2.0, 2.0]
    repair, output, status = repaired(positions)
    assert (status[50:53, 1] == MarkerStatus.DROPPED).all()
    assert (status[80:90, 3] == MarkerStatus.DROPPED).all()
    assert np.isnan(output[50:53, 1]).all()
    assert np.isnan(output[80:90, 3]).all()
    assert (repair.counters.jumps, repair.counters.ghosts, repair.counters.dropped) == (1, 1, 13)
    assert not status[90:].any()


@pytest.mark.parametrize("shift", [0.1, 0.4, 3.0])
@pytest.mark.parametrize("hidden", [0, 50])
def test_a_body_that_moved_unseen_is_found_again_within_a_few_frames(shift: float, hidden: int) -> None:
    positions = motion(200)
    positions[100:] += [shift, -shift, 0.0]
    positions[100 - hidden : 100] = np.nan
    _, output, status = repaired(positions)
    assert not status[106:].any()
    np.testing.assert_array_equal(output[106:], positions[106:])
    believed = np.isfinite(output[100:, :, 0]) & (status[100:] != MarkerStatus.BRIDGED)
    np.testing.assert_array_equal(output[100:][believed], positions[100:][believed])


def test_a_wrong_start_is_not_kept_for_ever() -> None:
    truth = motion(700)
    positions = truth.copy()
    positions[:20, [0, 3]] = truth[:20, [3, 0]]
    positions[40:60, [0, 3]] = np.nan
    _, output, status = repaired(positions)
    assert not status[-50:].any()
    np.testing.assert_array_equal(output[-50:], truth[-50:])


@given(data=st.data())
@settings(max_examples=40, deadline=None)
def test_whatever_comes_the_output_keeps_its_promises(data: st.DataObject) -> None:
    seed = data.draw(st.integers(0, 1000))
    rng = np.random.default_rng(seed)
    positions = motion(60, seed=seed)
    wild = rng.random(positions.shape[:2])
    positions[wild < 0.15] = np.nan
    positions[(wild > 0.15) & (wild < 0.25)] += rng.normal(size=3)
    positions[rng.random(positions.shape) < 0.01] = np.inf
    positions[rng.random(60) < 0.05] = np.nan
    repair, output, status = repaired(positions)
    gone = (status == MarkerStatus.MISSING) | (status == MarkerStatus.DROPPED)
    assert (np.isnan(output).all(axis=2) == gone).all()
    assert np.isfinite(output[~gone]).all()
    same = status == MarkerStatus.MEASURED
    np.testing.assert_array_equal(output[same], positions[same])
    assert repair.counters.dropped == (status == MarkerStatus.DROPPED).sum()
    assert repair.counters.bridged == (status == MarkerStatus.BRIDGED).sum()
