"""Playing a recording: every frame once, at its time, the same every time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_ros.errors import BadRequestError
from handover_ros.mocap.frames import Recording
from handover_ros.mocap.sources import MarkerSample, RecordingSource


def recording(frames: int) -> Recording:
    positions = np.arange(frames)[:, None, None] * np.ones((1, 3, 3))
    return Recording(("A", "B", "C"), ("torso",) * 3, 100.0, positions, Path("test"))


def played(source: RecordingSource, times: np.ndarray) -> list[MarkerSample]:
    samples = []
    for now in times:
        while (sample := source.poll(float(now))) is not None:
            samples.append(sample)
    return samples


@given(pace=st.floats(0.1, 20.0), step=st.floats(0.001, 0.5))
def test_every_frame_comes_once_with_its_own_time(pace: float, step: float) -> None:
    source = RecordingSource(recording(40), pace, start=3.0)
    samples = played(source, np.arange(0.0, 3.0 + 41 / (100.0 * pace) + 2 * step, step))
    assert [int(sample.positions[0, 0]) for sample in samples] == list(range(40))
    assert [sample.device_frame for sample in samples] == list(range(40))
    np.testing.assert_allclose([s.reference for s in samples], 3.0 + np.arange(40) / (100.0 * pace))
    assert source.finished
    assert source.rate == pytest.approx(100.0 * pace)


def test_nothing_comes_before_its_time() -> None:
    source = RecordingSource(recording(3), start=1.0)
    assert source.poll(0.99) is None
    assert source.poll(1.0) is not None
    assert source.poll(1.005) is None


def test_loops_restart_or_go_to_and_fro() -> None:
    for loop, expected, restarts in (
        ("restart", [0, 1, 2, 3, 0, 1, 2, 3, 0], [4, 8]),
        ("ping_pong", [0, 1, 2, 3, 2, 1, 0, 1, 2], []),
    ):
        source = RecordingSource(recording(4), loop=loop)
        samples = played(source, np.array([0.0801]))
        assert [int(sample.positions[0, 0]) for sample in samples] == expected
        assert [index for index, sample in enumerate(samples) if sample.restarted] == restarts
        assert not source.finished


def test_samples_do_not_share_memory_with_the_recording() -> None:
    source = RecordingSource(recording(2))
    sample = source.poll(0.0)
    assert sample is not None
    sample.positions[:] = 7.0
    assert RecordingSource(recording(2)).poll(0.0).positions[0, 0] == 0.0


def test_pace_and_loop_are_checked() -> None:
    with pytest.raises(BadRequestError, match="pace"):
        RecordingSource(recording(2), pace=0.0)
    with pytest.raises(BadRequestError, match="ping_pong"):
        RecordingSource(recording(2), loop="twice")
