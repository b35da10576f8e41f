"""Faults of the motion capture: validated, timed, deterministic; random gaps with the wanted share."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.errors import BadRequestError, UnknownNameError
from handover_ros.sim.faults import FAULT_KINDS, MEAN_GAP, Faults, RandomGaps


@given(
    kind=st.sampled_from([k for k in FAULT_KINDS if k != "none"]), start=st.floats(0, 100), duration=st.floats(0.01, 10)
)
def test_a_fault_is_on_for_its_duration(kind, start, duration):
    faults = Faults(24, 8)
    assert faults.active(kind, start) is None
    faults.set(kind, start, 0.0, duration)
    assert faults.active(kind, start) is not None
    assert faults.kinds(start + 0.9 * duration) == (kind,)
    assert faults.active(kind, start + 1.1 * duration) is None


def test_without_duration_it_stays_until_none():
    faults = Faults(24, 8)
    for kind in ("ghost", "freeze"):
        faults.set(kind, 0.0)
    assert faults.kinds(1e9) == ("ghost", "freeze")
    faults.set("none", 1e9)
    assert faults.kinds(1e9) == ()


@pytest.mark.parametrize(
    ("kind", "magnitude", "duration", "word"),
    [
        ("camera_drop", 8.0, 0.0, "camera"),
        ("camera_drop", 1.5, 0.0, "camera"),
        ("camera_drop", float("nan"), 0.0, "camera"),
        ("occlusion", 1.2, 0.0, "fraction"),
        ("occlusion", float("nan"), 0.0, "fraction"),
        ("clock_jump", float("inf"), 0.0, "clock_jump"),
        ("ghost", 0.0, -1.0, "duration"),
        ("ghost", 0.0, float("nan"), "duration"),
    ],
)
def test_values_out_of_range_are_refused(kind, magnitude, duration, word):
    faults = Faults(24, 8)
    with pytest.raises(BadRequestError, match=word):
        faults.set(kind, 0.0, magnitude, duration)
    assert faults.kinds(0.0) == ()


def test_an_unknown_fault_lists_the_known_ones():
    with pytest.raises(UnknownNameError, match="label_swap"):
        Faults(24, 8).set("earthquake", 0.0)


@given(st.integers(0, 2**31))
def test_the_same_seed_picks_the_same_markers(seed):
    chosen = []
    for _ in range(2):
        faults = Faults(24, 8, seed)
        faults.set("label_swap", 0.0)
        chosen.append(faults.active("label_swap", 0.0).markers)
    assert chosen[0] == chosen[1]
    assert chosen[0][0] != chosen[0][1]


@given(fraction=st.floats(0.02, 0.7), rate=st.sampled_from([50.0, 240.0]), seed=st.integers(0, 1000))
@settings(max_examples=15, deadline=None)
def test_gaps_have_the_wanted_share_and_come_in_bursts(fraction, rate, seed):
    gaps = RandomGaps(24, np.random.default_rng(seed))
    hidden = np.array([gaps.step(fraction, 1.0 / rate) for _ in range(8000)])
    assert abs(hidden.mean() - fraction) < 0.06
    ends = np.sum(hidden[:-1] & ~hidden[1:])
    assert 0.6 * MEAN_GAP < hidden.sum() / max(ends, 1) / rate < 1.6 * MEAN_GAP


@pytest.mark.parametrize("fraction", [0.0, 1.0])
def test_no_gaps_and_nothing_but_gaps(fraction):
    gaps = RandomGaps(5, np.random.default_rng(0))
    assert all(gaps.step(fraction, 0.01).mean() == fraction for _ in range(20))
