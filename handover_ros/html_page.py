"""Markdown as one page of HTML that needs no other file: pictures are in it."""

from __future__ import annotations

import base64
import html
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from markdown_it import MarkdownIt

from handover_ros.files import write_whole

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; max-width: 70rem; margin: 2rem auto; padding: 0 1rem; }
h1 { margin-top: 3rem; border-bottom: 2px solid #0072b2; } h2 { margin-top: 2.5rem; font-size: 1.15rem; }
table { border-collapse: collapse; font-size: 0.9rem; } td, th { padding: 0.4rem 0.6rem; vertical-align: top; }
th { text-align: left; border-bottom: 2px solid #222; } td { border-bottom: 1px solid #ddd; }
img { max-width: 100%; } td strong { white-space: nowrap; }
"""
PICTURE = re.compile(r'src="([^"]+\.png)"')
SPECIAL = re.compile(r"([\\`*\[\]<>|#~]|(?<![^\W_])_|_(?![^\W_]))")  # an underscore within a word is none


def write_page(
    path: Path, title: str, reports: Sequence[Path], dress: Callable[[str], str] = str, style: str = ""
) -> Path:
    """Write reports as one page and return its path.

    Args:
        path: Of the page.
        title: Of the page.
        reports: Markdown files; their pictures are PNG files beside them.
        dress: What is done to each report's HTML.
        style: More rules of style.
    """
    whole = "\n".join(dress(_body(report)) for report in reports)
    write_whole(
        path,
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{html.escape(title)}</title>\n'
        f"<style>{STYLE}{style}</style>\n</head>\n<body>\n{whole}\n</body>\n</html>\n",
    )
    return path


def markdown_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table as Markdown; what is in the cells is taken as it is, so escape text that comes from outside."""
    lines = [headings, ["---"] * len(headings), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def escaped(text: str) -> str:
    """Return any text in one line so that Markdown shows it as it is."""
    return SPECIAL.sub(r"\\\1", " ".join(text.split()))


def _body(report: Path) -> str:
    """Return a report as HTML with its pictures in it."""
    found = str(MarkdownIt("commonmark", {"html": False}).enable("table").render(report.read_text(encoding="utf-8")))

    def inside(match: re.Match[str]) -> str:
        picture = base64.b64encode((report.parent / match[1]).read_bytes()).decode("ascii")
        return f'src="data:image/png;base64,{picture}"'

    return PICTURE.sub(inside, found)
