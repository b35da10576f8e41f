"""Recordings: what is written is read, in metres and z up; what is broken is named in one line."""

from __future__ import annotations

from pathlib import Path

import ezc3d
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recorded import C3D, CSV, marker_set_text, real_recording, recorded, trc, vicon_csv

from handover_ros.errors import BadRecordingError, HandoverError
from handover_ros.mocap.marker_sets import MarkerSet, load_marker_set
from handover_ros.mocap.recordings import load_recording, read_recording

LABELS = ["A", "B", "C"]
POSITIONS = np.random.default_rng(0).uniform(-800.0, 800.0, (6, 3, 3)).round(3)
POSITIONS[2, 1] = np.nan


@pytest.fixture(scope="module")
def marker_set(tmp_path_factory: pytest.TempPathFactory) -> MarkerSet:
    path = tmp_path_factory.mktemp("sets") / "own.yaml"
    path.write_text(marker_set_text(LABELS))
    return load_marker_set(str(path))


def write_c3d(path: Path, positions: np.ndarray, units: str = "mm", vertical: str = "+Z") -> None:
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["UNITS"]["value"] = [units]
    file["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    file["parameters"]["POINT"]["LABELS"]["value"] = LABELS
    file.add_parameter("POINT", "Y_SCREEN", [vertical])
    points = np.ones((4, positions.shape[1], positions.shape[0]))
    points[:3] = positions.transpose(2, 1, 0)
    file["data"]["points"] = points
    file.write(str(path))


def write(folder: Path, name: str, positions: np.ndarray = POSITIONS) -> Path:
    path = folder / name
    if path.suffix == ".c3d":
        write_c3d(path, positions)
    else:
        text = vicon_csv(LABELS, positions) if path.suffix == ".csv" else trc(LABELS, positions)
        path.write_text(text, encoding="utf-8")
    return path


def complaint_of(path: Path, marker_set: MarkerSet) -> str | None:
    """Return what is said about a file, None when it is read; anything but a HandoverError fails the test."""
    try:
        load_recording(path, marker_set)
    except HandoverError as error:
        return str(error)
    return None


@pytest.mark.parametrize("name", ["a.csv", "a.trc", "a.c3d"])
def test_positions_come_back_in_metres_with_gaps_as_nan(tmp_path: Path, marker_set: MarkerSet, name: str) -> None:
    recording = load_recording(write(tmp_path, name), marker_set)
    assert recording.rate == 100.0
    assert recording.names == tuple(LABELS)
    np.testing.assert_allclose(recording.positions, POSITIONS * 1e-3, atol=1e-6)
    assert recording.missing_samples == 1


@pytest.mark.parametrize(("vertical", "expected"), [("+Y", [0.1, -0.3, 0.2]), ("+Z", [0.1, 0.2, 0.3])])
def test_c3d_with_y_up_is_turned_to_z_up(
    tmp_path: Path, marker_set: MarkerSet, vertical: str, expected: list[float]
) -> None:
    positions = POSITIONS.copy()
    positions[0, 0] = [100.0, 200.0, 300.0]
    write_c3d(tmp_path / "a.c3d", positions, vertical=vertical)
    recording = load_recording(tmp_path / "a.c3d", marker_set)
    np.testing.assert_allclose(recording.positions[0, 0], expected, atol=1e-6)


def test_skipped_frame_numbers_become_missing_frames(tmp_path: Path, marker_set: MarkerSet) -> None:
    lines = vicon_csv(LABELS, POSITIONS).split("\n")
    del lines[7]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(lines), encoding="utf-8")
    recording = load_recording(path, marker_set)
    assert recording.frames == 6
    assert np.isnan(recording.positions[2]).all()


def csv_with(line: int, column: int, text: str) -> str:
    lines = vicon_csv(LABELS, POSITIONS).split("\n")
    cells = lines[line - 1].split(",")
    cells[column - 1] = text
    lines[line - 1] = ",".join(cells)
    return "\n".join(lines)


def without_column(column: int) -> str:
    lines = vicon_csv(LABELS, POSITIONS).split("\n")
    return "\n".join(
        ",".join(cell for number, cell in enumerate(line.split(","), 1) if number != column or row < 2)
        for row, line in enumerate(lines)
    )


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "line 1"),
        ("Devices\n1\n", "Trajectories"),
        (vicon_csv(LABELS, POSITIONS, rate="0"), "line 2, column 1"),
        (vicon_csv(LABELS, POSITIONS, rate="-100"), "line 2, column 1"),
        (vicon_csv(LABELS, POSITIONS, rate="fast"), "line 2, column 1"),
        (vicon_csv(LABELS, POSITIONS[:0]), "at least one frame"),
        (vicon_csv(LABELS, POSITIONS, units="furlong"), "units"),
        (vicon_csv(LABELS, POSITIONS, units=""), "units"),
        (vicon_csv(LABELS, POSITIONS, units="m"), "units"),
        (vicon_csv(["A", "B", "D"], POSITIONS), "marker 'C'"),
        (vicon_csv(["A", "B", "B"], POSITIONS), "more than once"),
        (csv_with(6, 4, "nan"), r"line 6, column 4 \(A Y\)"),
        (csv_with(7, 8, "-inf"), r"line 7, column 8 \(B Z\)"),
        (csv_with(8, 3, "12,3"), "line 8"),
        (csv_with(8, 3, "twelve"), r"line 8, column 3 \(A X\)"),
        (csv_with(8, 1, "1"), "line 8, column 1"),
        (csv_with(5, 4, "cm"), "one unit"),
        (without_column(4), "line 3, column 5.*column missing"),
        (without_column(11), "line 4, column 11.*column missing"),
    ],
)
def test_a_broken_csv_is_one_line_with_file_and_place(
    tmp_path: Path, marker_set: MarkerSet, text: str, problem: str
) -> None:
    path = tmp_path / "broken.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(BadRecordingError, match=problem) as caught:
        load_recording(path, marker_set)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("PathFileType", "Something", "line 1"),
        ("100.0\t100.0", "-5\t100.0", "DataRate"),
        ("NumMarkers", "Markers", "NumMarkers"),
        ("A\t\t\tB", "A\t\t\tB\t\t\tD", "line 4"),
        ("\t6\t3\tmm", "\t9\t3\tmm", "cut short"),
        ("3\t0.02000\t", "3\t0.02000\tnan\t", "line 9"),
    ],
)
def test_a_broken_trc_is_one_line_with_file_and_place(
    tmp_path: Path, marker_set: MarkerSet, old: str, new: str, problem: str
) -> None:
    text = trc(LABELS, POSITIONS)
    assert old in text
    path = tmp_path / "broken.trc"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(BadRecordingError, match=problem):
        load_recording(path, marker_set)


def test_c3d_rate_and_units_are_checked(tmp_path: Path, marker_set: MarkerSet) -> None:
    path = tmp_path / "a.c3d"
    write_c3d(path, POSITIONS, units="furlong")
    with pytest.raises(BadRecordingError, match="units"):
        load_recording(path, marker_set)
    write_c3d(path, POSITIONS)
    whole = path.read_bytes()
    for rate in (0.0, -100.0):
        path.write_bytes(whole.replace(np.float32(100.0).tobytes(), np.float32(rate).tobytes()))
        with pytest.raises(BadRecordingError, match="RATE"):
            load_recording(path, marker_set)


def test_unknown_extensions_and_missing_files_are_named(tmp_path: Path, marker_set: MarkerSet) -> None:
    with pytest.raises(BadRecordingError, match=r"\.mp4.*\.c3d"):
        load_recording(tmp_path / "a.mp4", marker_set)
    with pytest.raises(BadRecordingError, match="no such file"):
        load_recording(tmp_path / "a.c3d", marker_set)


@pytest.mark.parametrize("name", ["a.csv", "a.trc", "a.c3d"])
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0.0, 1.0))
def test_a_file_cut_anywhere_is_read_or_refused_but_never_crashes(
    tmp_path: Path, marker_set: MarkerSet, name: str, share: float
) -> None:
    whole = write(tmp_path, name).read_bytes()
    path = tmp_path / f"cut_{name}"
    path.write_bytes(whole[: int(share * len(whole))])
    complaint = complaint_of(path, marker_set)
    assert complaint is None or str(path) in complaint


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_text_files_with_damaged_bytes_are_read_or_refused(
    tmp_path: Path, marker_set: MarkerSet, data: st.DataObject
) -> None:
    name = data.draw(st.sampled_from(["a.csv", "a.trc"]))
    content = bytearray(write(tmp_path, name).read_bytes())
    for _ in range(data.draw(st.integers(1, 5))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path / f"damaged_{name}"
    path.write_bytes(bytes(content))
    assert "\n" not in (complaint_of(path, marker_set) or "")


@pytest.mark.recordings
def test_the_real_c3d_has_its_real_gaps() -> None:
    recording = real_recording(C3D)
    assert recording.positions.shape == (580, 51, 3)
    missing = np.isnan(recording.positions[:, :, 0])
    assert missing.sum() == recording.missing_samples == 305
    pelvis = [recording.names.index(name) for name in ("ASISr", "ASISl", "PSISr", "PSISl")]
    assert 0.8 < np.nanmean(recording.positions[:, pelvis, 2]) < 1.1


@pytest.mark.recordings
def test_the_real_c3d_cut_short_is_refused(tmp_path: Path) -> None:
    whole = recorded(C3D).read_bytes()
    path = tmp_path / "cut.c3d"
    for size in (0, 1, 300, 700, 20_000, len(whole) // 2, len(whole) - 512):
        path.write_bytes(whole[:size])
        with pytest.raises(BadRecordingError, match=r"cut.c3d"):
            read_recording(path)


@pytest.mark.recordings
def test_the_real_csv_faces_the_right_way_and_keeps_its_frames() -> None:
    recording = real_recording("UE_ADLdatabase/ADL006/ADL006_static.csv")
    assert recording.positions.shape == (196, 45, 3)
    at = dict(zip(recording.names, recording.positions.mean(axis=0)))
    assert at["LSHO1"][1] > at["STRN"][1] > at["RSHO1"][1]  # the left shoulder is to the left (y)
    assert at["RHAN1"][0] > at["RSHO1"][0]  # the hand is in front (x)
    assert real_recording(CSV).missing_samples == 651 * 10  # the landmarks of the static trial only
