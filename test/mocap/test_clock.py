"""Stamps: increasing, close to the capture, whatever delays, drift and jumps there are."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.mocap.clock import STAMP_STEP, DeviceClock

PERIOD = 1.0 / 240.0


def delays(count: int, seed: int, typical: float = 0.004) -> np.ndarray:
    """Return positive delays [s]: a least one, an exponential rest, now and then a stall."""
    rng = np.random.default_rng(seed)
    rest = rng.exponential(typical, count)
    rest[rng.random(count) < 0.002] += 0.3
    return 0.001 + rest


@given(seed=st.integers(0, 10_000), drift=st.floats(-1e-4, 1e-4), epoch=st.floats(-1e5, 1e5))
@settings(max_examples=30, deadline=None)
def test_stamps_are_within_two_milliseconds_of_the_least_delay(seed: int, drift: float, epoch: float) -> None:
    count = 5000
    capture = 100.0 + np.arange(count) * PERIOD
    arrival = np.maximum.accumulate(capture + delays(count, seed))
    device = epoch + (capture - 100.0) * (1.0 + drift)
    clock = DeviceClock()
    stamps = np.array([clock.stamp(d, a) for d, a in zip(device, arrival)])
    assert (np.diff(stamps) > 0.0).all()
    assert np.abs(stamps - capture - 0.001)[1000:].max() < 0.002
    assert clock.jumps == 0


def test_drift_is_learned() -> None:
    clock = DeviceClock()
    for k in range(12_000):
        capture = k * PERIOD
        clock.stamp(capture / (1.0 + 50e-6), capture + delays(1, k)[0])
    assert abs(clock.drift - 50e-6) < 40e-6


@given(jump=st.one_of(st.floats(0.2, 1e6), st.floats(-1e6, -0.2)), seed=st.integers(0, 1000))
@settings(max_examples=40, deadline=None)
def test_a_jump_of_the_device_clock_is_noticed_and_leaves_no_trace(jump: float, seed: int) -> None:
    capture = 50.0 + np.arange(1200) * PERIOD
    arrival = capture + 0.001 + np.random.default_rng(seed).exponential(0.001, 1200)
    device = capture.copy()
    device[600:] += jump
    clock = DeviceClock()
    stamps = np.array([clock.stamp(d, a) for d, a in zip(device, arrival)])
    assert clock.jumps == 1
    assert (np.diff(stamps) >= 0.9 * STAMP_STEP).all()
    assert np.abs(stamps - capture).max() < 0.05


def test_a_stall_of_the_network_is_no_jump() -> None:
    capture = 10.0 + np.arange(2000) * PERIOD
    arrival = capture + 0.002
    arrival[1000:1240] = capture[1240] + 0.002
    clock = DeviceClock()
    stamps = np.array([clock.stamp(d, a) for d, a in zip(capture - 7.0, arrival)])
    assert clock.jumps == 0
    assert np.abs(stamps - capture - 0.002).max() < 1e-6


def test_a_driver_s_own_stamps_are_kept() -> None:
    clock = DeviceClock()
    for k in range(3000):
        stamp = 5.0 + k * PERIOD
        assert abs(clock.stamp(1234.5 + k * PERIOD, stamp) - stamp) < 1e-9
