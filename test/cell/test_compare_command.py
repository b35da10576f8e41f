"""handover compare: two sessions side by side; what differs, and nothing else."""

from __future__ import annotations

import io
import json
import math
import re
import shutil
from pathlib import Path

import made_bags as made
import pytest
from rich.console import Console

from handover_ros import cli
from handover_ros.cell.compare_command import CompareRequest, run_compare
from handover_ros.cell.session_compare import Comparison, Pair
from handover_ros.cell.session_folder import read_session


def compared(first: Path, second: Path, out: Path) -> tuple[dict, str]:
    """Return the JSON and what was printed."""
    console = Console(width=100, record=True, file=io.StringIO())
    assert run_compare(CompareRequest(first, second, out / "numbers.json", out), console) == 0
    html = (out / "compare.html").read_text()
    assert not re.search(r'src="(?!data:)', html)
    return json.loads((out / "numbers.json").read_text()), console.export_text()


@pytest.fixture(scope="module")
def sessions(tmp_path_factory):
    """Two sessions that differ in one of everything."""
    folder = tmp_path_factory.mktemp("sessions")
    one = made.write_session(folder / "monday", made.whole_cell(2))
    said = [*made.whole_cell(4), *made.markers(1.0, 30.0, 20.0, "/mocap/markers")]
    more = {"arguments": {"handovers": 4, "scheme": "personal", "out": "x"}, "metrics": {"ready_s": 6.5, "dropped": 0}}
    other = made.write_session(folder / "tuesday", said, versions={"numpy": "2.4.5", "handover_ros": "0.1.0"}, **more)
    file = other / "parameters" / "executive_node.yaml"
    file.write_text(file.read_text().replace("5.5", "4.5"))
    return one, other


def test_what_differs_is_told_and_the_rest_is_not(tmp_path: Path, sessions):
    document, text = compared(*sessions, tmp_path)
    assert [(each["kind"], each["name"], each["first"], each["second"]) for each in document["differing"]] == [
        ("version", "numpy", "2.4.6", "2.4.5"),
        ("argument", "handovers", 2, 4),
        ("parameter", "executive_node pull_threshold", 5.5, 4.5),
    ]
    for words in ("monday", "tuesday", "pull_threshold", "none | glass", "Median of the phases [s]", "ready_s",
                  "Believed at the end of anna", "/mocap/markers"):  # fmt: skip
        assert words in text, f"{words!r} is missing"
    metrics = document["metrics"]
    assert (metrics["handovers_difference"], metrics["handovers_ratio"], metrics["taken_difference"]) == (2, 2.0, 1)
    assert (metrics["ready_s_difference"], metrics["parameters_differing"]) == (1.0, 1)
    assert metrics["neutral_apart_deg"] == pytest.approx(math.degrees(0.1))
    assert metrics["weights_apart"] == pytest.approx(1.0)
    report = (tmp_path / "compare.md").read_text()
    assert "![both sessions](compare.png)" in report
    assert "## Phases of each handover \\[s\\]" in report or "## Phases of each handover [s]" in report
    assert (tmp_path / "compare.png").read_bytes().startswith(b"\x89PNG")


def test_a_session_is_like_itself(tmp_path: Path, sessions):
    document, text = compared(sessions[0], sessions[0], tmp_path)
    assert document["differing"] == []
    assert "What differs" not in text
    assert "Rates that differ" not in text
    assert not any(value for name, value in document["metrics"].items() if name.endswith("_difference"))


def test_turned_round_the_differences_change_sign(sessions):
    one, other = map(read_session, sessions)
    there, back = Comparison(one, other), Comparison(other, one)
    for pair in there.metrics():
        (turned,) = [each for each in back.metrics() if each.name == pair.name]
        assert turned.difference == pytest.approx(-pair.difference, nan_ok=True)
    assert len(there.unlike()) == len(back.unlike())
    assert [pair[::-1] for pair in there.handovers()] == back.handovers()


def test_sessions_without_bags_compare_too(tmp_path: Path):
    folders = [made.write_session(tmp_path / name / "session", None) for name in ("a", "b")]
    document, text = compared(*folders, tmp_path / "out")
    assert "a/session" in text
    assert not (tmp_path / "out" / "compare.png").exists()
    assert [Path(file).name for file in document["files"]] == ["compare.md", "compare.html"]


def test_a_crashed_session_compares_with_a_whole_one(tmp_path: Path, sessions):
    said = made.whole_cell(2)
    crashed = made.write_session(tmp_path / "crashed", said, closed=False, outcome="running", ended=None, metrics={})
    shutil.rmtree(crashed / "end")
    _, text = compared(sessions[0], crashed, tmp_path / "out")
    assert "outcome running" in text
    assert "was not closed" in text


def test_a_ratio_to_nothing_is_none():
    assert math.isnan(Pair("x", 0.0, 1.0).ratio)
    assert Pair("x", 2.0, 1.0).ratio == 0.5


def test_a_folder_that_is_no_session_is_one_line_and_exit_status_2(tmp_path: Path, sessions, capsys):
    line = ["compare", str(sessions[0]), str(tmp_path), "--out", str(tmp_path / "out")]
    assert cli.guarded(lambda: cli.app(line, standalone_mode=False, prog_name="./handover")) == cli.EXIT_BAD_INPUT
    error = capsys.readouterr().err
    assert error.startswith(f"error: {tmp_path}: is no session")
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()
