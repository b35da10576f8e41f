"""``handover compare``: two sessions side by side, in the terminal and as a page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from handover_ros.bags.timeline_types import HandoverSpan
from handover_ros.cell.bag_command import phase_durations
from handover_ros.cell.compare_picture import draw_comparison
from handover_ros.cell.late_progress import LateProgress
from handover_ros.cell.report import output_folder, write_json
from handover_ros.cell.session import plain
from handover_ros.cell.session_compare import Comparison, Pair
from handover_ros.cell.session_folder import read_document, read_session
from handover_ros.cell.session_report import MOST_ROWS, number, shown
from handover_ros.files import write_whole
from handover_ros.html_page import escaped, markdown_table, write_page

TOLD_LENGTH = 36  # letters of a value in the terminal
PICTURE = "compare.png"


@dataclass(frozen=True)
class CompareRequest:
    """What ``handover compare`` was asked for.

    Attributes:
        first: Folder of a session.
        second: Folder of another.
        json_file: Where to write the numbers too.
        out: Folder of everything written.
    """

    first: Path
    second: Path
    json_file: Path | None = None
    out: Path | None = None


@dataclass(frozen=True)
class Chapter:
    """A table of the comparison.

    Attributes:
        title: Of it.
        headings: Of its columns.
        rows: As text.
        words: Columns, from the left, that hold words and no numbers.
    """

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    words: int = 1

    def table(self) -> Table:
        """Return it for the terminal."""
        table = Table(title=escape(self.title), title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
        for column, heading in enumerate(self.headings):
            table.add_column(escape(heading), justify="left" if column < self.words else "right", overflow="fold")
        for row in self.rows[:MOST_ROWS]:
            table.add_row(
                *(escape(text if len(text) <= TOLD_LENGTH else f"{text[: TOLD_LENGTH - 3]}...") for text in row)
            )
        return table

    def markdown(self) -> str:
        """Return it for the report."""
        rows = [[escaped(text) for text in row] for row in self.rows]
        return f"## {escaped(self.title)}\n\n{markdown_table([escaped(text) for text in self.headings], rows)}"


def run_compare(request: CompareRequest, console: Console) -> int:
    """Compare two sessions: tell, draw and write; return the exit status.

    Raises:
        HandoverError: A folder holds no session.
    """
    for folder in (request.first, request.second):
        read_document(folder)  # before a bag is read
    with LateProgress(console, "reading") as bar:
        comparison = Comparison(
            read_session(request.first, lambda done: bar.update(0.5 * done)),
            read_session(request.second, lambda done: bar.update(0.5 + 0.5 * done)),
        )
    chapters = [chapter for chapter in chapters_of(comparison) if chapter.rows]
    for name, session in zip(comparison.names, comparison.both):
        console.print(session_line(name, session), highlight=False, markup=False, soft_wrap=True)
    for chapter in chapters:
        console.print(chapter.table())
        if len(chapter.rows) > MOST_ROWS:
            console.print(f"and {len(chapter.rows) - MOST_ROWS} more, see the page")
    folder = output_folder(request.out, "compare")
    picture = draw_comparison(comparison, folder / PICTURE)
    report = folder / "compare.md"
    write_whole(report, report_text(comparison, chapters, picture is not None))
    page = write_page(folder / "compare.html", " and ".join(comparison.names), [report])
    files = [report, page, *filter(None, [picture])]
    more: dict[str, Any] = {
        "sessions": [str(session.folder) for session in comparison.both],
        "session_metrics": [
            {name: plain(value) for name, value in session.metrics().items()} for session in comparison.both
        ],
        "differing": [
            {"kind": each.kind, "name": each.name, "first": plain(each.first), "second": plain(each.second)}
            for each in comparison.unlike()
        ],
        "folder": str(folder),
    }
    for target in filter(None, (folder / "compare.json", request.json_file)):
        write_json(target, "compare", True, 0, comparison.numbers(), files=files, **more)
    console.print(f"everything is in {folder}", highlight=False, markup=False, soft_wrap=True)
    return 0


def session_line(name: str, session: Any) -> str:
    """Return a line on one of the sessions."""
    document = session.document
    line = f"{name}: {document.command}, {document.began:%Y-%m-%d %H:%M:%S %Z}, outcome {document.outcome}"
    return f"{line}; {session.bag_note}" if session.bag_note else line


def chapters_of(comparison: Comparison) -> list[Chapter]:
    """Return the tables of a comparison; those without rows too."""
    names = comparison.names
    unlike = tuple(
        (each.kind, each.name, value_text(each.first), value_text(each.second)) for each in comparison.unlike()
    )
    more = ("difference", "ratio")
    return [
        Chapter("What differs", ("kind", "name", *names), unlike, words=4),
        Chapter("Handovers", ("#", "object", "ended", "all [s]", "plan [s]"), handover_rows(comparison), words=3),
        Chapter("Median of the phases [s]", ("phase", *names, *more), pair_rows(comparison.phases())),
        Chapter(belief_title(comparison), ("number", *names, *more), pair_rows(comparison.beliefs())),
        Chapter("Rates that differ [Hz]", ("topic", *names, *more), pair_rows(comparison.rates())),
        Chapter("Numbers", ("number", *names, *more), pair_rows(comparison.metrics())),
    ]


def belief_title(comparison: Comparison) -> str:
    """Return the title of the table of beliefs, with whom they are about."""
    people = dict.fromkeys(session.belief.profile_id for session in comparison.both if session.belief is not None)
    return f"Believed at the end of {' and '.join(people)}"


def handover_rows(comparison: Comparison) -> tuple[tuple[str, ...], ...]:
    """Return the handovers, both sessions in one cell where they differ."""
    rows = []
    for place, pair in enumerate(comparison.handovers(), start=1):
        row = [str(place)]
        row += [one_or_both([text(each) if each else "none" for each in pair]) for text in (object_text, outcome_text)]
        row += [one_or_both([number(value(each), digits) if each else "none" for each in pair])
                for value, digits in ((duration_of, 1), (planning_of, 2))]  # fmt: skip
        rows.append(tuple(row))
    return tuple(rows)


def object_text(handover: HandoverSpan) -> str:
    """Return what was handed over."""
    return handover.object_name


def outcome_text(handover: HandoverSpan) -> str:
    """Return how a handover ended."""
    return handover.outcome + (", dropped" if handover.dropped else "")


def duration_of(handover: HandoverSpan) -> float:
    """Return how long a handover took [s]."""
    return handover.duration


def planning_of(handover: HandoverSpan) -> float:
    """Return how long its plan took [s], by the wall clock."""
    return handover.planning_time


def one_or_both(texts: Sequence[str]) -> str:
    """Return two texts as one where they are the same."""
    return texts[0] if texts[0] == texts[1] else " | ".join(text or "unknown" for text in texts)


def pair_rows(pairs: Sequence[Pair]) -> tuple[tuple[str, ...], ...]:
    """Return a row for each number."""
    return tuple((pair.name, *pair_texts(pair)) for pair in pairs)


def pair_texts(pair: Pair, digits: int = 2) -> tuple[str, str, str, str]:
    """Return the number of both, the difference and the ratio."""
    difference = number(pair.difference, digits)
    sign = "+" if pair.difference > 0 else ""
    ratio = f"{pair.ratio:.2f}" if math.isfinite(pair.ratio) else ""
    return number(pair.first, digits), number(pair.second, digits), sign + difference, ratio


def value_text(value: Any) -> str:
    """Return a version, argument or parameter as text."""
    return "(not there)" if value is None else shown(value)


def report_text(comparison: Comparison, chapters: Sequence[Chapter], picture: bool) -> str:
    """Return the comparison as Markdown."""
    first, second = map(escaped, comparison.names)
    parts = [f"# {first} and {second}\n"]
    parts += [f"- {escaped(session_line(name, session))}" for name, session in zip(comparison.names, comparison.both)]
    parts += ["", f"![both sessions]({PICTURE})\n" if picture else ""]
    parts += [chapter.markdown() for chapter in chapters]
    parts += phase_chapter(comparison)
    return "\n".join(parts)


def phase_chapter(comparison: Comparison) -> list[str]:
    """Return the table of each handover's phases, for the page only."""
    pairs = comparison.handovers()
    names = list(dict.fromkeys(phase.name for pair in pairs for each in pair if each for phase in each.phases))
    if not names:
        return []
    rows = []
    for place, pair in enumerate(pairs, start=1):
        for name, each in zip(comparison.names, pair):
            if each is not None:
                durations = dict(phase_durations(each))
                told = [number(durations.get(phase, math.nan), 1) for phase in names]
                rows.append([str(place), escaped(name), escaped(each.object_name), each.outcome, *told])
    return ["## Phases of each handover [s]\n", markdown_table(("#", "session", "object", "ended", *names), rows)]
