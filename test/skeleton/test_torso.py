"""The torso tracker: learns, follows, says when it cannot, learns late markers, knows its speed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from handover_ros.geometry import (
    invert_transform,
    rotation_angle,
    transform_from_xyz_rpy,
    transform_points,
)
from handover_ros.mocap.frames import MarkerFrame, MarkerStatus
from handover_ros.mocap.marker_sets import load_marker_set
from handover_ros.mocap.pipeline import MarkerPipeline
from handover_ros.mocap.sources import MarkerSample
from handover_ros.objects.scene import load_scene
from handover_ros.sim.simulation import Simulation
from handover_ros.skeleton.torso import TorsoTracker, TrackingState, small_rotation_vector

SET = load_marker_set("upper_body_24")
BODY = np.random.default_rng(7).uniform(-0.15, 0.15, (24, 3))
BODY[:4, 0] += 0.3
BODY[[0, 1, 4, 5], 2] += 0.3
BODY[[0, 2, 4, 6], 1] += 0.3
RATE = 240.0


def pose_at(t: float) -> np.ndarray:
    return transform_from_xyz_rpy([1.4 + 0.2 * np.sin(t), 0.1 * t, 1.3], [0.1 * np.sin(t), 0.05, np.pi + 0.5 * t])


def frame_at(index: int, noise: float = 0.0, hidden: tuple[int, ...] = (), seed: int = 0) -> MarkerFrame:
    rng = np.random.default_rng([seed, index])
    positions = transform_points(pose_at(index / RATE), BODY) + rng.normal(size=(24, 3)) * noise
    status = np.zeros(24, dtype=np.uint8)
    positions[list(hidden)] = np.nan
    status[list(hidden)] = MarkerStatus.MISSING
    return MarkerFrame(index / RATE, index, index / RATE, positions, status)


def motion_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return invert_transform(first) @ second


@given(seed=st.integers(0, 1000), missing=st.floats(0.0, 0.4))
@settings(max_examples=20, deadline=None)
def test_the_torso_moves_as_the_body_does_under_missing_markers(seed: int, missing: float) -> None:
    tracker = TorsoTracker(SET.torso, SET.names)
    rng = np.random.default_rng(seed)
    reference = None
    for index in range(200):
        hidden = tuple(np.flatnonzero(rng.random(24) < missing)) if index >= 30 else ()
        estimate = tracker.update(frame_at(index, hidden=hidden))
        if index == 30 and not estimate.valid:
            return
        if not estimate.valid:
            assert np.isnan(estimate.world_from_torso[:3]).all()
            continue
        body_from_torso = motion_between(pose_at(index / RATE), estimate.world_from_torso)
        reference = body_from_torso if reference is None else reference
        np.testing.assert_allclose(body_from_torso, reference, atol=1e-7)
    assert tracker.valid_frames > 0


def test_states_follow_what_is_seen() -> None:
    tracker = TorsoTracker(SET.torso, SET.names, template_frames=10)
    assert tracker.state is TrackingState.LEARNING
    for index in range(9):
        assert not tracker.update(frame_at(index)).valid
    assert tracker.update(frame_at(9)).valid
    assert tracker.state is TrackingState.TRACKING
    lost = tracker.update(frame_at(10, hidden=tuple(range(8))))
    assert not lost.valid
    assert lost.markers_used == 0
    assert np.isnan(lost.covariance).all()
    assert tracker.state is TrackingState.LOST
    again = tracker.update(frame_at(11, hidden=(0, 5)))
    assert again.valid
    assert again.markers_used == 6
    assert 0.7 < again.confidence < 0.8


def test_markers_hidden_at_the_start_join_later() -> None:
    tracker = TorsoTracker(SET.torso, SET.names, template_frames=10)
    for index in range(10):
        tracker.update(frame_at(index, hidden=(3, 7)))
    assert tracker.update(frame_at(10)).markers_used == 6
    for index in range(11, 60):
        estimate = tracker.update(frame_at(index))
    assert estimate.markers_used == 8
    assert estimate.residual_rms < 1e-9


def test_velocity_is_that_of_the_torso_and_unknown_after_a_silence() -> None:
    tracker = TorsoTracker(SET.torso, SET.names, template_frames=10)
    for index in range(480):
        estimate = tracker.update(frame_at(index, noise=0.0005))
    step = 1e-4
    now, later = estimate.world_from_torso, motion_between(pose_at(479 / RATE), pose_at(479 / RATE + step))
    ahead = pose_at(479 / RATE) @ later @ invert_transform(pose_at(479 / RATE)) @ now
    expected_linear = (ahead[:3, 3] - now[:3, 3]) / step
    expected_angular = Rotation.from_matrix(ahead[:3, :3] @ now[:3, :3].T).as_rotvec() / step
    np.testing.assert_allclose(estimate.velocity[:3], expected_linear, atol=0.04)
    np.testing.assert_allclose(estimate.velocity[3:], expected_angular, atol=0.1)
    silent = tracker.update(frame_at(479 + 240))
    assert silent.valid
    assert np.isnan(silent.velocity).all()


def test_bridged_markers_count_little() -> None:
    tracker = TorsoTracker(SET.torso, SET.names, template_frames=10)
    for index in range(20):
        tracker.update(frame_at(index))
    frame = frame_at(20)
    frame.positions[0] += 0.004
    measured = tracker.update(frame)
    frame.status[0] = MarkerStatus.BRIDGED
    bridged = tracker.update(MarkerFrame(0.2, 21, 0.2, frame.positions, frame.status))
    truth = tracker.update(frame_at(20)).world_from_torso[:3, 3]
    off = [float(np.linalg.norm(e.world_from_torso[:3, 3] - truth)) for e in (measured, bridged)]
    assert off[1] < 0.3 * off[0]


@given(seed=st.integers(0, 200))
@settings(max_examples=20, deadline=None)
def test_frames_full_of_nonsense_never_raise(seed: int) -> None:
    tracker = TorsoTracker(SET.torso, SET.names, template_frames=5)
    rng = np.random.default_rng(seed)
    for index in range(40):
        frame = frame_at(index, seed=seed)
        frame.positions[rng.random(24) < 0.4] = np.nan
        frame.positions[rng.random((24, 3)) < 0.05] = np.inf
        frame.positions[rng.random(24) < 0.1] += 1e3 * rng.normal()
        estimate = tracker.update(frame)
        assert estimate.valid == bool(np.isfinite(estimate.world_from_torso).all())


@given(st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3))
def test_small_rotation_vectors_agree_with_scipy(vector: list[float]) -> None:
    rotation = Rotation.from_rotvec(vector).as_matrix()
    ours = Rotation.from_rotvec(small_rotation_vector(rotation)).as_matrix()
    np.testing.assert_allclose(ours, rotation, atol=1e-7)


@pytest.mark.parametrize("fault", ["", "label_swap", "ghost", "occlusion"])
def test_the_simulated_person_s_torso_is_found_through_the_whole_way(fault: str) -> None:
    """Simulated cameras, their faults, repair, torso: within 6 mm and 2 degrees of the truth."""
    simulation = Simulation(load_scene("lab"), seed=3)
    simulation.set_behaviour("calibrate")
    pipeline, tracker = MarkerPipeline(SET.segments), TorsoTracker(SET.torso, SET.names)
    errors = []
    while simulation.time < 3.0:
        simulation.step()
        if fault and abs(simulation.time - 1.0) < 1e-6:
            simulation.set_fault(fault, 0.3 if fault == "occlusion" else 0.0, 1.5)
        for time, captured in simulation.frames():
            order = [captured.names.index(name) for name in SET.names]
            sample = MarkerSample(captured.device_frame, captured.device_time, time, captured.positions[order])
            frame = pipeline.process(sample)
            assert frame is not None
            estimate = tracker.update(frame)
            if estimate.valid:
                truth = simulation.truth().torso
                error = motion_between(truth, estimate.world_from_torso)
                errors.append((np.linalg.norm(error[:3, 3]), rotation_angle(error, np.eye(4))))
    assert len(errors) > 0.9 * 3.0 * 240.0
    assert np.max(errors, axis=0)[0] < 0.006
    assert np.max(errors, axis=0)[1] < np.radians(2.0)
    assert (pipeline.report()["swaps"] > 0) == (fault == "label_swap")
    assert (pipeline.report()["jumps"] > 0) == (fault == "ghost")
