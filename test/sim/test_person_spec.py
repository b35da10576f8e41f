"""People files: what they hold, and one clear line for each way to get them wrong."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from handover_ros.errors import BadModelError, UnknownNameError
from handover_ros.resources import config_file, config_names
from handover_ros.sim.person_spec import ARM_SLICE, JOINTS, MARKERS, load_person

PEOPLE = ("adult", "small", "tall", "restricted")


@pytest.mark.parametrize("name", PEOPLE)
def test_arrays_follow_the_joints_and_postures_are_within_the_limits(name):
    person = load_person(name)
    assert tuple(person.markers) == MARKERS
    for array in (person.lower, person.upper, person.neutral, person.weights, person.standing):
        assert array.shape == (len(JOINTS),)
        assert not array.flags.writeable
    for posture in (person.neutral, person.standing):
        assert np.all(posture >= person.lower)
        assert np.all(posture <= person.upper)


def test_all_files_are_tested():
    assert set(PEOPLE) <= set(config_names("people"))


def test_the_strap_takes_range_from_the_dominant_arm_only():
    free, strapped = load_person("adult"), load_person("restricted")
    right, left = ARM_SLICE["right"], ARM_SLICE["left"]
    assert np.all((strapped.upper - strapped.lower)[right] < (free.upper - free.lower)[right])
    assert np.array_equal(strapped.upper[left], free.upper[left])


def set_in(content: dict, path: str, value: object) -> None:
    *parents, last = path.split(".")
    for key in parents:
        content = content[key]
    content[last] = value


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("limits.right.elbow_flexion", [1.2, 1.2]),
        ("limits.left.shoulder_flexion", [0.5, -0.5]),
        ("limits.right.elbow_flexion", [-0.3, 2.0]),
        ("limits.right.wrist_flexion", [-9.0, 1.0]),
        ("lengths.forearm", -0.25),
        ("lengths.trunk", float("nan")),
        ("lengths.tail", 0.3),
        ("mass", 0.0),
        ("dominant", "both"),
        ("comfort.weights.elbow_flexion", -1.0),
        ("comfort.rationality", 0.0),
        ("markers.CHEST1.segment", "foot"),
        ("markers.CHEST9", {"segment": "torso", "position": [0, 0, 0]}),
        ("timing.reaction", "fast"),
        ("stature", 1.2),
    ],
)
def test_a_wrong_value_names_file_and_field(tmp_path: Path, path, value):
    content = yaml.safe_load(config_file("people", "adult").read_text())
    set_in(content, path, value)
    file = tmp_path / "odd.yaml"
    file.write_text(yaml.safe_dump(content))
    with pytest.raises(BadModelError) as error:
        load_person(str(file))
    message = str(error.value)
    assert str(file) in message
    assert path.split(".")[-1] in message
    assert "\n" not in message


def test_a_missing_marker_and_an_unknown_person_are_named(tmp_path: Path):
    content = yaml.safe_load(config_file("people", "adult").read_text())
    del content["markers"]["LARM8"]
    file = tmp_path / "bare.yaml"
    file.write_text(yaml.safe_dump(content))
    with pytest.raises(BadModelError, match="LARM8"):
        load_person(str(file))
    with pytest.raises(UnknownNameError, match="adult"):
        load_person("nobody")


def test_a_changed_person_has_arrays_of_its_own():
    """Those of the first have been asked for before, and must not come along."""
    adult = load_person("adult")
    assert adult.upper[JOINTS.index("right_elbow_flexion")] > 2.0
    limits = adult.limits.model_copy(
        update={"right": adult.limits.right.model_copy(update={"elbow_flexion": (0.1, 1.5)})}
    )
    changed = adult.model_copy(update={"limits": limits})
    assert changed.upper[JOINTS.index("right_elbow_flexion")] == pytest.approx(1.5)
    with pytest.raises(ValueError, match="stature"):
        adult.model_copy(update={"stature": 1.2})
