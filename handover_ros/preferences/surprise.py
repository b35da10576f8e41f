"""Whether a person still answers as believed: how unlikely answers are, and when they are more than chance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import combine_pvalues

from handover_ros.preferences.belief import Belief
from handover_ros.preferences.likelihood import survey
from handover_ros.preferences.query import Answer, Query

ANSWERS = 6  # looked at together
LEAST_CHANCE = 1e-3  # of answers as unlikely as these, below which the person has changed


def unlikeliness(belief: Belief, query: Query, answer: Answer) -> float:
    """Return the predicted probability of answers no likelier than this one, in (0, 1].

    For someone who answers as believed it is below any p at most with probability p. Configurations are judged by their
    predicted density, probability over measure; of an answer that may be several, the likeliest counts.
    """
    predicted = survey(belief.people, belief.weights, query).predicted
    density = predicted / query.measures
    seen = answer.shares / answer.shares.sum() @ density[answer.places]
    return float(np.clip(predicted[density <= seen * (1.0 + 1e-9)].sum(), 1e-12, 1.0))


def has_changed(recent: Sequence[float]) -> bool:
    """Return whether the last answers together are too unlikely (Fisher's method).

    Args:
        recent: ``unlikeliness`` of answers, the newest last.
    """
    last = list(recent)[-ANSWERS:]
    return len(last) == ANSWERS and float(combine_pvalues(last, method="fisher").pvalue) < LEAST_CHANCE
