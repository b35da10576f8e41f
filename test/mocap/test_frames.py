"""Recordings and live samples are refused when nobody could use them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from handover_ros.errors import BadRecordingError, BadRequestError
from handover_ros.mocap.frames import MarkerStatus, Recording, positions_from_flat


@pytest.mark.parametrize("rate", [0.0, -100.0, float("nan"), float("inf"), 1e9])
def test_a_recording_needs_a_possible_rate(rate: float) -> None:
    with pytest.raises(BadRecordingError, match=r"some\.csv: rate"):
        Recording(("A",), ("torso",), rate, np.zeros((2, 1, 3)), Path("some.csv"))


def test_a_recording_needs_frames_and_matching_shapes() -> None:
    with pytest.raises(BadRecordingError, match="no frames"):
        Recording(("A",), ("torso",), 100.0, np.zeros((0, 1, 3)), Path("some.csv"))
    with pytest.raises(BadRecordingError, match="shape"):
        Recording(("A", "B"), ("torso", "torso"), 100.0, np.zeros((2, 1, 3)), Path("some.csv"))


def test_infinite_and_zero_samples_count_as_missing() -> None:
    flat = np.array([1.0, 2.0, 3.0, np.inf, 0.0, 0.0, 0.0, 0.0, 0.0, np.nan, 1.0, 1.0, 0.0, 0.0, 1.0])
    positions = positions_from_flat(flat, 5)
    assert np.isnan(positions).all(axis=1).tolist() == [False, True, True, True, False]


def test_a_sample_of_the_wrong_length_is_refused() -> None:
    with pytest.raises(BadRequestError, match="expected 6"):
        positions_from_flat(np.zeros(5), 2)


def test_the_states_are_those_of_the_message() -> None:
    message = pytest.importorskip("handover_msgs.msg").MarkerFrame
    assert {status.name: status.value for status in MarkerStatus} == {
        status.name: getattr(message, status.name) for status in MarkerStatus
    }
