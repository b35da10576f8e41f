"""Online repair of marker frames: short gaps bridged, label swaps undone, jumps and ghosts dropped.

Causal and per frame. Every marker carries a prediction; what comes is compared with it, and only when something does
not fit is the dearer work (assignment, relocation) done.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from handover_ros.geometry import FloatArray
from handover_ros.mocap.frames import MarkerFrame, MarkerStatus, measured_mask
from handover_ros.mocap.relabel import assign
from handover_ros.mocap.repair_types import BoolArray, RepairCounters, RepairSettings, Step
from handover_ros.mocap.rigid_prediction import Predictor, predict_from_segment
from handover_ros.mocap.shape_memory import ShapeMemory

# Plain numbers: comparing arrays with enumeration members costs ten times as much.
MEASURED, MISSING, BRIDGED, RELABELLED, DROPPED = (int(status) for status in MarkerStatus)
RIGID, NONE = int(Predictor.RIGID), int(Predictor.NONE)

VELOCITY_GAIN = 0.5  # share of an innovation that goes into the velocity
VELOCITY_LAG = 1.5  # innovation under a constant acceleration, in a * T^2, at that gain
BLIND_DECAY = 0.1  # [s] a velocity that nothing confirms dies away within this time
BLIND_GAP = 0.1  # [s] longest gap bridged by velocity alone
SHARP_AGE = 0.1  # [s] predictions older than this decide neither between neighbours nor over labels
REVIEW_AGE = 1.0  # [s] a lasting relabelling is compared with the remembered shape this often
LONE_CONFIRM = 5.0  # [s] a marker that left its segment must be steady this long
LONE_MATES = 2  # markers of its segment that stayed where they were
OLD_HABIT = 5.0  # a swap this many times as long as all that was seen before it was no swap: the start was wrong
# The gate grows over an unmeasured time T by min(acceleration * T^2, speed * T, reach), by predictor.
RIGID_SPEED, RIGID_REACH = 0.3, 0.05  # [m/s], [m]
SHIFT_SPEED, SHIFT_REACH = 1.0, 0.3
BLIND_REACH = 1.0
ROUNDING = 1e-6  # [s]
UNKNOWN_GROWTH = 1e9  # [m/s^2] the velocity is still unknown: only the speed limits


class MarkerRepair:
    """Repairs the frames of one stream, one after the other.

    Args:
        segments: The segment that carries each of the n markers.
        settings: Gates and times.

    Attributes:
        counters: What was seen and done.
    """

    def __init__(self, segments: tuple[str, ...], settings: RepairSettings | None = None) -> None:
        self.settings = settings or RepairSettings()
        self.counters = RepairCounters()
        self._n = n = len(segments)
        names = np.array(segments)
        self._mates: BoolArray = (names[:, None] == names[None, :]) & ~np.eye(n, dtype=bool)
        self._acceleration = VELOCITY_LAG * self.settings.max_acceleration
        self.reset()

    def reset(self) -> None:
        """Forget all tracks (another person, a restarted source); the counters stay."""
        n = self._n
        self._stamp = -np.inf
        self._position = np.zeros((n, 3))
        self._velocity = np.zeros((n, 3))
        self._seen = np.zeros(n)
        self._known = np.zeros(n, dtype=bool)
        self._fresh = np.zeros(n, dtype=bool)  # velocity not known yet
        self._measured_last = np.zeros(n, dtype=bool)
        self._dropping = np.zeros(n, dtype=bool)
        self._growth = np.full(n, self._acceleration)
        self._speed = np.full(n, self.settings.max_speed)
        self._reach = np.full(n, BLIND_REACH)
        self._anchor = np.zeros((n, n, 3))  # positions of all markers when the first-named was last measured
        self._anchor_mask = np.zeros((n, n), dtype=bool)
        self._candidate = np.zeros((n, 3))
        self._candidate_count = np.zeros(n, dtype=int)
        self._candidate_since = np.zeros(n)
        self._candidate_stamp = np.zeros(n)
        self._swap: tuple[tuple[int, int], ...] = ()
        self._swap_onset = self._swap_reviewed = 0.0
        self._begin = np.inf
        self._shape = ShapeMemory(self._mates, self.settings.neighbour_distance)

    def process(self, frame: MarkerFrame) -> MarkerFrame:
        """Return the frame repaired; frames must come with increasing stamps."""
        measured = frame.positions
        finite = measured_mask(measured)
        if np.count_nonzero(finite) < self._n:
            measured = measured.copy()
            measured[~finite] = np.nan
        elapsed = frame.stamp - self._stamp
        self._begin = min(self._begin, frame.stamp)
        self.counters.frames += 1
        predicted = self._position + self._velocity * min(elapsed, BLIND_GAP)
        age = frame.stamp - self._seen
        growth = np.minimum(np.minimum(self._growth * age * age, self._speed * age), self._reach)
        gate = growth + self.settings.gate
        innovation = measured - predicted
        suspicious = (np.einsum("ij,ij->i", innovation, innovation) > gate * gate) & self._known
        crossed = self._shape.crossed_pairs(measured, predicted)
        usual = not (np.count_nonzero(suspicious) or np.count_nonzero(crossed))
        if usual and np.count_nonzero(finite & self._known) == self._n:
            return self._accept_all(frame, innovation, age)
        status = (~finite).astype(np.uint8)  # MEASURED 0, MISSING 1
        step = Step(frame.stamp, elapsed, age, measured.copy(), finite, predicted, gate, finite.copy(), status)
        if usual:
            self._swap = ()
            self._shape.learn(measured, finite)
        else:
            suspicious |= self._shape.crossed_markers(crossed, age < SHARP_AGE) & finite
            self._resolve(step, suspicious)
        self._candidate_count[step.believed] = 0
        self._update(step)
        output = self._position.copy()
        output[(step.status == MISSING) | (step.status == DROPPED)] = np.nan
        self._count(step)
        self._measured_last = step.believed
        self._stamp = frame.stamp
        return replace(frame, positions=output, status=step.status)

    def _accept_all(self, frame: MarkerFrame, innovation: FloatArray, age: FloatArray) -> MarkerFrame:
        """The usual frame: everything is there and where it should be."""
        gain = np.where(self._fresh, 1.0, VELOCITY_GAIN) / age
        self._velocity += innovation * gain[:, None]
        self._position = frame.positions
        self._after_measurement(slice(None), frame.stamp)
        self._measured_last = np.ones(self._n, dtype=bool)
        self._dropping[:] = False
        self._candidate_count[:] = 0
        self._swap = ()
        self._stamp = frame.stamp
        self.counters.samples += self._n
        self._shape.learn(frame.positions, self._measured_last)
        return replace(frame, status=np.zeros(self._n, dtype=np.uint8))

    def _after_measurement(self, which: slice | BoolArray, stamp: float) -> None:
        self._seen[which] = stamp
        self._fresh[which] = False
        self._growth[which] = self._acceleration
        self._speed[which] = self.settings.max_speed
        self._reach[which] = BLIND_REACH

    def _resolve(self, step: Step, suspicious: BoolArray) -> None:
        """Find out what the suspicious samples are; corrects ``step``."""
        suspects = np.flatnonzero(suspicious)
        believable = (step.age < SHARP_AGE) | (self._reach <= RIGID_REACH)
        vacant = np.flatnonzero(self._known & ~step.finite & believable)
        narrow = np.minimum(step.gate, 2.0 * self.settings.gate + RIGID_REACH)
        samples = step.measured.copy()
        found = assign(suspects, vacant, samples, step.predicted, narrow, int(step.finite.sum()))
        moved = found.sources != found.targets
        pairs = tuple(zip(found.sources[moved].tolist(), found.targets[moved].tolist()))
        if not pairs:
            self._swap = ()
        elif not self._swap_holds(step, pairs):
            self._known[suspects] = False  # the source is right: start these afresh
            return
        step.believed[suspects] = False
        step.status[suspects] = MISSING
        step.measured[found.targets] = samples[found.sources]
        step.believed[found.targets] = True
        step.status[found.targets] = np.where(moved, RELABELLED, MEASURED)
        alone = (self._mates & step.believed).sum(axis=1) >= LONE_MATES
        for label in found.unexplained:
            if not step.believed[label]:
                self._judge(step, int(label), samples[label], bool(alone[label]))

    def _swap_holds(self, step: Step, pairs: tuple[tuple[int, int], ...]) -> bool:
        """Return whether a relabelling is to be believed: a new one is, a lasting one must fit the remembered shape."""
        if pairs != self._swap:
            self._swap = pairs
            self._swap_onset = self._swap_reviewed = step.stamp
            self.counters.swaps += 1
            return True
        if step.stamp - self._swap_reviewed < REVIEW_AGE:
            return True
        self._swap_reviewed = step.stamp
        sources = [source for source, _ in pairs]
        targets = [target for _, target in pairs]
        restored = step.measured.copy()
        restored[sources] = np.nan
        restored[targets] = step.measured[sources]
        involved = np.array(sorted({*sources, *targets}))
        fits = self._shape.misfit(restored, involved) <= self._shape.misfit(step.measured, involved)
        if fits and step.stamp - self._swap_onset < OLD_HABIT * (self._swap_onset - self._begin):
            return True
        self._swap = ()
        return False

    def _judge(self, step: Step, label: int, sample: FloatArray, alone: bool) -> None:
        """Drop a sample that belongs nowhere, or believe it once it has been steady at its new place."""
        wait = step.stamp - self._candidate_stamp[label]
        near = self.settings.gate + self.settings.max_speed * wait
        steady = self._candidate_count[label] > 0 and np.linalg.norm(sample - self._candidate[label]) < near
        if not steady:
            self._candidate_count[label] = 0
            self._candidate_since[label] = step.stamp
        self._candidate_count[label] += 1
        self._candidate[label] = sample
        self._candidate_stamp[label] = step.stamp
        long_enough = not alone or step.stamp - self._candidate_since[label] >= LONE_CONFIRM
        if self._candidate_count[label] >= self.settings.confirm_frames and long_enough:
            self._known[label] = False
            step.measured[label] = sample
            step.believed[label] = True
            step.status[label] = MEASURED
            self.counters.relocations += 1
        else:
            step.status[label] = DROPPED

    def _update(self, step: Step) -> None:
        """Carry all tracks to this frame: measured ones, missing ones by their segment, new ones afresh."""
        previous = self._position
        believed = step.believed
        lost = self._known & ~believed
        starting = lost & self._measured_last
        if np.count_nonzero(starting):
            self._anchor[starting] = previous
            self._anchor_mask[starting] = self._mates[starting] & self._measured_last
        tracked = self._known & believed
        gain = np.where(self._fresh[tracked], 1.0, VELOCITY_GAIN) / step.age[tracked]
        self._velocity[tracked] += (step.measured[tracked] - step.predicted[tracked]) * gain[:, None]
        self._position = step.predicted
        self._position[believed] = step.measured[believed]
        self._after_measurement(believed, step.stamp)
        new = believed & ~self._known
        if np.count_nonzero(new):
            self._velocity[new] = 0.0
            self._fresh[new] = True
            self._growth[new] = UNKNOWN_GROWTH
            self._known |= new
        if np.count_nonzero(lost):
            self._predict_lost(step, np.flatnonzero(lost), previous)

    def _predict_lost(self, step: Step, labels: npt.NDArray[np.intp], previous: FloatArray) -> None:
        """Predict the lost markers from their segments, else from their velocity; flag those that are bridged."""
        current = np.where(step.believed[:, None], step.measured, 0.0)
        anchors = self._anchor[labels]
        own = anchors[np.arange(len(labels)), labels]
        position, predictor = predict_from_segment(anchors, own, self._anchor_mask[labels] & step.believed, current)
        rigid, blind = predictor == RIGID, predictor == NONE
        guided = ~blind
        aimed = labels[guided]
        velocity = (position[guided] - previous[aimed]) / step.elapsed
        self._velocity[aimed] += VELOCITY_GAIN * (velocity - self._velocity[aimed])
        self._position[aimed] = position[guided]
        if len(aimed) < len(labels):
            self._velocity[labels[blind]] *= np.exp(-step.elapsed / BLIND_DECAY)
        self._speed[labels] = np.where(rigid, RIGID_SPEED, np.where(blind, self.settings.max_speed, SHIFT_SPEED))
        self._reach[labels] = np.where(rigid, RIGID_REACH, np.where(blind, BLIND_REACH, SHIFT_REACH))
        longest = np.where(blind, min(BLIND_GAP, self.settings.max_gap), self.settings.max_gap)
        bridged = (step.age[labels] <= longest + ROUNDING) & (step.status[labels] == MISSING)
        step.status[labels[bridged]] = BRIDGED

    def _count(self, step: Step) -> None:
        counters = self.counters
        counters.samples += int(np.count_nonzero(self._known))
        counters.missing += int(np.count_nonzero(self._known & ~step.finite))
        counters.bridged += int(np.count_nonzero(step.status == BRIDGED))
        counters.relabelled += int(np.count_nonzero(step.status == RELABELLED))
        dropped = step.status == DROPPED
        if np.count_nonzero(dropped):
            onset = dropped & ~self._dropping
            counters.dropped += int(np.count_nonzero(dropped))
            counters.jumps += int(np.count_nonzero(onset & self._measured_last))
            counters.ghosts += int(np.count_nonzero(onset & ~self._measured_last))
        self._dropping = dropped
