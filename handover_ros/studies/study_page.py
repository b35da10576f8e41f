"""Reports of studies as one page of HTML, with the verdicts in colour."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from handover_ros import html_page

STYLE = """.reproduced { color: #007a52; } .not-reproduced { color: #b03a00; } .needs-people { color: #777; }
"""
VERDICT = re.compile(r"<strong>(reproduced|not reproduced|needs people)</strong>")


def write_page(path: Path, title: str, reports: Sequence[Path]) -> Path:
    """Write the reports (Markdown, pictures beside them) as one page, and return its path."""
    return html_page.write_page(path, title, reports, _with_verdicts, STYLE)


def _with_verdicts(page: str) -> str:
    return VERDICT.sub(lambda match: f'<strong class="{match[1].replace(" ", "-")}">{match[1]}</strong>', page)
