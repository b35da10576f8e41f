"""The report of a session: what was run, how each handover went, what was learned, what was not as it should be."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from handover_ros.bags.timeline_picture import draw_timeline
from handover_ros.bags.timeline_types import HandoverSpan, Timeline
from handover_ros.cell.bag_command import phase_durations, span_of
from handover_ros.cell.session import RUNNING
from handover_ros.cell.session_folder import StoredSession, read_session
from handover_ros.cell.session_people import BeliefThen, PersonThen, belief_of, joint_changes
from handover_ros.errors import BadRequestError
from handover_ros.files import write_whole
from handover_ros.html_page import escaped, markdown_table, write_page

REPORT, PAGE, TIMELINE = "report.md", "report.html", "timeline.png"
PICTURES = ("phases.png", "learning.png")  # of demo, beside the report
MOST_RENDERED = 6  # pictures of handovers on the page
MOST_ROWS = 60  # of a table


def write_report(folder: Path, progress: Callable[[float], None] | None = None) -> Path:
    """Write ``report.md``, ``report.html`` and ``timeline.png`` of a session into its folder; return the page's path.

    Args:
        folder: Of a session, ended or not, with a bag or without.
        progress: Is told how much of the bag is read, 0 to 1.

    Raises:
        BadRequestError: The folder holds no session, or cannot be written to.
    """
    session = read_session(folder, progress)
    try:
        if session.timeline is not None:
            draw_timeline(session.timeline, folder / TIMELINE)
        write_whole(folder / REPORT, report_text(session))
        return write_page(folder / PAGE, f"Session {session.name}", [folder / REPORT])
    except OSError as error:
        raise BadRequestError(f"report of session {folder}: cannot be written: {error.strerror or error}") from None


def report_text(session: StoredSession) -> str:
    """Return the report as Markdown."""
    parts = [f"# Session {escaped(session.name)}\n", summary(session), overview(session)]
    if session.timeline is not None:
        parts += ["## Timeline\n", f"![what happened when]({TIMELINE})\n"]
        parts += handovers(session.timeline)
    parts += learned(session)
    parts += people(session)
    parts += settings(session)
    parts += troubles(session)
    parts += pictures(session.folder)
    parts += ["## Numbers\n", markdown_table(("number", "value"), number_rows(session))]
    parts += ["## Versions\n", markdown_table(("software", "version"), pairs(session.document.versions))]
    return "\n".join(parts)


def summary(session: StoredSession) -> str:
    """Return a sentence or two on the whole session."""
    document = session.document
    ends = {
        "ok": "It ended well.",
        "failed": "It ended, but not as it should.",
        "interrupted": "It was interrupted by the operator.",
        RUNNING: "It has no end: it still runs, or it was killed.",
    }
    told = [ends.get(document.outcome, f"Its outcome is {escaped(document.outcome)}.")]
    line = session.timeline
    if line is not None and line.handovers:
        told.append(f"{line.taken} of {len(line.handovers)} handovers ended with the object in the person's hand.")
    return " ".join(told) + "\n"


def overview(session: StoredSession) -> str:
    """Return the table of what was run and when."""
    document = session.document
    arguments = ", ".join(
        f"{name} {shown(value)}" for name, value in document.arguments.items() if told_argument(name, value)
    )
    rows = [
        ("command", escaped(document.command)),
        ("asked for", escaped(arguments) or "nothing special"),
        ("began", f"{document.began:%Y-%m-%d %H:%M:%S %Z}"),
        ("ended", f"{document.ended:%Y-%m-%d %H:%M:%S %Z}" if document.ended else "no end was written"),
        ("wall time", f"{session.duration:.0f} s" if math.isfinite(session.duration) else ""),
        ("outcome", escaped(document.outcome)),
        ("commit", escaped(document.commit) + (" (files were changed)" if document.commit.endswith("+") else "")),
        ("machine", escaped(document.host)),
        ("nodes", ", ".join(map(escaped, document.nodes))),
        ("bag", bag_words(session)),
    ]
    return markdown_table(("what", ""), rows)


def bag_words(session: StoredSession) -> str:
    """Return what is to be said about the session's bag."""
    line = session.timeline
    if line is None:
        return escaped(session.bag_note)
    words = f"{line.messages:,} messages in {line.duration:.1f} s"
    return f"{words}; {escaped(session.bag_note)}" if session.bag_note else words


def handovers(timeline: Timeline) -> list[str]:
    """Return the chapter on the handovers."""
    if not timeline.handovers:
        return ["## Handovers\n", "There was none.\n"]
    names = list(dict.fromkeys(phase.name for each in timeline.handovers for phase in each.phases))
    headings = (
        "#",
        "object",
        "scheme",
        "arm",
        "ended",
        "placed",
        "plan [s]",
        "all [s]",
        *(f"{name} [s]" for name in names),
    )
    rows = [handover_row(each, names) for each in timeline.handovers[:MOST_ROWS]]
    parts = ["## Handovers\n", markdown_table(headings, rows), left_out(timeline.handovers)]
    failed = [each for each in timeline.handovers if each.outcome != "taken"]
    if failed:
        parts += ["What the executive said of those that were not taken:\n"]
        parts += [
            f"- {each.number} {escaped(each.object_name)}: {escaped(each.message)}" for each in failed[:MOST_ROWS]
        ]
        parts += [""]
    return parts


def handover_row(handover: HandoverSpan, phases: Sequence[str]) -> list[str]:
    """Return a handover's line of the table."""
    durations = dict(phase_durations(handover))
    placed = {True: "yes", False: "no", None: ""}[handover.placed]
    return [
        str(handover.number),
        escaped(handover.object_name),
        escaped(handover.scheme),
        escaped(handover.arm),
        handover.outcome + (", dropped" if handover.dropped else ""),
        placed,
        number(handover.planning_time),
        number(handover.duration, 1),
        *(number(durations.get(name, math.nan), 1) for name in phases),
    ]


def learned(session: StoredSession) -> list[str]:
    """Return the chapter on what was learned."""
    line = session.timeline
    parts: list[str] = []
    if line is not None and line.answers:
        rows = []
        for answer in line.answers[:MOST_ROWS]:
            after = next((mark for mark in line.beliefs if mark.time >= answer.time), None)
            counted = after is not None and after.observations > 0
            rows.append(
                (
                    f"{answer.time:.1f}",
                    escaped(answer.profile_id) or "nobody known",
                    escaped(answer.object_name),
                    escaped(answer.hand),
                    escaped(answer.region) or "not seen",
                    number(after.entropy) if after is not None and counted else "",
                )
            )
        headings = ("at [s]", "person", "object", "hand", "grasp", "entropy after it [nat]")
        parts += ["How the objects were taken:\n", markdown_table(headings, rows), left_out(line.answers)]
    before = {person.profile_id: person for person in session.start}
    for person in session.end:
        first, last = belief_at_start(session, before.get(person.profile_id), person), person.belief
        if last is not None:
            parts += belief_parts(person.profile_id, first, last)
    if not any(person.belief for person in session.end) and session.belief is not None:
        parts += belief_parts(session.belief.profile_id, None, session.belief)
    return ["## What was learned\n", *(parts or ["Nothing: no answer was seen, and nobody's preference is known.\n"])]


def belief_at_start(session: StoredSession, then: PersonThen | None, now: PersonThen) -> BeliefThen | None:
    """Return what was believed of a person first: stored at the session's start, or said first in its bag."""
    if then is not None and then.belief is not None:
        return then.belief
    marks = session.timeline.beliefs if session.timeline is not None else ()
    return next((belief_of(mark) for mark in marks if mark.profile_id == now.profile_id), None)


def belief_parts(profile_id: str, first: BeliefThen | None, last: BeliefThen) -> list[str]:
    """Return what was believed of a person at the end, and how it changed."""
    name = escaped(profile_id)
    if first is None:
        beliefs = [
            (escaped(joint), number(math.degrees(neutral), 1), number(weight))
            for joint, neutral, weight in zip(last.joints, last.neutral, last.weights)
        ]
        told = f"Of {name} is believed after {last.observations} answers (entropy {number(last.entropy)} nat):\n"
        return [told, markdown_table(("joint", "neutral [deg]", "weight [1/rad²]"), beliefs)]
    told = (
        f"Of {name} was believed at first, after {first.observations} answers, entropy {number(first.entropy)} nat; "
        f"and at last, after {last.observations} answers, entropy {number(last.entropy)} nat:\n"
    )
    rows = [
        (escaped(joint), number(neutral, 1), number(neutral_after, 1), f"{neutral_after - neutral:+.1f}",
         number(weight), number(weight_after), f"{weight_after - weight:+.2f}")
        for joint, neutral, neutral_after, weight, weight_after in joint_changes(first, last)
    ]  # fmt: skip
    headings = (
        "joint", "neutral first [deg]", "last", "change", "weight first [1/rad²]", "last", "change",
    )  # fmt: skip
    return [told, markdown_table(headings, rows)]


def people(session: StoredSession) -> list[str]:
    """Return the chapter on the profiles at start and end."""
    rows = [
        (when, *row) for when, folk in (("start", session.start), ("end", session.end)) for row in people_rows(folk)
    ]
    if not rows:
        return ["## People\n", "No profile was stored.\n"]
    headings = ("at the", "profile", "person", "active", "fitted", "fit rms [mm]", "joints", "answers", "")
    return ["## People\n", markdown_table(headings, rows)]


def people_rows(folk: Iterable[PersonThen]) -> list[tuple[str, ...]]:
    """Return a row for each profile."""
    return [
        (
            escaped(person.profile_id),
            escaped(person.person),
            "yes" if person.active else "",
            escaped(person.created),
            number(1e3 * person.fit_rms),
            str(person.joints or ""),
            "" if person.belief is None else str(person.belief.observations),
            escaped(person.problem),
        )
        for person in folk
    ]


def settings(session: StoredSession) -> list[str]:
    """Return the chapter on the parameters."""
    rows = [
        (
            each.node,
            each.name,
            escaped(shown(each.value)),
            escaped(shown(each.default)) if each.default is not None else "(not set)",
        )
        for each in session.settings()
    ]
    if not rows:
        return ["## Parameters\n", "All are those of the package.\n" if session.parameters else "None are written.\n"]
    said = "Those that differ from the package's files in `config/`:\n"
    return ["## Parameters\n", said, markdown_table(("node", "parameter", "here", "in the package"), rows)]


def troubles(session: StoredSession) -> list[str]:
    """Return the chapter on what was not as it should be."""
    line = session.timeline
    parts: list[str] = []
    if line is not None:
        real = [each for each in line.troubles if not each.starting]
        rows = [
            (span_of(each), each.level, escaped(each.node), escaped(each.message), str(each.times), each.source)
            for each in real[:MOST_ROWS]
        ]
        if rows:
            headings = ("when", "level", "node", "what", "times", "seen in")
            parts += [markdown_table(headings, rows), left_out(real)]
        silent = [
            (escaped(topic.name), number(topic.rate, 1), number(topic.silence, 1), number(topic.silence_begin, 1))
            for topic in line.gaps
        ]
        if silent:
            parts += ["Topics that fell silent:\n"]
            parts += [markdown_table(("topic", "usually [Hz]", "silent for [s]", "from [s]"), silent)]
    if session.logs:
        told = [
            (escaped(each.node), each.level, escaped(each.text), str(each.times)) for each in session.logs[:MOST_ROWS]
        ]
        parts += [
            "In the nodes' logs:\n",
            markdown_table(("node", "level", "what", "times"), told),
            left_out(session.logs),
        ]
    parts += [f"- {escaped(note)}" for note in session.notes]
    starting = 0 if line is None else sum(each.starting for each in line.troubles)
    early = [f"{starting} were over soon after all nodes were up; the timeline has them in grey.\n"] if starting else []
    return ["## Troubles\n", *(parts or ["There were none that lasted.\n" if early else "There were none.\n"]), *early]


def pictures(folder: Path) -> list[str]:
    """Return the chapter with the pictures that the session left."""
    found = [folder / name for name in PICTURES if (folder / name).is_file()]
    found += sorted((folder / "pictures").glob("*.png"))[:MOST_RENDERED]
    whole = [file for file in found if file.read_bytes()[:4] == b"\x89PNG"]
    lines = [f"![{escaped(file.stem)}]({file.relative_to(folder).as_posix()})\n" for file in whole]
    return ["## Pictures\n", *lines] if lines else []


def number_rows(session: StoredSession) -> list[tuple[str, str]]:
    """Return a row for each number of the session and its bag."""
    return [(escaped(name), number(value)) for name, value in session.metrics().items()]


def pairs(values: dict[str, str]) -> list[tuple[str, str]]:
    """Return the rows of a table of names and texts."""
    return [(escaped(name), escaped(value)) for name, value in values.items()]


def left_out(entries: Sequence[Any]) -> str:
    """Return how many entries a table does not have; empty: it has all."""
    return f"and {len(entries) - MOST_ROWS} more\n" if len(entries) > MOST_ROWS else ""


def told_argument(name: str, value: Any) -> bool:
    """Return whether an argument says something about the session."""
    return name not in ("out", "json_file") and value not in (None, "", False, [])


def shown(value: Any) -> str:
    """Return a parameter's or argument's value as people write it."""
    if isinstance(value, str):
        return value or "(empty)"
    return json.dumps(value, default=str)


def number(value: float, digits: int = 2) -> str:
    """Return a number with so many digits after the point, or two that count if it is small; empty: there is none."""
    if isinstance(value, int):
        return f"{value:,}"
    if not math.isfinite(value):
        return ""
    return f"{value:,.{digits}f}" if abs(value) >= 10.0**-digits or value == 0.0 else f"{value:.2g}"
