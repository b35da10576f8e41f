"""Where missing markers are, given the markers of the same rigid segment that are seen: all of them in one batch."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
import numpy.typing as npt

from handover_ros.geometry import FloatArray

MIN_MATES = 3  # markers that fix a rotation
MIN_SPREAD = 0.01  # [m] root mean square width of the mates across their longest direction


class Predictor(IntEnum):
    """How a missing marker was predicted, best first."""

    RIGID = 0
    SHIFT = 1
    NONE = 2


def predict_from_segment(
    anchors: FloatArray, own: FloatArray, seen: npt.NDArray[np.bool_], current: FloatArray
) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Return predicted positions of k missing markers and how each was predicted.

    With three or more mates that do not lie on a line, the segment's rotation and translation since the anchor (least
    squares, Kabsch 1976); with fewer, the mates' mean shift; with none, NaN.

    Args:
        anchors: Positions of all markers [m] when the missing one was last measured, shape (k, n, 3).
        own: Its own position then [m], shape (k, 3).
        seen: Which markers are of its segment, were measured then and are measured now, shape (k, n).
        current: Positions of all markers now [m]; any finite number where not measured, shape (n, 3).

    Returns:
        Positions [m], shape (k, 3), and one :class:`Predictor` each, shape (k,).
    """
    count = np.count_nonzero(seen, axis=1)
    weights = seen / np.maximum(count, 1)[:, None]
    anchor_mean = (weights[:, None, :] @ anchors)[:, 0]
    current_mean = weights @ current
    predictor = np.where(count > 0, int(Predictor.SHIFT), int(Predictor.NONE))
    predicted = own + current_mean - anchor_mean
    predicted[count == 0] = np.nan
    enough = count >= MIN_MATES
    if np.count_nonzero(enough):
        centred = (anchors - anchor_mean[:, None]) * weights[:, :, None]
        u, singular, vt = np.linalg.svd(centred.transpose(0, 2, 1) @ current)
        u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
        turned = ((own - anchor_mean)[:, None, :] @ u @ vt)[:, 0]
        rigid = enough & (singular[:, 1] > MIN_SPREAD**2)
        predicted[rigid] = (turned + current_mean)[rigid]
        predictor[rigid] = int(Predictor.RIGID)
    return predicted, predictor
