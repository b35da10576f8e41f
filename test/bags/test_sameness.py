"""Two streams of states or beliefs are held against each other."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_ros.bags.definitions import Definitions
from handover_ros.bags.reading import Bag
from handover_ros.bags.recording import BagWriter
from handover_ros.bags.sameness import compare_beliefs, compare_states, largest_difference

STATE, BELIEF = "handover_msgs/msg/SkeletonState", "handover_msgs/msg/BeliefSummary"


def states(folder: Path, content: dict[int, tuple[float, str]]) -> Path:
    """Return a bag with states: stamp [ns] -> displacement, person."""
    from handover_msgs.msg import SkeletonState
    from rclpy.serialization import serialize_message

    writer = BagWriter(folder)
    writer.add("/human/skeleton_state", STATE, Definitions().of(STATE), [])
    for stamp, (value, person) in content.items():
        message = SkeletonState(valid=True, profile_id=person, displacements=[value], consistency=float("nan"))
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        writer.write("/human/skeleton_state", STATE, stamp, serialize_message(message))
    writer.close()
    return folder


def beliefs(folder: Path, content: list[tuple[int, float, int]]) -> Path:
    """Return a bag with beliefs about anna: answers, entropy, stamp [s] of the message."""
    from handover_msgs.msg import BeliefSummary
    from rclpy.serialization import serialize_message

    writer = BagWriter(folder)
    writer.add("/preferences/belief", BELIEF, Definitions().of(BELIEF), [])
    for number, (answers, entropy, stamp) in enumerate(content):
        message = BeliefSummary(profile_id="anna", observations=answers, entropy=entropy)
        message.header.stamp.sec = stamp
        writer.write("/preferences/belief", BELIEF, number, serialize_message(message))
    writer.close()
    return folder


def test_states_are_compared_frame_by_frame(tmp_path: Path) -> None:
    pytest.importorskip("handover_msgs", reason="handover_msgs is not built")
    ours = {1: (0.1, ""), 2: (0.2, ""), 3: (0.3, "a"), 4: (0.4, "a"), 5: (0.5, "a")}
    theirs = {0: (9.0, ""), 2: (0.2, ""), 3: (0.3, ""), 4: (0.45, "a"), 5: (0.5, "a"), 6: (0.6, "a")}
    with Bag(states(tmp_path / "a", ours)) as recorded, Bag(states(tmp_path / "b", theirs)) as replayed:
        same = compare_states(recorded, recorded)
        assert same.equal
        assert (same.recorded, same.identical) == (5, 5)
        found = compare_states(recorded, replayed)
        assert (found.recorded, found.missing, found.identical, found.unlike, found.unlike_at) == (5, 1, 2, 1, 3)
        assert found.largest == pytest.approx({"displacements": 0.05})
        assert not found.equal
        assert "1 are missing" in found.sentence()
        assert "displacements differs by up to 0.05" in found.sentence()
        assert compare_states(recorded, replayed, begin=5).equal


def test_beliefs_are_compared_after_each_answer_without_their_times(tmp_path: Path) -> None:
    pytest.importorskip("handover_msgs", reason="handover_msgs is not built")
    ours = beliefs(tmp_path / "a", [(0, 3.0, 1), (1, 2.0, 2), (2, 1.0, 3)])
    with Bag(ours) as recorded:
        with Bag(beliefs(tmp_path / "b", [(0, 3.0, 7), (1, 2.0, 8), (2, 1.0, 9)])) as same:
            assert compare_beliefs(recorded, same).equal
        with Bag(beliefs(tmp_path / "c", [(0, 3.0, 7), (1, 2.5, 8)])) as other:
            found = compare_beliefs(recorded, other)
        assert (found.identical, found.missing, found.largest) == (1, 1, {"entropy": 0.5})


def test_nothing_to_compare_is_no_equality(tmp_path: Path) -> None:
    with Bag(states(tmp_path / "a", {1: (0.0, "")})) as bag:
        found = compare_beliefs(bag, bag)
    assert not found.equal
    assert "nothing to compare" in found.sentence()


@given(st.lists(st.floats(-1e6, 1e6), max_size=5), st.floats(-10.0, 10.0))
def test_largest_difference_is_the_shift(values: list[float], shift: float) -> None:
    moved = [value + shift for value in values]
    assert largest_difference(values, moved) == pytest.approx(abs(shift) if values else 0.0, abs=1e-8)
    assert math.isinf(largest_difference(values, [*values, 0.0])) or not values
    assert largest_difference([float("nan"), *values], [float("nan"), *values]) == 0.0
    assert math.isinf(largest_difference([float("nan")], [1.0]))
