"""The rows of chapter 3 beside each other: each level of a factor as an array over the same blocks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.studies.tables import Rows, only


def beside(rows: Rows, factor: str, value: str, blocks: Sequence[str]) -> dict[str, FloatArray]:
    """Return a value by level of a factor, in the order in which levels come, each over all blocks (b,).

    A block's value is the mean of its rows; NaN where there is none.

    Args:
        rows: Of one table.
        factor: Column whose levels are compared.
        value: Column that is compared.
        blocks: Columns that tell which rows belong together; sorted by them.
    """
    keys = sorted({tuple(row[name] for name in blocks) for row in rows})
    place = {key: number for number, key in enumerate(keys)}
    levels = list(dict.fromkeys(row[factor] for row in rows))
    sums = {level: np.zeros(len(keys)) for level in levels}
    counts = {level: np.zeros(len(keys)) for level in levels}
    for row in rows:
        if row[value] is not None and np.isfinite(row[value]):
            block = place[tuple(row[name] for name in blocks)]
            sums[row[factor]][block] += row[value]
            counts[row[factor]][block] += 1
    return {
        level: np.divide(sums[level], counts[level], out=np.full(len(keys), np.nan), where=counts[level] > 0)
        for level in levels
    }


def costs_by_person(rows: Rows, value: str = "cost") -> dict[tuple[str, str], FloatArray]:
    """Return the mismatch's costs over goals (goals,), by (assumed, true) person."""
    pairs = sorted({(str(row["assumed"]), str(row["true"])) for row in rows})
    return {
        (assumed, true): beside(only(rows, assumed=assumed, true=true), "assumed", value, ("goal",))[assumed]
        for assumed, true in pairs
    }
