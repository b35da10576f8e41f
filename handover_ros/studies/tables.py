"""Rows of what units found, as tidy CSV and as arrays by person and iteration."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from handover_ros.geometry import FloatArray

Rows = list[dict[str, Any]]


def csv_of(rows: Rows) -> str:
    """Return tidy CSV: one observation a row, numbers that can be read back exactly, nothing where not measured."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    file = io.StringIO()
    writer = csv.DictWriter(file, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return file.getvalue()


def merged(found: Iterable[Mapping[str, Rows]]) -> dict[str, Rows]:
    """Return the rows of each table, those of all units one after the other."""
    tables: dict[str, Rows] = {}
    for each in found:
        for name, rows in each.items():
            tables.setdefault(name, []).extend(rows)
    return tables


def only(rows: Rows, **wanted: object) -> Rows:
    """Return the rows with these values."""
    return [row for row in rows if all(row[key] == value for key, value in wanted.items())]


def column(rows: Rows, name: str) -> FloatArray:
    """Return the numbers of a column (n,), NaN where not measured."""
    return np.array([np.nan if row[name] is None else row[name] for row in rows], dtype=float)


def curves(rows: Rows, scenario: str, strategy: str, measure: str) -> FloatArray:
    """Return a measure by person and iteration (people, iterations), those in rising order."""
    kept = only(rows, scenario=scenario, strategy=strategy)
    people = sorted({row["person"] for row in kept})
    iterations = sorted({row["iteration"] for row in kept})
    table = np.full((len(people), len(iterations)), np.nan)
    for row in kept:
        if row[measure] is not None:
            table[people.index(row["person"]), iterations.index(row["iteration"])] = row[measure]
    return table


def shares(rows: Rows, scenario: str, strategy: str, name: str) -> FloatArray:
    """Return for each person the share of their queries that offered an object (people,)."""
    kept = [row for row in only(rows, scenario=scenario, strategy=strategy) if row["iteration"] > 0]
    people = sorted({row["person"] for row in kept})
    offered: npt.NDArray[np.bool_] = np.array([row["object"] == name for row in kept])
    person = np.array([row["person"] for row in kept])
    return np.array([offered[person == each].mean() for each in people])
