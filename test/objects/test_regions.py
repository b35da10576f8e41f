"""Task Space Regions: poses lie inside, distances are what was put in."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.errors import BadModelError
from handover_ros.geometry import rotation_angle, transform_from_xyz_rpy
from handover_ros.objects.regions import TaskSpaceRegion

WIDE = np.array([[-0.1, 0.1], [-0.05, 0.2], [0.0, 0.0], [-0.4, 0.3], [-0.6, 0.5], [-np.pi, np.pi]])


def region(bounds=WIDE):
    return TaskSpaceRegion(
        "test", transform_from_xyz_rpy((0.1, 0.2, 0.3), (0.3, -0.5, 1.0)), transform_from_xyz_rpy((0, 0, 0.1)), bounds
    )


@given(seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=30)
def test_samples_lie_inside(seed):
    for pose in region().sample(np.random.default_rng(seed), 5):
        assert region().distance(pose) == pytest.approx((0.0, 0.0), abs=1e-7)


@given(
    step=st.tuples(st.floats(0.02, 0.5), st.floats(0.2, 4.0)),
)
@settings(deadline=None, max_examples=20)
def test_grid_lies_inside_and_repeats(step):
    grid = region().grid(*step)
    np.testing.assert_array_equal(grid, region().grid(*step))
    for pose in grid[:: max(1, len(grid) // 10)]:
        assert region().distance(pose) == pytest.approx((0.0, 0.0), abs=1e-7)


@given(offset=st.lists(st.floats(-1.2, 1.2), min_size=6, max_size=6))
@settings(deadline=None)
def test_offset_inverts_pose(offset):
    pose = region().pose(offset)
    np.testing.assert_allclose(region().pose(region().offset(pose)), pose, atol=1e-9)


@given(metres=st.floats(0.0, 0.5), angle=st.floats(0.0, 1.0))
@settings(deadline=None)
def test_distance_measures_how_far_outside(metres, angle):
    bounds = np.zeros((6, 2))
    assert region(bounds).distance(region(bounds).pose([0, metres, 0, 0, 0, angle])) == pytest.approx(
        (metres, angle), abs=1e-7
    )


def test_full_turn_has_no_double_pose():
    grid = region(np.array([[0, 0]] * 5 + [[-np.pi, np.pi]])).grid(0.1, np.pi / 2)
    assert len(grid) == 4
    assert min(rotation_angle(grid[i], grid[j]) for i in range(4) for j in range(i)) == pytest.approx(np.pi / 2)


def test_centre_of_fixed_region_is_its_only_grid_pose():
    fixed = region(np.zeros((6, 2)))
    np.testing.assert_allclose(fixed.grid(0.01, 0.1), fixed.centre()[None])


@pytest.mark.parametrize(
    "bounds",
    [np.zeros((5, 2)), np.full((6, 2), np.nan), np.array([[1, 0]] + [[0, 0]] * 5), np.array([[0, 0]] * 5 + [[0, 7]])],
)
def test_bad_bounds_are_refused(bounds):
    with pytest.raises(BadModelError, match="region 'test'"):
        region(bounds)


def test_arrays_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        region().bounds[0, 0] = 1.0
