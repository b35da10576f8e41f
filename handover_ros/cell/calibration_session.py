"""What is recorded of one person until it is fitted, and the fit that makes a profile of it."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from handover_ros.errors import BadRequestError, ErrorCode, HandoverError
from handover_ros.geometry import FloatArray
from handover_ros.mocap.frames import MarkerStatus, Recording
from handover_ros.mocap.marker_sets import MarkerSet
from handover_ros.provenance import versions
from handover_ros.resources import config_names
from handover_ros.skeleton.calibration import CalibrationSettings, calibrate
from handover_ros.skeleton.calibration_report import CalibrationReport
from handover_ros.skeleton.profile import Profile, safe_profile_id, utc_now
from handover_ros.skeleton.prompts import PROMPTS, STILL, CalibrationPrompt, prompt_at, prompt_of
from handover_ros.skeleton.templates import NamedTemplate, blank_skeleton, load_template, matching_template

MAX_PERSON = 100  # characters
HAND_MOVES = 0.12  # [m] a hand that is calibrated moves farther than that


@dataclass(frozen=True)
class RecordedMotion:
    """One recording of a session.

    Attributes:
        motion: The calibration motion; empty: all in order.
        positions: Measured positions [m], shape (frames, n, 3), NaN where a marker was not measured.
        lost_frames: Frame numbers of the device that never came.
    """

    motion: str
    positions: FloatArray
    lost_frames: int

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.positions)

    @property
    def missing_fraction(self) -> float:
        """Share of the marker samples that were not measured."""
        return float(np.isnan(self.positions[:, :, 0]).mean()) if self.positions.size else 1.0


class CalibrationSession:
    """The recordings of one person that are not fitted yet.

    Args:
        profile_id: Profile to be made or replaced.
        person: How the operator calls the person.
        template: The tree to fit.
        marker_set: Name of the marker set.
        names: The n marker names of the frames.
        segments: The segment that carries each.
        rate: Frames per second [Hz].
        limit: Longest recording in total [s].

    Raises:
        BadRequestError: The profile's name is not safe, or the person's too long.
        BadRecordingError: The template needs markers that the stream does not have.
    """

    def __init__(
        self,
        profile_id: str,
        person: str,
        template: NamedTemplate,
        marker_set: str,
        names: tuple[str, ...],
        segments: tuple[str, ...],
        rate: float,
        limit: float = 1200.0,
    ) -> None:
        self.profile_id = safe_profile_id(profile_id)
        if len(person) > MAX_PERSON:
            raise BadRequestError(f"person: at most {MAX_PERSON} characters, got {len(person)}")
        blank_skeleton(template, names, segments)
        self.person = person or profile_id
        self.template, self.marker_set = template, marker_set
        self.names, self.segments, self.rate = names, segments, rate
        self._most = int(limit * rate)
        self.motions: list[RecordedMotion] = []
        self.bad_frames = 0
        self.motion = ""
        self._positions: list[bytes] = []
        self._bridged: list[bytes] = []
        self._lost = 0
        self._last_number = -1
        self._motion_start = 0

    @property
    def current_frames(self) -> int:
        """Frames of the present recording."""
        return len(self._positions)

    @property
    def frames(self) -> int:
        """Frames of all recordings."""
        return sum(motion.frames for motion in self.motions) + len(self._positions)

    @property
    def full(self) -> bool:
        """Whether no more frames are taken."""
        return self.frames >= self._most

    def begin(self, motion: str) -> None:
        """Start a recording of one motion, or of all in order when it is empty.

        Raises:
            UnknownNameError: There is no such motion.
        """
        if motion:
            prompt_of(motion)
        self.motion = motion
        self._positions, self._bridged = [], []
        self._lost, self._last_number, self._motion_start = 0, -1, 0

    def prompt_next(self, motion: str) -> None:
        """Go on recording, and ask for another motion.

        Raises:
            UnknownNameError: There is no such motion.
        """
        if motion:
            prompt_of(motion)
        self.motion, self._motion_start = motion, len(self._positions)

    def add(self, positions: array[float], status: array[int], device_frame: int) -> None:
        """Take one frame as it came: 3n positions [m], n states, the device's frame number."""
        if len(positions) != 3 * len(self.names) or len(status) != len(self.names) or self.full:
            self.bad_frames += 1
            return
        self._positions.append(positions.tobytes())
        self._bridged.append(status.tobytes())
        if 0 <= self._last_number < device_frame - 1:
            self._lost += device_frame - self._last_number - 1
        self._last_number = device_frame

    def end(self) -> RecordedMotion:
        """End the present recording and keep it, if it has any frames."""
        count = len(self.names)
        positions = np.frombuffer(b"".join(self._positions), dtype=np.float64).reshape(-1, count, 3).copy()
        states = np.frombuffer(b"".join(self._bridged), dtype=np.uint8).reshape(-1, count)
        # What was predicted over a gap is no measurement.
        positions[(states == MarkerStatus.BRIDGED) | ~np.isfinite(positions).all(axis=2)] = np.nan
        recorded = RecordedMotion(self.motion, positions, self._lost)
        if recorded.frames:
            self.motions.append(recorded)
        self._positions, self._bridged = [], []
        return recorded

    def prompt(self, motion_time: float) -> CalibrationPrompt | None:
        """Return what the person should do now, when each motion gets ``motion_time`` [s]; None: all is over."""
        if self.motion:
            return prompt_of(self.motion)
        return prompt_at((len(self._positions) - self._motion_start) / self.rate, motion_time)

    def fraction(self, motion_time: float) -> float:
        """Return the share of the present recording that is done, 0 to 1."""
        planned = motion_time * (1 if self.motion else len(PROMPTS))
        return min(1.0, (len(self._positions) - self._motion_start) / self.rate / planned)

    def recording(self) -> Recording:
        """Return all recordings joined; standing still comes first, since it defines the zero posture.

        Raises:
            HandoverError: Nothing was recorded (NOT_ENOUGH_DATA).
        """
        if not self.motions:
            raise HandoverError(
                f"nothing was recorded for profile {self.profile_id!r}; call calibration/start_recording first",
                ErrorCode.NOT_ENOUGH_DATA,
            )
        ordered = sorted(self.motions, key=lambda motion: motion.motion not in ("", STILL))
        positions = np.concatenate([motion.positions for motion in ordered])
        return Recording(self.names, self.segments, self.rate, positions, Path(f"recording of {self.profile_id}"))

    @property
    def source(self) -> str:
        """Where the data came from, in words."""
        motions = ", ".join(f"{each.motion or 'all motions'} ({each.frames} frames)" for each in self.motions)
        return f"live markers of set {self.marker_set} at {self.rate:g} Hz: {motions}"


def chosen_template(name: str, segments: tuple[str, ...]) -> NamedTemplate:
    """Return the template of a name, or the one that fits the markers' segments best when it is empty.

    Raises:
        UnknownNameError: There is none of that name.
        HandoverError: None fits (NOT_ENOUGH_DATA).
    """
    if name:
        return load_template(name)
    template = matching_template(segments)
    if template is None:
        raise HandoverError(
            f"no skeleton template fits markers on {', '.join(sorted(set(segments)))}; name one, or write one in "
            "config/skeletons",
            ErrorCode.NOT_ENOUGH_DATA,
        )
    return template


def moving_segments(recording: Recording) -> tuple[str, ...]:
    """Return the segments of the markers that are seen, without the hands that hardly move: their arms are not meant.

    All of them when no hand moves.
    """
    hands = {hand for name in config_names("skeletons") for hand in load_template(name).content.hands.values()}
    seen = np.asarray(np.isfinite(recording.positions[:, :, 0]).any(axis=0))
    shown = tuple(segment for segment, is_seen in zip(recording.segments, seen) if is_seen)
    still = set()
    for hand in hands & set(shown):
        own = [row for row, segment in enumerate(recording.segments) if segment == hand and seen[row]]
        low, high = np.nanpercentile(recording.positions[:, own], [5.0, 95.0], axis=0)
        if float(np.linalg.norm(high - low, axis=1).max()) < HAND_MOVES:
            still.add(hand)
    return tuple(segment for segment in shown if segment not in still) if still < hands & set(shown) else shown


def fit_profile(
    recording: Recording,
    template: NamedTemplate,
    marker_set: MarkerSet,
    profile_id: str,
    person: str,
    source: str,
    settings: CalibrationSettings,
    progress: Callable[[float, float], None] | None = None,
) -> tuple[Profile, CalibrationReport]:
    """Fit a skeleton and return it as a profile, with its report; one with problems must not be stored.

    Raises:
        HandoverError: Not enough data, or no fit was found.
    """
    calibration = calibrate(recording, template, marker_set.torso, settings, progress)
    report = calibration.report
    profile = Profile(
        profile_id=profile_id,
        person=person or profile_id,
        created=utc_now(),
        marker_set=marker_set.name,
        template=template.name,
        skeleton=calibration.skeleton,
        report=report,
        notes=report.advice,
        source=source,
        versions=versions(),
    )
    return profile, report


def require_usable(report: CalibrationReport) -> None:
    """Refuse a fit with problems.

    Raises:
        HandoverError: The sentences of the problems (FIT_FAILED).
    """
    if not report.usable:
        raise HandoverError("; ".join(report.problems), ErrorCode.FIT_FAILED)
