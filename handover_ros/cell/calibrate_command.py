"""``handover calibrate``: fit a person's skeleton to recordings, report, draw, store."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from handover_ros.cell.calibration_session import chosen_template, fit_profile, moving_segments, require_usable
from handover_ros.cell.calibration_tables import print_report
from handover_ros.cell.late_progress import LateProgress
from handover_ros.cell.marker_files import JoinedFiles, load_recordings
from handover_ros.cell.motion_picture import MarkerBar, Motion, draw_motion
from handover_ros.cell.report import output_folder, write_json
from handover_ros.cell.store import ProfileStore
from handover_ros.files import write_whole
from handover_ros.geometry import FloatArray, make_transform
from handover_ros.mocap.frames import Recording
from handover_ros.skeleton.calibration import CalibrationSettings
from handover_ros.skeleton.calibration_report import CalibrationReport
from handover_ros.skeleton.postures import solve_postures
from handover_ros.skeleton.profile import Profile, profile_to_json, report_document, safe_profile_id
from handover_ros.skeleton.rigid_fit import fit_rigid_body
from handover_ros.skeleton.tree import Skeleton

PICTURE_FRAMES = 3000
ROBUST_SCALE = 0.02  # [m]
MARKER_NOISE = 0.001  # [m]


@dataclass(frozen=True)
class CalibrateRequest:
    """What ``handover calibrate`` was asked for.

    Attributes:
        recordings: Files, joined in this order; the person stands still at the beginning of the first.
        template: Skeleton template; empty: the one that fits the markers.
        marker_set: Marker set; ``auto``: the one that fits the labels.
        person: How the operator calls the person; empty: the profile's name.
        profile_id: Name of the profile; empty: from the first file's name.
        store: Whether to store it; None: if it was named.
        max_frames: Frames that enter the fit.
        seed: Of the fit's random starts.
        json_file: Where to write the numbers too.
        out: Folder of everything written.
    """

    recordings: tuple[Path, ...]
    template: str = ""
    marker_set: str = "auto"
    person: str = ""
    profile_id: str = ""
    store: bool | None = None
    max_frames: int = CalibrationSettings.max_frames
    seed: int = 0
    json_file: Path | None = None
    out: Path | None = None


def run_calibrate(request: CalibrateRequest, console: Console) -> int:
    """Fit, report, draw and store; return the exit status.

    Raises:
        HandoverError: Bad input, or a fit that must not be used; its report is printed and written before.
    """
    profile_id = safe_profile_id(request.profile_id or id_from(request.recordings))
    settings = CalibrationSettings(max_frames=request.max_frames, seed=request.seed)
    files = load_recordings(request.recordings, request.marker_set)
    marker_set, recording = files.marker_set, files.recording
    template = chosen_template(request.template, moving_segments(recording))
    source = ", ".join(path.name for path in request.recordings)
    with LateProgress(console, "fitting") as bar:
        profile, report = fit_profile(
            recording,
            template,
            marker_set,
            profile_id,
            request.person,
            source,
            settings,
            lambda fraction, rms: bar.update(fraction, f"{1e3 * rms:.1f} mm" if np.isfinite(rms) else ""),
        )
    folder = output_folder(request.out, "calibrate")
    console.print(
        f"{source}: {recording.frames} frames at {recording.rate:g} Hz, marker set {marker_set.name}, skeleton "
        f"{template.name}",
        highlight=False,
        soft_wrap=True,
    )
    print_report(console, profile.skeleton, report)
    written = [draw_fit(folder / "fit.png", profile, files, report)]
    if report.usable:
        written.append(folder / f"{profile_id}.json")
        write_whole(written[-1], profile_to_json(profile))
        if request.store or (request.store is None and request.profile_id):
            written.append(ProfileStore().save(profile))
            console.print(f"stored as {profile_id!r}: {written[-1]}", highlight=False, soft_wrap=True)
    metrics = metrics_of(report)
    for target in filter(None, (folder / "calibrate.json", request.json_file)):
        write_json(
            target,
            "calibrate",
            report.usable,
            request.seed,
            metrics,
            files=written,
            profile_id=profile_id,
            report=report_document(report),
            folder=str(folder),
        )
    console.print(f"everything is in {folder}", highlight=False, soft_wrap=True)
    require_usable(report)
    return 0


def id_from(recordings: tuple[Path, ...]) -> str:
    """Return a safe profile name made from the first file's name."""
    stem = recordings[0].stem if recordings else ""
    return re.sub(r"[^A-Za-z0-9_-]+", "_", stem)[:64].strip("_") or "person"


def metrics_of(report: CalibrationReport) -> dict[str, float]:
    """Return the metrics of a calibration."""
    return {
        "fit_rms_mm": 1e3 * report.fit_rms,
        "heldout_mean_mm": 1e3 * report.heldout_mean,
        "seconds": report.seconds,
        "frames": report.frames,
        "heldout_frames": report.heldout_frames,
        "missing_fraction": report.missing_fraction,
        "markers": len(report.markers),
        "displacements": len(report.joints),
        "problems": len(report.problems),
        "advice": len(report.advice),
    }


def draw_fit(path: Path, profile: Profile, files: JoinedFiles, report: CalibrationReport) -> Path:
    """Draw the markers' errors and the displacements of a fit, and return the picture's path."""
    skeleton, recording = profile.skeleton, files.recording
    step = max(1, -(-recording.frames // PICTURE_FRAMES))
    displacements = displacements_of(skeleton, recording, step)
    times = np.arange(0, recording.frames, step) / recording.rate
    bars = [MarkerBar(each.name, each.segment, each.fitted_rms, each.heldout_mean) for each in report.markers]
    title = (
        f"{profile.person}: skeleton {profile.template}, {1e3 * report.fit_rms:.1f} mm rms, "
        f"{1e3 * report.heldout_mean:.1f} mm mean on frames left out"
    )
    motion = Motion(times, displacements, joins=tuple(start / recording.rate for start in files.starts[1:]))
    return draw_motion(path, skeleton, motion, bars, title, ("fitted, rms", "left out, mean"))


def displacements_of(skeleton: Skeleton, recording: Recording, step: int = 1) -> FloatArray:
    """Return the displacements (frames, n) that explain every ``step``-th frame of a recording best."""
    columns = [recording.names.index(name) for name in skeleton.marker_names]
    observed = np.ascontiguousarray(recording.positions[::step, columns])
    coordinates, _ = solve_postures(skeleton.tree, first_coordinates(skeleton, observed), observed, ROBUST_SCALE)
    return skeleton.displacements(coordinates, near=np.zeros(len(skeleton.displacement_names)))


def first_coordinates(skeleton: Skeleton, observed: FloatArray) -> FloatArray:
    """Return the zero posture with the root at its markers (frames, nq); where few are seen, as in the frame before."""
    own = [row for row, segment in enumerate(skeleton.marker_segments) if segment == skeleton.root]
    poses = np.tile(np.eye(4), (len(observed), 1, 1))
    if not skeleton.is_free:
        return skeleton.coordinates(np.zeros((len(observed), len(skeleton.displacement_names))))
    pose = make_transform(np.eye(3), np.nanmean(observed.reshape(-1, 3), axis=0))
    for frame, markers in enumerate(observed[:, own]):
        seen = np.isfinite(markers[:, 0])
        fit = fit_rigid_body(skeleton.markers[own], markers, np.ones(len(own)), MARKER_NOISE, seen)
        pose = pose if fit is None else fit.target_from_body
        poses[frame] = pose
    return skeleton.coordinates(np.zeros((len(observed), len(skeleton.displacement_names))), poses)
