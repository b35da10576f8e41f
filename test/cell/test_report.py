from __future__ import annotations

import io
import json
import math
from pathlib import Path

from rich.console import Console

from handover_ros.cell.report import HandoverRecord, draw_phases, handover_table, phase_table, write_json

RECORDS = [
    HandoverRecord(1, "mug", "relative", "left", True, True, True, "fine", (("planning", 0.5), ("fetching", 6.1)), 0.4),
    HandoverRecord(2, "glass", "constant", "", False, False, False, "out of reach", (("planning", 0.2),)),
]


def test_json_has_the_stable_shape_and_no_nan(tmp_path: Path):
    write_json(tmp_path / "a" / "r.json", "demo", True, 3, {"x": math.nan, "n": 2, "y": 0.5}, files=[Path("p.png")])
    document = json.loads((tmp_path / "a" / "r.json").read_text())
    assert {"command", "ok", "seed", "versions", "metrics", "claims", "files"} <= set(document)
    assert document["metrics"] == {"x": None, "n": 2, "y": 0.5}
    assert document["seed"] == 3
    assert "numpy" in document["versions"]


def test_the_tables_name_every_handover_and_phase_in_80_columns():
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(handover_table(RECORDS), phase_table(RECORDS))
    text = console.export_text()
    for word in ("mug", "glass", "planning", "fetching", "6.1", "yes", "no"):
        assert word in text


def test_the_picture_of_the_phases_is_drawn(tmp_path: Path):
    path = draw_phases(RECORDS, tmp_path / "phases.png")
    assert path.read_bytes().startswith(b"\x89PNG")
    assert path.stat().st_size > 5000
