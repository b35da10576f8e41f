"""The picture of a bag's timeline: handovers, events, belief, troubles, and how often each topic spoke."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import numpy.typing as npt

from handover_ros.bags.reading import BAG, clock
from handover_ros.bags.timeline_types import ERROR, HandoverSpan, Timeline, TopicCourse, Trouble
from handover_ros.colours import BAD, EVENT_COLOURS, GOOD, NEUTRAL, OTHER_COLOUR, PHASE_COLOURS, WARNING

WIDTH = 12.0  # [in]
LETTER = 0.0062  # width of a letter of 8 points, as a share of the axes
MOST_TOPICS, MOST_NODES = 40, 12
PLAIN_TEXT: Any = {"text.parse_math": False}  # names and messages are no formulas
STEADY = 15.0  # messages in a bin from which on their number is steady
BELIEF_COLOUR = "#5b4b8a"
MARKS = {"taken": "^", "placed": "v", "dropped": "X", "grasped": "o", "released": "o", "fault": "P", "person": "s"}


def draw_timeline(timeline: Timeline, path: Path) -> Path:
    """Draw what happened in a bag and return the PNG's path; what the bag knows nothing of has no panel."""
    matplotlib.use("Agg")
    with matplotlib.rc_context(PLAIN_TEXT):
        return _draw(timeline, path)


def _draw(timeline: Timeline, path: Path) -> Path:
    from matplotlib import pyplot

    panels = panels_of(timeline)
    heights = [height for height, _ in panels]
    figure, grid = pyplot.subplots(
        len(panels), 1, figsize=(WIDTH, 1.0 + sum(heights)), height_ratios=heights, sharex=True, squeeze=False,
        layout="constrained",
    )  # fmt: skip
    span = max(timeline.duration, 1e-3)
    for axes, (_, draw) in zip(grid[:, 0], panels, strict=True):
        draw(axes, timeline, span)
    grid[-1, 0].set_xlim(0.0, span)
    grid[-1, 0].set_xlabel("time since the first message [s]", fontsize=9)
    figure.suptitle(headline(timeline), fontsize=10, x=0.01, ha="left")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
    pyplot.close(figure)
    return path


Draw = Callable[[Any, Timeline, float], None]  # axes, what happened, length of the time axis [s]


def panels_of(timeline: Timeline) -> list[tuple[float, Draw]]:
    """Return the panels that there is something for: (height [in], what draws it)."""
    panels: list[tuple[float, Draw]] = []
    if timeline.handovers:
        panels.append((1.35, draw_handovers))
    if timeline.events or timeline.answers or any(each.profile_id for each in timeline.activations):
        panels.append((0.55 + 0.19 * len(event_rows(timeline)), draw_events))
    if timeline.beliefs:
        panels.append((1.5, draw_belief))
    if timeline.troubles or timeline.gaps:
        panels.append((0.55 + 0.21 * len(trouble_rows(timeline)), draw_troubles))
    panels.append((0.6 + 0.155 * max(3, len(spoken(timeline))), draw_rates))
    return panels


def headline(timeline: Timeline) -> str:
    """Return the title: which bag, when, how long, how much."""
    rate = timeline.clock_rate
    ros = f", ROS time passed {rate:.2f} times as fast" if np.isfinite(rate) and abs(rate - 1.0) > 0.05 else ""
    name = "/".join(timeline.path.parts[-2:]) if timeline.path.name == BAG else timeline.path.name
    when = f", {clock(timeline.start)[:19]}" if timeline.messages else ""
    return f"{name}{when}: {timeline.duration:.1f} s, {timeline.messages:,} messages{ros}"


def draw_handovers(axes: Any, timeline: Timeline, span: float) -> None:
    """Draw the phases of each handover as bars, with object and outcome above."""
    free = [-np.inf, -np.inf]  # where the text of a row ends
    for handover in timeline.handovers:
        for phase in handover.phases:
            colour = PHASE_COLOURS.get(phase.name, OTHER_COLOUR)
            axes.barh(0.0, phase.end - phase.begin, left=phase.begin, height=0.8, color=colour)
        text, colour = handover_label(handover)
        for words in (text, text[:1]):  # too many for their names: the outcome only
            width = LETTER * len(words) * span
            begin = min(handover.begin, span - width)
            row = next((row for row in (0, 1) if begin >= free[row]), None)
            if row is not None:
                axes.text(begin, 0.5 + 0.42 * row, words, fontsize=8, color=colour, va="bottom")
                free[row] = begin + width
                break
    axes.set_ylim(-0.5, 0.95 if free[1] < 0.0 else 1.4)
    axes.set_yticks([])
    name_panel(axes, "handovers")
    used = dict.fromkeys(phase.name for handover in timeline.handovers for phase in handover.phases)
    if used:
        from matplotlib.patches import Patch

        names = [name for name in PHASE_COLOURS if name in used] + [name for name in used if name not in PHASE_COLOURS]
        handles = [Patch(color=PHASE_COLOURS.get(name, OTHER_COLOUR), label=name) for name in names]
        axes.legend(
            handles=handles, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(names), frameon=False, fontsize=8,
            handlelength=1.0, columnspacing=1.2, borderaxespad=0.0,
        )  # fmt: skip


def handover_label(handover: HandoverSpan) -> tuple[str, str]:
    """Return what is written over a handover, and in which colour."""
    sign = {"taken": "✓", "not taken": "✗", "unknown": "?", "under way": "…"}[handover.outcome]
    colour = {"taken": GOOD, "not taken": BAD}.get(handover.outcome, NEUTRAL)
    fell = ", dropped" if handover.dropped else ""
    return f"{sign} {handover.number} {handover.object_name}{fell}", colour


def event_rows(timeline: Timeline) -> list[str]:
    """Return the rows of the panel of events, from the bottom."""
    kinds = dict.fromkeys(event.kind for event in timeline.events)
    rows = [kind for kind in EVENT_COLOURS if kind in kinds] + [kind for kind in kinds if kind not in EVENT_COLOURS]
    rows += ["answer"] if timeline.answers else []
    rows += ["profile"] if any(each.profile_id for each in timeline.activations) else []
    return rows[::-1]


def draw_events(axes: Any, timeline: Timeline, span: float) -> None:
    """Draw what the simulation noticed, how objects were taken, and who was active."""
    rows = event_rows(timeline)
    for event in timeline.events:
        marker, colour = MARKS.get(event.kind, "d"), EVENT_COLOURS.get(event.kind, OTHER_COLOUR)
        by_person = event.holder.startswith("person") or event.kind not in ("grasped", "released")
        face = colour if by_person else "white"
        axes.plot(event.time, rows.index(event.kind), marker, color=colour, markerfacecolor=face, markersize=5)
    texts = [
        (answer.time, rows.index("answer"), answer.region.replace("_", " ") or "grasp not seen")
        for answer in timeline.answers
    ]
    for active in timeline.activations:
        if "profile" in rows and (active.profile_id or active is not timeline.activations[0]):
            texts.append((active.time, rows.index("profile"), active.profile_id or "nobody"))
    write_along(axes, span, texts)
    axes.set_yticks(range(len(rows)), rows, fontsize=8)
    axes.set_ylim(-0.7, len(rows) - 0.3)
    name_panel(axes, "events")


def write_along(axes: Any, span: float, texts: Sequence[tuple[float, int, str]]) -> None:
    """Mark points (time, row, text) and write the text beside each, where the next one leaves room."""
    for time, row, text in texts:
        axes.plot(time, row, "D", color=BELIEF_COLOUR, markersize=4)
        others = [other for other, its_row, _ in texts if its_row == row and other != time]
        width = LETTER * (len(text) + 2) * span
        if width < min((other for other in others if other > time), default=span) - time:
            place, align = (5, 0), "left"
        elif time > max(others, default=0.0) and width < time - max(others, default=0.0):  # the last one
            place, align = (-5, 0), "right"
        else:
            continue
        axes.annotate(text, (time, row), place, textcoords="offset points", fontsize=7.5, va="center", ha=align)


def draw_belief(axes: Any, timeline: Timeline, span: float, colour: str = BELIEF_COLOUR, label: str = "") -> None:
    """Draw the entropy of the belief, and after which answers it was so; a line for each person."""
    del span
    beliefs = timeline.beliefs
    people = dict.fromkeys(belief.profile_id for belief in beliefs)
    for style, person in zip(("-", "--", ":", "-.") * (1 + len(people) // 4), people):
        marks = [belief for belief in beliefs if belief.profile_id == person]
        times = [*(mark.time for mark in marks), timeline.duration]
        entropies = [mark.entropy for mark in marks]
        told = " ".join(filter(None, (label, person)))
        axes.step(times, [*entropies, entropies[-1]], style, where="post", color=colour, label=told)
        axes.plot(times[:-1], entropies, "o", color=colour, markersize=4)
        for mark in marks if len(marks) <= 25 else ():
            axes.annotate(
                str(mark.observations), (mark.time, mark.entropy), (4, 3), textcoords="offset points", fontsize=8
            )
    axes.margins(y=0.3)
    axes.tick_params(axis="y", labelsize=8)
    axes.set_ylabel("entropy [nat]", fontsize=8)
    if people:
        axes.legend(frameon=False, fontsize=8, loc="lower left")
    name_panel(axes, "belief, after so many answers")


def trouble_rows(timeline: Timeline) -> list[str]:
    """Return the rows of the panel of troubles, from the bottom: nodes, and topics that fell silent."""
    rows = list(dict.fromkeys(trouble.node for trouble in worst_first(timeline)))[:MOST_NODES]
    rows += [topic.name for topic in timeline.gaps][: max(3, MOST_NODES - len(rows))]
    return rows[::-1]


def worst_first(timeline: Timeline) -> list[Trouble]:
    """Return the troubles, errors first, those of the start last."""
    return sorted(timeline.troubles, key=lambda trouble: (trouble.starting, trouble.level != ERROR, trouble.begin))


def draw_troubles(axes: Any, timeline: Timeline, span: float) -> None:
    """Draw who complained from when to when, and what was said."""
    rows = trouble_rows(timeline)
    shown = [trouble for trouble in worst_first(timeline) if trouble.node in rows]
    taken: dict[int, list[tuple[float, float]]] = {}
    for trouble in shown:
        taken.setdefault(rows.index(trouble.node), []).append((trouble.begin, trouble.end))
    for trouble in shown:
        row = rows.index(trouble.node)
        colour = NEUTRAL if trouble.starting else BAD if trouble.level == ERROR else WARNING
        length = trouble.end - trouble.begin
        if length > 0.004 * span:
            axes.barh(row, length, left=trouble.begin, height=0.55, color=colour, alpha=0.45 if trouble.starting else 1)
        else:
            axes.plot(trouble.begin, row, "|" if trouble.starting else "X", color=colour, markersize=7)
        write_beside(axes, span, row, (trouble.begin, trouble.end), trouble.message, colour, taken)
    for topic in timeline.gaps:
        if topic.name in rows:
            row = rows.index(topic.name)
            place = (topic.silence_begin, topic.silence_begin + topic.silence)
            axes.barh(row, topic.silence, left=place[0], height=0.55, color=BAD, hatch="///", edgecolor="white")
            write_beside(axes, span, row, place, f"silent for {topic.silence:.1f} s", BAD, taken)
    axes.set_yticks(range(len(rows)), rows, fontsize=8)
    axes.set_ylim(-0.7, len(rows) - 0.3)
    name_panel(axes, "troubles (grey: of the start)")


def write_beside(
    axes: Any,
    span: float,
    row: int,
    place: tuple[float, float],
    text: str,
    colour: str,
    taken: dict[int, list[tuple[float, float]]],
) -> None:
    """Write what was said right of its bar, or left of it, where nothing is written yet."""
    text = text if len(text) <= 70 else text[:67] + "..."
    width = LETTER * (len(text) + 1) * span
    pad = 0.006 * span
    used = taken.setdefault(row, [])
    for begin, align in ((place[1] + pad, "left"), (place[0] - pad - width, "right")):
        end = begin + width
        if begin >= 0.0 and end <= span and all(end < low or begin > high for low, high in used):
            x = begin if align == "left" else end
            axes.text(x, row, text, fontsize=7.5, color=colour, va="center", ha=align)
            used.append((begin, end))
            return


def spoken(timeline: Timeline) -> list[TopicCourse]:
    """Return the topics that have a row, the most talkative ones if there are many."""
    topics = [topic for topic in timeline.topics if topic.messages]
    kept = sorted(topics, key=lambda topic: (not topic.regular, -topic.messages))[:MOST_TOPICS]
    return sorted(kept, key=lambda topic: topic.name)


def draw_rates(axes: Any, timeline: Timeline, span: float) -> None:
    """Draw a strip for each topic: how many messages came, relative to its busiest times."""
    topics = spoken(timeline)
    del span
    image = rate_image(topics, timeline.bin_width)
    if image.size:
        extent = (0.0, max(timeline.duration, 1e-3), len(topics) - 0.5, -0.5)
        axes.imshow(
            image, aspect="auto", interpolation="nearest", extent=extent, vmin=0.0, vmax=1.0, cmap=_strip_colours()
        )
    for row in range(1, len(topics)):
        axes.axhline(row - 0.5, color="white", linewidth=1.0)
    axes.set_yticks(range(len(topics)), [topic.name for topic in topics], fontsize=7.5)
    for row, topic in enumerate(topics):
        told = f"{topic.rate:.3g} Hz" if topic.regular else f"{topic.messages:,}"
        axes.text(1.005, row, told, fontsize=7.5, va="center", transform=axes.get_yaxis_transform(), color=NEUTRAL)
    left_out = sum(topic.messages > 0 for topic in timeline.topics) - len(topics)
    more = f", {left_out} more topics" if left_out else ""
    name_panel(axes, f"messages of each topic (rate, or how many{more})" if topics else "there is no message")
    axes.tick_params(axis="x", labelsize=8)


def rate_image(topics: Sequence[TopicCourse], bin_width: float) -> npt.NDArray[np.float64]:
    """Return for each topic and time bin 0 (nothing) to 1 (as busy as it is most of the time).

    Counts of a slow regular topic are averaged over neighbouring bins of ``bin_width`` [s]: they would only show how
    its period and the bins interfere.
    """
    rows = []
    for topic in topics:
        counts = topic.counts.astype(float)
        expected = topic.rate * bin_width if topic.regular else np.inf
        if 0.0 < expected < STEADY:
            window = np.ones(min(len(counts) // 8 * 2 + 1, int(STEADY / expected) // 2 * 2 + 1))
            counts = np.convolve(counts, window, "same") / np.convolve(np.ones(len(counts)), window, "same")
        busy = counts[counts > 0.0]
        usual = np.quantile(busy, 0.9) if busy.size else 1.0
        rows.append(np.where(counts > 0.0, 0.25 + 0.75 * np.clip(counts / usual, 0.0, 1.0), 0.0))
    return np.array(rows, float)


def _strip_colours() -> Any:
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("strip", ["#f4f4f2", "#d5e3ef", "#7aa6cc", "#2f6a9f"])


def name_panel(axes: Any, name: str) -> None:
    """Write what a panel shows over its upper left corner, and leave out what only frames it."""
    axes.set_title(name, fontsize=9, loc="left", color=NEUTRAL, pad=3)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="x", color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
