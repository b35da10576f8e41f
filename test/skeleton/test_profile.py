"""Profiles: exact there and back, readable, and one clear line for whatever is wrong with a file."""

from __future__ import annotations

import json
import string
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from profiles import profile_of

from handover_ros.errors import BadModelError, BadRequestError
from handover_ros.skeleton.profile import (
    Profile,
    profile_document,
    profile_from_json,
    profile_to_json,
    read_profile,
    readable_json,
    safe_profile_id,
)
from handover_ros.skeleton.templates import blank_skeleton, load_template


def assert_same(one: Profile, other: Profile) -> None:
    """The skeletons and all figures are equal to the last bit."""
    assert profile_document(one) == profile_document(other)
    for first, second in zip(one.skeleton.joints, other.skeleton.joints):
        assert first.name == second.name
        assert first.kind is second.kind
        assert (first.parent, first.segment) == (second.parent, second.segment)
        assert first.displacement_names == second.displacement_names
        assert np.array_equal(first.axes, second.axes)
        assert np.array_equal(first.point, second.point)
    for field in ("markers", "lower", "upper"):
        assert np.array_equal(getattr(one.skeleton, field), getattr(other.skeleton, field))
    assert one.skeleton.hands == other.skeleton.hands
    assert one.skeleton.marker_names == other.skeleton.marker_names


@given(st.integers(0, 2**20), st.text(st.characters(codec="utf-8"), max_size=30))
@settings(max_examples=15, deadline=None)
def test_a_profile_survives_being_stored_to_the_last_bit(seed, person):
    profile = profile_of(seed=seed, person=person)
    assert_same(profile, profile_from_json(profile_to_json(profile)))


def test_the_file_is_readable_and_holds_no_nan():
    text = profile_to_json(profile_of())
    assert max(len(line) for line in text.splitlines()) < 200
    assert 100 < len(text.splitlines()) < 700
    assert "NaN" not in text
    assert "Infinity" not in text
    assert "Åström" in text
    document = json.loads(text)
    assert (document["format"], document["version"]) == ("handover_ros profile", 1)
    assert document["skeleton"]["joints"][1]["displacements"][2]["lower"] is None
    assert document["report"]["markers"][0]["heldout_mean"] is None
    assert profile_of().created_seconds == 1769860800.0


@pytest.mark.parametrize("name", ["drawer_cabinet", "two_dof_arm", "right_arm_with_scapula"])
def test_every_kind_of_tree_can_be_stored(name):
    segments = tuple(
        segment for segment in load_template(name).content.segments if segment != "world" for _ in range(3)
    )
    names = tuple(f"M{row}" for row in range(len(segments)))
    skeleton = blank_skeleton(load_template(name), names, segments)
    profile = replace(profile_of(), skeleton=skeleton, template=name)
    assert_same(profile, profile_from_json(profile_to_json(profile)))


@pytest.mark.parametrize("text", ["anna", "A-b_9", "x" * 64])
def test_safe_names_pass(text):
    assert safe_profile_id(text) == text


@pytest.mark.parametrize(
    "text", ["", "a" * 65, "../anna", "anna/b", "anna.json", "anna\n", "a b", "Åsa", "a\x00", "~", "C:x", ".."]
)
def test_names_that_could_be_paths_are_refused(text):
    with pytest.raises(BadRequestError, match="profile_id"):
        safe_profile_id(text)


@given(st.text(max_size=80))
def test_exactly_the_safe_names_pass(text):
    if set(text) <= set(string.ascii_letters + string.digits + "-_") and 1 <= len(text) <= 64:
        assert safe_profile_id(text) == text
    else:
        with pytest.raises(BadRequestError):
            safe_profile_id(text)


def changed(path, value):
    """Return the text of a good profile with one field changed; ``...`` removes it."""
    document = profile_document(profile_of())
    place = document
    for key in path[:-1]:
        place = place[key]
    if value is ...:
        del place[path[-1]]
    else:
        place[path[-1]] = value
    return json.dumps(document)


FIRST_JOINT = ("skeleton", "joints", 1)
BAD = [
    (("version",), 2, "version"),
    (("version",), "1", "version"),
    (("version",), ..., "version"),
    (("format",), "something else", "format"),
    (("format",), ..., "format"),
    (("person",), ..., "person"),
    (("person",), 7, "person"),
    (("surprise",), 1, "surprise"),
    (("profile_id",), "../x", "profile_id"),
    (("profile_id",), "x\n", "profile_id"),
    (("created",), "yesterday", "created"),
    (("created",), "2026-01-31T12:00:00", "created"),
    (("report", "fit_rms"), ..., "report.fit_rms"),
    (("report", "fit_rms"), "small", "report.fit_rms"),
    (("report", "fit_rms"), 10**400, "report.fit_rms"),
    (("report", "frames"), -1, "report.frames"),
    (("report", "markers"), None, "report.markers"),
    (("skeleton",), ..., "skeleton"),
    (("skeleton", "joints"), [], "skeleton.joints"),
    ((*FIRST_JOINT, "kind"), "hinge", "skeleton.joints.1.kind"),
    ((*FIRST_JOINT, "point"), [0, 0], "skeleton.joints.1.point"),
    ((*FIRST_JOINT, "parent"), "nowhere", "nowhere"),
    ((*FIRST_JOINT, "displacements", 0, "axis"), [1, 1, 0], "unit length"),
    ((*FIRST_JOINT, "displacements", 0, "lower"), 3.5, "cross"),
    (("skeleton", "markers", 3, "segment"), "tail", "tail"),
    (("skeleton", "markers", 3, "position"), [0, 0, "x"], "skeleton.markers.3.position"),
    (("skeleton", "hands"), {"third": "right_hand"}, "skeleton.hands"),
    (("skeleton", "hands"), {"right": "paw"}, "paw"),
]


@pytest.mark.parametrize(("path", "value", "words"), BAD, ids=[".".join(map(str, bad[0])) for bad in BAD])
def test_a_wrong_field_is_named_with_its_file(tmp_path: Path, path, value, words):
    file = tmp_path / "anna.json"
    file.write_text(changed(path, value))
    with pytest.raises(BadModelError) as caught:
        read_profile(file)
    message = str(caught.value)
    assert str(file) in message
    assert words in message
    assert len(message.splitlines()) == 1


@pytest.mark.parametrize("constant", ["NaN", "Infinity", "-Infinity", "1e999", "-1e999"])
@pytest.mark.parametrize("field", ['"fit_rms": ', '"position": [', '"lower": '])
def test_numbers_that_are_none_are_refused(tmp_path: Path, field, constant):
    text = profile_to_json(profile_of())
    start = text.index(field) + len(field)
    end = min(text.index(mark, start) for mark in ",}\n" if mark in text[start:])
    file = tmp_path / "anna.json"
    file.write_text(text[:start] + constant + text[end:])
    with pytest.raises(BadModelError, match=r"anna\.json: .*(is no number|finite)"):
        read_profile(file)


def test_a_file_cut_short_at_any_place_is_refused(tmp_path: Path):
    text = profile_to_json(profile_of())
    file = tmp_path / "anna.json"
    for length in range(0, len(text) - 2, 211):
        file.write_text(text[:length])
        with pytest.raises(BadModelError, match=r"anna\.json"):
            read_profile(file)
    file.write_text(text[:-2])
    with pytest.raises(BadModelError, match="cut short"):
        read_profile(file)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "JSON"),
        (b"null", "format"),
        (b"[]", "format"),
        (b"\xff\xfe{\x00}\x00", "UTF-8"),
        ('{"person": "Åsa"}'.encode("latin-1"), "UTF-8"),
        (b"[" * 100_000, "JSON"),
        (b'{"a": 1, "a": 2}', "twice"),
        (b"\x00" * 100, "JSON"),
    ],
)
def test_what_is_no_profile_is_refused_in_one_line(tmp_path: Path, content, words):
    file = tmp_path / "anna.json"
    file.write_bytes(content)
    with pytest.raises(BadModelError, match=words) as caught:
        read_profile(file)
    assert len(str(caught.value).splitlines()) == 1


def test_a_byte_order_mark_does_no_harm(tmp_path: Path):
    file = tmp_path / "anna.json"
    file.write_bytes(b"\xef\xbb\xbf" + profile_to_json(profile_of()).encode())
    assert read_profile(file).person == "Anna Åström"


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path):
    for path in (tmp_path / "none.json", tmp_path):
        with pytest.raises(BadModelError, match="no such file"):
            read_profile(path)


def test_half_a_character_cannot_be_smuggled_in(tmp_path: Path):
    file = tmp_path / "anna.json"
    file.write_text(profile_to_json(profile_of()).replace("Anna Åström", "\\ud800"))
    with pytest.raises(BadModelError, match="person"):
        read_profile(file)


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
        lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(), inner, max_size=5),
        max_leaves=30,
    )
)
def test_readable_json_is_json(value):
    assert json.loads(readable_json(value)) == value
