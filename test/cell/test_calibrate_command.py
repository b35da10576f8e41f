"""handover calibrate: files in; report, picture, profile and numbers out; one line for bad input."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from people import NAMES, SEGMENTS, calibration_motion, random_person
from profiles import profile_of, report_of
from recorded import vicon_csv
from rich.console import Console

from handover_ros.cell.calibrate_command import CalibrateRequest, displacements_of, id_from, run_calibrate
from handover_ros.cell.calibration_session import moving_segments
from handover_ros.cell.calibration_tables import print_report
from handover_ros.cell.late_progress import LateProgress
from handover_ros.cell.marker_files import load_recordings
from handover_ros.cell.store import ProfileStore
from handover_ros.errors import BadRecordingError, BadRequestError, ErrorCode, HandoverError, UnknownNameError
from handover_ros.mocap.frames import Recording
from handover_ros.skeleton.profile import read_profile

RATE = 50.0


@pytest.fixture(scope="module")
def motion():
    return calibration_motion(random_person(6), frames=1200, rate=RATE)


@pytest.fixture(scope="module")
def files(motion, tmp_path_factory) -> tuple[Path, Path]:
    """The motion in two files, in millimetres."""
    folder = tmp_path_factory.mktemp("trials")
    halves = (motion.measured[:700], motion.measured[700:])
    paths = tuple(folder / f"trial {number}.csv" for number in (1, 2))
    for path, half in zip(paths, halves):
        path.write_text(vicon_csv(list(NAMES), 1e3 * half, rate="50"))
    return paths


@pytest.fixture(autouse=True)
def own_store(monkeypatch, tmp_path: Path) -> ProfileStore:
    monkeypatch.setenv("HANDOVER_PROFILES", str(tmp_path / "store"))
    return ProfileStore()


def run(request: CalibrateRequest) -> str:
    """Return what the command prints on a terminal of 80 columns."""
    console = Console(width=80, record=True, file=io.StringIO())
    assert run_calibrate(request, console) == 0
    return console.export_text()


def test_two_files_become_one_profile_with_report_picture_and_numbers(files, motion, tmp_path: Path, own_store):
    request = CalibrateRequest(files, person="Åsa", max_frames=600, out=tmp_path / "out", json_file=tmp_path / "n.json")
    text = run(request)
    for words in ("Joints", "Markers", "right_elbow_flexion", "RARM8", "1200 frames", "upper_body"):
        assert words in text
    document = json.loads((tmp_path / "n.json").read_text())
    assert document["command"] == "calibrate"
    assert document["ok"] is True
    metrics = document["metrics"]
    assert 1.0 < metrics["fit_rms_mm"] < 3.0
    assert 1.0 < metrics["heldout_mean_mm"] < 3.5
    assert metrics["frames"] <= 600
    assert metrics["seconds"] > 0.0
    assert metrics["missing_fraction"] == pytest.approx(0.1, abs=0.02)
    profile = read_profile(tmp_path / "out" / "trial_1.json")
    assert profile.person == "Åsa"
    assert profile.source == "trial 1.csv, trial 2.csv"
    assert (tmp_path / "out" / "fit.png").read_bytes().startswith(b"\x89PNG")
    assert all(Path(file).is_file() for file in document["files"])
    assert own_store.list() == (), "a profile that nobody named is not stored"
    elbow = profile.skeleton.displacement_names.index("right_elbow_flexion")
    recording = load_recordings(files).recording
    found, true = displacements_of(profile.skeleton, recording)[:, elbow], motion.displacements[:, elbow]
    assert np.corrcoef(found, true)[0, 1] > 0.999


def test_a_named_profile_is_stored_unless_told_otherwise(files, tmp_path: Path, own_store):
    request = CalibrateRequest(files, max_frames=300, profile_id="asa", out=tmp_path / "out")
    run(request)
    assert own_store.load("asa").person == "asa"
    run(replace(request, profile_id="other", store=False))
    assert own_store.names() == ("asa",)


def test_swapped_arms_are_reported_and_nothing_is_stored(motion, tmp_path: Path, own_store):
    swapped = motion.measured.copy()
    right, left = [NAMES.index(f"RARM{i}") for i in range(1, 9)], [NAMES.index(f"LARM{i}") for i in range(1, 9)]
    swapped[:, right + left] = swapped[:, left + right]
    path = tmp_path / "swapped.csv"
    path.write_text(vicon_csv(list(NAMES), 1e3 * swapped, rate="50"))
    console = Console(width=80, record=True, file=io.StringIO())
    request = CalibrateRequest((path,), max_frames=300, profile_id="asa", out=tmp_path / "out")
    with pytest.raises(HandoverError, match="swapped") as caught:
        run_calibrate(request, console)
    assert caught.value.code is ErrorCode.FIT_FAILED
    text = console.export_text()
    assert text.index("swapped") < text.index("Joints"), "problems come first"
    assert json.loads((tmp_path / "out" / "calibrate.json").read_text())["ok"] is False
    assert not (tmp_path / "out" / "asa.json").exists()
    assert own_store.list() == ()


@pytest.mark.parametrize(
    ("change", "kind", "words"),
    [
        ({"recordings": ()}, BadRequestError, "recording"),
        ({"recordings": (Path("none.csv"),)}, BadRecordingError, "no such file"),
        ({"recordings": (Path("none.txt"),)}, BadRecordingError, "extension"),
        ({"template": "octopus"}, UnknownNameError, "upper_body"),
        ({"marker_set": "octopus"}, UnknownNameError, "upper_body_24"),
        ({"profile_id": "../x"}, BadRequestError, "profile_id"),
        ({"max_frames": 1}, BadRequestError, "max_frames"),
    ],
)
def test_bad_input_is_refused(files, change, kind, words, tmp_path: Path):
    request = replace(CalibrateRequest(files, out=tmp_path / "out"), **change)
    with pytest.raises(kind, match=words):
        run_calibrate(request, Console(file=io.StringIO()))
    assert not (tmp_path / "out").exists()


def test_files_of_different_rates_or_persons_without_a_marker_set_are_refused(files, motion, tmp_path: Path):
    other = tmp_path / "other.csv"
    other.write_text(vicon_csv(list(NAMES), 1e3 * motion.measured[:80], rate="100"))
    with pytest.raises(BadRecordingError, match="one rate"):
        load_recordings((files[0], other))
    other.write_text(vicon_csv(["A", "B", "C"], 1e3 * motion.measured[:80, :3]))
    with pytest.raises(BadRecordingError, match="marker-set"):
        load_recordings((other,))
    joined = load_recordings(files)
    assert joined.starts == (0, 700)
    assert joined.recording.frames == 1200


def test_the_command_line_answers_bad_input_with_one_line_and_exit_2(tmp_path: Path):
    command = [sys.executable, "-m", "handover_ros.cli", "calibrate", str(tmp_path / "none.c3d")]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert answer.returncode == 2
    assert len(answer.stderr.strip().splitlines()) == 1
    assert "none.c3d" in answer.stderr


def test_the_profile_is_named_after_the_file():
    assert id_from((Path("a/My trial (2).c3d"),)) == "My_trial_2"
    assert id_from((Path("é.c3d"),)) == "person"


def test_an_arm_that_hangs_is_not_meant(motion):
    positions = motion.measured.copy()
    recording = Recording(NAMES, SEGMENTS, RATE, positions, Path("x"))
    assert set(moving_segments(recording)) == set(SEGMENTS)
    left = [row for row, segment in enumerate(SEGMENTS) if segment.startswith("left")]
    positions[:, left] = positions[:1, left]
    assert set(SEGMENTS) - set(moving_segments(recording)) == {"left_hand"}
    still = Recording(NAMES, SEGMENTS, RATE, np.repeat(positions[:1], 100, axis=0), Path("x"))
    assert set(moving_segments(still)) >= {"torso", "right_upper_arm"}


def test_the_report_fits_80_columns_and_shows_unknown_figures_as_a_dash():
    profile = profile_of()
    console = Console(width=80, record=True, file=io.StringIO())
    report = report_of(profile.skeleton, advice=("right elbow moved 9 deg",), problems=("left and right are swapped",))
    print_report(console, profile.skeleton, report)
    text = console.export_text()
    assert max(map(len, text.splitlines())) <= 80
    assert "left and right are swapped" in text
    assert "right elbow moved 9 deg" in text
    assert " - " in text


def test_progress_is_shown_late_and_only_on_a_terminal(monkeypatch):
    clock = iter([0.0, 1.0, 3.0, 4.0])
    monkeypatch.setattr("handover_ros.cell.late_progress.time.monotonic", lambda: next(clock, 5.0))
    file = io.StringIO()
    with LateProgress(Console(file=file, force_terminal=True, width=80), "fitting") as bar:
        bar.update(0.1)
        assert file.getvalue() == ""
        bar.update(0.5, "1.0 mm")
        bar.update(0.9)
    assert "fitting" in file.getvalue()
    file = io.StringIO()
    with LateProgress(Console(file=file, force_terminal=False), "fitting") as bar:
        bar.update(0.5)
    assert file.getvalue() == ""
