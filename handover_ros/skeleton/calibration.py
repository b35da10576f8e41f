"""Calibration: the skeleton of one person from marker frames of calibration motions (Bestick 2017, section 2.2)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from handover_ros.errors import BadRequestError, ErrorCode, HandoverError
from handover_ros.geometry import FloatArray
from handover_ros.mocap.frames import Recording
from handover_ros.mocap.marker_sets import TorsoDefinition
from handover_ros.skeleton.calibration_frames import divide, frame_of, nearest, stillest, torso_motion, zero_frame
from handover_ros.skeleton.calibration_report import CalibrationReport
from handover_ros.skeleton.calibration_summary import rms_of, robust_sigma, summarise
from handover_ros.skeleton.checks import check_amount, input_problems
from handover_ros.skeleton.coarse_fit import (
    COARSE_SCALE,
    coarse_fit,
    meeting_joints,
    template_directions,
    template_wishes,
    wishes_for,
)
from handover_ros.skeleton.gauge import mean_posture, with_root_frame, with_signs, with_zero_at, within_a_turn
from handover_ros.skeleton.group_starts import spread
from handover_ros.skeleton.initial import first_guess
from handover_ros.skeleton.layout import parameter_layout
from handover_ros.skeleton.postures import solve_postures
from handover_ros.skeleton.prediction_error import Fit, FitSettings, minimise
from handover_ros.skeleton.templates import NamedTemplate, blank_skeleton
from handover_ros.skeleton.torso_template import TemplateError, TorsoMarkers, estimate_template
from handover_ros.skeleton.tree import FlatTree, Skeleton
from handover_ros.skeleton.wishes import wish_strength

COARSE_FRAMES = 120
SCALE_IN_SIGMAS = 6.0  # of the final robust scale; keeps 98 % of the efficiency for Gaussian noise
SMALLEST_SCALE = 0.002  # [m]

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

    max_frames: int = 6000
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
    seen = [bool(np.isfinite(recording.positions[:, column, 0]).any()) for column in columns]
    if not all(seen):
        blank = blank.with_markers(tuple(name for name, ok in zip(blank.marker_names, seen) if ok))
        columns = [recording.names.index(name) for name in blank.marker_names]
    observed = np.ascontiguousarray(recording.positions[:, columns])
    torso_poses = torso_motion(recording, torso)
    problems = input_problems(recording, torso_poses, template)
    fitted, held_out = divide(observed, blank, recording.rate, settings.max_frames, settings.holdout)
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
    skeleton, report = summarise(
        recording,
        template,
        blank,
        layout,
        tree,
        coordinates,
        observed,
        fitted,
        held_out,
        scale,
        problems,
        time.perf_counter() - began,
    )
    return Calibration(skeleton, report)


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
    """Return tree and postures in the torso frame, zero where the person stands still, with the template's signs."""
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


def robust_scale(residuals: FloatArray) -> float:
    """Return the Cauchy scale [m] of the final fit."""
    return max(SCALE_IN_SIGMAS * robust_sigma(residuals), SMALLEST_SCALE)
