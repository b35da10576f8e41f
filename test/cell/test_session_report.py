"""A session's report is written whatever is left of the session."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import made_bags as made
import numpy as np
import pytest
from planar_people import answer_of, random_query, whole_space
from profiles import profile_of

from handover_ros.cell.belief_store import BeliefStore
from handover_ros.cell.session_folder import HERE, is_session, read_session, trouble_lines
from handover_ros.cell.session_report import number, write_report
from handover_ros.cell.store import ProfileStore
from handover_ros.errors import BadRequestError
from handover_ros.preferences.belief import first_belief
from handover_ros.preferences.belief_file import PersonBelief
from handover_ros.preferences.prior import Prior
from handover_ros.preferences.query import chosen


def add_person(folder: Path, answers: int, name: str = "anna") -> None:
    """Store a person with a belief after so many answers in a copy of the store, active."""
    store = ProfileStore(folder)
    store.save(profile_of(name))
    store.activate(name)
    rng = np.random.default_rng(0)
    belief = first_belief(Prior(whole_space()), 200, seed=4)
    truth = whole_space().people(belief.particles[:1])
    for _ in range(answers):
        query = random_query(rng)
        belief = belief.updated(query, chosen(answer_of(truth, query, rng)))
    BeliefStore(folder).save(PersonBelief(name, belief, tuple(map(str, range(answers))), (0.5,) * answers))


def report_of(folder: Path) -> str:
    page = write_report(folder)
    assert page == folder / "report.html"
    text = (folder / "report.md").read_text()
    html = page.read_text()
    assert text.startswith(f"# Session {folder.name}")
    assert not re.search(r'src="(?!data:)', html), "a picture is not in the page"
    assert html.count("data:image/png") == len(re.findall(r"!\[", text))
    for name in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", text):
        assert (folder / name).is_file()
    return text


def test_a_whole_session(tmp_path: Path):
    folder = made.write_session(tmp_path / "monday", made.whole_cell(3))
    add_person(folder / "start", 0)
    add_person(folder / "end", 2)
    (folder / "log" / "planner_node.log").write_text(
        "[WARN] [1.5] [planner_node]: the | is_near <b>\nerror: no *arm*\n"
    )
    shutil.copy(made_png(tmp_path), folder / "phases.png")
    text = report_of(folder)
    for words in (
        "It ended well. 2 of 3 handovers", "scheme personal", "2026-01-31 12:00:00 UTC", "60 s",
        "| 1 | glass | personal | left | taken | yes | 0.40 |", "| 3 | glass | personal | left | not taken | no |",
        "- 3 glass: nobody took it", "| 7.1 | anna | glass | right | handle | 10.00 |",
        "Of anna was believed at first, after 0 answers", "at last, after 2 answers",
        "| executive_node | pull_threshold | 5.5 | 4.0 |", "![phases](phases.png)", "| numpy | 2.4.6 |",
        "the \\| is_near \\<b\\>", "no \\*arm\\*", "| ready_s | 5.50 |",
    ):  # fmt: skip
        assert words in text, f"{words!r} is missing"
    assert "| recorder_node | bag" not in text  # the session's own folder is no difference
    assert re.search(r"\| start \| anna .*\| 0 \|", text)
    assert re.search(r"\| end \| anna .*\| 2 \|", text)
    assert (folder / "timeline.png").is_file()


def made_png(folder: Path) -> Path:
    from matplotlib.image import imsave

    imsave(folder / "dot.png", np.zeros((2, 2)))
    return folder / "dot.png"


def test_a_session_without_a_bag_or_anything_else(tmp_path: Path):
    folder = made.write_session(tmp_path / "bare", None)
    for part in ("start", "end", "log", "parameters"):
        shutil.rmtree(folder / part)
    text = report_of(folder)
    assert "nothing was recorded" in text
    assert not (folder / "timeline.png").exists()


def test_a_crashed_session(tmp_path: Path):
    """No end, a bag that was not closed and is cut, a belief that is cut, parameters that are rubbish."""
    said = made.markers(0.0, 30.0, 100.0) + made.whole_cell(3)
    folder = made.write_session(tmp_path / "crashed", said, closed=False, outcome="running", ended=None, metrics={})
    with (folder / "bag" / "bag.mcap").open("r+b") as stream:
        stream.truncate(int(0.8 * (folder / "bag" / "bag.mcap").stat().st_size))
    add_person(folder / "start", 1)
    with (folder / "start" / "beliefs" / "anna.npz").open("r+b") as stream:
        stream.truncate(500)
    (folder / "parameters" / "executive_node.yaml").write_text("executive_node: [")
    shutil.rmtree(folder / "end")
    trace = "Traceback (most recent call last):\n  File 'x', line 1\n    f()\nValueError: it broke\n"
    (folder / "log" / "sim_node.log").write_text(trace + "later\n")
    text = report_of(folder)
    for words in ("it still runs, or it was killed", "was not closed", "ValueError: it broke", "cut short",
                  "parameters/executive_node.yaml: cannot be read", "## Timeline"):  # fmt: skip
        assert words in text, f"{words!r} is missing"
    assert "later" not in text


def test_what_the_graph_said_stands_for_a_belief_that_is_not_stored(tmp_path: Path):
    folder = made.write_session(tmp_path / "unstored", made.whole_cell(2))
    belief = read_session(folder).belief
    assert belief is not None
    assert (belief.profile_id, belief.observations, belief.joints) == ("anna", 2, made.JOINTS)
    assert "Of anna is believed after 2 answers" in report_of(folder)


def test_a_bag_that_nothing_can_be_read_of_is_told(tmp_path: Path):
    folder = made.write_session(tmp_path / "broken", made.whole_cell(1))
    (folder / "bag" / "bag.mcap").write_bytes(b"rubbish")
    assert "cut short or damaged" in report_of(folder)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "there is no session.json"),
        ("{", "session.json: "),
        ('{"format": 1}', "command: Field required"),
        (json.dumps({"format": 9, "command": "demo", "began": "2026-01-31T12:00:00Z", "outcome": "ok"}), "format is 9"),
    ],
)
def test_a_folder_that_is_no_session_is_refused(tmp_path: Path, content, words):
    if content is not None:
        (tmp_path / "session.json").write_text(content)
    assert is_session(tmp_path) == (content is not None)
    with pytest.raises(BadRequestError, match=words) as raised:
        write_report(tmp_path)
    assert "\n" not in str(raised.value)
    assert not (tmp_path / "report.md").exists()


def test_parameters_are_the_same_wherever_the_session_was(tmp_path: Path):
    one, other = (made.write_session(tmp_path / name, None) for name in ("one", "other"))
    moved = tmp_path / "moved"
    shutil.move(other, moved)
    assert read_session(one).parameters == read_session(moved).parameters
    assert read_session(moved).parameters["recorder_node"]["bag"] == f"{HERE}/bag"


def test_a_line_of_a_log_that_comes_again_is_told_once(tmp_path: Path):
    log = tmp_path / "sim_node.log"
    log.write_text("[INFO] [1.0] [a]: x\n" + "[ERROR] [1.0] [a]: bad\n[WARN] [2.0] [a]: odd\n" * 3)
    assert [(line.level, line.text, line.times) for line in trouble_lines(log)] == [
        ("error", "bad", 3), ("warning", "odd", 3),
    ]  # fmt: skip
    assert trouble_lines(tmp_path / "none.log") == []


def test_numbers_are_short():
    values = (1234, 0.5, 0.00529, float("nan"), 12345.678, 0.0)
    assert [number(value) for value in values] == ["1,234", "0.50", "0.0053", "", "12,345.68", "0.00"]
