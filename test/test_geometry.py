from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from handover_ros.geometry import (
    invert_transform,
    make_transform,
    pose_from_transform,
    rotation_angle,
    skew,
    transform_from_pose,
    transform_from_xyz_rpy,
    transform_points,
)

vectors = arrays(float, 3, elements=st.floats(-10.0, 10.0))
transforms = st.builds(transform_from_xyz_rpy, vectors, vectors)


@given(transforms, transforms, vectors)
def test_transforms_form_a_group_that_acts_on_points(a, b, point):
    assert np.allclose(a @ invert_transform(a), np.eye(4), atol=1e-9)
    assert np.allclose(transform_points(a @ b, point), transform_points(a, transform_points(b, point)), atol=1e-9)


@given(transforms)
def test_flat_pose_keeps_the_transform(transform):
    pose = pose_from_transform(transform)
    assert np.linalg.norm(pose[3:]) == pytest.approx(1.0)
    assert pose[6] >= 0.0
    assert np.allclose(transform_from_pose(pose), transform, atol=1e-9)


@given(vectors, vectors)
def test_skew_is_the_cross_product(a, b):
    assert np.allclose(skew(a) @ b, np.cross(a, b))


@given(st.floats(0.0, np.pi), transforms)
def test_rotation_angle_is_the_angle_turned(angle, transform):
    turned = transform[:3, :3] @ Rotation.from_rotvec([0.0, angle, 0.0]).as_matrix()
    assert rotation_angle(transform, make_transform(turned, [0, 0, 0])) == pytest.approx(angle, abs=1e-6)


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        ([0, 0, 0, 0, 0, 0, 2], "length 2"),
        ([0, 0, 0, 0, 0, 0, 0], "length 0"),
        ([np.nan, 0, 0, 0, 0, 0, 1], "finite"),
        ([0, 0, 0, 1], "7 finite numbers"),
    ],
)
def test_a_pose_that_is_none_is_refused_with_its_reason(pose, words):
    with pytest.raises(ValueError, match=words):
        transform_from_pose(pose)
