"""What is known of a chapter 2 subject through markers alone: the calibrated skeleton, and how the torso turns."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.ndimage import gaussian_filter1d

from handover_ros.arm.hand import hand_frames
from handover_ros.cell.calibrate_command import ROBUST_SCALE, first_coordinates
from handover_ros.errors import BadModelError
from handover_ros.geometry import FloatArray
from handover_ros.mocap.frames import MarkerFrame, MarkerStatus
from handover_ros.mocap.marker_sets import load_marker_set
from handover_ros.sim.calibration_recording import calibration_recording
from handover_ros.sim.person_kinematics import PersonKinematics
from handover_ros.sim.person_skeleton import TEMPLATE, skeleton_of
from handover_ros.sim.person_spec import JOINTS, MARKER_SET, PersonSpec
from handover_ros.skeleton.calibration import CalibrationSettings, calibrate
from handover_ros.skeleton.kernels import forward
from handover_ros.skeleton.postures import solve_postures
from handover_ros.skeleton.templates import load_template
from handover_ros.skeleton.tracking import SkeletonEstimate, SkeletonTracker
from handover_ros.skeleton.tree import Skeleton
from handover_ros.studies.chapter2_settings import Chapter2Settings, MarkerSettings
from handover_ros.studies.chapter2_subjects import Condition, subject
from handover_ros.studies.seeds import generator

EVERY = 8  # every eighth frame of the calibration motions is looked at for the reprojection error
ATTEMPTS = 4  # the motions are made anew when a skeleton cannot be used, as the cell asks for


@dataclass(frozen=True, eq=False)
class Known:
    """What calibration found.

    Attributes:
        skeleton: The person as the planner knows them.
        medians: Median distance [m] of each marker from where the skeleton has it, by name.
        problems: Why the skeleton should not be used; empty: it can.
        attempts: How often the motions were made until it could.
    """

    skeleton: Skeleton
    medians: dict[str, float]
    problems: tuple[str, ...]
    attempts: int


def skin_motion(shape: tuple[int, ...], given: MarkerSettings, rng: np.random.Generator) -> FloatArray:
    """Return how markers slide on the bones [m], of shape (frames, n, 3): slowly, each by itself."""
    width = given.skin_time * given.rate
    raw = gaussian_filter1d(rng.standard_normal((shape[0] + 8 * int(width), *shape[1:])), width, axis=0)
    # The smoothed noise has a known, smaller deviation: 1 / sqrt(2 sqrt(pi) width).
    kept = raw[4 * int(width) : 4 * int(width) + shape[0]]
    return np.asarray(given.skin * kept * np.sqrt(2.0 * np.sqrt(np.pi) * width))


def known(settings: Chapter2Settings, number: int, seed: int, condition: Condition) -> Known:
    """Return what calibration finds of a subject from their own noisy markers.

    Raises:
        HandoverError: The calibration failed, again and again.
    """
    person = subject(settings, number, seed, condition)
    return _known(person.model_dump_json(), settings.markers, settings.calibration_frames, number, seed, condition)


@lru_cache(maxsize=16)
def _known(body: str, given: MarkerSettings, frames: int, number: int, seed: int, condition: Condition) -> Known:
    """Return what calibration finds of a body, which is given as text because that can be remembered."""
    person = PersonSpec.model_validate_json(body)
    rng = generator(seed, f"chapter2 calibration {condition}", number)
    for attempt in range(1, ATTEMPTS + 1):
        recording = calibration_recording(person, int(rng.integers(2**31)), given.rate, given.noise, given.missing)
        moved = recording.positions + skin_motion(recording.positions.shape, given, rng)
        recording = replace(recording, positions=moved)
        fit = CalibrationSettings(max_frames=frames, seed=seed + attempt)
        found = calibrate(recording, load_template(TEMPLATE), load_marker_set(MARKER_SET).torso, fit)
        if found.report.usable and has_hands(found.skeleton):
            break
    hand_frames(found.skeleton)
    skeleton = found.skeleton
    columns = [recording.names.index(name) for name in skeleton.marker_names]
    observed = np.ascontiguousarray(moved[::EVERY, columns])
    postures, _ = solve_postures(skeleton.tree, first_coordinates(skeleton, observed), observed, ROBUST_SCALE)
    distance = np.linalg.norm(forward(skeleton.tree, postures) - observed, axis=2)
    medians = dict(zip(skeleton.marker_names, np.nanmedian(distance, axis=0).tolist()))
    return Known(skeleton, medians, found.report.problems, attempt)


def has_hands(skeleton: Skeleton) -> bool:
    """Return whether the wrists were calibrated well enough to tell how the hands hold something."""
    try:
        hand_frames(skeleton)
    except BadModelError:
        return False
    return True


class Watched:
    """Motion capture and tracking of one subject through one trial.

    Args:
        kinematics: The true person, standing where they stand.
        skeleton: The calibrated one, with which is tracked.
        given: What motion capture sees.
        rng: Of all its errors.
    """

    def __init__(
        self, kinematics: PersonKinematics, skeleton: Skeleton, given: MarkerSettings, rng: np.random.Generator
    ) -> None:
        self._kinematics, self._given, self._rng = kinematics, given, rng
        self._body = skeleton_of(kinematics.person)
        self._columns = [JOINTS.index(name) for name in self._body.displacement_names]
        self._tracker = SkeletonTracker(skeleton, self._body.marker_names)
        self._frames = 0
        self._skin = skin_motion((1, len(self._body.marker_names), 3), given, rng)[0]

    def see(self, postures: FloatArray) -> SkeletonEstimate:
        """Return the estimate in the last of some frames, in which the person has postures (frames, 20)."""
        poses = self._kinematics.torso_pose(postures[:, :6])
        markers = forward(self._body.tree, self._body.coordinates(postures[:, self._columns], poses))
        markers = markers + self._skin + self._given.noise * self._rng.standard_normal(markers.shape)
        markers[self._rng.random(markers.shape[:2]) < self._given.missing] = np.nan
        for positions in markers:
            seen = np.isfinite(positions[:, 0])
            status = np.where(seen, MarkerStatus.MEASURED, MarkerStatus.MISSING).astype(np.uint8)
            stamp = self._frames / self._given.rate
            estimate = self._tracker.update(MarkerFrame(stamp, self._frames, stamp, positions, status))
            self._frames += 1
        return estimate

    def stand(self, posture: FloatArray) -> SkeletonEstimate:
        """Return the estimate after standing for a while in a posture (20,)."""
        return self.see(np.tile(posture, (max(1, round(self._given.stand * self._given.rate)), 1)))

    def reach(self, start: FloatArray, end: FloatArray) -> SkeletonEstimate:
        """Return the estimate at the end of a reach between postures (20,) and of staying there."""
        share = np.linspace(0.0, 1.0, max(2, round(self._given.reach * self._given.rate)))[1:, None]
        way = start + (3.0 * share**2 - 2.0 * share**3) * (end - start)
        stay = np.tile(end, (max(1, round(self._given.stay * self._given.rate)), 1))
        return self.see(np.concatenate([way, stay]))


def heading(world_from_torso: FloatArray) -> float:
    """Return the direction [rad] in which a torso (4, 4) faces, about the vertical."""
    return float(np.arctan2(world_from_torso[1, 0], world_from_torso[0, 0]))


def rotation(before: FloatArray, after: FloatArray) -> float:
    """Return by how much a torso has turned about the vertical between two poses (4, 4) [deg], within half a turn."""
    turn = heading(after) - heading(before)
    return float(np.degrees((turn + np.pi) % (2.0 * np.pi) - np.pi))
