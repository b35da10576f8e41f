"""What a fit amounts to: errors of markers in the fit and out of it, limits, certainty, and sentences about them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from handover_ros.geometry import FloatArray
from handover_ros.mocap.frames import Recording
from handover_ros.skeleton.calibration_report import CalibrationReport, JointQuality, MarkerError
from handover_ros.skeleton.certainty import posture_deviations, standard_errors
from handover_ros.skeleton.checks import (
    certainty_advice,
    fit_problems,
    inseparable_joints,
    missing_advice,
    motion_advice,
    outlying_markers,
)
from handover_ros.skeleton.kernels import forward
from handover_ros.skeleton.layout import Layout
from handover_ros.skeleton.limits import estimate_limits
from handover_ros.skeleton.postures import solve_postures
from handover_ros.skeleton.templates import NamedTemplate
from handover_ros.skeleton.tree import FlatTree, Skeleton


def summarise(
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
    seconds: float,
) -> tuple[Skeleton, CalibrationReport]:
    """Return the skeleton of a fitted tree, with limits, and the report.

    Args:
        recording: All marker frames.
        template: The tree.
        blank: The skeleton before the fit.
        layout: The parameters of the fit.
        tree: The fitted tree, in its standard gauge.
        coordinates: Postures of the fitted frames, shape (frames, nq).
        observed: The skeleton's markers in all frames [m], shape (all frames, m, 3).
        fitted: Numbers of the fitted frames.
        held_out: Numbers of the frames left out.
        scale: Robust scale of the fit [m].
        problems: What was wrong with the input already.
        seconds: Time the fit took [s].
    """
    skeleton = blank.with_geometry(tree.axis, tree.point, tree.marker)
    tree = skeleton.tree
    residuals = np.linalg.norm(forward(tree, coordinates) - observed[fitted], axis=2)
    noise = robust_sigma(residuals)
    others = held_out_postures(tree, coordinates, observed, fitted, held_out, scale)
    left_out = np.linalg.norm(forward(tree, others) - observed[held_out], axis=2)
    # Limits from all frames: what a joint reached may lie in the frames left out, and gaps would spoil the smoothing.
    frames = np.concatenate([fitted, held_out])
    order = np.argsort(frames)
    frames, postures = frames[order], np.concatenate([coordinates, others])[order]
    displacements = skeleton.displacements(postures, near=np.zeros(len(skeleton.displacement_names)))
    deviations = noise * posture_deviations(skeleton, postures, observed[frames])
    step = float(np.median(np.diff(frames))) if len(frames) > 1 else 1.0
    lower, upper = estimate_limits(skeleton, displacements, deviations, recording.rate / step)
    moved = np.where(np.isfinite(upper - lower), upper - lower, 0.0)
    skeleton = skeleton.with_limits(lower, upper)
    axis_errors, point_errors = standard_errors(tree, layout, coordinates, observed[fitted], noise)
    markers = marker_errors(skeleton, residuals, left_out)
    fit_rms = rms_of(residuals)
    fit_rms_of = {marker.name: marker.fitted_rms for marker in markers}
    problems = [
        *problems,
        *fit_problems(skeleton, fit_rms, fit_rms_of, template),
        *inseparable_joints(skeleton, deviations),
    ]
    if not problems:
        problems = outlying_markers(skeleton, residuals)
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
        seconds=seconds,
        markers=markers,
        joints=joints,
        problems=tuple(dict.fromkeys(problems)),
        advice=(*still_joints, *uncertain, *missing_advice(recording)),
    )
    return skeleton, report


def held_out_postures(
    tree: FlatTree,
    coordinates: FloatArray,
    observed: FloatArray,
    fitted: npt.NDArray[np.intp],
    held_out: npt.NDArray[np.intp],
    scale: float,
) -> FloatArray:
    """Return the best postures (frames, nq) of the frames that were left out of the fit."""
    if not len(held_out):
        return coordinates[:0]
    near = coordinates[np.abs(held_out[:, None] - fitted[None]).argmin(axis=1)]
    postures, _ = solve_postures(tree, near, observed[held_out], scale, iterations=8)
    return postures


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
    """Return the standard deviation [m] of a coordinate: the median distance over that of a unit 3-D Gaussian."""
    return max(float(np.nanmedian(residuals)) / 1.538, 1e-6)
