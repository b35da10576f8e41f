"""Undoes label swaps within a frame by assigning measured positions to predicted ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from handover_ros.geometry import FloatArray

IndexArray = npt.NDArray[np.intp]
REFUSED = 1e3  # [m] cost of a match outside the gate
EXPLAINED = 0.9  # share of many suspicious samples that swaps must explain to be believed


@dataclass(frozen=True, eq=False)
class Assignment:
    """What suspicious samples turned out to be.

    Attributes:
        sources: Labels under which the samples came, in the source.
        targets: Labels they belong to, as many.
        unexplained: Labels whose sample belongs nowhere.
    """

    sources: IndexArray
    targets: IndexArray
    unexplained: IndexArray


def assign(
    suspects: IndexArray, vacant: IndexArray, measured: FloatArray, predicted: FloatArray, gate: FloatArray, total: int
) -> Assignment:
    """Assign suspicious samples to the labels they belong to.

    The cheapest one-to-one assignment of the suspects' samples to the suspects' own labels and the vacant ones
    (Kuhn 1955), no match farther than the target's gate. When more than half of all samples are suspicious, the body
    moved unseen rather than being relabelled: then only an assignment that explains nearly all of them counts.

    Args:
        suspects: Labels whose sample does not fit, shape (s,).
        vacant: Known labels without a sample, shape (v,).
        measured: Positions as labelled by the source [m], shape (n, 3).
        predicted: Expected positions [m], shape (n, 3).
        gate: Largest believable distance from the prediction [m], shape (n,).
        total: Number of samples in the frame.
    """
    labels = np.concatenate([suspects, vacant])
    cost = np.linalg.norm(measured[suspects][:, None] - predicted[labels][None], axis=2)
    cost = np.where(cost <= gate[labels][None], cost, REFUSED)
    rows, columns = linear_sum_assignment(cost)
    matched = cost[rows, columns] < REFUSED
    if 2 * len(suspects) > total > 3 and matched.sum() < EXPLAINED * len(suspects):
        return Assignment(suspects[:0], suspects[:0], suspects)
    unexplained = np.setdiff1d(suspects, suspects[rows[matched]])
    return Assignment(suspects[rows[matched]], labels[columns[matched]], unexplained)
