"""What a command leaves behind: the stable JSON, the table of handovers, the picture of their phases."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

import matplotlib
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from handover_ros.colours import OTHER_COLOUR, PHASE_COLOURS
from handover_ros.errors import BadRequestError
from handover_ros.files import write_whole
from handover_ros.provenance import versions


@dataclass(frozen=True)
class HandoverRecord:
    """One handover as it went.

    Attributes:
        number: 1, 2, ...
        object_name: What was handed over.
        scheme: How the pose was chosen.
        arm: The robot's arm; empty when none was chosen.
        success: The executive's verdict.
        taken: True state: the object ended in the person's hand.
        placed: True state: the person brought it to its goal.
        message: The executive's sentence.
        phases: (name, duration [s] of ROS time), in order.
        planning_time: [s] wall time of the plan.
        pictures: Rendered pictures.
    """

    number: int
    object_name: str
    scheme: str
    arm: str
    success: bool
    taken: bool
    placed: bool
    message: str
    phases: tuple[tuple[str, float], ...] = ()
    planning_time: float = float("nan")
    pictures: tuple[Path, ...] = field(default_factory=tuple)

    @property
    def duration(self) -> float:
        """Duration of all phases [s]."""
        return sum(seconds for _, seconds in self.phases)


def output_folder(out: Path | None, command: str) -> Path:
    """Return the folder to write to, made if need be.

    Raises:
        BadRequestError: It cannot be made.
    """
    folder = out or Path("handover_out") / f"{command}-{datetime.now():%Y%m%d-%H%M%S}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadRequestError(f"--out {folder}: cannot be made: {error.strerror}") from None
    return folder.resolve()


def write_json(
    path: Path,
    command: str,
    ok: bool,
    seed: int,
    metrics: dict[str, float],
    claims: Sequence[dict[str, object]] = (),
    files: Sequence[Path] = (),
    **more: object,
) -> None:
    """Write a command's result in the one stable shape, whole or not at all.

    Numbers that are not finite become null.
    """
    document = {
        "command": command,
        "ok": ok,
        "seed": seed,
        "versions": versions(),
        "metrics": {key: finite(value) for key, value in metrics.items()},
        "claims": list(claims),
        "files": [str(file) for file in files],
        **more,
    }
    write_whole(path, json.dumps(document, indent=2, allow_nan=False) + "\n")


def finite(value: float) -> float | int | None:
    """Return a plain JSON number, None for NaN and infinity."""
    if isinstance(value, int):
        return int(value)
    return float(value) if math.isfinite(value) else None


def handover_table(records: Sequence[HandoverRecord]) -> Table:
    """Return the table of how the handovers ended, for a terminal of 80 columns."""
    table = Table(title="Handovers", title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for heading in ("#", "object", "scheme", "arm", "taken", "placed"):
        table.add_column(heading)
    table.add_column(escape("duration [s]"), justify="right")
    table.add_column(escape("planning [s wall]"), justify="right")
    for record in records:
        table.add_row(
            str(record.number),
            record.object_name,
            record.scheme,
            record.arm,
            "yes" if record.taken else "[red]no[/red]",
            "yes" if record.placed else "no",
            f"{record.duration:.1f}",
            f"{record.planning_time:.2f}" if math.isfinite(record.planning_time) else "",
        )
    return table


def phase_table(records: Sequence[HandoverRecord]) -> Table:
    """Return the table of how long each phase took, in seconds of ROS time, for a terminal of 80 columns."""
    table = Table(title=escape("Phases [s]"), title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("#")
    names = list(dict.fromkeys(name for record in records for name, _ in record.phases))
    for name in names:
        table.add_column(name, justify="right")
    for record in records:
        durations = dict(record.phases)
        table.add_row(str(record.number), *(f"{durations[name]:.1f}" if name in durations else "" for name in names))
    return table


def draw_phases(records: Sequence[HandoverRecord], path: Path) -> Path:
    """Draw the phases of each handover as bars over time and return the PNG's path."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(9.0, 1.4 + 0.45 * len(records)), layout="constrained")
    for row, record in enumerate(records):
        start = 0.0
        for name, seconds in record.phases:
            axes.barh(row, seconds, left=start, color=PHASE_COLOURS.get(name, OTHER_COLOUR), edgecolor="white")
            if seconds > 0.9:
                axes.text(start + seconds / 2, row, f"{seconds:.1f}", ha="center", va="center", fontsize=8)
            start += seconds
        axes.text(start + 0.1, row, "taken" if record.taken else "not taken", va="center", fontsize=8)
    axes.set_yticks(range(len(records)), [f"{record.number} {record.object_name}" for record in records])
    axes.invert_yaxis()
    axes.set_xlabel("time [s]")
    axes.margins(x=0.08)
    axes.spines[["top", "right"]].set_visible(False)
    used = dict.fromkeys(name for record in records for name, _ in record.phases)
    handles = [pyplot.Rectangle((0, 0), 1, 1, color=PHASE_COLOURS.get(name, OTHER_COLOUR)) for name in used]
    axes.legend(handles, list(used), loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=6, frameon=False, fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)
    pyplot.close(figure)
    return path
