"""Marker sets: every shipped one loads, labels are matched as promised, mistakes are named."""

from __future__ import annotations

from pathlib import Path

import pytest
from recorded import marker_set_text

from handover_ros.errors import BadModelError, UnknownNameError
from handover_ros.mocap.marker_sets import load_marker_set, match_labels, matching_marker_set
from handover_ros.resources import config_names

LABELS = ["A", "B", "C"]


def write(folder: Path, text: str) -> str:
    path = folder / "own.yaml"
    path.write_text(text)
    return str(path)


@pytest.mark.parametrize("name", config_names("marker_sets"))
def test_every_shipped_marker_set_loads_and_finds_its_own_names(name: str) -> None:
    marker_set = load_marker_set(name)
    assert len(marker_set.names) == len(marker_set.segments)
    labels = tuple(
        marker.match[0] if marker.match else f"{marker_set.content.subject}:{marker.name}"
        for marker in marker_set.content.markers
    )
    assert match_labels(marker_set, labels) == list(range(len(labels)))
    assert matching_marker_set(labels).name == name


def test_the_dissertation_s_set_has_eight_torso_and_sixteen_arm_markers() -> None:
    segments = load_marker_set("upper_body_24").segments
    assert len(segments) == 24
    assert segments.count("torso") == 8


def test_an_unknown_marker_set_lists_the_known_ones() -> None:
    with pytest.raises(UnknownNameError, match="upper_body_24"):
        load_marker_set("upper_body_25")


def test_subjects_case_and_order_do_not_matter(tmp_path: Path) -> None:
    marker_set = load_marker_set(write(tmp_path, marker_set_text(LABELS)))
    assert match_labels(marker_set, ("Eve:c", "other", "Eve:B", "Eve:a")) == [3, 2, 0]


def test_case_matters_when_the_file_says_so(tmp_path: Path) -> None:
    marker_set = load_marker_set(write(tmp_path, marker_set_text(LABELS, "case_sensitive: true\n")))
    with pytest.raises(BadModelError, match="'A'"):
        match_labels(marker_set, ("a", "B", "C"))


def test_two_people_need_a_subject(tmp_path: Path) -> None:
    labels = ("Eve:A", "Eve:B", "Eve:C", "Tom:A", "Tom:B", "Tom:C")
    with pytest.raises(BadModelError, match="several labels"):
        match_labels(load_marker_set(write(tmp_path, marker_set_text(LABELS))), labels)
    tom = load_marker_set(write(tmp_path, marker_set_text(LABELS, "subject: To*\n")))
    assert match_labels(tom, labels) == [3, 4, 5]


def test_a_missing_marker_is_named_with_what_is_there(tmp_path: Path) -> None:
    marker_set = load_marker_set(write(tmp_path, marker_set_text(LABELS)))
    with pytest.raises(BadModelError, match=r"marker 'C'.*A, B"):
        match_labels(marker_set, ("A", "B"))
    assert matching_marker_set(("A", "B")) is None


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("markers: 3\n", "markers"),
        (marker_set_text(LABELS, "untis: mm\n"), "untis"),
        (marker_set_text(LABELS, "units: furlong\n"), "units"),
        (marker_set_text(["A", "B"]), "markers"),
        (marker_set_text(["A", "B", "C", "D"]).replace("name: D", "name: C"), "more than once"),
        (marker_set_text(LABELS, "axes: [[1, 0, 0], [0, 1, 0], [0, 0, -1]]\n"), "right-handed"),
        (marker_set_text(LABELS, "origin_offset: [0.0, .nan, 0.0]\n"), "origin_offset"),
        (marker_set_text(LABELS).replace("C: 1.0", "D: 1.0"), "'D'"),
        (marker_set_text(LABELS, "  front: [A]\n"), "front and back"),
        (marker_set_text(LABELS, "  front: [A]\n  back: [Z]\n"), "'Z'"),
        (marker_set_text(LABELS).replace("A: 1.0", "A: -1.0"), "weights"),
        (marker_set_text(LABELS).partition("  template")[0], "origin"),
    ],
)
def test_a_mistake_is_one_line_with_file_and_field(tmp_path: Path, text: str, problem: str) -> None:
    with pytest.raises(BadModelError, match=problem) as caught:
        load_marker_set(write(tmp_path, text))
    assert "own.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)
