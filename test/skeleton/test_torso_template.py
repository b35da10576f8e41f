"""The template: found from frames with gaps, in anatomical axes, whatever the person's pose."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from handover_ros.geometry import make_transform, rotation_angle, transform_points
from handover_ros.mocap.marker_sets import TorsoDefinition, load_marker_set
from handover_ros.sim.person_spec import load_person
from handover_ros.skeleton.torso_template import (
    TemplateError,
    TorsoMarkers,
    anatomical_frame,
    estimate_template,
    procrustes_mean,
    stated_template,
)

NAMES = ("LU", "RU", "LL", "RL", "B")
SHAPE = np.array([[0.1, 0.1, 0.0], [0.1, -0.1, 0.0], [0.1, 0.1, -0.3], [0.1, -0.1, -0.3], [-0.1, 0.0, -0.1]])
FIELDS = {
    "weights": dict.fromkeys(NAMES, 1.0),
    "left": ("LU", "LL"),
    "right": ("RU", "RL"),
    "upper": ("LU", "RU"),
    "lower": ("LL", "RL"),
    "origin": ("LU", "RU"),
    "origin_offset": (-0.1, 0.0, 0.0),
}
MARKERS = TorsoMarkers.of(TorsoDefinition(**FIELDS), ("other", *NAMES))


def frames_of(rng: np.random.Generator, count: int, noise: float, missing: float) -> np.ndarray:
    """Return the shape moved about, with noise and gaps; the first frame is whole."""
    frames = np.empty((count, 5, 3))
    for index in range(count):
        turn = Rotation.from_rotvec(rng.normal(size=3) * 0.3).as_matrix()
        frames[index] = transform_points(make_transform(turn, rng.uniform(-1.0, 1.0, 3)), SHAPE)
    frames += rng.normal(size=frames.shape) * noise
    hidden = rng.random((count, 5)) < missing
    hidden[0] = False
    frames[hidden] = np.nan
    return frames


@given(seed=st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_the_template_comes_out_whatever_the_poses_and_gaps(seed: int) -> None:
    frames = frames_of(np.random.default_rng(seed), 30, 0.0, 0.25)
    template = estimate_template(MARKERS, frames)
    np.testing.assert_allclose(template, SHAPE, atol=1e-6)


def test_averaging_beats_a_single_frame() -> None:
    frames = frames_of(np.random.default_rng(0), 40, 0.002, 0.1)
    template = estimate_template(MARKERS, frames)
    assert np.abs(template - SHAPE).max() < 0.002


def test_frames_that_never_share_three_markers_are_refused() -> None:
    frames = np.full((4, 5, 3), np.nan)
    frames[:, :2] = 1.0
    with pytest.raises(TemplateError, match="three torso markers"):
        procrustes_mean(frames, np.ones(5))


def test_a_marker_never_seen_stays_unknown_and_a_needed_one_is_named() -> None:
    frames = frames_of(np.random.default_rng(0), 10, 0.0, 0.0)
    frames[:, 4] = np.nan
    assert np.isnan(estimate_template(MARKERS, frames)[4]).all()
    frames[:, [0, 2]] = np.nan
    with pytest.raises(TemplateError, match=r"LU|three"):
        estimate_template(MARKERS, frames)


def test_without_upper_and_lower_the_world_says_what_is_up() -> None:
    definition = TorsoDefinition(**{**FIELDS, "upper": (), "lower": ()})
    markers = TorsoMarkers.of(definition, NAMES)
    leaning = make_transform(Rotation.from_euler("y", 0.4).as_matrix(), [1.0, 2.0, 3.0])
    frame = anatomical_frame(markers, transform_points(leaning, SHAPE))
    np.testing.assert_allclose(frame[:3, 2], [0.0, 0.0, 1.0], atol=1e-12)


def test_front_and_back_serve_where_left_and_right_are_not_marked() -> None:
    fields = {**FIELDS, "left": (), "right": (), "front": NAMES[:4], "back": ("B",)}
    frame = anatomical_frame(TorsoMarkers.of(TorsoDefinition(**fields), NAMES), SHAPE)
    np.testing.assert_allclose(frame[:3, 0], [1.0, 0.0, 0.0], atol=1e-12)


def test_a_stated_template_is_taken_as_it_is() -> None:
    stated = {name: tuple(row) for name, row in zip(NAMES, SHAPE)}
    definition = TorsoDefinition(weights=dict.fromkeys(NAMES, 1.0), template=stated)
    np.testing.assert_array_equal(stated_template(TorsoMarkers.of(definition, NAMES)), SHAPE)
    assert stated_template(MARKERS) is None


def test_a_stream_without_torso_markers_is_refused() -> None:
    with pytest.raises(TemplateError, match="needs 3"):
        TorsoMarkers.of(TorsoDefinition(**FIELDS), ("LU", "RU", "hand"))


@pytest.mark.parametrize("person", ["adult", "small", "tall"])
def test_the_simulated_people_s_torso_frame_is_found_from_their_markers(person: str) -> None:
    """Origin between the shoulders within 1 cm, axes within 1.5 degrees, for three statures."""
    marker_set = load_marker_set("upper_body_24")
    markers = TorsoMarkers.of(marker_set.torso, marker_set.names)
    placed = load_person(person).markers
    positions = np.array([placed[name].position for name in markers.names])
    frame = anatomical_frame(markers, positions)
    assert np.linalg.norm(frame[:3, 3]) < 0.01
    assert rotation_angle(frame, np.eye(4)) < np.radians(1.5)
