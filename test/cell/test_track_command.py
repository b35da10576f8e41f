"""handover track: a recording and a profile in; displacements, picture and numbers out."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from people import NAMES, calibration_motion, random_person
from profiles import profile_of
from recorded import vicon_csv
from rich.console import Console

from handover_ros.cell.store import ProfileStore
from handover_ros.cell.track_command import TrackRequest, run_track
from handover_ros.errors import BadModelError, BadRecordingError, BadRequestError, HandoverError, UnknownNameError
from handover_ros.files import write_whole
from handover_ros.skeleton.profile import profile_to_json

FRAMES, RATE = 1500, 100.0


@pytest.fixture(scope="module")
def motion():
    """A slow motion, as people make."""
    return calibration_motion(random_person(7), frames=4 * FRAMES, rate=RATE)


@pytest.fixture
def trial(motion, tmp_path: Path) -> Path:
    path = tmp_path / "trial.csv"
    path.write_text(vicon_csv(list(NAMES), 1e3 * motion.measured[:FRAMES]))
    return path


@pytest.fixture
def profile_file(motion, tmp_path: Path, monkeypatch) -> Path:
    monkeypatch.setenv("HANDOVER_PROFILES", str(tmp_path / "store"))
    profile = replace(profile_of("anna"), skeleton=motion.skeleton)
    ProfileStore().save(profile)
    write_whole(tmp_path / "file.json", profile_to_json(profile))
    return tmp_path / "file.json"


@pytest.mark.parametrize("smooth", [False, True])
def test_the_displacements_are_those_of_the_person(trial, profile_file, motion, tmp_path: Path, smooth):
    request = TrackRequest(trial, "anna", smooth=smooth, json_file=tmp_path / "n.json", out=tmp_path / "out")
    console = Console(width=100, record=True, file=io.StringIO())
    assert run_track(request, console) == 0
    assert "right_elbow_flexion" in console.export_text()
    document = json.loads((tmp_path / "n.json").read_text())
    metrics = document["metrics"]
    assert document["command"] == "track"
    assert metrics["frames"] == FRAMES
    assert metrics["nonfinite"] == 0
    assert metrics["valid_frames"] == FRAMES
    assert 0.5 < metrics["reprojection_mean_mm"] < 4.0
    assert (tmp_path / "out" / "track.png").read_bytes().startswith(b"\x89PNG")
    rows = list(csv.reader((tmp_path / "out" / "displacements.csv").open()))
    assert len(rows) == FRAMES + 1
    assert rows[0][1] == "right_shoulder_flexion [rad]"
    found = np.array(rows[1:], dtype=float)
    elbow = motion.skeleton.displacement_names.index("right_elbow_flexion")
    error = found[:, 1 + elbow] - motion.displacements[:FRAMES, elbow]
    assert np.sqrt(np.mean(error**2)) < 0.03
    assert np.allclose(found[:, 0], np.arange(FRAMES) / RATE)


def test_a_profile_file_serves_as_well(trial, profile_file, tmp_path: Path):
    run_track(TrackRequest(trial, str(profile_file), out=tmp_path / "out"), Console(file=io.StringIO()))
    assert json.loads((tmp_path / "out" / "track.json").read_text())["profile"] == "anna"


@pytest.mark.parametrize(
    ("change", "kind", "words"),
    [
        ({"profile": "nobody"}, UnknownNameError, "anna"),
        ({"profile": ""}, BadModelError, "--profile"),
        ({"profile": "none.json"}, BadModelError, "no such file"),
        ({"profile": "a b"}, BadRequestError, "profile_id"),
        ({"recording": Path("none.c3d")}, BadRecordingError, "no such file"),
        ({"marker_set": "octopus"}, UnknownNameError, "upper_body_24"),
    ],
)
def test_bad_input_is_refused(trial, profile_file, tmp_path: Path, change, kind, words):
    with pytest.raises(kind, match=words):
        run_track(replace(TrackRequest(trial, "anna", out=tmp_path / "out"), **change), Console(file=io.StringIO()))
    assert not (tmp_path / "out").exists()


def test_a_recording_in_which_nobody_is_seen_is_refused(profile_file, motion, tmp_path: Path):
    hidden = motion.measured[:80].copy()
    hidden[:, [row for row, name in enumerate(NAMES) if name not in ("CHEST1", "RARM8", "LARM8")]] = np.nan
    path = tmp_path / "hidden.csv"
    path.write_text(vicon_csv(list(NAMES), 1e3 * hidden))
    for smooth in (False, True):
        with pytest.raises(HandoverError, match="enough markers"):
            run_track(TrackRequest(path, "anna", smooth=smooth, out=tmp_path / "o"), Console(file=io.StringIO()))
