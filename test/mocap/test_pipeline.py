"""The whole way of a sample: order, clock, repair."""

from __future__ import annotations

import numpy as np

from handover_ros.mocap.pipeline import MarkerPipeline
from handover_ros.mocap.sources import MarkerSample

BODY = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0], [0.0, 0.1, 1.1], [0.1, 0.1, 1.2]])


def sample(number: int, device_offset: float = 0.0, **changes: object) -> MarkerSample:
    seconds = 1.0 + number / 100.0
    fields = {"positions": BODY.copy(), "restarted": False, **changes}
    return MarkerSample(number, seconds + device_offset, seconds, **fields)


def test_only_frames_in_order_come_out_with_increasing_stamps() -> None:
    pipeline = MarkerPipeline(("torso",) * 4)
    frames = [pipeline.process(sample(number)) for number in (0, 1, 1, 3, 2, 4)]
    assert [frame is not None for frame in frames] == [True, True, False, True, False, True]
    stamps = [frame.stamp for frame in frames if frame is not None]
    assert all(np.diff(stamps) > 0.0)
    report = pipeline.report()
    assert (report["duplicates"], report["out_of_order"], report["lost_frames"]) == (1, 1, 1)


def test_a_jumping_device_clock_leaves_the_stamps_alone() -> None:
    pipeline = MarkerPipeline(("torso",) * 4)
    stamps = [pipeline.process(sample(n, 5.0 if 40 <= n < 80 else 0.0)).stamp for n in range(120)]
    np.testing.assert_allclose(stamps, 1.0 + np.arange(120) / 100.0, atol=1e-6)
    assert pipeline.report()["clock_jumps"] == 2


def test_a_recording_that_starts_over_is_believed_at_once() -> None:
    pipeline = MarkerPipeline(("torso",) * 4)
    for number in range(10):
        pipeline.process(sample(number))
    frame = pipeline.process(sample(10, positions=BODY + 2.0, restarted=True))
    assert not frame.status.any()
    assert pipeline.report()["restarts"] == 1
