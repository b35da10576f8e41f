"""The object poses that a plan may choose from."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from handover_ros.errors import BadModelError
from handover_ros.geometry import make_transform, transform_from_xyz_rpy, transform_points
from handover_ros.objects import load_catalogue
from handover_ros.planning.facing import object_centre, object_corners
from handover_ros.planning.pose_space import EYES, VIEW_DOWN, PoseSpace
from handover_ros.planning.taking_postures import body_distance

CATALOGUE = load_catalogue()
SPACE = PoseSpace()
NAMES = sorted(CATALOGUE)
UPRIGHT = sorted(name for name, model in CATALOGUE.items() if model.keep_upright)
FREE = sorted(set(NAMES) - set(UPRIGHT))
names, seeds = st.sampled_from(NAMES), st.integers(0, 10**6)


def points_of(model, seed, count=20, space=SPACE):
    low, high = space.bounds(model)
    return np.random.default_rng(seed).uniform(low, high, (count, 6))


def wrapped(angles):
    return (angles + np.pi) % (2.0 * np.pi) - np.pi


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("count", [1, 2, 100, 128])
def test_a_spread_fills_the_bounds(name, count):
    """As many poses as asked for, all within the bounds, the same ones for the same seed."""
    model = CATALOGUE[name]
    low, high = SPACE.bounds(model)
    points = SPACE.spread(model, count, 3)
    assert points.shape == (count, 6)
    assert ((points >= low) & (points <= high)).all()
    np.testing.assert_array_equal(points, SPACE.spread(model, count, 3))
    if count >= 100:
        assert np.abs(SPACE.spread(model, count, 4) - points).max() > 0.1
        free = high > low
        share = (points[:, free] - low[free]) / (high - low)[free]
        for column in share.T:  # each eighth of every axis has its share
            found = np.histogram(column, 8, (0.0, 1.0))[0]
            assert found.min() >= 0.6 * count / 8.0


@given(names, st.floats(0.15, 0.6), st.floats(1.2, 3.0))
@settings(max_examples=30, deadline=None)
def test_a_grid_is_regular_and_reaches_the_bounds(name, spacing, angle):
    """Neighbours are at most so far apart, no pose comes twice (a full turn has one end), and all are within."""
    model = CATALOGUE[name]
    low, high = SPACE.bounds(model)
    points = SPACE.grid(model, spacing, angle)
    assert ((points >= low - 1e-12) & (points <= high + 1e-12)).all()
    assert len(np.unique(points.round(9), axis=0)) == len(points)
    axes = [np.unique(column.round(12)) for column in points.T]
    assert len(points) == np.prod([len(axis) for axis in axes])
    for index, (axis, step) in enumerate(zip(axes, [spacing] * 3 + [angle] * 3, strict=True)):
        if high[index] == low[index]:
            assert axis == pytest.approx([low[index]])
            continue
        assert np.diff(axis).max() <= step + 1e-9
        assert axis[0] == pytest.approx(low[index])
        if index in (3, 5):  # and once more round the circle to the first
            assert low[index] + 2.0 * np.pi - axis[-1] <= step + 1e-9
            assert axis[-1] < np.pi - 1e-9
        else:
            assert axis[-1] == pytest.approx(high[index])


@given(names, seeds)
@settings(max_examples=40, deadline=None)
def test_the_centre_is_where_the_point_says(name, seed):
    """Whatever the turn, lean and spin; transforms are rigid."""
    model = CATALOGUE[name]
    points = points_of(model, seed)
    poses = SPACE.transforms(model, points)
    for pose, point in zip(poses, points, strict=True):
        np.testing.assert_allclose(transform_points(pose, object_centre(model)), point[:3], atol=1e-12)
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)


@given(names, seeds)
@settings(max_examples=40, deadline=None)
def test_the_lean_is_the_angle_of_the_objects_axis(name, seed):
    """The axis leans so far from the vertical, in the direction of the turn; what must stay upright does."""
    model = CATALOGUE[name]
    points = points_of(model, seed)
    axes = SPACE.transforms(model, points)[:, :3, 2]
    np.testing.assert_allclose(axes[:, 2], np.cos(points[:, 4]), atol=1e-12)
    across = np.sin(points[:, 4])[:, None] * np.column_stack([np.cos(points[:, 3]), np.sin(points[:, 3])])
    np.testing.assert_allclose(axes[:, :2], across, atol=1e-12)
    if model.keep_upright:
        np.testing.assert_allclose(axes, np.tile([0.0, 0.0, 1.0], (len(axes), 1)), atol=1e-12)


@given(names, seeds)
@settings(max_examples=40, deadline=None)
def test_points_of_undoes_transforms(name, seed):
    """The pose of the point of a pose is that pose; upright ones, where turn and spin are one, included."""
    model = CATALOGUE[name]
    points = points_of(model, seed)
    points[::4, 4] = 0.0
    poses = SPACE.transforms(model, points)
    found = SPACE.points_of(model, poses)
    np.testing.assert_allclose(found[:, :3], points[:, :3], atol=1e-9)
    np.testing.assert_allclose(SPACE.transforms(model, found), poses, atol=1e-6)


@given(st.sampled_from(UPRIGHT), seeds)
@settings(max_examples=30, deadline=None)
def test_points_of_a_leaning_cup_are_the_nearest_upright_ones(name, seed):
    """Of all turns about the vertical the found one leaves the least rotation."""
    model = CATALOGUE[name]
    rng = np.random.default_rng(seed)
    leaning = make_transform(Rotation.from_rotvec(rng.normal(0.0, 0.8, 3)).as_matrix(), [0.4, 0.0, -0.2])
    point = SPACE.points_of(model, leaning[None])
    assert not point[0, 4:].any()

    def left(turn):
        upright = Rotation.from_euler("z", turn).as_matrix()
        return Rotation.from_matrix(upright.T @ leaning[:3, :3]).magnitude()

    assert left(point[0, 3]) <= min(left(turn) for turn in np.linspace(-np.pi, np.pi, 200)) + 1e-6


@given(names, seeds)
@settings(max_examples=40, deadline=None)
def test_clipping_brings_points_within_and_leaves_those_inside(name, seed):
    """A turn goes on round the circle instead of stopping at its end; what is inside stays."""
    model = CATALOGUE[name]
    low, high = SPACE.bounds(model)
    inside = points_of(model, seed)
    np.testing.assert_allclose(SPACE.clip(model, inside), inside, atol=1e-12)
    outside = inside + np.random.default_rng([seed, 1]).normal(0.0, 3.0, inside.shape)
    clipped = SPACE.clip(model, outside)
    assert ((clipped >= low) & (clipped <= high)).all()
    np.testing.assert_allclose(wrapped(clipped[:, 3] - outside[:, 3]), 0.0, atol=1e-9)
    stay = np.clip(outside, low, high)
    np.testing.assert_allclose(clipped[:, [0, 1, 2, 4]], stay[:, [0, 1, 2, 4]])


@given(names, seeds)
@settings(max_examples=40, deadline=None)
def test_allowed_agrees_with_a_plain_check(name, seed):
    """Every corner far enough from trunk and head, the centre within the cone of view; refusals are counted."""
    model = CATALOGUE[name]
    space = PoseSpace(lower=(0.0, -0.8, -0.7), upper=(0.8, 0.8, 0.4), clearance=0.12, view=0.9)
    poses = space.transforms(model, points_of(model, seed, 40, space))
    expected, near, unseen = [], 0, 0
    ahead = [np.cos(VIEW_DOWN), 0.0, -np.sin(VIEW_DOWN)]
    for pose in poses:
        corners = [pose[:3, :3] @ corner + pose[:3, 3] for corner in object_corners(model)]
        clear = min(float(body_distance(corner)) for corner in corners) >= 0.12
        sight = pose[:3, :3] @ object_centre(model) + pose[:3, 3] - EYES
        seen = np.arccos(np.clip(sight @ ahead / np.linalg.norm(sight), -1.0, 1.0)) <= 0.9
        expected.append(clear and seen)
        near += not clear
        unseen += clear and not seen
    refused = Counter()
    assert space.allowed(model, poses, refused).tolist() == expected
    assert refused["too near to trunk or head"] == near
    assert refused["out of the person's view"] == unseen
    assert space.allowed(model, poses).tolist() == expected


@pytest.mark.parametrize("name", NAMES)
def test_in_front_of_the_chest_is_allowed_behind_and_inside_is_not(name):
    """0.5 m ahead and a little down is; inside the trunk, and behind the back, is not."""
    model = CATALOGUE[name]
    points = np.zeros((3, 6))
    points[:, :3] = [[0.5, 0.0, -0.2], [0.0, 0.0, -0.2], [-0.6, 0.0, -0.2]]
    assert SPACE.allowed(model, SPACE.transforms(model, points)).tolist() == [True, False, False]


def test_no_pose_has_no_answer():
    """Empty arrays in, empty arrays out."""
    for name in ("mug", "plate"):
        model = CATALOGUE[name]
        assert SPACE.allowed(model, np.empty((0, 4, 4))).shape == (0,)
        assert SPACE.transforms(model, np.empty((0, 6))).shape == (0, 4, 4)
        assert SPACE.points_of(model, np.empty((0, 4, 4))).shape == (0, 6)


@pytest.mark.parametrize(
    ("fields", "word"),
    [
        ({"lower": (0.8, -0.5, -0.5)}, "bounds of x"),
        ({"upper": (0.7, -0.55, 0.0)}, "bounds of y"),
        ({"lower": (0.2, -0.5, np.nan)}, "bounds of z"),
        ({"most_lean": -0.1}, "most_lean -0.1"),
        ({"most_lean": 3.2}, "most_lean 3.2"),
        ({"view": 0.0}, "view 0.0"),
        ({"clearance": -0.01}, "clearance -0.01"),
        ({"clearance": np.nan}, "clearance nan"),
    ],
)
def test_impossible_spaces_are_refused(fields, word):
    """The message names the number."""
    with pytest.raises(BadModelError, match=word):
        PoseSpace(**fields)


def test_bounds_of_what_may_lean_little():
    """most_lean bounds the lean of what may lean, and nothing else."""
    plate, mug = CATALOGUE["plate"], CATALOGUE["mug"]
    assert PoseSpace(most_lean=0.3).bounds(plate)[:, 4].tolist() == [0.0, 0.3]
    assert PoseSpace(most_lean=0.3).bounds(mug)[:, 4:].tolist() == [[0.0, 0.0], [0.0, 0.0]]
    stiff = PoseSpace(most_lean=0.0)
    assert stiff.spread(plate, 10, 0)[:, 4].tolist() == [0.0] * 10
    far = transform_from_xyz_rpy([0.4, 0.0, -0.2], [1.0, 0.0, 0.0])
    assert stiff.points_of(plate, far[None])[0, 4] == 0.0
