"""What is recorded until it is fitted: joined, with standing still first, and nothing predicted taken for measured."""

from __future__ import annotations

from array import array

import numpy as np
import pytest
from people import NAMES, SEGMENTS, calibration_motion, random_person
from profiles import report_of

from handover_ros.cell.calibration_session import (
    CalibrationSession,
    chosen_template,
    fit_profile,
    require_usable,
)
from handover_ros.errors import BadRequestError, ErrorCode, HandoverError, UnknownNameError
from handover_ros.mocap.frames import MarkerStatus
from handover_ros.mocap.marker_sets import load_marker_set
from handover_ros.skeleton.calibration import CalibrationSettings
from handover_ros.skeleton.profile import profile_document, profile_from_json, profile_to_json
from handover_ros.skeleton.prompts import MOTION_NAMES, PROMPTS, prompt_at
from handover_ros.skeleton.templates import load_template

RATE = 50.0


def session_for(profile_id: str = "anna", limit: float = 100.0, names=NAMES, segments=SEGMENTS) -> CalibrationSession:
    return CalibrationSession(
        profile_id, "Anna", load_template("upper_body"), "upper_body_24", names, segments, RATE, limit
    )


def feed(session: CalibrationSession, positions: np.ndarray, first: int = 0) -> None:
    status = array("B", bytes(len(NAMES)))
    for number, frame in enumerate(positions):
        session.add(array("d", np.ascontiguousarray(frame).tobytes()), status, first + number)


def frames_at(height: float, count: int = 10) -> np.ndarray:
    return np.full((count, len(NAMES), 3), height)


def test_recordings_add_up_and_standing_still_comes_first():
    session = session_for()
    for height, motion in ((1.0, "elbow_flexion"), (2.0, "still"), (3.0, "wrist_flexion")):
        session.begin(motion)
        feed(session, frames_at(height))
        assert session.current_frames == 10
        assert session.end().frames == 10
    assert session.frames == 30
    recording = session.recording()
    assert recording.positions[:, 0, 2].tolist() == [2.0] * 10 + [1.0] * 10 + [3.0] * 10
    assert "still (10 frames)" in session.source


def test_predicted_and_half_measured_markers_are_missing_and_lost_frames_are_counted():
    session = session_for()
    session.begin("")
    frame, status = frames_at(1.0, 1)[0], np.zeros(len(NAMES), dtype=np.uint8)
    status[3], status[4], status[5] = MarkerStatus.BRIDGED, MarkerStatus.RELABELLED, MarkerStatus.DROPPED
    frame[5], frame[6, 1] = np.nan, np.inf
    for number in (7, 8, 11):
        session.add(array("d", frame.tobytes()), array("B", status.tobytes()), number)
    recorded = session.end()
    assert recorded.lost_frames == 2
    missing = np.isnan(recorded.positions[0, :, 0])
    assert np.flatnonzero(missing).tolist() == [3, 5, 6]
    assert recorded.missing_fraction == pytest.approx(3 / len(NAMES))


def test_frames_of_another_size_are_counted_and_the_limit_holds():
    session = session_for(limit=20 / RATE)
    session.begin("still")
    session.add(array("d", [0.0] * 3), array("B", [0]), 0)
    assert (session.frames, session.bad_frames) == (0, 1)
    feed(session, frames_at(1.0, 30))
    assert session.full
    assert session.frames == 20


def test_an_empty_recording_is_not_kept_and_nothing_recorded_is_said():
    session = session_for()
    session.begin("still")
    assert session.end().missing_fraction == 1.0
    with pytest.raises(HandoverError, match="start_recording") as caught:
        session.recording()
    assert caught.value.code is ErrorCode.NOT_ENOUGH_DATA


def test_prompts_go_on_by_themselves_or_by_call():
    session = session_for()
    session.begin("")
    assert session.prompt(0.2).name == "still"
    feed(session, frames_at(1.0, 10))  # 0.2 s
    assert session.prompt(0.2).name == "shoulder_flexion"
    assert session.fraction(0.2) == pytest.approx(1 / len(PROMPTS))
    session.prompt_next("wrist_deviation")
    assert session.prompt(0.2).name == "wrist_deviation"
    assert session.fraction(0.2) == 0.0
    session.prompt_next("")
    feed(session, frames_at(1.0, 10 * len(PROMPTS) + 1))
    assert session.prompt(0.2) is None
    assert session.fraction(0.2) == 1.0
    for bad in (session.begin, session.prompt_next):
        with pytest.raises(UnknownNameError, match="elbow_flexion"):
            bad("somersault")


def test_the_schedule_shows_each_motion_once_in_order():
    shown = [prompt_at(seconds, 15.0) for seconds in np.arange(0.0, 15.0 * len(PROMPTS), 1.0)]
    assert list(dict.fromkeys(prompt.name for prompt in shown)) == list(MOTION_NAMES)
    assert prompt_at(-1.0, 15.0) is PROMPTS[0]
    assert prompt_at(15.0 * len(PROMPTS), 15.0) is None


def test_bad_names_and_unfit_markers_are_refused_at_the_start():
    with pytest.raises(BadRequestError, match="profile_id"):
        session_for("../anna")
    with pytest.raises(BadRequestError, match="person"):
        CalibrationSession("a", "x" * 101, load_template("upper_body"), "s", NAMES, SEGMENTS, RATE)
    segments = tuple("torso" for _ in SEGMENTS)
    with pytest.raises(HandoverError, match="hand"):
        session_for(segments=segments)
    assert chosen_template("", SEGMENTS).name == "upper_body"
    assert chosen_template("left_arm", SEGMENTS).name == "left_arm"
    with pytest.raises(HandoverError, match="skeletons"):
        chosen_template("", ("tail",) * 5)


def test_a_fit_with_problems_is_refused_with_its_sentences():
    report = report_of(random_person(1), problems=("left and right are swapped; swap the labels",))
    with pytest.raises(HandoverError, match="swapped") as caught:
        require_usable(report)
    assert caught.value.code is ErrorCode.FIT_FAILED
    require_usable(report_of(random_person(1)))


def test_recorded_motions_become_a_profile_that_can_be_stored():
    motion = calibration_motion(random_person(4), frames=1500)
    session = session_for()
    for name, part in (("still", motion.measured[:60]), ("", motion.measured[60:])):
        session.begin(name)
        feed(session, part)
        session.end()
    heard: list[tuple[float, float]] = []
    profile, report = fit_profile(
        session.recording(),
        session.template,
        load_marker_set("upper_body_24"),
        session.profile_id,
        session.person,
        session.source,
        CalibrationSettings(max_frames=600),
        lambda fraction, rms: heard.append((fraction, rms)),
    )
    require_usable(report)
    assert report.fit_rms < 0.003
    fractions = [fraction for fraction, _ in heard]
    assert fractions == sorted(fractions)
    assert 0.0 <= fractions[0] < fractions[-1] <= 1.0
    again = profile_from_json(profile_to_json(profile))
    assert profile_document(again) == profile_document(profile)
    assert again.skeleton.displacement_names == motion.skeleton.displacement_names
