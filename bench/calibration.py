"""Calibration: how fast, how its time grows, whether it stalls, and how near the truth it comes."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from handover_ros.geometry import FloatArray
from handover_ros.mocap.frames import Recording
from handover_ros.mocap.marker_sets import load_marker_set
from handover_ros.skeleton.calibration import Calibration, CalibrationSettings, calibrate
from handover_ros.skeleton.kernels import forward
from handover_ros.skeleton.layout import parameter_layout
from handover_ros.skeleton.prediction_error import FitSettings, minimise
from handover_ros.skeleton.templates import load_template
from handover_ros.skeleton.tree import WORLD, FlatTree, Joint, JointKind, Skeleton

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "test" / "skeleton"))
from comparison import compare
from people import calibration_motion, random_person

AXES = FRAMES = 10
STALLED = 1.0 + 1e-6  # times the loss of the optimum found from the truth
KINDS = ("shoulder", "elbow", "forearm", "wrist")
LENGTHS = (750, 1500, 3000, 6000)
TWO_MINUTES, RATE = 12000, 100.0  # frames [1], [Hz]: for the accuracy


def recording_of(person: Skeleton, frames: int, seed: int, rate: float) -> Recording:
    """Return the synthetic calibration motions of a person, 1 mm noise, 10 % missing."""
    motion = calibration_motion(person, frames=frames, rate=rate, seed=seed)
    return Recording(person.marker_names, person.marker_segments, motion.rate, motion.measured, Path("synthetic"))


def fitted(person: Skeleton, frames: int, seed: int, rate: float = 50.0) -> Calibration:
    """Return the calibration from all of ``frames`` frames."""
    settings = CalibrationSettings(holdout=0.0, max_frames=frames)
    torso = load_marker_set("upper_body_24").torso
    return calibrate(recording_of(person, frames, seed, rate), load_template("upper_body"), torso, settings)


def errors(truth: Skeleton, skeleton: Skeleton) -> dict[str, dict[str, list[float]]]:
    """Return errors of centres [mm], axes [deg] and limits [deg] for each kind of joint, of both arms."""
    found = compare(truth, skeleton)
    owner = dict(zip(skeleton.displacement_names, (skeleton.joints[j].name for j in skeleton.displacement_joints)))
    result: dict[str, dict[str, list[float]]] = {kind: {"centre": [], "axis": [], "limit": []} for kind in KINDS}
    for name, value in found.centres.items():
        result[kind_of(name)]["centre"].append(1e3 * value)
    for name, value in found.axes.items():
        result[kind_of(name)]["axis"].append(float(np.degrees(value)))
    for name in found.lower:
        limits = (found.lower[name], found.upper[name])
        result[kind_of(owner[name])]["limit"] += [float(np.degrees(abs(each))) for each in limits]
    return result


def kind_of(joint: str) -> str:
    """Return which of the kinds a joint belongs to; the palm's axis is the wrist's second."""
    kind = joint.partition("_")[2]
    return "wrist" if kind == "palm" else kind


def chain_problem(seed: int) -> tuple[Skeleton, FloatArray, FloatArray, FlatTree]:
    """Return (truth, its postures, measured markers, a first guess) of a chain of ten axes with known markers.

    150 unknowns: 2 of direction and 3 of place for each axis, 10 displacements in 10 frames. Axes are off by 0.05 rad,
    places by 20 mm, displacements start at zero.
    """
    rng = np.random.default_rng(seed)
    joints, markers, names, segments = [], [], [], []
    place, parent = np.zeros(3), WORLD
    for index in range(AXES):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        joints.append(Joint(f"j{index}", JointKind.REVOLUTE, parent, f"s{index}", (f"d{index}",), axis[None], place))
        for marker in range(3):
            names.append(f"m{index}{marker}")
            segments.append(f"s{index}")
            markers.append(place + 0.08 * rng.normal(size=3))
        step = rng.normal(size=3)
        place, parent = place + 0.1 * step / np.linalg.norm(step), f"s{index}"
    open_limits = np.full(AXES, np.inf)
    truth = Skeleton(
        "chain", tuple(joints), tuple(names), tuple(segments), np.array(markers), -open_limits, open_limits
    )
    postures = truth.coordinates(rng.uniform(-1.0, 1.0, size=(FRAMES, AXES)))
    measured = forward(truth.tree, postures) + 0.001 * rng.normal(size=(FRAMES, len(names), 3))
    axis = truth.tree.axis + 0.05 * rng.normal(size=(AXES, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    return (
        truth,
        postures,
        measured,
        truth.tree._replace(axis=axis, point=truth.tree.point + 0.02 * rng.normal(size=(AXES, 3))),
    )


def by_scipy(start: FlatTree, measured: FloatArray) -> tuple[float, float]:
    """Return (loss [m^2], seconds) of scipy's trust-region method with finite differences on the same problem."""
    polar = np.column_stack([np.arccos(start.axis[:, 2]), np.arctan2(start.axis[:, 1], start.axis[:, 0])])

    def residuals(x: FloatArray) -> FloatArray:
        theta, phi = x[:AXES], x[AXES : 2 * AXES]
        axis = np.column_stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
        tree = start._replace(axis=axis, point=x[2 * AXES : 5 * AXES].reshape(AXES, 3))
        return np.asarray((forward(tree, x[5 * AXES :].reshape(FRAMES, AXES)) - measured).ravel())

    first = np.concatenate([polar.T.ravel(), start.point.ravel(), np.zeros(FRAMES * AXES)])
    began = time.perf_counter()
    answer = least_squares(residuals, first, method="trf", xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=200)
    return 2.0 * float(answer.cost), time.perf_counter() - began


def measure(seed: int, quick: bool) -> dict[str, float]:
    """Return the metrics of calibration."""
    begun = time.perf_counter()
    person = random_person(seed)
    fitted(person, 300, seed)
    metrics = {"calibration_warm_up_s": time.perf_counter() - begun}
    times: dict[int, list[float]] = {frames: [] for frames in (LENGTHS[:2] if quick else LENGTHS)}
    for round_ in range(1 if quick else 3):
        for frames in times:
            times[frames].append(fitted(random_person(seed + round_), frames, seed + round_).report.seconds)
    medians = {frames: float(np.median(values)) for frames, values in times.items()}
    metrics["calibration_s"] = medians[1500]
    metrics |= {f"calibration_{frames}_frames_s": value for frames, value in medians.items()}
    slope = np.polyfit(np.log(list(medians)), np.log(list(medians.values())), 1)[0]
    metrics["calibration_linear_exponent"] = float(slope)

    stalls, ratios = 0, []
    for index in range(6 if quick else 20):
        truth, postures, measured, start = chain_problem(seed + index)
        layout = parameter_layout(start, markers=False)
        best = minimise(truth.tree, layout, postures, measured, FitSettings(tolerance=1e-10))
        begun = time.perf_counter()
        fit = minimise(start, layout, np.zeros_like(postures), measured, FitSettings(tolerance=1e-10, iterations=200))
        elapsed = time.perf_counter() - begun
        stalls += fit.loss > STALLED * best.loss
        if index < (1 if quick else 3):
            loss, seconds = by_scipy(start, measured)
            ratios.append(seconds / elapsed)
            metrics[f"scipy_loss_over_ours_{index}"] = loss / fit.loss
    metrics["calibration_stalls"] = float(stalls)
    metrics["calibration_speed_over_scipy"] = float(np.median(ratios))

    collected, seconds = [], []
    for index in range(4 if quick else 16):
        truth = random_person(seed + index)
        calibration = fitted(truth, TWO_MINUTES, seed + index, RATE)
        seconds.append(calibration.report.seconds)
        collected.append(errors(truth, calibration.skeleton))
    metrics["calibration_two_minutes_s"] = float(np.median(seconds))
    for what, unit in (("centre", "mm"), ("axis", "deg"), ("limit", "deg")):
        for kind in KINDS:
            values = [value for each in collected for value in each[kind][what]]
            if values:  # a ball joint has no axis
                metrics[f"calibration_{kind}_{what}_median_{unit}"] = float(np.median(values))
                metrics[f"calibration_{kind}_{what}_max_{unit}"] = float(np.max(values))
    return metrics
