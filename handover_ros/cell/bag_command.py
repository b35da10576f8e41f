"""``handover bag``: what is in a bag, with a picture of its timeline; what can be saved of one that was cut short."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from handover_ros.bags.definitions import Definitions, difference
from handover_ros.bags.reading import BAG, Bag, bag_folder, clock
from handover_ros.bags.rescue import rescue
from handover_ros.bags.timeline import read_timeline
from handover_ros.bags.timeline_picture import draw_timeline
from handover_ros.bags.timeline_types import HandoverSpan, Timeline, Trouble, plain
from handover_ros.cell.late_progress import LateProgress
from handover_ros.cell.report import HandoverRecord, handover_table, output_folder, phase_table, write_json
from handover_ros.errors import HandoverError

MEGABYTE = 1e6
TOLD = 12  # troubles, answers and handovers that are printed


@dataclass(frozen=True)
class BagInfoRequest:
    """What ``handover bag info`` was asked for.

    Attributes:
        bag: Folder of a bag or of a session, or a storage file.
        json_file: Where to write the numbers too.
        out: Folder of everything written.
    """

    bag: Path
    json_file: Path | None = None
    out: Path | None = None


@dataclass(frozen=True)
class BagRescueRequest:
    """What ``handover bag rescue`` was asked for.

    Attributes:
        bag: Folder of a bag or of a session, or a storage file.
        out: Folder of the new bag; None: beside the old one.
    """

    bag: Path
    out: Path | None = None


def run_bag_info(request: BagInfoRequest, console: Console) -> int:
    """Tell, draw and write what is in a bag; return the exit status.

    Raises:
        HandoverError: There is no bag, or it is cut short or damaged.
    """
    with LateProgress(console, "reading") as bar, Bag(request.bag) as bag:
        timeline = read_timeline(bag, bar.update)
        different = other_definitions(bag)
        about: dict[str, str] = {"path": str(bag.path), "storage": bag.storage, "note": bag.note}
        megabytes = bag.size / MEGABYTE
    folder = output_folder(request.out, "bag-info")
    picture = draw_timeline(timeline, folder / "timeline.png")
    metrics = {
        **timeline.metrics(),
        "megabytes": megabytes,
        "whole": int(not about["note"]),
        "other_definitions": len(different),
    }
    for line in bag_lines(timeline, metrics, about):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    console.print(topic_table(timeline))
    for name, what in different.items():
        console.print(f"[yellow]differs from the installed definition:[/yellow] {escape(name)}: {escape(what)}",
                      highlight=False, soft_wrap=True)  # fmt: skip
    tell_happenings(timeline, console)
    topics = [
        {
            "name": topic.name,
            "type": topic.type_name,
            "messages": topic.messages,
            "rate_hz": plain(topic.rate),
            "latched": topic.latched,
            "regular": topic.regular,
            "longest_silence_s": plain(topic.silence),
            "definition": different.get(topic.name, ""),
        }
        for topic in timeline.topics
    ]
    for target in filter(None, (folder / "info.json", request.json_file)):
        write_json(
            target, "bag info", True, 0, metrics, files=[picture], bag=about, topic_list=topics, folder=str(folder),
            timeline=timeline.document(),
        )  # fmt: skip
    console.print(f"everything is in {folder}", highlight=False, markup=False, soft_wrap=True)
    return 0


def run_bag_rescue(request: BagRescueRequest, console: Console) -> int:
    """Make a whole bag of what is left of one and return the exit status.

    Raises:
        HandoverError: Nothing can be read, or the new folder exists.
    """
    source = bag_folder(request.bag)
    # A file's name goes without its suffix, a session's bag is named after the session.
    named = source.parent if source.name == BAG and source.is_dir() and request.bag != source else source
    target = request.out or named.with_name(f"{named.stem if named.is_file() else named.resolve().name}_rescued")
    saved = rescue(source, target)
    console.print(
        f"{saved.messages:,} messages up to {clock(saved.end)} are in {saved.path}",
        highlight=False, markup=False, soft_wrap=True,
    )  # fmt: skip
    return 0


def other_definitions(bag: Bag) -> dict[str, str]:
    """Return for each topic in what its message type differs from the installed one, where it does."""
    installed, found, known = Definitions(), {}, {}
    for name, topic in bag.topics.items():
        if topic.type_name not in known:
            try:
                own = installed.of(topic.type_name)
                known[topic.type_name] = difference(topic.type_name, topic.definition, topic.digest, own)
            except HandoverError:
                known[topic.type_name] = f"{topic.type_name} is not installed"
        if known[topic.type_name]:
            found[name] = known[topic.type_name]
    return found


def bag_lines(timeline: Timeline, metrics: dict[str, float], about: dict[str, str]) -> list[str]:
    """Return the lines on the bag as a whole."""
    lines = [
        f"{about['path']}: {about['storage']}, {metrics['megabytes']:.1f} MB, {timeline.messages:,} messages of "
        f"{metrics['topics']} topics",
        f"from {clock(timeline.start)}, {timeline.duration:.1f} s long" if timeline.messages else "it is empty",
    ]
    begin = timeline.ros_time(0.0)
    if math.isfinite(begin):
        rate = timeline.clock_rate
        passed = f", passing {rate:.2f} times as fast" if math.isfinite(rate) else ""
        lines.append(f"ROS time (/clock): from {begin:.1f} s{passed}")
    lines.append(about["note"] or "it is whole")
    if timeline.unreadable:
        lines.append(f"{timeline.unreadable} messages cannot be decoded and are only counted")
    return lines


def topic_table(timeline: Timeline) -> Table:
    """Return the table of the topics, for a terminal of 80 columns."""
    table = Table(title="Topics", title_justify="left", box=SIMPLE_HEAD, padding=0, pad_edge=False)
    table.add_column("topic", overflow="fold")
    table.add_column("type", overflow="fold")
    for heading in ("messages", "Hz"):
        table.add_column(heading, justify="right")
    for topic in timeline.topics:
        rate = "latched" if topic.latched else f"{topic.rate:.1f}" if topic.regular else ""
        kind = topic.type_name.replace("/msg/", "/")
        table.add_row(escape(topic.name), escape(kind), f"{topic.messages:,}", rate)
    return table


def tell_happenings(timeline: Timeline, console: Console) -> None:
    """Print what happened: handovers, answers, belief, troubles, silences."""
    if timeline.handovers:
        records = [record_of(handover) for handover in timeline.handovers]
        console.print(handover_table(records[:TOLD]), phase_table(records[:TOLD]))
        if len(records) > TOLD:
            console.print(f"and {len(records) - TOLD} more; {timeline.taken} of {len(records)} were taken")
    lines = [
        *(f"handover {each.number} {each.object_name} ({each.outcome}): {each.message}" for each in timeline.handovers
          if each.outcome != "taken"),
        *belief_lines(timeline),
        *trouble_lines(timeline.troubles),
        *(f"{topic.name} ({topic.rate:.0f} Hz) was silent for {topic.silence:.1f} s from {topic.silence_begin:.1f} s on"
          for topic in timeline.gaps),
    ]  # fmt: skip
    for line in lines:
        console.print(line, highlight=False, markup=False, soft_wrap=True)


def record_of(handover: HandoverSpan) -> HandoverRecord:
    """Return a handover of a bag as commands report theirs."""
    return HandoverRecord(
        number=handover.number,
        object_name=handover.object_name,
        scheme=handover.scheme,
        arm=handover.arm,
        success=bool(handover.taken),
        taken=bool(handover.taken),
        placed=bool(handover.placed),
        message=handover.message,
        phases=phase_durations(handover),
        planning_time=handover.planning_time,
    )


def phase_durations(handover: HandoverSpan) -> tuple[tuple[str, float], ...]:
    """Return how long each phase took [s]; one that came twice counts once, with both."""
    durations: dict[str, float] = {}
    for phase in handover.phases:
        durations[phase.name] = durations.get(phase.name, 0.0) + phase.seconds
    return tuple(durations.items())


def belief_lines(timeline: Timeline) -> list[str]:
    """Return a line for each person on what was learned of them."""
    lines = []
    for person in dict.fromkeys(belief.profile_id for belief in timeline.beliefs):
        marks = [belief for belief in timeline.beliefs if belief.profile_id == person]
        first, last = marks[0], marks[-1]
        lines.append(
            f"belief about {person}: {first.observations} answers, entropy {first.entropy:.2f} nat, at first; "
            f"{last.observations} answers, {last.entropy:.2f} nat, at last"
        )
    return lines


def trouble_lines(troubles: Sequence[Trouble], most: int = TOLD) -> list[str]:
    """Return a line for each trouble that is not of the start."""
    real = [trouble for trouble in troubles if not trouble.starting]
    lines = [
        f"{each.level} {span_of(each)}: {each.node}: {each.message}" + (f" ({each.times} times)" * (each.times > 1))
        for each in real[:most]
    ]
    return lines + ([f"and {len(real) - most} more troubles"] if len(real) > most else [])


def span_of(trouble: Trouble) -> str:
    """Return when a trouble was."""
    if trouble.end - trouble.begin < 0.1:
        return f"at {trouble.begin:.1f} s"
    return f"from {trouble.begin:.1f} to {trouble.end:.1f} s"
