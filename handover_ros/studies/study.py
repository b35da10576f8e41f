"""What a study is: settings, units of work, and what is made of what they found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from handover_ros.studies.claims import Claim
from handover_ros.studies.tables import Rows
from handover_ros.studies.units import Unit, Work
from handover_ros.yaml_file import Schema


@dataclass(frozen=True)
class Figure:
    """A figure of a study.

    Attributes:
        number: Of the dissertation's figure.
        caption: What it shows.
        files: PNG first.
    """

    number: str
    caption: str
    files: tuple[Path, ...]


@dataclass(frozen=True)
class Study:
    """A study, whose settings are the first argument of all its functions.

    Attributes:
        name: As the command knows it.
        title: Of the report.
        settings: Returns them; quick or in full.
        units: Its parts.
        work: What is done for one part; a module's function.
        claims: Of the tables that the units found.
        figures: Drawn into a folder, of the tables and the seed.
        notes: For the report: what was simulated and how.
    """

    name: str
    title: str
    settings: Callable[[bool], Schema]
    units: Callable[[Any], list[Unit]]
    work: Work
    claims: Callable[[Any, dict[str, Rows]], list[Claim]]
    figures: Callable[[Any, dict[str, Rows], int, Path], list[Figure]]
    notes: Callable[[Any], Sequence[str]]
