"""What is remembered of the markers' arrangement: who is near whom, and the distances within rigid segments."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from handover_ros.geometry import FloatArray

BoolArray = npt.NDArray[np.bool_]

LEARN_EVERY = 16  # frames
MEMORY = 64  # lessons over which distances are averaged
MIN_LESSONS = 4
TOO_CLOSE = 0.005  # [m] markers nearer than this cannot be told apart
CROSSED = -0.2  # share of the squared distance below which the measured difference points the other way


class ShapeMemory:
    """Neighbours and segment distances of n markers, learned from frames in which all is well.

    Args:
        mates: Which markers share a segment, shape (n, n).
        neighbour_distance: Markers closer than this [m] are neighbours.
    """

    def __init__(self, mates: BoolArray, neighbour_distance: float) -> None:
        n = len(mates)
        self._mates = mates
        self._neighbour_distance = neighbour_distance
        self._first = np.zeros(0, dtype=np.intp)
        self._second = np.zeros(0, dtype=np.intp)
        self._distance = np.zeros((n, n))
        self._lessons = np.zeros((n, n))
        self._countdown = 0

    def learn(self, positions: FloatArray, measured: BoolArray) -> None:
        """Take in a frame; only every 16th costs anything. Positions [m] (n, 3), NaN or anything where not measured."""
        self._countdown -= 1
        if self._countdown > 0:
            return
        self._countdown = LEARN_EVERY
        difference = positions[:, None] - positions[None]
        distance = np.sqrt(np.einsum("ijk,ijk->ij", difference, difference))
        both = measured[:, None] & measured[None]
        near = both & (distance > TOO_CLOSE) & (distance < self._neighbour_distance)
        self._first, self._second = np.nonzero(np.triu(near, 1))
        self._lessons[both] = np.minimum(self._lessons[both] + 1, MEMORY)
        self._distance[both] += (distance[both] - self._distance[both]) / self._lessons[both]

    def crossed_pairs(self, measured: FloatArray, predicted: FloatArray) -> BoolArray:
        """Return which neighbour pairs lie the other way round than predicted.

        Exchanging the samples a and b of two markers lowers the sum of squared distances to the predictions p and q
        exactly when (a - b) . (p - q) < 0.
        """
        expected = predicted[self._first] - predicted[self._second]
        difference = measured[self._first] - measured[self._second]
        along = np.einsum("ij,ij->i", difference, expected)
        return along < CROSSED * np.einsum("ij,ij->i", expected, expected)

    def crossed_markers(self, crossed: BoolArray, sharp: BoolArray) -> BoolArray:
        """Return which markers are in a crossed pair of markers whose predictions are both ``sharp``, shape (n,)."""
        markers = np.zeros(len(self._mates), dtype=bool)
        if crossed.any():
            pairs = crossed & sharp[self._first] & sharp[self._second]
            markers[self._first[pairs]] = True
            markers[self._second[pairs]] = True
        return markers

    def misfit(self, positions: FloatArray, involved: npt.NDArray[np.intp]) -> float:
        """Return the mean misfit [m] of the distances between ``involved`` markers and their segment; 0 if unknown."""
        difference = positions[involved][:, None] - positions[None]
        distance = np.sqrt(np.einsum("ijk,ijk->ij", difference, difference))
        usable = self._mates[involved] & (self._lessons[involved] >= MIN_LESSONS) & np.isfinite(distance)
        if not usable.any():
            return 0.0
        return float(np.abs(distance - self._distance[involved])[usable].mean())
