"""Calibration: the skeleton of one person from marker frames of calibration motions (Bestick 2017, section 2.2)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from handover_ros.errors import BadRequestError, ErrorCode, HandoverError
from handover_ros.geometry import FloatArray
from handover_ros.mocap.frames import Recording
from handover_ros.mocap.marker_sets import TorsoDefinition
from handover_ros.skeleton.calibration_report import CalibrationReport, JointQuality, MarkerError
from handover_ros.skeleton.certainty import posture_deviations, standard_errors
from handover_ros.skeleton.checks import (
    certainty_advice,
    check_amount,
    fit_problems,
    input_problems,
    missing_advice,
    motion_advice,
)
from handover_ros.skeleton.gauge import mean_posture, with_root_frame, with_signs, with_zero_at, within_a_turn
from handover_ros.skeleton.initial import Group, GroupFit, InitialGuess, first_guess, place_group, spread
from handover_ros.skeleton.kernels import forward
from handover_ros.skeleton.layout import Layout, parameter_layout
from handover_ros.skeleton.limits import estimate_limits
from handover_ros.skeleton.postures import solve_postures
from handover_ros.skeleton.prediction_error import Fit, FitSettings, minimise
from handover_ros.skeleton.rigid_motion import rigid_motion
from handover_ros.skeleton.templates import NamedTemplate, blank_skeleton
from handover_ros.skeleton.torso_template import TemplateError, TorsoMarkers, estimate_template
from handover_ros.skeleton.tree import FlatTree, Skeleton
from handover_ros.skeleton.wishes import Wishes, wish_strength

COARSE_FRAMES = 120
COARSE_SCALE = 0.03  # [m] robust scale while the noise is not known
SCALE_IN_SIGMAS = 6.0  # of the final robust scale; keeps 98 % of the efficiency for Gaussian noise
SMALLEST_SCALE = 0.002  # [m]
BLOCK = 0.6  # [s] length of the blocks that are left out
STILL_SEARCH = 4.0  # [s] at the beginning in which the person is expected to stand still
STILL_LENGTH = 0.3  # [s]
UNDECIDED = 16.0  # difference in chi-squared below which the markers do not decide between two fits
LEAST_FIT_FRAMES = 40

Progress = Callable[[float, float], None]


@dataclass(frozen=True)
class CalibrationSettings:
    """How a skeleton is fitted.

    Attributes:
        max_frames: Frames that enter the fit, spread evenly over time.
        holdout: Share of the time left out of the fit, in blocks, for the error on frames the fit has not seen.
        still: First and last + 1 frame of standing still, the zero posture; None: the stillest moment of the first 4 s.
        seed: Of the starting axes.
    """

    max_frames: int = 1500
    holdout: float = 0.2
    still: tuple[int, int] | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            BadRequestError: A setting is out of its range.
        """
        if not 60 <= self.max_frames <= 20000:
            raise BadRequestError(f"max_frames: must lie within 60 to 20000, got {self.max_frames}")
        if not 0.0 <= self.holdout <= 0.5:
            raise BadRequestError(f"holdout: must lie within 0 to 0.5, got {self.holdout:g}")


@dataclass(frozen=True, eq=False)
class Calibration:
    """A fitted skeleton and what the fit found out."""

    skeleton: Skeleton
    report: CalibrationReport


def calibrate(
    recording: Recording,
    template: NamedTemplate,
    torso: TorsoDefinition | None = None,
    settings: CalibrationSettings | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Return the skeleton of a person from marker frames; twists, markers and limits are fitted, nothing is assumed.

    The posture of standing still becomes the zero posture; the torso frame of the marker set, if there is one, the zero
    frame. The report says what must be mended; a skeleton with problems must not be used.

    Args:
        recording: Marker frames of one person; frames follow each other in time.
        template: The tree.
        torso: How the torso frame follows from markers; None: the zero frame has the world's axes.
        settings: How.
        progress: Called with the share done (0 to 1) and the root mean square error [m] so far.

    Raises:
        HandoverError: Too few frames or markers (NOT_ENOUGH_DATA), or the fit failed (FIT_FAILED).
    """
    settings = settings or CalibrationSettings()
    report_progress = progress or (lambda fraction, rms: None)
    began = time.perf_counter()
    check_amount(recording, template)
    blank = blank_skeleton(template, recording.names, recording.segments)
    columns = [recording.names.index(name) for name in blank.marker_names]
    seen = np.isfinite(recording.positions[:, columns, 0]).any(axis=0)
    if not seen.all():
        blank = blank.with_markers(tuple(name for name, ok in zip(blank.marker_names, seen) if ok))
        columns = [recording.names.index(name) for name in blank.marker_names]
    observed = np.ascontiguousarray(recording.positions[:, columns])
    torso_poses = torso_motion(recording, torso)
    problems = input_problems(recording, torso_poses, template)
    fitted, held_out = divide(observed, blank, recording.rate, settings)
    still = settings.still or stillest(observed, recording.rate)
    reference = nearest(fitted, (still[0] + still[1]) // 2)
    meets = meeting_joints(blank, template)
    layout = parameter_layout(blank.tree, meets)
    wishes = template_wishes(blank, template, wish_strength(observed, blank.tree.marker_joint))
    report_progress(0.05, float("nan"))

    start = zero_frame(blank, observed, reference, torso_poses)
    coarse_frames = spread(fitted, reference, COARSE_FRAMES)
    at = int(np.searchsorted(coarse_frames, reference))
    guess = first_guess(
        blank.tree,
        observed[coarse_frames],
        at,
        meets,
        start,
        template_directions(blank, template),
        wishes,
        settings.seed,
    )
    report_progress(0.3, float("nan"))
    coarse = coarse_fit(guess, layout, observed[coarse_frames], at, template, blank, wishes)
    report_progress(0.5, rms_of(coarse.residuals(observed[coarse_frames])))
    scale = robust_scale(coarse.residuals(observed[coarse_frames]))
    nearest_coarse = np.abs(fitted[:, None] - coarse_frames[None]).argmin(axis=1)
    first, _ = solve_postures(coarse.tree, coarse.coordinates[nearest_coarse], observed[fitted], COARSE_SCALE)
    fine_settings = FitSettings(robust_scale=scale, tolerance=1e-5, damping=1e-5)
    fit = minimise(
        coarse.tree,
        layout,
        first,
        observed[fitted],
        fine_settings,
        frozen=int(np.searchsorted(fitted, reference)),
        wishes=wishes_for(wishes, observed[fitted]),
    )
    if not np.isfinite(fit.loss):
        raise HandoverError(
            f"{recording.path}: the fit found no skeleton; record the motions again", ErrorCode.FIT_FAILED
        )
    report_progress(0.85, rms_of(fit.residuals(observed[fitted])))

    tree, coordinates = standard_gauge(fit, blank, template, observed, fitted, still, torso, recording)
    return _finished(
        recording, template, blank, layout, tree, coordinates, observed, fitted, held_out, scale, problems, began
    )


def _finished(
    recording: Recording,
    template: NamedTemplate,
    blank: Skeleton,
    layout: Layout,
    tree: FlatTree,
    coordinates: FloatArray,
    observed: FloatArray,
    fitted: npt.NDArray[np.intp],
    held_out: npt.NDArray[np.intp],
    scale: float,
    problems: list[str],
    began: float,
) -> Calibration:
    """Return the calibration of a fitted tree: limits, errors and sentences."""
    skeleton = blank.with_geometry(tree.axis, tree.point, tree.marker)
    tree = skeleton.tree
    residuals = np.linalg.norm(forward(tree, coordinates) - observed[fitted], axis=2)
    noise = robust_sigma(residuals)
    displacements = skeleton.displacements(coordinates, near=np.zeros(len(skeleton.displacement_names)))
    deviations = noise * posture_deviations(skeleton, coordinates, observed[fitted])
    step = float(np.median(np.diff(fitted))) if len(fitted) > 1 else 1.0
    lower, upper = estimate_limits(skeleton, displacements, deviations, recording.rate / step)
    moved = np.where(np.isfinite(upper - lower), upper - lower, 0.0)
    skeleton = skeleton.with_limits(lower, upper)
    axis_errors, point_errors = standard_errors(tree, layout, coordinates, observed[fitted], noise)
    left_out = held_out_residuals(tree, coordinates, observed, fitted, held_out, scale)
    markers = marker_errors(skeleton, residuals, left_out)
    fit_rms = rms_of(residuals)
    problems = [*problems, *fit_problems(skeleton, fit_rms, {m.name: m.fitted_rms for m in markers}, template)]
    names = [joint.name for joint in skeleton.joints]
    still_joints = motion_advice(skeleton, moved)
    told = {name for name in names if any(name.replace("_", " ") in sentence for sentence in still_joints)}
    uncertain = certainty_advice(
        [name for name in names if name not in told],
        np.array([axis_errors[i] for i, name in enumerate(names) if name not in told]),
        np.array([point_errors[i] for i, name in enumerate(names) if name not in told]),
    )
    joints = tuple(
        JointQuality(
            name=names[joint],
            displacement=displacement,
            lower=float(lower[index]),
            upper=float(upper[index]),
            moved=float(moved[index]),
            axis_error=float(axis_errors[joint]),
            point_error=float(point_errors[joint]),
        )
        for index, (displacement, joint) in enumerate(zip(skeleton.displacement_names, skeleton.displacement_joints))
    )
    report = CalibrationReport(
        frames=len(fitted),
        heldout_frames=len(held_out),
        missing_fraction=float(np.isnan(observed[:, :, 0]).mean()),
        fit_rms=fit_rms,
        heldout_mean=float(np.nanmean(left_out)) if np.isfinite(left_out).any() else float("nan"),
        seconds=time.perf_counter() - began,
        markers=markers,
        joints=joints,
        problems=tuple(dict.fromkeys(problems)),
        advice=(*still_joints, *uncertain, *missing_advice(recording)),
    )
    return Calibration(skeleton, report)


def coarse_fit(
    guess: InitialGuess,
    layout: Layout,
    observed: FloatArray,
    at: int,
    template: NamedTemplate,
    blank: Skeleton,
    wishes: Wishes,
) -> Fit:
    """Return the best minimum on a few frames; rivals of a group are tried in its place.

    Where the markers do not decide between two fits, the one whose axes are nearer to the template's directions is taken.
    """
    settings = FitSettings(robust_scale=COARSE_SCALE, tolerance=1e-5, damping=1e-4)
    wishes = wishes_for(wishes, observed)
    best = minimise(guess.tree, layout, guess.coordinates, observed, settings, frozen=at, wishes=wishes)
    directions = template_directions(blank, template)
    for group, rival in guess.rivals:
        tree, coordinates = with_group(best, group, rival, guess)
        coordinates, _ = solve_postures(tree, coordinates, observed, COARSE_SCALE, at)
        other = minimise(tree, layout, coordinates, observed, settings, frozen=at, wishes=wishes)
        variance = best.loss / max(3 * np.isfinite(observed[:, :, 0]).sum(), 1)
        gain = (best.loss - other.loss) / max(variance, 1e-12)
        agrees = agreement(other.tree, directions, group) > agreement(best.tree, directions, group)
        if gain > UNDECIDED or (gain > -UNDECIDED and agrees):
            best = other
    return best


def with_group(fit: Fit, group: Group, rival: GroupFit, guess: InitialGuess) -> tuple[FlatTree, FloatArray]:
    """Return a fit's tree and postures with one group replaced."""
    tree = fit.tree
    axis, point, marker, coordinates = tree.axis.copy(), tree.point.copy(), tree.marker.copy(), fit.coordinates.copy()
    place_group(guess.tree, group, rival, axis, point, marker, coordinates)
    return tree._replace(axis=axis, point=point, marker=marker), coordinates


def agreement(tree: FlatTree, directions: FloatArray, group: Group) -> float:
    """Return how well a group's axes agree with directions (joints, 3), 1 for each axis that is parallel."""
    return float(sum(abs(tree.axis[j] @ directions[j]) for j in group.joints))


def template_directions(blank: Skeleton, template: NamedTemplate) -> FloatArray:
    """Return the first positive direction of every joint (joints, 3); zero where the template gives none."""
    directions = np.zeros((len(blank.joints), 3))
    for joint in template.content.joints:
        if joint.positive:
            directions[[each.name for each in blank.joints].index(joint.name)] = joint.directions[0]
    return directions


def template_wishes(blank: Skeleton, template: NamedTemplate, strength: float) -> Wishes:
    """Return a template's wishes, with their strength [m^2] for each marker sample."""
    index = {joint.name: number for number, joint in enumerate(blank.joints)}
    joints = template.content.joints
    return Wishes(
        tuple((index[j.right_angle_to], index[j.name]) for j in joints if j.right_angle_to is not None),
        tuple((index[j.name], index[j.towards]) for j in joints if j.towards is not None),
        strength,
    )


def wishes_for(wishes: Wishes, observed: FloatArray) -> Wishes:
    """Return wishes with the strength for all samples of some frames (frames, m, 3)."""
    return replace(wishes, strength=wishes.strength * int(np.isfinite(observed[:, :, 0]).sum()))


def meeting_joints(blank: Skeleton, template: NamedTemplate) -> dict[int, int]:
    """Return the joints whose axes meet, by index."""
    names = [joint.name for joint in blank.joints]
    return {names.index(j.name): names.index(j.meets) for j in template.content.joints if j.meets is not None}


def standard_gauge(
    fit: Fit,
    blank: Skeleton,
    template: NamedTemplate,
    observed: FloatArray,
    fitted: npt.NDArray[np.intp],
    still: tuple[int, int],
    torso: TorsoDefinition | None,
    recording: Recording,
) -> tuple[FlatTree, FloatArray]:
    """Return tree and postures with the torso frame as zero frame, standing still as zero posture, and signs as the template."""
    tree, coordinates = fit.tree, fit.coordinates
    if torso is not None and blank.root == "torso":
        own = {name: tree.marker[i] for i, name in enumerate(blank.marker_names)}
        shape = np.array([own.get(name, np.full(3, np.nan)) for name in recording.names])
        try:
            markers = TorsoMarkers.of(torso, recording.names)
            from_torso = estimate_template(markers, shape[markers.index][None])
            tree, coordinates = with_root_frame(tree, coordinates, frame_of(from_torso, shape[markers.index]))
        except TemplateError:
            pass  # the markers that define the torso's axes are not on the root: the first guess stays
    frames = np.flatnonzero((fitted >= still[0]) & (fitted < still[1]))
    if not len(frames):
        frames = np.array([int(np.argmin(np.abs(fitted - still[0])))])
    tree, coordinates = with_zero_at(tree, coordinates, mean_posture(tree, within_a_turn(tree, coordinates)[frames]))
    tree, coordinates = with_signs(tree, coordinates, template_directions(blank, template))
    return tree, within_a_turn(tree, coordinates)


def frame_of(inside: FloatArray, outside: FloatArray) -> FloatArray:
    """Return the pose (4, 4) that maps points (k, 3) to points (k, 3), NaN where unknown."""
    from handover_ros.skeleton.rigid_fit import kabsch

    known = np.isfinite(inside[:, 0]) & np.isfinite(outside[:, 0])
    rotation, translation, _ = kabsch(inside[known], outside[known], np.ones(int(known.sum())))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, translation
    return pose


def torso_motion(recording: Recording, torso: TorsoDefinition | None) -> FloatArray | None:
    """Return the torso pose of every frame (frames, 4, 4), NaN where its markers are not seen; None: there is no torso."""
    if torso is None:
        return None
    try:
        markers = TorsoMarkers.of(torso, recording.names)
        few = np.linspace(0, recording.frames - 1, min(60, recording.frames)).astype(int)
        inside = estimate_template(markers, recording.positions[few][:, markers.index])
    except TemplateError:
        return None
    known = np.isfinite(inside[:, 0])
    if known.sum() < 3:
        return None
    positions = recording.positions[:, markers.index[known]]
    poses, shape = rigid_motion(positions, int(np.argmax(np.isfinite(positions[:, :, 0]).sum(axis=1))))
    return np.asarray(poses @ frame_of(inside[known], shape))


def zero_frame(
    blank: Skeleton, observed: FloatArray, reference: int, torso_poses: FloatArray | None
) -> FloatArray | None:
    """Return the zero frame in the world (4, 4) at the reference frame: the torso frame, or its axes at the root's markers."""
    if not blank.is_free or torso_poses is None:
        return None
    pose = torso_poses[reference].copy()
    if blank.root != "torso":
        own = [i for i, segment in enumerate(blank.marker_segments) if segment == blank.root]
        pose[:3, 3] = np.nanmean(observed[reference, own], axis=0)
        if not np.isfinite(pose).all():
            return None
    return pose


def divide(
    observed: FloatArray, blank: Skeleton, rate: float, settings: CalibrationSettings
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Return frame numbers of the fit and of what is left out of it; a frame must show the root."""
    tree = blank.tree
    usable = np.isfinite(observed[:, :, 0]).sum(axis=1) >= 3
    if blank.is_free:
        usable &= np.isfinite(observed[:, tree.marker_joint == 0, 0]).sum(axis=1) >= 3
    frames = np.arange(len(observed))
    block = (frames / max(BLOCK * rate, 1.0)).astype(int)
    period = int(round(1.0 / settings.holdout)) if settings.holdout > 0.0 else 0
    left_out = (block % period == period - 1) if period else np.zeros(len(frames), dtype=bool)
    fitted, held_out = frames[usable & ~left_out], frames[usable & left_out]
    if len(fitted) < LEAST_FIT_FRAMES:
        raise HandoverError(
            f"only {len(fitted)} frames show at least three markers of {blank.root}, {LEAST_FIT_FRAMES} are needed; uncover "
            "its markers",
            ErrorCode.NOT_ENOUGH_DATA,
        )
    if len(fitted) > settings.max_frames:
        fitted = fitted[np.linspace(0, len(fitted) - 1, settings.max_frames).astype(int)]
    if len(held_out) > settings.max_frames // 3:
        held_out = held_out[np.linspace(0, len(held_out) - 1, max(settings.max_frames // 3, 1)).astype(int)]
    return fitted, held_out


def stillest(observed: FloatArray, rate: float) -> tuple[int, int]:
    """Return the frames [first, last + 1) of the stillest moment near the beginning."""
    length = max(int(STILL_LENGTH * rate), 3)
    end = min(len(observed), max(int(STILL_SEARCH * rate), 3 * length))
    best, where = np.inf, 0
    for start in range(0, max(end - length, 1), max(length // 3, 1)):
        window = observed[start : start + length]
        with np.errstate(invalid="ignore"):
            spread_of = (
                np.nanmax(window, axis=0) - np.nanmin(window, axis=0) if len(window) else np.full((1, 3), np.inf)
            )
        motion = float(np.nanmean(spread_of)) if np.isfinite(spread_of).any() else np.inf
        if motion < best:
            best, where = motion, start
    return where, where + length


def nearest(frames: npt.NDArray[np.intp], wanted: int) -> int:
    """Return the frame number nearest to a wanted one."""
    return int(frames[np.argmin(np.abs(frames - wanted))])


def held_out_residuals(
    tree: FlatTree,
    coordinates: FloatArray,
    observed: FloatArray,
    fitted: npt.NDArray[np.intp],
    held_out: npt.NDArray[np.intp],
    scale: float,
) -> FloatArray:
    """Return the distances (frames, m) [m] of frames that were left out, each with its own best posture."""
    if not len(held_out):
        return np.full((0, observed.shape[1]), np.nan)
    near = coordinates[np.abs(held_out[:, None] - fitted[None]).argmin(axis=1)]
    postures, _ = solve_postures(tree, near, observed[held_out], scale, iterations=8)
    return np.linalg.norm(forward(tree, postures) - observed[held_out], axis=2)


def marker_errors(skeleton: Skeleton, residuals: FloatArray, left_out: FloatArray) -> tuple[MarkerError, ...]:
    """Return each marker's errors from distances (frames, m) in the fit and out of it."""

    def mean(values: FloatArray, power: float) -> float:
        values = values[np.isfinite(values)]
        return float(np.mean(values**power) ** (1.0 / power)) if len(values) else float("nan")

    return tuple(
        MarkerError(name, segment, mean(residuals[:, i], 2.0), mean(left_out[:, i], 1.0))
        for i, (name, segment) in enumerate(zip(skeleton.marker_names, skeleton.marker_segments))
    )


def rms_of(residuals: FloatArray) -> float:
    """Return the root mean square of the finite distances."""
    return float(np.sqrt(np.nanmean(np.square(residuals))))


def robust_sigma(residuals: FloatArray) -> float:
    """Return the standard deviation [m] of a coordinate from distances: their median over that of a unit 3-D Gaussian."""
    return max(float(np.nanmedian(residuals)) / 1.538, 1e-6)


def robust_scale(residuals: FloatArray) -> float:
    """Return the Cauchy scale [m] of the final fit."""
    return max(SCALE_IN_SIGMAS * robust_sigma(residuals), SMALLEST_SCALE)
