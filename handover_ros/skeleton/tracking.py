"""Tracks a person's posture from marker frames: an unscented Kalman filter over a calibrated skeleton (eq. 2.7)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from handover_ros.errors import BadModelError, BadRequestError
from handover_ros.geometry import FloatArray
from handover_ros.mocap.frames import MarkerFrame
from handover_ros.skeleton.acquisition import Acquisition, acquire
from handover_ros.skeleton.dynamics_model import decays
from handover_ros.skeleton.limit_kernels import displacement_table, limit_table
from handover_ros.skeleton.torso import TrackingState
from handover_ros.skeleton.tracking_kernels import COVARIANCE, POSE, estimate_size, read_estimate, step
from handover_ros.skeleton.tree import JointKind, Skeleton
from handover_ros.skeleton.ukf_kernels import GATED, SEEN

FEWEST_MARKERS = 3
# A sudden motion is allowed for by white acceleration: the density of the dynamics times, by order, a factor or [s^2].
STARTLED = {2: 100.0, 3: 10.0}


@dataclass(frozen=True)
class TrackingSettings:
    """How the filter works.

    Attributes:
        marker_noise: Standard deviation of a marker's coordinate about the skeleton [m]: of the device, and of skin.
        rotation_noise: Spectral density of what drives the joints: for order 2 of angular acceleration [rad^2/s^3], for
            order 3 of angular jerk [rad^2/s^5].
        translation_noise: The same for prismatic joints and the root's position [m^2/s^3] or [m^2/s^5].
        order: 2: displacements and rates, 3: accelerations too.
        rate_memory: Time constant [s] with which rates fade by themselves, as movements end; inf: not at all.
        acceleration_memory: The same for accelerations.
        gate: Squared Mahalanobis distance (3 degrees of freedom) beyond which a marker is not believed; inf: none.
        limits: Whether joint limits bound the estimate.
        limit_margin: How far [rad] or [m] beyond the calibrated limits a joint may go.
        coasting: Time constant [s] with which rates fade while nothing is seen.
        longest_gap: After so long without markers [s] the posture is looked for anew.
        startled_share: Share of the measured markers that may be disbelieved before a sudden motion is allowed for.
        lost_share: Share of the measured markers that may be disbelieved before the posture is looked for anew.
    """

    marker_noise: float = 0.002
    rotation_noise: float = 400.0
    translation_noise: float = 60.0
    order: int = 3
    rate_memory: float = 0.5
    acceleration_memory: float = 0.25
    gate: float = 30.0
    limits: bool = True
    limit_margin: float = 0.035
    coasting: float = 0.15
    longest_gap: float = 0.25
    startled_share: float = 0.12
    lost_share: float = 0.5

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            BadRequestError: A setting is out of its range.
        """
        for name in (
            "marker_noise",
            "rotation_noise",
            "translation_noise",
            "rate_memory",
            "acceleration_memory",
            "gate",
            "coasting",
            "longest_gap",
        ):
            if not getattr(self, name) > 0.0:
                raise BadRequestError(f"tracking: {name} must be positive, got {getattr(self, name)}")
        if self.order not in (2, 3):
            raise BadRequestError(f"tracking: order must be 2 or 3, got {self.order}")


@dataclass(frozen=True, eq=False)
class SkeletonEstimate:
    """The person in one frame; all numbers NaN where not ``valid``.

    Attributes:
        stamp: Time of the frame [s].
        valid: Whether the markers fixed the posture.
        world_from_torso: Root pose (4, 4); for a skeleton on a fixed root the identity.
        torso_covariance: Of (x y z [m], rotation about fixed axes [rad]), (6, 6).
        torso_velocity: Linear [m/s] and angular [rad/s] in the world, (6,).
        displacements: Shape (n,) [rad] or [m].
        velocities: Their rates, shape (n,) [rad/s] or [m/s].
        covariance: Of the displacements, shape (n, n).
        markers_used: Markers that were believed.
        residual_rms: Root mean square distance of the believed markers from the estimate [m].
        consistency: Normalised innovation squared over its degrees of freedom; 1 = as uncertain as it says.
        confidence: Share of the skeleton's markers that were believed, 0 to 1.
        marker_predictions: Where the skeleton has its markers [m], shape (m, 3), in the order of the skeleton.
    """

    stamp: float
    valid: bool
    world_from_torso: FloatArray
    torso_covariance: FloatArray
    torso_velocity: FloatArray
    displacements: FloatArray
    velocities: FloatArray
    covariance: FloatArray
    markers_used: int
    residual_rms: float
    consistency: float
    confidence: float
    marker_predictions: FloatArray


class SkeletonTracker:
    """Filters marker frames, one after the other; frames must come with increasing stamps.

    Outliers are gated, swapped labels put back, joint limits kept, and after a dropout the posture is found again by
    itself.

    Args:
        skeleton: The calibrated skeleton.
        marker_names: Names of the markers of the frames, in order; those the skeleton lacks are not used.
        settings: How.

    Attributes:
        state: LOST or TRACKING.
        frames: Frames seen.
        valid_frames: Frames with a posture.
        gated: Measurements not believed.
        relabelled: Measurements put back under their label.
        reacquired: Times the posture was found anew, the first time included.
        coordinates: Present posture, shape (nq,).
        rates: Derivatives of its tangent, shape (order - 1, nv).
        home: Displacements (n,) in the middle of what is possible.
        error_covariance: Of tangent and derivatives, shape (order nv, order nv).
        spectral: Spectral density of each tangent's noise, shape (nv,).
        decay: How fast the derivatives fade [1/s], shape (order - 1,).
        fade: Factor on the rates before the last prediction; 1 unless nothing was seen.

    Raises:
        BadModelError: The frames lack so many of the skeleton's markers that a joint cannot be seen.
    """

    def __init__(
        self, skeleton: Skeleton, marker_names: tuple[str, ...], settings: TrackingSettings | None = None
    ) -> None:
        self.settings = settings or TrackingSettings()
        known = tuple(name for name in skeleton.marker_names if name in marker_names)
        self.skeleton = skeleton.with_markers(known)
        _check_visible(self.skeleton, skeleton)
        self._columns = np.array([marker_names.index(name) for name in known], dtype=np.intp)
        self._tree = self.skeleton.tree
        _, self._tangents = self.skeleton.size
        self._limits = limit_table(self.skeleton, self.settings.limit_margin)
        self.spectral = np.full(self._tangents, self.settings.rotation_noise)
        for index, joint in enumerate(self.skeleton.joints):
            own = self.skeleton.tangent_slice(index)
            if joint.kind is JointKind.PRISMATIC:
                self.spectral[own] = self.settings.translation_noise
            elif joint.kind is JointKind.FREE:
                self.spectral[own.start : own.start + 3] = self.settings.translation_noise
        self._startled = STARTLED[self.settings.order] * self.spectral
        self.decay = decays(self.settings.order, self.settings.rate_memory, self.settings.acceleration_memory)
        count = len(known)
        self._observed = np.full((count, 3), np.nan)
        self._not_valid = _not_valid(self.skeleton)
        self.home = np.where(
            np.isfinite(self.skeleton.lower) & np.isfinite(self.skeleton.upper), self.skeleton.middle, 0.0
        )
        self._table = displacement_table(self.skeleton, self.home)
        self._size = estimate_size(count, len(self.home))
        self.frames = self.valid_frames = self.gated = self.relabelled = self.reacquired = 0
        self._squared_residuals = 0.0
        self.reset()

    def reset(self) -> None:
        """Forget the posture: it is looked for in the next frame."""
        self.state = TrackingState.LOST
        self.coordinates = self.skeleton.zero
        size = self.settings.order * self._tangents
        self.rates = np.zeros((self.settings.order - 1, self._tangents))
        self.error_covariance = np.eye(size)
        self._stamp = self._seen = -math.inf
        self.fade = 1.0

    @property
    def mean_residual(self) -> float:
        """Root mean square over all valid frames of the residual [m]; NaN before the first."""
        return math.sqrt(self._squared_residuals / self.valid_frames) if self.valid_frames else math.nan

    def update(self, frame: MarkerFrame) -> SkeletonEstimate:
        """Return the person in a frame."""
        self.frames += 1
        settings, stamp = self.settings, frame.stamp
        observed = self._observed = frame.positions.take(self._columns, 0)
        elapsed = stamp - self._stamp
        self._stamp = stamp
        if self.state is not TrackingState.TRACKING or not 0.0 < elapsed <= settings.longest_gap:
            self.state = TrackingState.LOST
            return self._look_for(stamp)
        # Without any marker a movement is not taken to go on for long.
        self.fade = math.exp(-elapsed / settings.coasting) if stamp - self._seen > 1.5 * elapsed else 1.0
        out = np.empty(self._size)
        used, squared, distance, gated, seen, relabelled = step(
            self._tree,
            self._limits,
            self._table,
            self.coordinates,
            self.rates,
            self.error_covariance,
            self.spectral,
            self.decay,
            observed,
            frame.status.take(self._columns),
            settings.marker_noise,
            elapsed,
            self.fade,
            settings.gate,
            FEWEST_MARKERS,
            settings.startled_share,
            self._startled,
            settings.limits,
            out,
        )
        if used < 0:
            raise BadModelError(f"skeleton {self.skeleton.name!r}: the filter's covariance is not positive definite")
        if gated > settings.lost_share * (gated + seen) and gated + seen >= FEWEST_MARKERS:
            # It is not the markers that are wrong. Look for the posture; if none is found, go on as before.
            estimate = self._look_for(stamp)
            if estimate.valid:
                return estimate
        self.gated += gated
        self.relabelled += relabelled
        if used >= FEWEST_MARKERS:
            self._seen = stamp
        elif stamp - self._seen > settings.longest_gap:
            self.state = TrackingState.LOST
            return self._lost(stamp)
        return self._estimate(stamp, out, used, distance, squared / (3 * used) if used else math.nan)

    def _look_for(self, stamp: float) -> SkeletonEstimate:
        """Find the posture in one frame by itself, and begin again from there."""
        observed = self._observed
        found = acquire(self.skeleton, observed, self.coordinates, self.settings.marker_noise, self.home)
        if found is None:
            return self._lost(stamp)
        self._restart(found)
        self._seen = stamp
        out = np.empty(self._size)
        status = np.where(np.isfinite(observed[:, 0]), SEEN, GATED)
        state = self.coordinates, self.rates, self.error_covariance
        distance = read_estimate(self._tree, self._table, *state, observed, status, out)
        return self._estimate(stamp, out, int(np.count_nonzero(status == SEEN)), distance, math.nan)

    def _restart(self, found: Acquisition) -> None:
        """Begin again from a posture."""
        self.state = TrackingState.TRACKING
        self.reacquired += 1
        nv = self._tangents
        self.coordinates = found.coordinates
        self.rates[:] = 0.0
        self.error_covariance[:] = 0.0
        self.error_covariance[:nv, :nv] = found.covariance
        for a, deviation in ((1, 3.0), (2, 30.0)):
            if a < self.settings.order:
                own = slice(a * nv, (a + 1) * nv)
                self.error_covariance[own, own] = deviation**2 * np.eye(nv)

    def _estimate(
        self, stamp: float, out: FloatArray, used: int, distance: float, consistency: float
    ) -> SkeletonEstimate:
        """Return the estimate that was read out."""
        self.valid_frames += 1
        residual = math.nan
        if used:
            self._squared_residuals += distance / used
            residual = math.sqrt(distance / used)
        n, at = len(self.home), 3 * len(self._columns)
        root = at + 2 * n + n * n
        return SkeletonEstimate(
            stamp=stamp,
            valid=True,
            world_from_torso=out[root : root + POSE].reshape(4, 4),
            torso_covariance=out[root + POSE : root + POSE + COVARIANCE].reshape(6, 6),
            torso_velocity=out[root + POSE + COVARIANCE :],
            displacements=out[at : at + n],
            velocities=out[at + n : at + 2 * n],
            covariance=out[at + 2 * n : root].reshape(n, n),
            markers_used=used,
            residual_rms=residual,
            consistency=consistency,
            confidence=used / len(self._columns),
            marker_predictions=out[:at].reshape(-1, 3),
        )

    def _lost(self, stamp: float) -> SkeletonEstimate:
        """Return the estimate of a frame in which the posture is not known."""
        return replace(self._not_valid, stamp=stamp)


def _not_valid(skeleton: Skeleton) -> SkeletonEstimate:
    """Return an estimate that is not valid; its stamp is to be set."""
    n, nan = len(skeleton.displacement_names), math.nan
    return SkeletonEstimate(
        stamp=nan,
        valid=False,
        world_from_torso=np.full((4, 4), nan),
        torso_covariance=np.full((6, 6), nan),
        torso_velocity=np.full(6, nan),
        displacements=np.full(n, nan),
        velocities=np.full(n, nan),
        covariance=np.full((n, n), nan),
        markers_used=0,
        residual_rms=nan,
        consistency=nan,
        confidence=0.0,
        marker_predictions=np.full((len(skeleton.marker_names), 3), nan),
    )


def _check_visible(part: Skeleton, whole: Skeleton) -> None:
    """Refuse frames in which a joint at the end of a limb, or a free root, has no markers."""
    missing = [name for name in whole.marker_names if name not in part.marker_names]
    ends = {joint.segment for joint in whole.joints} - {joint.parent for joint in whole.joints}
    blind = sorted(segment for segment in ends if segment not in part.marker_segments)
    if whole.is_free and part.marker_segments.count(whole.root) < FEWEST_MARKERS:
        blind.insert(0, whole.root)
    if blind:
        raise BadModelError(
            f"skeleton {whole.name!r} cannot be tracked: the frames lack its markers {', '.join(missing)}, so that "
            f"{blind[0]} is not seen; use the marker set the person was calibrated with, or calibrate again"
        )
