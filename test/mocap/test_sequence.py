"""Frame numbers: what is next, twice, late, or a device that counts anew."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from handover_ros.mocap.sequence import RESTART_AFTER, Arrival, FrameSequence


@given(st.lists(st.integers(1, 5), min_size=1, max_size=50))
def test_increasing_numbers_are_next_and_holes_are_counted(steps: list[int]) -> None:
    sequence, number = FrameSequence(), 0
    sequence.classify(0)
    for step in steps:
        number += step
        assert sequence.classify(number) is Arrival.NEXT
    assert sequence.lost == sum(steps) - len(steps)


def test_a_duplicate_and_a_late_frame_are_told_apart() -> None:
    sequence = FrameSequence()
    arrivals = [sequence.classify(number) for number in (5, 6, 6, 4, 7)]
    assert arrivals == [Arrival.NEXT, Arrival.NEXT, Arrival.DUPLICATE, Arrival.OUT_OF_ORDER, Arrival.NEXT]


def test_a_device_that_counts_anew_is_followed() -> None:
    sequence = FrameSequence()
    for number in range(1000, 1010):
        sequence.classify(number)
    arrivals = [sequence.classify(number) for number in range(RESTART_AFTER + 2)]
    assert arrivals[: RESTART_AFTER - 1] == [Arrival.OUT_OF_ORDER] * (RESTART_AFTER - 1)
    assert arrivals[RESTART_AFTER - 1 :] == [Arrival.RESTART, Arrival.NEXT, Arrival.NEXT]
