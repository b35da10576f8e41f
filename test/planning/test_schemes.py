"""Schemes: constant means constant, relative means relative."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.errors import BadModelError, ErrorCode, StaleDataError, UnknownNameError
from handover_ros.geometry import invert_transform, rotation_angle, transform_from_xyz_rpy
from handover_ros.objects import load_object
from handover_ros.planning import TrackedPerson, load_scheme, load_schemes
from handover_ros.planning.facing import object_centre
from handover_ros.planning.offers import HandoverTask, levelled

MUG, BOX = load_object("mug"), load_object("box")
BASE = transform_from_xyz_rpy([0.0, 0.0, 0.93])
CONSTANT, RELATIVE = load_scheme("constant"), load_scheme("relative")
TORSOS = st.builds(
    lambda x, y, z, lean, nod, yaw: transform_from_xyz_rpy([x, y, z], [lean, nod, yaw]),
    st.floats(0.5, 2.0),
    st.floats(-1.0, 1.0),
    st.floats(1.0, 1.6),
    st.floats(-0.4, 0.4),
    st.floats(-0.4, 0.4),
    st.floats(-np.pi, np.pi),
)


@given(TORSOS)
@settings(deadline=None, max_examples=40)
def test_constant_ignores_the_person(torso):
    """The same offers whether nobody or anybody stands anywhere."""
    alone, watched = (
        CONSTANT.offers(HandoverTask(MUG, BASE, None)),
        CONSTANT.offers(HandoverTask(MUG, BASE, TrackedPerson(torso))),
    )
    for a, b in zip(alone, watched, strict=True):
        np.testing.assert_array_equal(a.world_from_object, b.world_from_object)


@given(TORSOS, TORSOS)
@settings(deadline=None, max_examples=40)
def test_relative_is_constant_in_the_levelled_torso_frame(first, second):
    """Seen from the person's heading, the offers are the same wherever the person stands."""
    one, other = (RELATIVE.offers(HandoverTask(MUG, BASE, TrackedPerson(torso))) for torso in (first, second))
    for a, b in zip(one[:10], other[:10], strict=True):
        seen_a = invert_transform(levelled(first)) @ a.world_from_object
        seen_b = invert_transform(levelled(second)) @ b.world_from_object
        np.testing.assert_allclose(seen_a, seen_b, atol=1e-9)


@given(TORSOS)
@settings(deadline=None, max_examples=40)
def test_nominal_offer_comes_first_and_is_upright(torso):
    """The first offer has the object's centre where the file says, the object upright, and the handle to the person."""
    offer = RELATIVE.offers(HandoverTask(MUG, BASE, TrackedPerson(torso)))[0]
    centre = offer.world_from_object[:3, :3] @ object_centre(MUG) + offer.world_from_object[:3, 3]
    seen = invert_transform(levelled(torso)) @ np.append(centre, 1.0)
    np.testing.assert_allclose(seen[:3], RELATIVE.position, atol=1e-9)
    assert offer.nominal
    np.testing.assert_allclose(offer.world_from_object[:3, 2], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(offer.world_from_hand[:3, 2], offer.reach, atol=1e-9)


@given(TORSOS)
@settings(deadline=None, max_examples=40)
def test_only_what_may_lean_leans(torso):
    """Open containers stay upright in every offer; others also come leaning away from the person."""
    assert all(
        offer.world_from_object[2, 2] > 1 - 1e-9
        for offer in RELATIVE.offers(HandoverTask(MUG, BASE, TrackedPerson(torso)))
    )
    leaning = [
        offer
        for offer in RELATIVE.offers(HandoverTask(BOX, BASE, TrackedPerson(torso)))
        if offer.world_from_object[2, 2] < 0.99
    ]
    assert leaning
    assert all(offer.world_from_object[:3, 2] @ offer.reach > 0 for offer in leaning)


@given(TORSOS)
@settings(deadline=None, max_examples=40)
def test_levelled_keeps_origin_and_heading(torso):
    level = levelled(torso)
    np.testing.assert_allclose(level[:3, 3], torso[:3, 3])
    np.testing.assert_allclose(level[:3, :3] @ level[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(level[:3, :3]) > 0
    assert np.cross(level[:3, 0], torso[:3, 0])[2] == pytest.approx(0.0, abs=1e-9)
    assert level[:2, 0] @ torso[:2, 0] > 0
    assert level[2, 2] == pytest.approx(1.0)


def test_a_person_bent_over_still_has_a_heading():
    """With the trunk horizontal, the heading is that in which the person bent over."""
    bent = transform_from_xyz_rpy([1.0, 0.0, 1.0], [0.0, np.pi / 2.0, 0.0])
    assert rotation_angle(levelled(bent), np.eye(4)) < 1e-6


def test_relative_needs_the_person():
    with pytest.raises(StaleDataError, match="not tracked") as caught:
        RELATIVE.offers(HandoverTask(MUG, BASE, None))
    assert caught.value.code is ErrorCode.PERSON_NOT_TRACKED
    assert RELATIVE.needs_person
    assert not CONSTANT.needs_person


def test_shipped_schemes():
    chapter_2 = {"constant", "personal", "relative"}
    chapter_3 = {"expected_cost", "minimum_mean", "maximum_feasibility"}
    assert set(load_schemes()) == chapter_2 | chapter_3 | {"hip_offset"}
    with pytest.raises(UnknownNameError, match=r"constant, expected_cost, .*, relative"):
        load_scheme("telepathic")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("kind: magic\nxyz: [1, 0, 0]", "kind"),
        ("kind: constant\nxyz: [1, 0]", "xyz"),
        ("kind: constant\nxyz: [1, 0, .nan]", "xyz"),
        ("kind: relative\nxyz: [1, 0, 0]\nlevl: true", "levl"),
        ("kind: relative\nxyz: [1, 0, 0]\nvariations: {yaws: []}", "variations.yaws"),
    ],
)
def test_a_mistake_in_a_file_is_named(tmp_path, text, words):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(BadModelError, match="mine") as caught:
        load_scheme(str(path))
    assert words in str(caught.value)
