"""What a study writes: CSV tables, summary.json, figures and report.md with the table of claims."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from handover_ros.files import write_whole
from handover_ros.studies.claims import Claim
from handover_ros.studies.study import Figure, Study
from handover_ros.studies.tables import Rows, csv_of
from handover_ros.yaml_file import Schema


def write_tables(folder: Path, study: Study, tables: dict[str, Rows]) -> list[Path]:
    """Write each table as CSV and return the files."""
    files = []
    for name, rows in tables.items():
        files.append(folder / f"{study.name}_{name}.csv")
        write_whole(files[-1], csv_of(rows))
    return files


def write_summary(folder: Path, study: Study, settings: Schema, seed: int, claims: Sequence[Claim]) -> Path:
    """Write all claims with their tests, and the settings that they hold for."""
    path = folder / "summary.json"
    document = {
        "study": study.name,
        "seed": seed,
        "verdicts": counts(claims),
        "claims": [claim.document() for claim in claims],
        "settings": settings.model_dump(mode="json"),
    }
    write_whole(path, json.dumps(document, indent=2, allow_nan=False) + "\n")
    return path


def write_report(
    folder: Path, study: Study, settings: Schema, seed: int, claims: Sequence[Claim], figures: Sequence[Figure]
) -> Path:
    """Write the report."""
    told = ", ".join(f"{number} {verdict}" for verdict, number in counts(claims).items())
    lines = [f"# {study.title}", "", f"Seed {seed}. {len(claims)} claims: {told}.", ""]
    lines += [f"- {note}" for note in study.notes(settings)]
    lines += [
        "- A claim is reproduced when every test of its rule is significant (p < 0.05); intervals are of 95 %.",
        "",
        "| claim | dissertation | ours | verdict |",
        "|---|---|---|---|",
    ]
    lines += [f"| {claim.text} | {claim.dissertation} | {claim.ours} | **{claim.verdict}** |" for claim in claims]
    for figure in figures:
        lines += ["", f"## Figure {figure.number}", "", f"![{figure.caption}]({figure.files[0].name})", ""]
        lines.append(figure.caption)
    path = folder / "report.md"
    write_whole(path, "\n".join(lines) + "\n")
    return path


def counts(claims: Sequence[Claim]) -> dict[str, int]:
    """Return how many claims have each verdict."""
    return dict(Counter(claim.verdict for claim in claims))
