"""A calibration for people to read: what is wrong first, then the joints, the markers, and what could be better."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from handover_ros.skeleton.calibration_report import CalibrationReport
from handover_ros.skeleton.tree import JointKind, Skeleton

UNKNOWN = "-"


def print_report(console: Console, skeleton: Skeleton, report: CalibrationReport) -> None:
    """Print a calibration's report for a terminal of 80 columns."""
    print_sentences(console, "Problems: the fit must not be used", report.problems, "red")
    console.print(joint_table(skeleton, report))
    console.print(marker_table(report))
    console.print(
        f"{report.frames} frames fitted in {report.seconds:.1f} s to {millimetres(report.fit_rms)} mm rms; "
        f"{millimetres(report.heldout_mean)} mm mean error on {report.heldout_frames} frames left out; "
        f"{100.0 * report.missing_fraction:.1f} % of the marker samples missing",
        highlight=False,
    )
    print_sentences(console, "Could be better", report.advice, "yellow")


def print_sentences(console: Console, title: str, sentences: Sequence[str], colour: str) -> None:
    """Print sentences as a list, nothing when there are none."""
    if sentences:
        console.print(f"[{colour}]{title}[/{colour}]")
        for sentence in sentences:
            console.print(Text(f"  - {sentence}"), soft_wrap=True)


def joint_table(skeleton: Skeleton, report: CalibrationReport) -> Table:
    """Return the table of all displacements: limits, range seen, how well their joint is known."""
    table = Table(title="Joints", title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("displacement", no_wrap=True)
    for heading in ("lower", "upper", "moved", "axis known to", "place known to"):
        table.add_column(heading, justify="right")
    kinds = {joint.name: joint.kind for joint in skeleton.joints}
    for joint in report.joints:
        length = kinds.get(joint.name) is JointKind.PRISMATIC
        values = [measure(value, length) for value in (joint.lower, joint.upper, joint.moved)]
        ball = kinds.get(joint.name) is JointKind.BALL
        table.add_row(
            joint.displacement,
            *values,
            UNKNOWN if ball else degrees(joint.axis_error, 1),
            UNKNOWN if length else f"{millimetres(joint.point_error)} mm",
        )
    return table


def marker_table(report: CalibrationReport) -> Table:
    """Return the table of the markers' errors."""
    table = Table(title="Markers [mm]", title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("marker", no_wrap=True)
    table.add_column("segment", no_wrap=True)
    table.add_column("fitted, rms", justify="right")
    table.add_column("left out, mean", justify="right")
    for marker in report.markers:
        table.add_row(marker.name, marker.segment, millimetres(marker.fitted_rms), millimetres(marker.heldout_mean))
    return table


def measure(value: float, length: bool) -> str:
    """Return a displacement with its unit: degrees, or millimetres of a prismatic joint."""
    return f"{millimetres(value)} mm" if length and math.isfinite(value) else degrees(value)


def degrees(value: float, digits: int = 0) -> str:
    """Return an angle [rad] in degrees."""
    return f"{math.degrees(value):.{digits}f} deg" if math.isfinite(value) else UNKNOWN


def millimetres(value: float) -> str:
    """Return a length [m] in millimetres."""
    return f"{1e3 * value:.1f}" if math.isfinite(value) else UNKNOWN
