"""Mistakes as they happen in a laboratory: each is told with what to do about it, none is a silent bad fit."""

import os
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from bad_recordings import (
    ARMS,
    FRAMES,
    TORSO,
    column,
    exchanged,
    good,
    hidden,
    loose,
    motionless,
    on_segment_of,
    part,
    recording_of,
    scaled,
    stuck,
)
from people import NAMES, calibration_motion, random_person, right_arm_of

from handover_ros.errors import BadRecordingError, ErrorCode, HandoverError
from handover_ros.mocap.marker_sets import load_marker_set
from handover_ros.mocap.recordings import load_recording
from handover_ros.skeleton.calibration import calibrate
from handover_ros.skeleton.calibration_frames import torso_motion
from handover_ros.skeleton.checks import (
    check_amount,
    displacements_between,
    input_problems,
    inseparable_joints,
    outlying_markers,
)
from handover_ros.skeleton.templates import load_template

UPPER_BODY = load_template("upper_body")
TORSO_FRAME = load_marker_set("upper_body_24").torso
DATA = Path(os.environ.get("HANDOVER_RECORDINGS", Path(__file__).resolve().parents[2] / ".." / "shared" / "data"))
SOME = np.random.default_rng(0).random(FRAMES) < 0.3
RIGHT_ARM = [column(f"RARM{i}") for i in range(1, 9)]


@cache
def motion():
    return good(0)


def problems_of(measured):
    """Return what is found before any fit."""
    recording = recording_of(motion(), measured)
    check_amount(recording, UPPER_BODY)
    return input_problems(recording, torso_motion(recording, TORSO_FRAME), UPPER_BODY)


# Found before the fit.

REMEDIES = ("swap the labels", "mend the labels", "one unit", "state its unit", "the unit of the others", "marker set")


@pytest.mark.parametrize(
    ("mistake", "words"),
    [
        pytest.param(
            lambda x: exchanged(x, ARMS), ["right_upper_arm", "left and right are swapped"], id="arms swapped"
        ),
        pytest.param(lambda x: exchanged(x, TORSO), ["left and right are swapped"], id="torso swapped"),
        pytest.param(lambda x: exchanged(x, ARMS, part(0.5)), ["left and right"], id="arms swapped half the time"),
        pytest.param(lambda x: exchanged(x, ARMS, part(0.1)), ["RARM1 and LARM1", "10 %"], id="arms swapped 10 %"),
        pytest.param(lambda x: scaled(x, 1000.0, SOME), ["units are mixed"], id="some frames in mm"),
        pytest.param(lambda x: scaled(x, 1000.0, part(0.3)), ["units are mixed", "233"], id="a part in mm"),
        pytest.param(lambda x: scaled(x, 1000.0, slice(90, 92)), ["2 frames", "90 and 91"], id="two frames in mm"),
        pytest.param(lambda x: scaled(x, 1000.0), ["another unit"], id="everything in mm"),
        pytest.param(lambda x: scaled(x, 39.37), ["another unit"], id="everything in inches"),
        pytest.param(lambda x: scaled(x, 0.001), ["another unit"], id="everything in km"),
        pytest.param(
            lambda x: scaled(x, 1000.0, slice(None), column("RARM5")), ["marker RARM5 lies"], id="a marker in mm"
        ),
        pytest.param(
            lambda x: scaled(x, 100.0, slice(None), column("CHEST2")), ["marker CHEST2 lies"], id="a marker in cm"
        ),
        pytest.param(
            lambda x: scaled(x, 1000.0, SOME, column("RARM5")),
            ["RARM5", "one rigid segment"],
            id="a marker partly in mm",
        ),
        pytest.param(lambda x: scaled(x, 1000.0, slice(None), RIGHT_ARM), ["marker RARM1"], id="an arm in mm"),
        pytest.param(
            lambda x: exchanged(x, [("RARM1", "RARM2")], part(0.3)), ["RARM1 and RARM2", "30 %"], id="swap in a limb"
        ),
        pytest.param(
            lambda x: exchanged(x, [("RARM4", "RARM6")], part(0.1)), ["RARM4 and RARM6", "10 %"], id="short swap"
        ),
        pytest.param(
            lambda x: exchanged(x, [("RARM7", "RARM8")], part(0.3)), ["RARM7 and RARM8", "30 %"], id="swap on the hand"
        ),
        pytest.param(
            lambda x: exchanged(x, [("RARM3", "RARM4")], part(0.3)), ["RARM3 and RARM4"], id="swap across the elbow"
        ),
        pytest.param(
            lambda x: exchanged(x, [("CHEST1", "BACK1")], part(0.3)), ["CHEST1 and BACK1"], id="swap on torso"
        ),
        pytest.param(lambda x: exchanged(x, [("RARM3", "RARM4")]), ["rigid segment"], id="labels of two segments"),
        pytest.param(
            lambda x: on_segment_of(motion(), "RARM4", "RARM2"), ["RARM4", "right_forearm"], id="forearm marker on arm"
        ),
        pytest.param(
            lambda x: on_segment_of(motion(), "RARM3", "RARM5"),
            ["RARM3", "right_upper_arm"],
            id="arm marker on forearm",
        ),
        pytest.param(
            lambda x: on_segment_of(motion(), "CHEST1", "RARM1"), ["CHEST1", "torso"], id="chest marker on arm"
        ),
        pytest.param(lambda x: stuck(x, "RARM5"), ["RARM5", "rigid"], id="marker that stays"),
        pytest.param(lambda x: loose(x, "RARM2"), ["RARM2", "loose"], id="marker that slips"),
    ],
)
def test_a_mistake_is_told_with_its_remedy(mistake, words):
    problems = problems_of(mistake(motion().measured))
    assert problems
    for word in words:
        assert any(word in problem for problem in problems), problems
    for problem in problems:
        assert any(remedy in problem for remedy in REMEDIES), problem
        assert "\n" not in problem


@pytest.mark.parametrize("seed", range(8))
def test_nothing_is_wrong_with_clean_recordings(seed):
    moving = good(seed)
    recording = recording_of(moving)
    check_amount(recording, UPPER_BODY)
    assert input_problems(recording, torso_motion(recording, TORSO_FRAME), UPPER_BODY) == []


def test_single_frames_under_a_wrong_name_are_left_to_the_robust_fit():
    measured = exchanged(motion().measured, [("RARM1", "RARM2")], slice(200, 203))
    assert problems_of(measured) == []


def test_a_person_seldom_seen_is_not_taken_for_a_small_one():
    """With four fifths of the samples missing, the markers seen in a frame may all be on one limb."""
    measured = motion().measured.copy()
    measured[np.random.default_rng(0).random(measured.shape[:2]) < 0.8] = np.nan
    recording = recording_of(motion(), measured)
    assert input_problems(recording, None, UPPER_BODY) == []


def test_a_marker_never_seen_is_no_problem_by_itself():
    assert problems_of(hidden(motion().measured, "CHEST1")) == []


@pytest.mark.recordings
@pytest.mark.parametrize(
    ("name", "marker_set", "template"),
    [
        ("pyomeca/markers_analogs.c3d", "pyomeca_daphnee", "right_arm_with_scapula"),
        ("UE_ADLdatabase/ADL006/ADL006DR1.csv", "ue_adl", "right_arm_on_shoulder"),
        ("UE_ADLdatabase/ADL009/ADL009CL1.csv", "ue_adl", "left_arm_on_shoulder"),
    ],
)
def test_nothing_is_wrong_with_real_recordings(name, marker_set, template):
    """Skin moves, fingers bend, markers come and go: that is how recordings are."""
    if not (DATA / name).is_file():
        pytest.skip(f"no real recording {DATA / name}")
    definition = load_marker_set(marker_set)
    recording = load_recording(DATA / name, definition)
    named = load_template(template)
    assert input_problems(recording, torso_motion(recording, definition.torso), named) == []


# Too little.


@pytest.mark.parametrize(
    ("measured", "words"),
    [
        pytest.param(lambda x: x[:3], ["3 frames are too few", "at least 60", "record"], id="three frames"),
        pytest.param(lambda x: hidden(x, *NAMES[:6]), ["'torso' shows 2 markers", "CHEST1", "uncover"], id="torso"),
        pytest.param(lambda x: hidden(x, "RARM7", "RARM8"), ["'right_hand' shows 0", "RARM7, RARM8"], id="no hand"),
        pytest.param(
            lambda x: hidden(x, "LARM8"), ["'left_hand' shows 1", "2 displacements", "LARM8"], id="half a hand"
        ),
        pytest.param(
            lambda x: hidden(x, "RARM4", "RARM5", "RARM6"), ["4 displacements", "RARM4, RARM5"], id="no forearm"
        ),
        pytest.param(lambda x: np.full_like(x, np.nan), ["shows 0 markers"], id="nothing seen"),
        pytest.param(lambda x: np.where(np.arange(FRAMES)[:, None, None] < 20, x, np.nan), ["shows"], id="hardly seen"),
    ],
)
def test_too_little_is_refused_with_its_remedy(measured, words):
    with pytest.raises(BadRecordingError) as caught:
        calibrate(recording_of(motion(), measured(motion().measured)), UPPER_BODY, TORSO_FRAME)
    assert caught.value.code == ErrorCode.NOT_ENOUGH_DATA
    for word in words:
        assert word in str(caught.value)


def test_displacements_are_counted_up_to_the_next_segment_that_is_seen():
    every = set(UPPER_BODY.content.segments)
    assert displacements_between(UPPER_BODY, every)["right_hand"] == 1
    limbs = {"torso", "right_upper_arm", "right_forearm", "right_hand"}
    assert displacements_between(UPPER_BODY, limbs) == {"right_upper_arm": 3, "right_forearm": 2, "right_hand": 2}
    assert displacements_between(UPPER_BODY, {"torso", "right_hand"}) == {"right_hand": 7}


def test_few_frames_with_a_torso_are_told():
    """Enough of every marker over time, but never three of the torso's together."""
    measured = motion().measured.copy()
    torso = np.arange(8)[None] // 2 == (np.arange(FRAMES) % 4)[:, None]
    measured[:, :8][~torso] = np.nan
    with pytest.raises(HandoverError, match="torso"):
        calibrate(recording_of(motion(), measured), UPPER_BODY, TORSO_FRAME)


# Found in the fit.


@cache
def arm_motion():
    return calibration_motion(right_arm_of(random_person(0)), frames=500, seed=0)


def arm_report(motion_, measured=None):
    return calibrate(recording_of(motion_, measured), load_template("right_arm"), TORSO_FRAME).report


def test_everything_swapped_bends_the_elbow_backwards():
    """Labels of the arms and the torso: every side is right, but front is back."""
    report = calibrate(
        recording_of(motion(), exchanged(motion().measured, ARMS + TORSO)), UPPER_BODY, TORSO_FRAME
    ).report
    assert not report.usable
    assert any(
        "elbow_flexion bends backwards" in problem and "mend the labels" in problem for problem in report.problems
    )


@pytest.mark.parametrize(
    ("name", "other", "told"),
    [("RARM6", "RARM8", "RARM6"), ("RARM8", "RARM6", "RARM7")],
    ids=["forearm marker on the hand", "hand marker on the forearm"],
)
def test_a_marker_near_a_joint_but_beyond_it_stands_out(name, other, told):
    report = arm_report(arm_motion(), on_segment_of(arm_motion(), name, other))
    assert not report.usable
    assert any(told in problem and "segment" in problem for problem in report.problems), report.problems


def test_a_motion_without_motion_is_no_calibration():
    still = motionless(arm_motion(), *arm_motion().skeleton.displacement_names)
    report = arm_report(still)
    assert not report.usable
    assert any("record the calibration motions" in problem for problem in report.problems)


@pytest.mark.parametrize("name", ["right_elbow_flexion", "right_wrist_deviation"])
def test_a_joint_that_did_not_move_is_advised_on_in_degrees(name):
    """And the other joints are found as ever: the shoulder is not spoilt."""
    report = arm_report(motionless(arm_motion(), name))
    found = [re.match(rf"{name.replace('_', ' ')} moved (\d+) deg: move it through", line) for line in report.advice]
    degrees = [int(match.group(1)) for match in found if match]
    assert len(degrees) == 1, report.advice
    assert degrees[0] < 25
    shoulder = next(joint for joint in report.joints if joint.name == "right_shoulder")
    assert shoulder.point_error < 0.002
    assert report.usable


def test_a_forearm_that_did_not_turn_does_not_pass_for_a_second_elbow():
    """Its axis is fitted where that of the elbow is, perfectly; only their sum means anything."""
    report = arm_report(motionless(arm_motion(), "right_forearm_pronation"))
    told = [*report.problems, *(line for line in report.advice if "pronation moved" in line)]
    assert any("right forearm pronation" in line and "full range" in line for line in told), report


def test_displacements_known_in_each_frame_are_separable():
    skeleton = arm_motion().skeleton
    deviations = np.full((50, 7), np.deg2rad(2.0))
    deviations[:20, 4] = 1.0
    assert inseparable_joints(skeleton, deviations) == []
    deviations[:30, 3:5] = 1.0
    told = inseparable_joints(skeleton, deviations)
    assert len(told) == 1
    assert told[0].startswith("right elbow flexion and right forearm pronation cannot be told apart (known to 57 deg")


def test_a_clean_arm_has_nothing_to_mend():
    report = arm_report(arm_motion())
    assert report.usable
    assert report.problems == ()
    assert not [sentence for sentence in report.advice if "moved" in sentence]


def test_a_marker_hidden_all_the_time_is_advised_on():
    report = arm_report(arm_motion(), hidden(arm_motion().measured, "CHEST1"))
    assert report.usable
    assert "marker CHEST1 was hidden in 100 % of the frames: uncover it" in report.advice


def test_outlying_markers_are_those_bad_for_long():
    """A twentieth of bad frames does not count; a marker never seen says nothing."""
    rng = np.random.default_rng(0)
    skeleton = arm_motion().skeleton
    residuals = np.abs(0.002 * rng.normal(size=(400, len(skeleton.marker_names))))
    residuals[:, 3] = np.nan
    residuals[:15, 5] = 0.3
    assert outlying_markers(skeleton, residuals) == []
    residuals[:100, 7] = 0.05
    told = outlying_markers(skeleton, residuals)
    assert len(told) == 1
    assert skeleton.marker_names[7] in told[0]
    assert "fasten it" in told[0]
