"""Liveness of the graph's nodes and freshness of live data, by the wall clock."""

from __future__ import annotations

from handover_ros.errors import BadRequestError

LOST_AFTER = 1.5  # [s] of wall time without a heartbeat
OWN_STALL = 0.25  # [s] between two questions after which the asking process itself was stalled


class LivenessMonitor:
    """Knows which of the required nodes are alive.

    Args:
        required: Names of the nodes the cell cannot do without.
        lost_after: [s] of steady wall time without a heartbeat after which a node counts as lost.

    Whoever asks must ask often: time in which the asking process itself did not run (a busy machine) is not held
    against the others, whose heartbeats still wait in its queue.
    """

    def __init__(self, required: tuple[str, ...], lost_after: float = LOST_AFTER) -> None:
        if lost_after <= 0.0:
            raise BadRequestError(f"lost_after must be positive, got {lost_after:g} s")
        self.required = required
        self.lost_after = lost_after
        self._last: dict[str, float] = {}
        self._asked: float | None = None

    def _own_stall(self, now: float) -> None:
        """Forgive everybody the time in which nobody asked."""
        gap = now - self._asked if self._asked is not None else 0.0
        self._asked = now
        if gap > OWN_STALL:
            self._last = {node: min(now, last + gap) for node, last in self._last.items()}

    def beat(self, node: str, now: float) -> None:
        """Take a heartbeat of ``node`` at steady wall time ``now`` [s]."""
        self._last[node] = now

    def lost(self, now: float) -> tuple[str, ...]:
        """Return the required nodes that beat once and then fell silent."""
        self._own_stall(now)
        return tuple(node for node in self.required if node in self._last and now - self._last[node] > self.lost_after)

    def missing(self, now: float) -> tuple[str, ...]:
        """Return the required nodes that are not alive now: never seen, or lost."""
        self._own_stall(now)
        return tuple(node for node in self.required if now - self._last.get(node, -1e9) > self.lost_after)


class Freshness:
    """Age of one stream of live data.

    Args:
        name: What a person calls it, with the node it comes from.
        limit: [s] of wall time between samples that is still fresh.
    """

    def __init__(self, name: str, limit: float) -> None:
        self.name = name
        self.limit = limit
        self._last: float | None = None

    def sample(self, now: float) -> None:
        """Take a sample at steady wall time ``now`` [s]."""
        self._last = now

    def age(self, now: float) -> float:
        """Return how old the newest sample is at steady wall time ``now`` [s]; NaN: there was none."""
        return float("nan") if self._last is None else now - self._last

    def problem(self, now: float) -> str:
        """Return a sentence when the stream is stale or never began, otherwise an empty string."""
        if self._last is None:
            return f"{self.name}: nothing received yet"
        age = now - self._last
        return f"{self.name}: nothing received for {age:.1f} s" if age > self.limit else ""
