"""Whether a replay gave the same: the states of the person frame by frame, and the belief after each answer."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from handover_ros.bags.reading import Bag
from handover_ros.bags.replay import stamp_of

STATES = "/human/skeleton_state"
BELIEFS = "/preferences/belief"
STATE_NUMBERS = ("displacements", "velocities", "covariance", "torso_velocity", "residual_rms", "consistency")
BELIEF_NUMBERS = ("mean", "covariance", "mode", "entropy", "effective_particles", "rationality", "mean_neutral",
                  "mean_weights", "mode_neutral", "mode_weights", "expected_neutral", "expected_weights")  # fmt: skip


@dataclass
class Sameness:
    """How alike two streams of messages are.

    Attributes:
        topic: Which.
        recorded: Messages in the recorded bag that are compared.
        missing: Of those, how many the replay lacks.
        identical: Of those, how many are the same bit for bit.
        largest: Greatest difference of each field, where any differs.
        unlike: Messages that cannot be compared by numbers (another person, not valid on one side).
        unlike_at: Stamp [ns] of the first one; None: there is none.
    """

    topic: str
    recorded: int = 0
    missing: int = 0
    identical: int = 0
    largest: dict[str, float] = field(default_factory=dict)
    unlike: int = 0
    unlike_at: int | None = None

    @property
    def equal(self) -> bool:
        """Whether all is there and the same, bit for bit."""
        return self.recorded > 0 and self.identical == self.recorded

    def note_difference(self, ours: Any, theirs: Any, names: tuple[str, ...], stamp: int) -> None:
        """Take in a pair of messages; NaN equals NaN."""
        differences = {name: largest_difference(getattr(ours, name), getattr(theirs, name)) for name in names}
        if any(math.isinf(value) for value in differences.values()):
            self.unlike += 1
            self.unlike_at = stamp if self.unlike_at is None else self.unlike_at
        elif not any(differences.values()):
            self.identical += 1
        else:
            for name, value in differences.items():
                if value:
                    self.largest[name] = max(value, self.largest.get(name, 0.0))

    def sentence(self) -> str:
        """Return one line."""
        if not self.recorded:
            return f"{self.topic}: nothing to compare"
        parts = [f"{self.topic}: {self.identical:,} of {self.recorded:,} are the same bit for bit"]
        parts += [f"{self.missing:,} are missing"] if self.missing else []
        parts += [f"{self.unlike:,} are of another person or validity"] if self.unlike else []
        parts += [f"{name} differs by up to {value:.2g}" for name, value in self.largest.items()]
        return ", ".join(parts)


def largest_difference(ours: Any, theirs: Any) -> float:
    """Return the greatest absolute difference of numbers; inf when their count or what is NaN differs."""
    first, second = np.atleast_1d(np.asarray(ours, float)), np.atleast_1d(np.asarray(theirs, float))
    if first.shape != second.shape or (np.isnan(first) != np.isnan(second)).any():
        return math.inf
    apart: npt.NDArray[np.float64] = np.abs(first - second)
    return float(np.nan_to_num(apart).max(initial=0.0))


def compare_states(recorded: Bag, replayed: Bag, begin: int = 0, end: int | None = None) -> Sameness:
    """Compare the states of the person, frame by frame, found by their stamps.

    Args:
        recorded: What was recorded.
        replayed: What the replay gave.
        begin: Stamp [ns] of the first frame that counts.
        end: Stamp [ns] of the last one; None: all count.
    """
    result = Sameness(STATES)
    theirs = _by_stamp(replayed)
    stamp, data = next(theirs, (None, b""))
    for topic, _, ours in recorded.read([STATES]):
        wanted = stamp_of(ours)
        if wanted < begin or (end is not None and wanted > end):
            continue
        result.recorded += 1
        while stamp is not None and stamp < wanted:
            stamp, data = next(theirs, (None, b""))
        if stamp != wanted:
            result.missing += 1
        elif ours == data:
            result.identical += 1
        else:
            first, second = recorded.decode(topic, ours), replayed.decode(replayed.topics[STATES], data)
            if (first.profile_id, first.valid) != (second.profile_id, second.valid):
                result.unlike += 1
                result.unlike_at = wanted if result.unlike_at is None else result.unlike_at
                continue
            result.note_difference(_State(first), _State(second), (*STATE_NUMBERS, "torso"), wanted)
    return result


class _State:
    """The numbers of a state."""

    def __init__(self, state: Any) -> None:
        pose = state.torso.pose
        place, turn = pose.position, pose.orientation
        self.torso = [place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w]
        for name in STATE_NUMBERS:
            setattr(self, name, getattr(state, name))


def _by_stamp(bag: Bag) -> Iterator[tuple[int | None, bytes]]:
    for _, _, data in bag.read([STATES]):
        yield stamp_of(data), data


def compare_beliefs(recorded: Bag, replayed: Bag) -> Sameness:
    """Compare what was believed of each person after each answer, the last word on it on both sides."""
    result = Sameness(BELIEFS)
    ours, theirs = _beliefs(recorded), _beliefs(replayed)
    for number, (key, (stamp, belief)) in enumerate(ours.items()):
        result.recorded += 1
        if key not in theirs:
            result.missing += 1
        else:
            result.note_difference(belief, theirs[key][1], BELIEF_NUMBERS, stamp or number)
    return result


def _beliefs(bag: Bag) -> dict[tuple[str, int], tuple[int, Any]]:
    found = {}
    for topic, stamp, data in bag.read([BELIEFS]):
        belief = bag.decode(topic, data)
        if belief.profile_id:
            found[belief.profile_id, int(belief.observations)] = stamp, belief
    return found
