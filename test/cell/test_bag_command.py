"""handover bag: what is in a bag, told, drawn and written; what can be saved of one; bad input in one line."""

from __future__ import annotations

import io
import json
import shutil
from pathlib import Path

import made_bags as made
import pytest
from rich.console import Console

from handover_ros import cli
from handover_ros.bags.definitions import Definition, Definitions
from handover_ros.bags.reading import Bag
from handover_ros.bags.recording import BagWriter
from handover_ros.cell.bag_command import BagInfoRequest, BagRescueRequest, run_bag_info, run_bag_rescue
from handover_ros.errors import BadRecordingError, BadRequestError


def told(bag: Path, out: Path) -> tuple[dict, str]:
    """Return the JSON and what was printed of ``handover bag info``."""
    console = Console(width=80, record=True, file=io.StringIO())
    assert run_bag_info(BagInfoRequest(bag, out / "numbers.json", out), console) == 0
    assert (out / "info.json").read_text() == (out / "numbers.json").read_text()
    assert (out / "timeline.png").read_bytes().startswith(b"\x89PNG")
    return json.loads((out / "info.json").read_text()), console.export_text()


@pytest.fixture(scope="module")
def said():
    return made.whole_cell(3)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_whole_bag(tmp_path: Path, said, storage):
    bag = made.write_bag(tmp_path / "bag", said, storage)
    document, text = told(bag, tmp_path / "out")
    assert {"command", "ok", "seed", "versions", "metrics", "claims", "files"} <= set(document)
    metrics = document["metrics"]
    assert (metrics["messages"], metrics["handovers"], metrics["taken"], metrics["whole"]) == (len(said), 3, 2, 1)
    assert metrics["duration_s"] == pytest.approx(29.0, abs=0.1)
    assert metrics["megabytes"] > 0.0
    assert metrics["other_definitions"] == 0
    assert document["bag"]["storage"] == storage
    for line in (
        "it is whole", "/sim/markers", "handover_msgs/MarkerFrame", "50.0", "latched", "glass", "nobody took it",
        "belief about anna: 0 answers, entropy 11.00 nat", "2 answers, 9.00 nat",
    ):  # fmt: skip
        assert line in text, f"{line!r} is missing"
    assert max(map(len, text.split("everything is in")[0].splitlines())) <= 200


def test_a_folder_a_file_and_a_session_tell_the_same(tmp_path: Path, said):
    session = made.write_session(tmp_path / "session", said)
    wanted = told(session / "bag", tmp_path / "out")[0]["metrics"]
    assert told(session, tmp_path / "of_session")[0]["metrics"] == wanted
    assert told(session / "bag" / "bag.mcap", tmp_path / "of_file")[0]["metrics"] == wanted


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_bag_that_was_not_closed(tmp_path: Path, said, storage):
    bag = made.write_bag(tmp_path / "bag", said, storage, closed=False)
    document, text = told(bag, tmp_path / "out")
    assert (document["metrics"]["messages"], document["metrics"]["whole"]) == (len(said), 0)
    assert "was not closed" in text


def test_an_empty_bag_and_one_with_markers_only(tmp_path: Path):
    assert told(made.write_bag(tmp_path / "empty", []), tmp_path / "a")[0]["metrics"]["messages"] == 0
    document, text = told(made.write_bag(tmp_path / "markers", made.markers(0.0, 2.0, 240.0)), tmp_path / "b")
    assert document["metrics"]["handovers"] == 0
    assert "240.0" in text


def test_a_definition_that_differs_and_one_that_is_not_installed_have_a_line(tmp_path: Path):
    frame = "handover_msgs/msg/MarkerFrame"
    try:
        text = Definitions().of(frame).text
    except Exception:
        pytest.skip("handover_msgs is not built")
    writer = BagWriter(tmp_path / "bag")
    writer.add("/mocap/markers", frame, Definition("string more\n" + text, "RIHS01_0"), [])
    writer.add("/other", "their_msgs/msg/Thing", Definition("int32 a\n", "RIHS01_0"), [])
    writer.write("/other", "their_msgs/msg/Thing", 1, b"\x00\x01\x00\x00\x01\x00\x00\x00")
    writer.close()
    document, text = told(tmp_path / "bag", tmp_path / "out")
    assert "/mocap/markers: field more is in the bag only" in text
    assert "/other: their_msgs/msg/Thing is not installed" in text
    assert document["metrics"]["other_definitions"] == 2


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_what_is_left_of_a_cut_bag_is_rescued(tmp_path: Path, said, storage):
    """Its information is refused with the command to type; what that command makes can be looked at."""
    bag = made.write_bag(tmp_path / "bag", said, storage)
    file = next(path for path in bag.iterdir() if path.suffix in (".mcap", ".db3"))
    with file.open("r+b") as stream:
        stream.truncate(int(0.6 * file.stat().st_size))
    with pytest.raises(BadRecordingError, match="bag rescue"):
        told(bag, tmp_path / "out")
    console = Console(width=80, record=True, file=io.StringIO())
    assert run_bag_rescue(BagRescueRequest(bag), console) == 0
    with Bag(tmp_path / "bag_rescued") as saved:
        assert 0 < saved.messages < len(said)
        assert f"{saved.messages:,} messages up to" in console.export_text()
    told(tmp_path / "bag_rescued", tmp_path / "out")
    with pytest.raises(BadRequestError, match="name another folder"):
        run_bag_rescue(BagRescueRequest(bag), console)
    assert run_bag_rescue(BagRescueRequest(bag, tmp_path / "elsewhere"), console) == 0


def test_the_rescued_bag_of_a_file_or_session_stands_beside_it(tmp_path: Path, said):
    session = made.write_session(tmp_path / "monday", said, closed=False)
    shutil.copy(session / "bag" / "bag.mcap", tmp_path / "single.mcap")
    console = Console(file=io.StringIO())
    run_bag_rescue(BagRescueRequest(session), console)
    run_bag_rescue(BagRescueRequest(tmp_path / "single.mcap"), console)
    assert (tmp_path / "monday_rescued" / "metadata.yaml").is_file()
    assert (tmp_path / "single_rescued" / "metadata.yaml").is_file()


@pytest.mark.parametrize("command", ["info", "rescue"])
@pytest.mark.parametrize("content", ["absent", "empty folder", "no bag", "rubbish"])
def test_bad_input_is_one_line_and_exit_status_2(tmp_path: Path, capsys, command, content):
    bag = tmp_path / "it"
    if content != "absent":
        bag.mkdir()
    if content == "no bag":
        (bag / "notes.txt").write_text("hello")
    if content == "rubbish":
        (bag / "bag.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(range(256)) * 4)
    line = ["bag", command, str(bag), "--out", str(tmp_path / "out")]
    assert cli.guarded(lambda: cli.app(line, standalone_mode=False, prog_name="./handover")) == cli.EXIT_BAD_INPUT
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert str(bag) in error
    assert not (tmp_path / "out").exists()


def test_the_commands_are_there(tmp_path: Path, said, monkeypatch):
    monkeypatch.chdir(tmp_path)
    made.write_bag(tmp_path / "bag", said)
    assert cli.guarded(lambda: cli.app(["bag", "info", "bag", "--json", "n.json"], standalone_mode=False)) == 0
    assert json.loads((tmp_path / "n.json").read_text())["command"] == "bag info"
    assert next((tmp_path / "handover_out").glob("bag-info-*/timeline.png")).is_file()
    assert cli.guarded(lambda: cli.app(["bag", "rescue", "bag"], standalone_mode=False)) == 0
    assert (tmp_path / "bag_rescued").is_dir()
