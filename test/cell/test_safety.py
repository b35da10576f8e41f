from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_ros.cell.display import text_picture
from handover_ros.cell.safety import Freshness, LivenessMonitor
from handover_ros.cell.touch import PullDetector
from handover_ros.errors import BadRequestError


def ask_until(monitor: LivenessMonitor, start: float, end: float) -> tuple[str, ...]:
    """Ask at 50 Hz, as the executive does, and return the last answer."""
    for now in np.arange(start, end, 0.02):
        monitor.lost(float(now))
    return monitor.lost(end)


@given(st.lists(st.floats(0.01, 3.0), min_size=1, max_size=10), st.floats(0.0, 5.0))
def test_a_node_is_lost_exactly_when_its_last_beat_is_too_old(gaps, wait):
    monitor = LivenessMonitor(("a", "b"), lost_after=1.5)
    now = 0.0
    for gap in gaps:
        ask_until(monitor, now, now + gap)
        now += gap
        monitor.beat("a", now)
    assert ask_until(monitor, now, now + wait) == (("a",) if wait > 1.5 else ())
    assert "b" in monitor.missing(now)
    assert "b" not in monitor.lost(now)


def test_time_in_which_the_watcher_itself_stood_still_is_forgiven():
    monitor = LivenessMonitor(("a",), lost_after=1.5)
    monitor.beat("a", 0.0)
    assert ask_until(monitor, 0.0, 1.0) == ()
    assert monitor.lost(4.0) == (), "three seconds nobody asked; a's heartbeats may wait in the queue"
    assert ask_until(monitor, 4.0, 4.4) == ()
    assert ask_until(monitor, 4.4, 5.2) == ("a",)


def test_a_beat_brings_a_lost_node_back():
    monitor = LivenessMonitor(("a",), lost_after=1.0)
    monitor.beat("a", 0.0)
    assert ask_until(monitor, 0.0, 2.0) == ("a",)
    monitor.beat("a", 2.1)
    assert monitor.lost(2.2) == ()


def test_limits_must_be_positive():
    with pytest.raises(BadRequestError, match="lost_after"):
        LivenessMonitor(("a",), lost_after=0.0)


def test_freshness_names_the_stream_and_its_age():
    stream = Freshness("robot/joint_states", limit=0.5)
    assert "nothing received yet" in stream.problem(0.0)
    stream.sample(1.0)
    assert stream.problem(1.4) == ""
    assert "for 2.0 s" in stream.problem(3.0)


def test_pull_is_the_change_of_force_not_the_force():
    detector = PullDetector(threshold=4.0, baseline_samples=5)
    weight = np.array([0.0, 0.0, -9.0])
    assert not any(detector.update(weight) for _ in range(20))
    assert not detector.update(weight + [3.0, 0.0, 0.0])
    assert detector.update(weight + [0.0, 5.0, 0.0])
    assert not detector.update(np.array([np.nan, 0.0, 0.0]))
    detector.reset()
    assert not detector.update(weight + [0.0, 5.0, 0.0])


@pytest.mark.parametrize("text", ["Ready?", "Please wait", "a sentence that is far too long for one line at full size"])
def test_display_text_stays_inside_the_picture(text):
    picture = text_picture(text)
    assert picture.shape == (600, 1024, 3)
    edge = np.concatenate([picture[0], picture[-1], picture[:, 0], picture[:, -1]])
    assert (edge == edge[0]).all()
    assert (picture == 255).all(axis=-1).sum() > 500
