"""``handover track``: a recording as the motion of one person's skeleton: CSV, picture, numbers."""

from __future__ import annotations

import csv
import io
import math
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from handover_ros.cell.late_progress import LateProgress
from handover_ros.cell.marker_files import load_recordings
from handover_ros.cell.motion_picture import MarkerBar, Motion, draw_motion
from handover_ros.cell.report import output_folder, write_json
from handover_ros.cell.store import SUFFIX, ProfileStore
from handover_ros.errors import BadModelError, BadRecordingError, ErrorCode
from handover_ros.files import write_whole
from handover_ros.geometry import FloatArray
from handover_ros.mocap.frames import MarkerFrame, Recording
from handover_ros.skeleton.profile import Profile, read_profile
from handover_ros.skeleton.smoothing import smooth
from handover_ros.skeleton.tracking import SkeletonTracker
from handover_ros.skeleton.tree import JointKind, Skeleton

TOLD_EVERY = 200  # frames between two steps of the progress bar
BEYOND = 1e-6  # [rad] or [m] beyond a limit that is rounding


@dataclass(frozen=True)
class TrackRequest:
    """What ``handover track`` was asked for.

    Attributes:
        recording: The file.
        profile: Name of a stored profile, or a profile's file.
        marker_set: Marker set; ``auto``: the one that fits the labels.
        smooth: Whether frames after a frame help to estimate it.
        seed: Written into the JSON; tracking draws no random numbers.
        json_file: Where to write the numbers too.
        out: Folder of everything written.
    """

    recording: Path
    profile: str
    marker_set: str = "auto"
    smooth: bool = False
    seed: int = 0
    json_file: Path | None = None
    out: Path | None = None


@dataclass(frozen=True, eq=False)
class Tracked:
    """A tracked recording.

    Attributes:
        skeleton: The skeleton, with the markers that the recording has.
        displacements: (frames, n) [rad] or [m]; NaN where nobody was found.
        velocities: (frames, n).
        deviations: (frames, n) standard deviations.
        residuals: (frames, m) distances of the measured markers [m], NaN = not measured.
        counts: Measurements not believed, put back under their label, and times the posture was found anew.
        consistency: Mean normalised innovation squared over its degrees of freedom; NaN: not known.
    """

    skeleton: Skeleton
    displacements: FloatArray
    velocities: FloatArray
    deviations: FloatArray
    residuals: FloatArray
    counts: dict[str, int]
    consistency: float


def run_track(request: TrackRequest, console: Console) -> int:
    """Track, report, draw and write; return the exit status.

    Raises:
        HandoverError: Bad input.
    """
    profile = named_profile(request.profile)
    recording = load_recordings((request.recording,), request.marker_set).recording
    began = time.perf_counter()
    with LateProgress(console, "tracking") as bar:
        tracked = (
            smoothed(profile.skeleton, recording) if request.smooth else filtered(profile.skeleton, recording, bar)
        )
    seconds = time.perf_counter() - began
    metrics = metrics_of(tracked, seconds)
    folder = output_folder(request.out, "track")
    written = [folder / "displacements.csv"]
    times = np.arange(recording.frames) / recording.rate
    write_whole(written[0], csv_text(tracked, times))
    motion = Motion(times, tracked.displacements, tracked.deviations)
    how = "smoothed" if request.smooth else "tracked"
    title = f"{request.recording.name} {how} with {profile.person}: {metrics['reprojection_mean_mm']:.1f} mm mean"
    labels = ("mean distance from the skeleton", "")
    written.append(draw_motion(folder / "track.png", tracked.skeleton, motion, bars_of(tracked), title, labels))
    console.print(f"{title} of {recording.frames} frames at {recording.rate:g} Hz", highlight=False, soft_wrap=True)
    console.print(table_of(tracked))
    numbers = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    for key, value in metrics.items():
        numbers.add_row(key, f"{value:.4g}" if isinstance(value, float) else str(value))
    console.print(numbers)
    for target in filter(None, (folder / "track.json", request.json_file)):
        write_json(
            target, "track", True, request.seed, metrics, files=written, profile=profile.profile_id, folder=str(folder)
        )
    console.print(f"everything is in {folder}", highlight=False, soft_wrap=True)
    return 0


def named_profile(name: str) -> Profile:
    """Return the profile of a file, or of the store.

    Raises:
        HandoverError: There is none, or it is damaged.
    """
    if name.endswith(SUFFIX) or "/" in name:
        return read_profile(Path(name))
    if not name:
        raise BadModelError("--profile: name a stored profile or a profile's file; ./handover calibrate makes one")
    return ProfileStore().load(name)


def filtered(skeleton: Skeleton, recording: Recording, bar: LateProgress | None = None) -> Tracked:
    """Return a recording as the live filter sees it, frame by frame.

    Raises:
        BadModelError: The recording lacks markers of the skeleton.
        BadRecordingError: Nobody was found in any frame.
    """
    tracker = SkeletonTracker(skeleton, recording.names)
    own = tracker.skeleton
    columns = [recording.names.index(name) for name in own.marker_names]
    status = np.zeros(len(recording.names), dtype=np.uint8)
    n, frames = len(own.displacement_names), recording.frames
    displacements, velocities, deviations = (np.full((frames, n), np.nan) for _ in range(3))
    residuals = np.full((frames, len(columns)), np.nan)
    consistencies = np.full(frames, np.nan)
    for index, positions in enumerate(recording.positions):
        time_now = index / recording.rate
        estimate = tracker.update(MarkerFrame(time_now, index, time_now, positions, status))
        if bar is not None and index % TOLD_EVERY == 0:
            bar.update(index / frames, f"{index} of {frames} frames")
        if not estimate.valid:
            continue
        displacements[index], velocities[index] = estimate.displacements, estimate.velocities
        deviations[index] = np.sqrt(np.maximum(np.diag(estimate.covariance), 0.0))
        residuals[index] = np.linalg.norm(estimate.marker_predictions - positions[columns], axis=1)
        consistencies[index] = estimate.consistency
    if not tracker.valid_frames:
        raise BadRecordingError(
            f"{recording.path}: no frame shows enough markers of the profile's skeleton {skeleton.name!r}",
            ErrorCode.NOT_ENOUGH_DATA,
        )
    counts = {"gated": tracker.gated, "relabelled": tracker.relabelled, "reacquired": tracker.reacquired}
    known = consistencies[np.isfinite(consistencies)]
    consistency = float(known.mean()) if len(known) else math.nan
    return Tracked(own, displacements, velocities, deviations, residuals, counts, consistency)


def smoothed(skeleton: Skeleton, recording: Recording) -> Tracked:
    """Return a recording smoothed over its whole length.

    Raises:
        BadModelError: The recording lacks markers of the skeleton.
        BadRecordingError: Nobody was found in any frame.
    """
    motion = smooth(skeleton, recording)
    own = skeleton.with_markers(tuple(name for name in skeleton.marker_names if name in recording.names))
    counts = {"gated": motion.gated, "reacquired": motion.reacquired}
    return Tracked(own, motion.displacements, motion.velocities, motion.deviations, motion.residuals, counts, math.nan)


def metrics_of(tracked: Tracked, seconds: float) -> dict[str, float]:
    """Return the metrics of a tracked recording."""
    values = tracked.displacements
    found = np.isfinite(values).all(axis=1)
    beyond = (values < tracked.skeleton.lower - BEYOND) | (values > tracked.skeleton.upper + BEYOND)
    measured = tracked.residuals[np.isfinite(tracked.residuals)]
    return {
        "frames": len(values),
        "valid_frames": int(found.sum()),
        "reprojection_mean_mm": 1e3 * float(measured.mean()) if len(measured) else math.nan,
        "nonfinite": int((~np.isfinite(values)).sum()),
        "beyond_limits": int(beyond.sum()),
        "consistency": tracked.consistency,
        **tracked.counts,
        "seconds": seconds,
        "frames_per_s": len(values) / seconds,
    }


def csv_text(tracked: Tracked, times: FloatArray) -> str:
    """Return time, displacements, rates, standard deviations and mean marker distance as CSV; empty: not known."""
    names = tracked.skeleton.displacement_names
    units = ["m" if is_length else "rad" for is_length in lengths(tracked.skeleton)]
    heading = ["time [s]"]
    for suffix, per in (("", ""), (" rate", "/s"), (" standard deviation", "")):
        heading += [f"{name}{suffix} [{unit}{per}]" for name, unit in zip(names, units)]
    seen = np.isfinite(tracked.residuals)
    distance = np.where(seen, tracked.residuals, 0.0).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
    distance[~seen.any(axis=1)] = np.nan
    columns = (times[:, None], tracked.displacements, tracked.velocities, tracked.deviations, distance[:, None])
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*heading, "marker distance [m]"])
    for row in np.concatenate(columns, axis=1).tolist():
        writer.writerow(["" if math.isnan(value) else f"{value:.9g}" for value in row])
    return text.getvalue()


def lengths(skeleton: Skeleton) -> list[bool]:
    """Return which displacements are lengths."""
    return [skeleton.joints[joint].kind is JointKind.PRISMATIC for joint in skeleton.displacement_joints]


def bars_of(tracked: Tracked) -> list[MarkerBar]:
    """Return each marker's mean distance."""
    skeleton, bars = tracked.skeleton, []
    for column, (name, segment) in enumerate(zip(skeleton.marker_names, skeleton.marker_segments)):
        own = tracked.residuals[:, column]
        own = own[np.isfinite(own)]
        bars.append(MarkerBar(name, segment, float(own.mean()) if len(own) else math.nan, math.nan))
    return bars


def table_of(tracked: Tracked) -> Table:
    """Return the table of the displacements: limits of the profile, range seen."""
    table = Table(title="Displacements [deg, mm]", title_justify="left", box=None, padding=(0, 2, 0, 0))
    table.add_column("displacement", no_wrap=True)
    for heading in ("from", "to", "lower limit", "upper limit", "deviation"):
        table.add_column(heading, justify="right")
    skeleton = tracked.skeleton
    for index, (name, is_length) in enumerate(zip(skeleton.displacement_names, lengths(skeleton))):
        scale = 1e3 if is_length else 180.0 / math.pi
        own, deviation = tracked.displacements[:, index], tracked.deviations[:, index]
        known = np.isfinite(own)
        values = (own[known].min(), own[known].max(), skeleton.lower[index], skeleton.upper[index])
        spread = float(np.median(deviation[known]))
        table.add_row(name, *(f"{scale * value:.0f}" for value in values), f"{scale * spread:.1f}")
    return table
