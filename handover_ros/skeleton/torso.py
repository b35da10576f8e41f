"""Tracks the torso of one person: learns its marker template, then fits it to every frame."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from handover_ros.geometry import FloatArray, make_transform
from handover_ros.mocap.frames import MarkerFrame, MarkerStatus, Recording, measured_mask
from handover_ros.mocap.marker_sets import TorsoDefinition
from handover_ros.skeleton.rigid_fit import RigidFit, fit_rigid_body
from handover_ros.skeleton.torso_template import (
    TemplateError,
    TorsoMarkers,
    estimate_template,
    stated_template,
)

BoolArray = npt.NDArray[np.bool_]

BRIDGED = int(MarkerStatus.BRIDGED)
TEMPLATE_FRAMES = 30
MIN_TEMPLATE_MARKERS = 4
BRIDGED_WEIGHT = 0.1  # a predicted marker says little that the others do not say
LATE_FRAMES = 30  # frames over which the place of a marker seen late is averaged
VELOCITY_TIME = 0.08  # [s] time constant of the velocity estimate
VELOCITY_GAP = 0.3  # [s] after a longer silence the velocity is unknown
MAX_ROTATION_SIGMA = 0.15  # [rad] a pose less certain than this is not valid


class TrackingState(Enum):
    """What the torso tracker is doing."""

    LEARNING = "learning"
    TRACKING = "tracking"
    LOST = "lost"


@dataclass(frozen=True, eq=False)
class TorsoEstimate:
    """Torso pose of one frame; all numbers NaN where not ``valid``.

    Attributes:
        stamp: Time of the frame [s].
        valid: Whether the markers fixed the pose.
        world_from_torso: The pose (4, 4).
        covariance: Of (x y z [m], rotation about fixed axes [rad]), (6, 6).
        velocity: Linear [m/s] and angular [rad/s] velocity in the world, (6,), NaN when unknown.
        markers_used: Number of markers in the fit.
        residual_rms: Root mean square distance of the used markers from the body [m].
        consistency: Squared residuals over their expectation, 1 = as the marker noise says.
        confidence: 0 (nothing seen) to 1 (all markers seen and in place).
    """

    stamp: float
    valid: bool
    world_from_torso: FloatArray
    covariance: FloatArray
    velocity: FloatArray
    markers_used: int
    residual_rms: float
    consistency: float
    confidence: float


class TorsoTracker:
    """Fits the torso to marker frames, one after the other.

    Args:
        definition: The torso of the marker set.
        names: Marker names of the frames, in order.
        template_frames: Good frames from which the template is learned when the marker set states none.

    Attributes:
        state: What the tracker is doing.
        frames: Frames seen.
        valid_frames: Frames with a valid pose.

    Raises:
        TemplateError: The stream has fewer than three torso markers.
    """

    def __init__(
        self, definition: TorsoDefinition, names: tuple[str, ...], template_frames: int = TEMPLATE_FRAMES
    ) -> None:
        self._markers = TorsoMarkers.of(definition, names)
        self._noise = definition.marker_noise
        self._template_frames = template_frames
        self.frames = 0
        self.valid_frames = 0
        self._squared_residuals = 0.0
        self.reset()

    def reset(self) -> None:
        """Forget the person: the template is learned again."""
        self.template: FloatArray | None = stated_template(self._markers)
        self._in_template = np.zeros(len(self._markers.index), dtype=bool)
        if self.template is not None:
            self._in_template = np.isfinite(self.template[:, 0])
        self.state = TrackingState.LEARNING if self.template is None else TrackingState.LOST
        self._collected: list[FloatArray] = []
        self._late_sum = np.zeros((len(self._markers.index), 3))
        self._late_count = np.zeros(len(self._markers.index))
        self._previous: FloatArray | None = None
        self._previous_stamp = -np.inf
        self._velocity = np.full(6, np.nan)

    @property
    def mean_residual(self) -> float:
        """Root mean square over all valid frames of the residual [m]; NaN before the first."""
        return float(np.sqrt(self._squared_residuals / self.valid_frames)) if self.valid_frames else float("nan")

    def update(self, frame: MarkerFrame) -> TorsoEstimate:
        """Return the torso of a frame; frames must come with increasing stamps."""
        self.frames += 1
        positions = frame.positions[self._markers.index]
        status = frame.status[self._markers.index]
        seen = measured_mask(positions)
        if self.template is None and not self._learn(positions, seen & (status != BRIDGED)):
            return self._invalid(frame.stamp)
        assert self.template is not None
        weights = np.where(status == BRIDGED, BRIDGED_WEIGHT, 1.0) * self._markers.weights
        fit = fit_rigid_body(self.template, positions, weights, self._noise, seen & self._in_template)
        if fit is None or fit.covariance[3:, 3:].diagonal().max() > MAX_ROTATION_SIGMA**2:
            self.state = TrackingState.LOST
            return self._invalid(frame.stamp)
        self.state = TrackingState.TRACKING
        self.valid_frames += 1
        self._squared_residuals += fit.residual_rms**2
        if np.count_nonzero(self._in_template) < len(self._in_template):
            self._learn_late(positions, seen & ~self._in_template, fit)
        self._differentiate(frame.stamp, fit.target_from_body)
        return TorsoEstimate(
            stamp=frame.stamp,
            valid=True,
            world_from_torso=fit.target_from_body,
            covariance=fit.covariance,
            velocity=self._velocity.copy(),
            markers_used=int(np.count_nonzero(fit.used)),
            residual_rms=fit.residual_rms,
            consistency=fit.consistency,
            confidence=float(fit.weights.sum() / self._markers.weights.sum()),
        )

    def _learn(self, positions: FloatArray, measured: BoolArray) -> bool:
        """Collect a frame; return whether the template is known now."""
        if measured.sum() < MIN_TEMPLATE_MARKERS and measured.sum() < len(measured):
            return False
        self._collected.append(np.where(measured[:, None], positions, np.nan))
        if len(self._collected) % self._template_frames:
            return False
        try:
            self.template = estimate_template(self._markers, np.array(self._collected))
        except TemplateError:
            self._collected = self._collected[-self._template_frames * 9 :]
            return False
        self._in_template = np.isfinite(self.template[:, 0])
        self._collected = []
        return True

    def _learn_late(self, positions: FloatArray, late: BoolArray, fit: RigidFit) -> None:
        """Learn the place of markers that were hidden while the template was made."""
        assert self.template is not None
        pose = fit.target_from_body
        self._late_sum[late] += (positions[late] - pose[:3, 3]) @ pose[:3, :3]
        self._late_count[late] += 1
        done = (self._late_count >= LATE_FRAMES) & ~self._in_template
        if done.any():
            self.template = self.template.copy()
            self.template[done] = self._late_sum[done] / self._late_count[done, None]
            self._in_template |= done

    def _differentiate(self, stamp: float, pose: FloatArray) -> None:
        """Low-pass the finite differences of the pose."""
        elapsed = stamp - self._previous_stamp
        if self._previous is None or not 0.0 < elapsed <= VELOCITY_GAP:
            self._velocity = np.full(6, np.nan)
        else:
            turn = pose[:3, :3] @ self._previous[:3, :3].T
            step = np.concatenate([pose[:3, 3] - self._previous[:3, 3], small_rotation_vector(turn)]) / elapsed
            if math.isnan(self._velocity[0]):
                self._velocity = step
            else:
                self._velocity += (step - self._velocity) * (elapsed / (VELOCITY_TIME + elapsed))
        self._previous, self._previous_stamp = pose, stamp

    def _invalid(self, stamp: float) -> TorsoEstimate:
        nan = float("nan")
        pose = make_transform(np.full((3, 3), nan), np.full(3, nan))
        return TorsoEstimate(stamp, False, pose, np.full((6, 6), nan), np.full(6, nan), 0, nan, nan, 0.0)


def small_rotation_vector(rotation: FloatArray) -> FloatArray:
    """Return the rotation vector [rad] of a 3x3 rotation; exact, and cheap for the small ones between frames."""
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    x, y, z = 0.5 * (h - f), 0.5 * (c - g), 0.5 * (d - b)
    sine = math.sqrt(x * x + y * y + z * z)
    if sine > 0.5 or a + e + i < 1.0:
        return np.asarray(Rotation.from_matrix(rotation).as_rotvec())
    scale = math.asin(sine) / sine if sine > 1e-9 else 1.0
    return np.array([scale * x, scale * y, scale * z])


def track_recording(definition: TorsoDefinition, recording: Recording, max_frames: int) -> list[TorsoEstimate]:
    """Return the torso in the first ``max_frames`` frames of a recording; the template comes from its first good ones.

    Raises:
        TemplateError: The recording has fewer than three torso markers.
    """
    tracker = TorsoTracker(definition, recording.names)
    positions = recording.positions[:max_frames]
    status = np.zeros(len(recording.names), dtype=np.uint8)
    frames = [
        MarkerFrame(index / recording.rate, index, index / recording.rate, sample, status)
        for index, sample in enumerate(positions)
    ]
    learning = 0
    while learning < len(frames) and tracker.template is None:
        tracker.update(frames[learning])
        learning += 1
    return [tracker.update(frame) for frame in frames]
