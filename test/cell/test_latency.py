"""Latencies and rates of a stream."""

from __future__ import annotations

import pytest

from handover_ros.cell.latency import KEPT, Latencies


def test_rate_and_percentiles_are_those_of_what_came() -> None:
    latencies = Latencies()
    assert latencies.report(0.0) == {"rate_hz": 0.0}
    for number in range(1, 101):
        latencies.note(number * 1e-3)
    report = latencies.report(0.5)
    assert report["rate_hz"] == pytest.approx(200.0)
    assert report["latency_median_ms"] == pytest.approx(50.5)
    assert report["latency_p99_ms"] == pytest.approx(99.01)
    assert report["latency_max_ms"] == pytest.approx(100.0)
    assert latencies.report(1.5)["rate_hz"] == 0.0


def test_old_values_are_forgotten() -> None:
    latencies = Latencies()
    latencies.note(9.0)
    for _ in range(KEPT):
        latencies.note(1e-3)
    assert latencies.report(1.0)["latency_max_ms"] == pytest.approx(1.0)
