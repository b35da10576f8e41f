"""``handover study``: works on a study's units, settles its claims, draws its figures, writes its report."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from handover_ros.cell.late_progress import LateProgress
from handover_ros.cell.report import output_folder, write_json
from handover_ros.studies.claims import Claim
from handover_ros.studies.registry import ALL, STUDIES, study_named
from handover_ros.studies.study import Study
from handover_ros.studies.study_page import write_page
from handover_ros.studies.study_report import counts, write_report, write_summary, write_tables
from handover_ros.studies.tables import merged
from handover_ros.studies.units import unit_store, work_on

COLOURS = {"reproduced": "green", "not reproduced": "red", "needs people": "dim"}


@dataclass(frozen=True)
class StudyRequest:
    """What ``handover study`` was asked for.

    Attributes:
        name: Of the study.
        quick: Whether with fewer people.
        jobs: Number of processes.
        seed: Of all random numbers.
        json_file: Where to write the numbers too.
        out: Folder of everything written; an interrupted run goes on there.
    """

    name: str
    quick: bool = False
    jobs: int = 1
    seed: int = 1
    json_file: Path | None = None
    out: Path | None = None


def run_study(request: StudyRequest, console: Console) -> int:
    """Run a study, or all of them, and return the exit status.

    Raises:
        HandoverError: Bad input.
    """
    wanted = [*STUDIES.values()] if request.name == ALL else [study_named(request.name)]
    folder = output_folder(request.out, f"study-{request.name}")
    began = time.perf_counter()
    metrics: dict[str, float] = {}
    claims: list[Claim] = []
    files: list[Path] = []
    pages: list[Path] = []
    for study in wanted:
        if len(wanted) > 1:
            console.print(f"[bold]{study.title}[/bold]")
        own = run_one(study, request, folder / study.name if len(wanted) > 1 else folder, console)
        for name, value in own.metrics.items():
            metrics[f"{study.name}_{name}" if len(wanted) > 1 else name] = value
        claims += own.claims
        files += own.files
        pages.append(own.report)
    metrics["seconds"] = time.perf_counter() - began
    title = "All studies" if len(wanted) > 1 else wanted[0].title
    files.append(write_page(folder / "report.html", title, pages))
    documents = [claim.document() for claim in claims]
    for target in filter(None, (folder / "study.json", request.json_file)):
        write_json(
            target, "study", True, request.seed, metrics, documents, files, study=request.name, folder=str(folder)
        )
    console.print(f"everything is in {folder}; begin with report.html", highlight=False, soft_wrap=True)
    return 0


@dataclass(frozen=True)
class Ran:
    """What a study's run left.

    Attributes:
        metrics: Numbers of the run.
        claims: With their verdicts.
        files: All that was written.
        report: ``report.md``.
    """

    metrics: dict[str, float]
    claims: list[Claim]
    files: list[Path]
    report: Path


def run_one(study: Study, request: StudyRequest, folder: Path, console: Console) -> Ran:
    """Run one study into a folder, and print its claims."""
    folder.mkdir(parents=True, exist_ok=True)
    settings = study.settings(request.quick)
    units = study.units(settings)
    began = time.perf_counter()
    kept: list[int] = []
    with LateProgress(console, study.name) as bar:

        def told(done: int, every: int) -> None:
            kept.append(done)
            bar.update(done / every, f"{done} of {every} parts")

        store = unit_store(folder, study.name, settings, request.seed)
        found = work_on(units, study.work, settings, request.seed, store, request.jobs, told)
    worked = time.perf_counter() - began
    tables = merged(found)
    claims = study.claims(settings, tables)
    files = write_tables(folder, study, tables)
    files.append(write_summary(folder, study, settings, request.seed, claims))
    figures = study.figures(settings, tables, request.seed, folder)
    files += [file for figure in figures for file in figure.files]
    report = write_report(folder, study, settings, request.seed, claims, figures)
    console.print(table_of(claims))
    metrics: dict[str, float] = {
        "parts": len(units),
        "parts_kept": kept[0],
        "work_s": worked,
        "seconds": time.perf_counter() - began,
        **{f"claims_{verdict.replace(' ', '_')}": number for verdict, number in counts(claims).items()},
    }
    return Ran(metrics, claims, [*files, report], report)


def table_of(claims: list[Claim]) -> Table:
    """Return the table of claims for a terminal."""
    table = Table(title="Claims", title_justify="left", box=SIMPLE_HEAD)
    for heading in ("claim", "ours", "verdict"):
        table.add_column(heading, no_wrap=heading == "verdict")
    for claim in claims:
        table.add_row(claim.text, claim.ours, f"[{COLOURS[claim.verdict]}]{claim.verdict}[/]")
    return table
