"""Tracking: true to a known motion, honest about its uncertainty, and not to be thrown off."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from people import Motion, calibration_motion, random_person

from handover_ros.errors import BadModelError, BadRequestError
from handover_ros.mocap.frames import MarkerFrame, Recording
from handover_ros.skeleton.smoothing import smooth
from handover_ros.skeleton.torso import TrackingState
from handover_ros.skeleton.tracking import SkeletonEstimate, SkeletonTracker, TrackingSettings

RATE = 100.0
KNOWN_NOISE = TrackingSettings(marker_noise=0.001)
OUTER = [0, 2, 7, 9]  # flexion and rotation of the shoulders: hardly defined where the arm points sideways


def motion_of(seed: int, frames: int = 2400, missing: float = 0.0) -> Motion:
    return calibration_motion(random_person(seed), frames, RATE, 0.001, missing, seed)


def follow(
    motion: Motion, measured: np.ndarray | None = None, settings: TrackingSettings = KNOWN_NOISE
) -> tuple[SkeletonTracker, list[SkeletonEstimate]]:
    tracker = SkeletonTracker(motion.skeleton, motion.skeleton.marker_names, settings)
    status = np.zeros(len(motion.skeleton.marker_names), dtype=np.uint8)
    frames = motion.measured if measured is None else measured
    return tracker, [
        tracker.update(MarkerFrame(index / RATE, index, index / RATE, positions, status))
        for index, positions in enumerate(frames)
    ]


def errors_deg(motion: Motion, estimates: list[SkeletonEstimate]) -> np.ndarray:
    """Return errors (frames, n) [deg] without the outer shoulder angles."""
    error = np.degrees(np.array([each.displacements for each in estimates]) - motion.displacements)
    return np.delete(error, OUTER, axis=1)


@pytest.mark.parametrize(("seed", "missing"), [(0, 0.0), (1, 0.1), (2, 0.3)])
def test_follows_a_known_motion(seed: int, missing: float) -> None:
    motion = motion_of(seed, missing=missing)
    tracker, estimates = follow(motion)
    assert all(each.valid for each in estimates)
    assert np.sqrt(np.mean(errors_deg(motion, estimates)[50:] ** 2)) < 2.0
    assert tracker.reacquired == 1
    torso = np.array([each.world_from_torso for each in estimates])
    truth = motion.skeleton.world_from_root(motion.coordinates)
    assert np.linalg.norm(torso[50:, :3, 3] - truth[50:, :3, 3], axis=1).max() < 0.005


def test_is_as_uncertain_as_it_says() -> None:
    """Innovations and errors lie within what the covariance says, on average over a motion."""
    motion = motion_of(4)
    _, estimates = follow(motion)
    assert 0.7 < np.nanmean([each.consistency for each in estimates[50:]]) < 1.2
    deviations = np.degrees(np.sqrt([np.diag(each.covariance) for each in estimates]))
    within = np.abs(errors_deg(motion, estimates)) < 2.0 * np.delete(deviations, OUTER, axis=1)
    assert 0.85 < within[50:].mean() <= 1.0


def test_occlusion_dropout_and_swaps_never_throw_it_off() -> None:
    """30 % random occlusion, 2 s without any marker, five swapped labels: right again after each."""
    for seed in range(3):
        motion = motion_of(10 + seed, missing=0.3)
        measured = motion.measured.copy()
        measured[700:900] = np.nan
        rng = np.random.default_rng(seed)
        for first in rng.integers(100, 2300, 5):
            pair = rng.choice(np.arange(8, 24), 2, replace=False)
            measured[first : first + 20, pair] = measured[first : first + 20, pair[::-1]]
        tracker, estimates = follow(motion, measured)
        valid = np.array([each.valid for each in estimates])
        assert not valid[760:900].any()
        assert valid[900:905].any()
        assert valid[905:].all()
        error = np.abs(errors_deg(motion, estimates))
        assert np.concatenate([error[50:700], error[910:]]).max() < 20.0
        assert tracker.relabelled > 20


def test_outliers_are_not_believed() -> None:
    motion = motion_of(20)
    measured = motion.measured.copy()
    measured[100:200, 11] += [0.1, 0.1, 0.0]
    tracker, estimates = follow(motion, measured)
    assert tracker.gated >= 90
    assert np.abs(errors_deg(motion, estimates)[50:]).max() < 12.0


def test_limits_hold_inside_the_estimate() -> None:
    """A skeleton whose elbows stop earlier than the person's: the estimate stays there, and says how sure it is."""
    motion = motion_of(21)
    column = motion.skeleton.displacement_names.index("right_elbow_flexion")
    upper = motion.skeleton.upper.copy()
    upper[column] = 0.8
    limited = Motion(
        motion.skeleton.with_limits(motion.skeleton.lower, upper),
        motion.displacements,
        motion.coordinates,
        motion.measured,
        RATE,
    )
    assert motion.displacements[:, column].max() > 1.2
    settings = TrackingSettings(marker_noise=0.02, limit_margin=0.02, gate=np.inf)
    _, held = follow(limited, settings=settings)
    _, free = follow(limited, settings=TrackingSettings(marker_noise=0.02, gate=np.inf, limits=False))
    assert max(each.displacements[column] for each in held[50:]) < 0.85
    assert max(each.displacements[column] for each in free[50:]) > 1.0
    assert all(np.linalg.eigvalsh(each.covariance).min() > -1e-12 for each in held[50:])


def test_markers_it_cannot_do_without() -> None:
    """Frames without a hand's markers are refused with the names; other missing markers are no matter."""
    skeleton = random_person(0)
    names = tuple(name for name in skeleton.marker_names if name not in ("RARM7", "RARM8"))
    with pytest.raises(BadModelError, match=r"RARM7, RARM8.*right_hand"):
        SkeletonTracker(skeleton, names)
    with pytest.raises(BadModelError, match="torso"):
        SkeletonTracker(skeleton, tuple(name for name in skeleton.marker_names if "ARM" in name))
    motion = motion_of(0)
    some = tuple(name for name in skeleton.marker_names if name not in ("RARM2", "CHEST1"))
    tracker = SkeletonTracker(skeleton, some, KNOWN_NOISE)
    columns = [skeleton.marker_names.index(name) for name in some]
    status = np.zeros(len(some), dtype=np.uint8)
    for index, positions in enumerate(motion.measured[:, columns]):
        assert tracker.update(MarkerFrame(index / RATE, index, index / RATE, positions, status)).valid


def test_nothing_seen_is_not_valid_and_not_an_error() -> None:
    skeleton = random_person(0)
    tracker = SkeletonTracker(skeleton, skeleton.marker_names)
    nothing = np.full((len(skeleton.marker_names), 3), np.nan)
    estimate = tracker.update(MarkerFrame(0.0, 0, 0.0, nothing, np.zeros(len(nothing), dtype=np.uint8)))
    assert not estimate.valid
    assert tracker.state is TrackingState.LOST
    assert np.isnan(estimate.displacements).all()


@pytest.mark.parametrize("change", [{"marker_noise": 0.0}, {"gate": -1.0}, {"order": 4}, {"coasting": float("nan")}])
def test_settings_out_of_range_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(BadRequestError, match=next(iter(change))):
        TrackingSettings(**change)


def test_same_frames_same_states() -> None:
    motion = motion_of(5, missing=0.1)
    first, second = (follow(motion)[1] for _ in range(2))
    for one, other in zip(first, second):
        np.testing.assert_array_equal(one.displacements, other.displacements)


def test_smoothing_halves_the_errors_and_knows_its_own() -> None:
    motion = motion_of(6, missing=0.1)
    _, estimates = follow(motion)
    recording = Recording(
        motion.skeleton.marker_names, motion.skeleton.marker_segments, RATE, motion.measured, Path("synthetic")
    )
    smoothed = smooth(motion.skeleton, recording, KNOWN_NOISE)
    error = np.degrees(np.delete(smoothed.displacements - motion.displacements, OUTER, axis=1))
    filtered = errors_deg(motion, estimates)
    assert np.sqrt(np.mean(error[50:-50] ** 2)) < 0.75 * np.sqrt(np.mean(filtered[50:-50] ** 2))
    within = np.abs(error) < 2.0 * np.degrees(np.delete(smoothed.deviations, OUTER, axis=1))
    assert 0.85 < within[50:-50].mean() <= 1.0
    seen = np.isfinite(motion.measured[:, :, 0])
    assert np.isfinite(smoothed.residuals[seen]).all()
    assert np.sqrt(np.mean(smoothed.residuals[seen] ** 2)) < 0.0025
