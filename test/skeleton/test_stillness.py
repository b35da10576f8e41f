from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_ros.errors import BadRequestError
from handover_ros.geometry import transform_from_xyz_rpy
from handover_ros.skeleton.stillness import Stillness


def watch(stillness: Stillness, pose, duration: float = 1.0, start: float = 0.0, rate: float = 240.0) -> bool:
    for time in np.arange(start, start + duration, 1.0 / rate):
        x, yaw = pose(time)
        stillness.update(time, transform_from_xyz_rpy([x, 0.0, 1.4], [0.0, 0.0, yaw]))
    return stillness.still()


@given(st.floats(0.0, 0.3), st.floats(0.0, 0.5))
def test_a_person_is_still_exactly_when_the_window_holds_no_more_motion_than_allowed(speed, turn):
    still = watch(Stillness(window=0.5, distance=0.03, angle=0.06), lambda time: (speed * time, turn * time))
    if speed * 0.56 < 0.03 and turn * 0.56 < 0.06:
        assert still
    if speed * 0.49 > 0.03 or turn * 0.49 > 0.06:
        assert not still


def test_sway_is_still_and_a_turn_is_not_until_it_has_ended():
    stillness = Stillness()
    assert watch(stillness, lambda time: (0.008 * np.sin(2 * time), 0.015 * np.cos(1.5 * time)))
    assert not watch(stillness, lambda time: (0.0, 0.6 * (time - 1.0)), start=1.0)
    assert watch(stillness, lambda time: (0.0, 0.6), start=2.0)


def test_nothing_known_or_too_short_is_not_still_and_a_clock_that_goes_back_starts_afresh():
    stillness = Stillness(window=0.5)
    assert not stillness.still()
    assert not watch(stillness, lambda time: (0.0, 0.0), duration=0.3)
    assert watch(stillness, lambda time: (0.0, 0.0), duration=0.6, start=100.0)
    assert not watch(stillness, lambda time: (0.0, 0.0), duration=0.3, start=5.0)


def test_limits_must_be_positive():
    with pytest.raises(BadRequestError, match="positive"):
        Stillness(window=0.0)
