"""Smooths a recorded motion: the filter forwards, then Rauch, Tung and Striebel's recursion backwards."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handover_ros.errors import BadRecordingError, ErrorCode
from handover_ros.geometry import FloatArray
from handover_ros.mocap.frames import MarkerFrame, Recording
from handover_ros.skeleton.dynamics_model import fill_dynamics
from handover_ros.skeleton.kernels import difference, forward, move
from handover_ros.skeleton.tracking import SkeletonTracker, TrackingSettings
from handover_ros.skeleton.tree import Skeleton
from handover_ros.skeleton.ukf_kernels import predict


@dataclass(frozen=True, eq=False)
class SmoothedMotion:
    """A whole recording as a skeleton's motion; frames in which no posture was found are NaN.

    Attributes:
        displacements: Shape (frames, n) [rad] or [m].
        velocities: Shape (frames, n).
        deviations: Standard deviations of the displacements, shape (frames, n).
        world_from_root: Root poses, shape (frames, 4, 4).
        residuals: Distances of the measured markers from the skeleton's [m], shape (frames, m), NaN = not measured;
            markers in the skeleton's order.
        gated: Measurements that were not believed.
        reacquired: Times the posture was found anew.
    """

    displacements: FloatArray
    velocities: FloatArray
    deviations: FloatArray
    world_from_root: FloatArray
    residuals: FloatArray
    gated: int
    reacquired: int


@dataclass(frozen=True, eq=False)
class _Step:
    """One frame of the forward pass: predicted and filtered state, None for the prediction after a restart."""

    predicted: tuple[FloatArray, FloatArray, FloatArray] | None
    filtered: tuple[FloatArray, FloatArray, FloatArray]
    transition: FloatArray


def smooth(skeleton: Skeleton, recording: Recording, settings: TrackingSettings | None = None) -> SmoothedMotion:
    """Return the motion of a skeleton that explains a recording best, using for each frame those before and after.

    Args:
        skeleton: The calibrated skeleton.
        recording: Marker frames.
        settings: Of the filter.

    Raises:
        BadModelError: The recording lacks markers of the skeleton.
        BadRecordingError: No frame shows enough markers.
    """
    tracker = _RecordingTracker(skeleton, recording.names, settings)
    steps: list[_Step | None] = []
    status = np.zeros(len(recording.names), dtype=np.uint8)
    for index, positions in enumerate(recording.positions):
        steps.append(
            tracker.follow(MarkerFrame(index / recording.rate, index, index / recording.rate, positions, status))
        )
    if not any(step is not None for step in steps):
        raise BadRecordingError(
            f"{recording.path}: no frame shows enough markers of skeleton {skeleton.name!r}", ErrorCode.NOT_ENOUGH_DATA
        )
    return _collect(tracker, recording, _backwards(tracker, steps))


class _RecordingTracker(SkeletonTracker):
    """The tracker with its states laid open, frame by frame."""

    def follow(self, frame: MarkerFrame) -> _Step | None:
        """Filter a frame; None when it has no posture."""
        before, elapsed, state = self.reacquired, frame.stamp - self._stamp, self._state()
        if not self.update(frame).valid:
            return None
        if self.reacquired != before:
            return _Step(None, self._state(), np.eye(self.settings.order))
        transition, noise = np.empty((self.settings.order,) * 2), np.empty((self.settings.order,) * 2)
        fill_dynamics(elapsed, self.decay, transition, noise)
        coordinates, rates, covariance = state
        rates *= self.fade
        predict(self._tree, coordinates, rates, covariance, transition, noise, self.spectral)
        return _Step(state, self._state(), transition)

    def _state(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        return self.coordinates.copy(), self.rates.copy(), self.error_covariance.copy()


def _backwards(
    tracker: SkeletonTracker, steps: list[_Step | None]
) -> list[tuple[FloatArray, FloatArray, FloatArray] | None]:
    """Return the smoothed state of each frame."""
    tree, nv = tracker.skeleton.tree, tracker.rates.shape[1]
    smoothed: list[tuple[FloatArray, FloatArray, FloatArray] | None] = [
        step.filtered if step else None for step in steps
    ]
    for index in range(len(steps) - 2, -1, -1):
        here, after, later = steps[index], steps[index + 1], smoothed[index + 1]
        if here is None or after is None or after.predicted is None or later is None:
            continue
        q, rates, covariance = here.filtered
        predicted_q, predicted_rates, predicted_covariance = after.predicted
        whole = np.kron(after.transition, np.eye(nv))
        gain = np.linalg.solve(predicted_covariance, whole @ covariance).T
        error = np.empty(len(covariance))
        difference(tree, later[0], predicted_q, error[:nv])
        error[nv:] = (later[1] - predicted_rates).ravel()
        shift = gain @ error
        q = q.copy()
        move(tree, q, np.ascontiguousarray(shift[:nv]))
        smoothed[index] = (
            q,
            rates + shift[nv:].reshape(rates.shape),
            covariance + gain @ (later[2] - predicted_covariance) @ gain.T,
        )
    return smoothed


def _collect(
    tracker: SkeletonTracker,
    recording: Recording,
    states: list[tuple[FloatArray, FloatArray, FloatArray] | None],
) -> SmoothedMotion:
    """Return the motion of smoothed states."""
    skeleton, frames = tracker.skeleton, len(states)
    n, nv = len(skeleton.displacement_names), tracker.rates.shape[1]
    displacements, velocities, deviations = (np.full((frames, n), np.nan) for _ in range(3))
    poses = np.full((frames, 4, 4), np.nan)
    columns = [recording.names.index(name) for name in skeleton.marker_names]
    residuals = np.full((frames, len(columns)), np.nan)
    known = [index for index, state in enumerate(states) if state is not None]
    q = np.array([state[0] for state in states if state is not None])
    rates = np.array([state[1][0] for state in states if state is not None])
    covariance = np.array([state[2][:nv, :nv] for state in states if state is not None])
    displacements[known] = skeleton.displacements(q, near=tracker.home)
    mapping = skeleton.displacement_mapping(displacements[known])
    velocities[known] = np.einsum("fnv,fv->fn", mapping, rates)
    spread = np.einsum("fnv,fvw,fnw->fn", mapping, covariance, mapping)
    deviations[known] = np.sqrt(np.maximum(spread, 0.0))
    poses[known] = skeleton.world_from_root(q)
    residuals[known] = np.linalg.norm(forward(skeleton.tree, q) - recording.positions[known][:, columns], axis=2)
    return SmoothedMotion(displacements, velocities, deviations, poses, residuals, tracker.gated, tracker.reacquired)
