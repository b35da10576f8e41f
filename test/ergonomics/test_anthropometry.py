"""Masses, centres and inertias of a person's segments."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_ros.ergonomics.anthropometry import UPPER_ARM, rod_inertia, segment_inertias
from handover_ros.errors import BadModelError, BadRequestError
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.sim.person_spec import load_person
from handover_ros.skeleton.templates import blank_skeleton, load_template

PERSON = load_person("adult")
SKELETON = skeleton_of(PERSON)
vectors = st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(np.array)


@given(vectors, vectors, st.floats(20.0, 150.0))
def test_a_segments_inertia_is_that_of_a_body_of_revolution(start, bone, mass):
    if np.linalg.norm(bone) < 0.01:
        return
    inertia = rod_inertia(UPPER_ARM, mass, start, start + bone)
    values = np.linalg.eigvalsh(inertia.tensor)
    length = np.linalg.norm(bone)
    assert values[0] > 0.0
    np.testing.assert_allclose(values[1:], 0.028 * mass * (0.322 * length) ** 2, rtol=1e-9)
    assert values[0] + values[1] >= values[2]  # a real body
    np.testing.assert_allclose(inertia.tensor @ bone, values[0] * bone, atol=1e-9)
    np.testing.assert_allclose(inertia.centre, start + 0.436 * bone)


@given(st.floats(20.0, 150.0))
def test_masses_are_winters_fractions(mass):
    inertias = segment_inertias(SKELETON, mass)
    assert set(inertias) == {
        "torso",
        *(f"{s}_{n}" for s in ("right", "left") for n in ("upper_arm", "forearm", "hand")),
    }
    assert sum(inertia.mass for inertia in inertias.values()) == pytest.approx((0.578 + 2 * 0.050) * mass)
    assert inertias["right_forearm"].mass == pytest.approx(0.016 * mass)


def test_centres_lie_on_the_bones():
    inertias = segment_inertias(SKELETON, PERSON.mass)
    lengths = PERSON.lengths
    for side, sign in (("right", -1.0), ("left", 1.0)):
        y = sign * lengths.shoulder_half_width
        np.testing.assert_allclose(inertias[f"{side}_upper_arm"].centre, [0.0, y, -0.436 * lengths.upper_arm])
        z = -lengths.upper_arm - 0.430 * lengths.forearm
        np.testing.assert_allclose(inertias[f"{side}_forearm"].centre, [0.0, y, z], atol=1e-12)
        assert inertias[f"{side}_hand"].centre[2] < -lengths.upper_arm - lengths.forearm
    np.testing.assert_allclose(inertias["torso"].centre[:2], 0.0, atol=1e-12)
    assert -0.3 < inertias["torso"].centre[2] < -0.1


def test_an_arm_without_a_hand_carries_its_mass_in_the_forearm():
    blank = blank_skeleton(load_template("two_dof_arm"), SKELETON.marker_names, SKELETON.marker_segments)
    points = blank.tree.point.copy()
    points[1], points[2] = [0.0, -0.2, 0.0], [0.0, -0.2, -0.3]
    used = SKELETON.with_markers(blank.marker_names).markers
    inertias = segment_inertias(blank.with_geometry(blank.tree.axis, points, used), 80.0)
    assert inertias["right_forearm"].mass == pytest.approx(0.022 * 80.0)
    assert inertias["right_forearm"].centre[2] < -0.4


def test_what_has_no_arm_or_is_no_person_is_refused():
    cabinet = blank_skeleton(load_template("drawer_cabinet"), ("m", "n"), ("drawer", "flap"))
    with pytest.raises(BadModelError, match="no arm"):
        segment_inertias(cabinet, 75.0)
    with pytest.raises(BadRequestError, match="kg"):
        segment_inertias(SKELETON, 75000.0)
