"""Tracks a person's posture from marker frames: an unscented Kalman filter over a calibrated skeleton (eq. 2.7)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from handover_ros.errors import BadModelError, BadRequestError
from handover_ros.geometry import FloatArray
from handover_ros.mocap.frames import MarkerFrame, MarkerStatus
from handover_ros.skeleton.acquisition import Acquisition, acquire
from handover_ros.skeleton.dynamics_model import linear_dynamics
from handover_ros.skeleton.kernels import turn_of_quaternion
from handover_ros.skeleton.limit_kernels import apply_limits, displacement_table, limit_table, read_displacements
from handover_ros.skeleton.torso import TrackingState
from handover_ros.skeleton.tree import Skeleton
from handover_ros.skeleton.ukf_kernels import (
    GATED,
    RELABELLED,
    SEEN,
    factor_columns,
    follow_liveliness,
    judge_markers,
    posterior_distance,
    predict,
    spread_points,
    update,
)

BRIDGED = int(MarkerStatus.BRIDGED)
BRIDGED_FACTOR = 5.0  # a predicted marker is this many times less certain than a measured one
FEWEST_MARKERS = 3
# The densities follow how much the rates had to be corrected lately: up quickly, down slowly, within these multiples of
# where they start. In balance the corrections' variance is what the dynamics add (Mehra 1972); a share of it is aimed
# at, since people's motions are smoother than white acceleration.
RISE, FALL = 0.05, 0.2  # [s] time constants
AIMED_SHARE = 0.7
CALMEST, LIVELIEST = 1.0 / 60.0, 5.0
STARTLED = 100.0  # times the usual noise of the dynamics in a frame with a sudden motion


@dataclass(frozen=True)
class TrackingSettings:
    """How the filter works.

    Attributes:
        marker_noise: Standard deviation of a marker's coordinate about the skeleton [m]: of the device, and of skin.
        rotation_noise: Spectral density of what drives the joints: for order 2 of angular acceleration [rad^2/s^3], for
            order 3 of angular jerk [rad^2/s^5].
        translation_noise: The same for prismatic joints and the root's position [m^2/s^3] or [m^2/s^5].
        order: 2: displacements and rates, 3: accelerations too.
        adaptive: Whether the spectral density of each tangent follows the motion (order 2 only); the two values above
            are where it starts.
        gate: Squared Mahalanobis distance (3 degrees of freedom) beyond which a marker is not believed; inf: none.
        limits: Whether joint limits bound the estimate.
        limit_margin: How far [rad] or [m] beyond the calibrated limits a joint may go.
        coasting: Time constant [s] with which rates fade while nothing is seen.
        longest_gap: After so long without markers [s] the posture is looked for anew.
        startled_share: Share of the measured markers that may be disbelieved before a sudden motion is allowed for.
        lost_share: Share of the measured markers that may be disbelieved before the posture is looked for anew.
    """

    marker_noise: float = 0.002
    rotation_noise: float = 60.0
    translation_noise: float = 2.0
    order: int = 2
    adaptive: bool = True
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
        for name in ("marker_noise", "rotation_noise", "translation_noise", "gate", "coasting", "longest_gap"):
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
        self._spectral = np.full(self._tangents, self.settings.rotation_noise)
        for index, joint in enumerate(self.skeleton.joints):
            own = self.skeleton.tangent_slice(index)
            if joint.kind.name == "PRISMATIC":
                self._spectral[own] = self.settings.translation_noise
            elif joint.kind.name == "FREE":
                self._spectral[own.start : own.start + 3] = self.settings.translation_noise
        self._first_spectral = self._spectral.copy()
        count, size = len(known), self.settings.order * self._tangents
        self._gain = np.empty((size, self._tangents))
        self._mean = np.empty((count, 3))
        self._first, self._second = np.empty((count, 3, self._tangents)), np.empty((count, 3, self._tangents))
        self._status = np.full(count, GATED, dtype=np.int64)
        self._measured = np.empty((count, 3))
        self._variance = np.empty(count)
        self._not_valid = _not_valid(self.skeleton)
        self.home = np.where(
            np.isfinite(self.skeleton.lower) & np.isfinite(self.skeleton.upper), self.skeleton.middle, 0.0
        )
        self._table = displacement_table(self.skeleton, self.home)
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
        self._spectral[:] = self._first_spectral
        self._activity = self._first_spectral.copy()
        self._stamp = self._seen = -math.inf

    @property
    def mean_residual(self) -> float:
        """Root mean square over all valid frames of the residual [m]; NaN before the first."""
        return math.sqrt(self._squared_residuals / self.valid_frames) if self.valid_frames else math.nan

    def update(self, frame: MarkerFrame) -> SkeletonEstimate:
        """Return the person in a frame."""
        self.frames += 1
        observed = frame.positions[self._columns]
        self._variance[:] = self.settings.marker_noise**2
        bridged = frame.status[self._columns] == BRIDGED
        if bridged.any():
            self._variance[bridged] *= BRIDGED_FACTOR**2
        elapsed = frame.stamp - self._stamp
        self._stamp = frame.stamp
        if self.state is not TrackingState.TRACKING or not 0.0 < elapsed <= self.settings.longest_gap:
            return self._look_for(frame.stamp, observed)
        self._predict(elapsed)
        used, squared = self._correct(observed, elapsed)
        if used >= FEWEST_MARKERS:
            self._seen = frame.stamp
        elif frame.stamp - self._seen > self.settings.longest_gap:
            self.state = TrackingState.LOST
            return self._lost(frame.stamp)
        consistency = squared / (3 * used) if used else math.nan
        return self._estimate(frame.stamp, used, consistency)

    def _fade(self, elapsed: float) -> float:
        """Return the time constant [s] with which rates fade now: none while markers are seen."""
        return self.settings.coasting if self._stamp - self._seen > 1.5 * elapsed else math.inf

    def _predict(self, elapsed: float) -> None:
        transition, noise = linear_dynamics(elapsed, self.settings.order, self._fade(elapsed))
        predict(self._tree, self.coordinates, self.rates, self.error_covariance, transition, noise, self._spectral)

    def _judge(self, observed: FloatArray) -> tuple[int, int]:
        """Predict the markers, decide which measurements to believe; return the numbers of disbelieved and believed."""
        if not factor_columns(self.error_covariance, self._tangents, self._gain):
            raise BadModelError(f"skeleton {self.skeleton.name!r}: the filter's covariance is not positive definite")
        spread_points(self._tree, self.coordinates, self._gain, self._mean, self._first, self._second)
        return judge_markers(
            observed,
            self._mean,
            self._first,
            self._second,
            self._variance,
            self.settings.gate,
            self._status,
            self._measured,
        )

    def _correct(self, observed: FloatArray, elapsed: float) -> tuple[int, float]:
        """Correct by the markers; return how many were believed and the normalised innovation squared."""
        gated, seen = self._judge(observed)
        if gated >= FEWEST_MARKERS and gated > self.settings.startled_share * (gated + seen):
            # So many markers are rarely wrong at once: the person rather moved more suddenly than expected.
            _, noise = linear_dynamics(elapsed, self.settings.order)
            own = np.arange(self._tangents)
            for a in range(self.settings.order):
                for b in range(self.settings.order):
                    rows, columns = own + a * self._tangents, own + b * self._tangents
                    self.error_covariance[rows, columns] += STARTLED * noise[a, b] * self._spectral
            gated, seen = self._judge(observed)
        if gated > self.settings.lost_share * (gated + seen) and gated + seen >= FEWEST_MARKERS:
            # It is not the markers that are wrong. Look for the posture; if none is found, go on as before.
            found = acquire(self.skeleton, observed, self.coordinates, self.settings.marker_noise, self.home)
            if found is not None:
                self._restart(found)
                return int(np.count_nonzero(np.isfinite(observed[:, 0]))), math.nan
        self.gated += gated
        if seen < len(self._columns):
            self.relabelled += int(np.count_nonzero(self._status == RELABELLED))
        before = self.rates[0].copy()
        squared, used = update(
            self._tree,
            self.coordinates,
            self.rates,
            self.error_covariance,
            self._gain,
            self._mean,
            self._first,
            self._second,
            self._measured,
            self._status,
            self._variance,
        )
        if self.settings.adaptive and self.settings.order == 2 and used:
            follow_liveliness(
                self._spectral,
                self._activity,
                self._first_spectral,
                self.rates[0] - before,
                elapsed,
                RISE,
                FALL,
                AIMED_SHARE,
                CALMEST,
                LIVELIEST,
            )
        if self.settings.limits:
            apply_limits(self._tree, self.coordinates, self.rates, self.error_covariance, *self._limits)
        return used, squared

    def _look_for(self, stamp: float, observed: FloatArray) -> SkeletonEstimate:
        """Find the posture in one frame by itself."""
        self.state = TrackingState.LOST
        found = acquire(self.skeleton, observed, self.coordinates, self.settings.marker_noise, self.home)
        if found is None:
            return self._lost(stamp)
        self._restart(found)
        self._seen = stamp
        self._measured[:] = observed
        self._status[:] = np.where(np.isfinite(observed[:, 0]), SEEN, GATED)
        return self._estimate(stamp, found.markers_used, math.nan)

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

    def _estimate(self, stamp: float, used: int, consistency: float) -> SkeletonEstimate:
        self.valid_frames += 1
        predictions = np.empty_like(self._mean)
        squared = posterior_distance(self._tree, self.coordinates, self._measured, self._status, predictions)
        residual = math.sqrt(squared / used) if used else math.nan
        if used:
            self._squared_residuals += residual**2
        skeleton, nv = self.skeleton, self._tangents
        n = len(self.home)
        displacements, velocities, covariance = np.empty(n), np.empty(n), np.empty((n, n))
        posture_covariance = self.error_covariance[:nv, :nv]
        read_displacements(
            self._tree,
            self._table,
            self.coordinates,
            self.rates[0],
            posture_covariance,
            displacements,
            velocities,
            covariance,
        )
        return SkeletonEstimate(
            stamp=stamp,
            valid=True,
            world_from_torso=root_pose_of(skeleton, self.coordinates),
            torso_covariance=self.error_covariance[:6, :6].copy() if skeleton.is_free else np.zeros((6, 6)),
            torso_velocity=self.rates[0, :6].copy() if skeleton.is_free else np.zeros(6),
            displacements=displacements,
            velocities=velocities,
            covariance=covariance,
            markers_used=used,
            residual_rms=residual,
            consistency=consistency,
            confidence=used / len(self._columns),
            marker_predictions=predictions,
        )

    def _lost(self, stamp: float) -> SkeletonEstimate:
        """Return the estimate of a frame in which the posture is not known."""
        return replace(self._not_valid, stamp=stamp)


def root_pose_of(skeleton: Skeleton, coordinates: FloatArray) -> FloatArray:
    """Return ``Skeleton.world_from_root`` of one posture (nq,), cheaper."""
    pose = np.eye(4)
    if skeleton.is_free:
        turn_of_quaternion(coordinates, 3, pose[:3, :3])
        pose[:3, 3] = coordinates[:3]
    return pose


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
