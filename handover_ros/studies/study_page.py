"""Reports as one page of HTML that needs no other file: pictures are in it."""

from __future__ import annotations

import base64
import html
import re
from collections.abc import Sequence
from pathlib import Path

from markdown_it import MarkdownIt

from handover_ros.files import write_whole

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; max-width: 70rem; margin: 2rem auto; padding: 0 1rem; }
h1 { margin-top: 3rem; border-bottom: 2px solid #0072b2; } h2 { margin-top: 2.5rem; font-size: 1.15rem; }
table { border-collapse: collapse; font-size: 0.9rem; } td, th { padding: 0.4rem 0.6rem; vertical-align: top; }
th { text-align: left; border-bottom: 2px solid #222; } td { border-bottom: 1px solid #ddd; }
img { max-width: 100%; } td strong { white-space: nowrap; }
.reproduced { color: #007a52; } .not-reproduced { color: #b03a00; } .needs-people { color: #777; }
"""
PICTURE = re.compile(r'src="([^"]+\.png)"')
VERDICT = re.compile(r"<strong>(reproduced|not reproduced|needs people)</strong>")


def write_page(path: Path, title: str, reports: Sequence[Path]) -> Path:
    """Write the reports (Markdown, pictures beside them) as one page, and return its path."""
    whole = "\n".join(_body(report) for report in reports)
    write_whole(
        path,
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{html.escape(title)}</title>\n'
        f"<style>{STYLE}</style>\n</head>\n<body>\n{whole}\n</body>\n</html>\n",
    )
    return path


def _body(report: Path) -> str:
    """Return a report as HTML with its pictures in it."""
    found = MarkdownIt("commonmark", {"html": False}).enable("table").render(report.read_text(encoding="utf-8"))
    found = VERDICT.sub(lambda match: f'<strong class="{match[1].replace(" ", "-")}">{match[1]}</strong>', found)

    def inside(match: re.Match[str]) -> str:
        picture = base64.b64encode((report.parent / match[1]).read_bytes()).decode("ascii")
        return f'src="data:image/png;base64,{picture}"'

    return PICTURE.sub(inside, found)
