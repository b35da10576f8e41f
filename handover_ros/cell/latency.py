"""How long messages took, over the last moments."""

from __future__ import annotations

from collections import deque

import numpy as np

KEPT = 2000  # values: some seconds of a fast stream


class Latencies:
    """The newest latencies of a stream, and its rate.

    Values are noted in one thread and reported from another.
    """

    def __init__(self) -> None:
        self._values: deque[float] = deque(maxlen=KEPT)
        self._count, self._reported, self._reported_at = 0, 0, float("nan")

    def note(self, seconds: float) -> None:
        """Take in one latency [s]."""
        self._values.append(seconds)
        self._count += 1

    def report(self, now: float) -> dict[str, object]:
        """Return the rate since the last report [Hz], and median, 99th percentile and maximum [ms] of the newest ones.

        Args:
            now: Steady time [s].
        """
        values = 1e3 * np.array(self._values.copy())
        rate = (self._count - self._reported) / max(now - self._reported_at, 1e-3)
        self._reported, self._reported_at = self._count, now
        if not len(values):
            return {"rate_hz": 0.0}
        median, late = np.percentile(values, [50.0, 99.0])
        return {
            "rate_hz": rate,
            "latency_median_ms": float(median),
            "latency_p99_ms": float(late),
            "latency_max_ms": float(values.max()),
        }
