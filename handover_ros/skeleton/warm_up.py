"""Runs the compiled kernels of tracking and calibration once, on a made-up arm, so that they are compiled and loaded.

Loading them takes some tenths of a second during which nothing else of the process runs: too long while frames come in.
"""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np

from handover_ros.errors import HandoverError
from handover_ros.geometry import FloatArray
from handover_ros.mocap.frames import MarkerFrame, Recording
from handover_ros.skeleton.calibration import CalibrationSettings, calibrate
from handover_ros.skeleton.kernels import forward
from handover_ros.skeleton.templates import NamedTemplate, SkeletonTemplate, TemplateJoint, blank_skeleton
from handover_ros.skeleton.tracking import SkeletonTracker
from handover_ros.skeleton.tree import Skeleton

TEMPLATE = NamedTemplate(
    "made_up_arm",
    SkeletonTemplate(
        description="An arm that nobody has",
        root="body",
        joints=(
            TemplateJoint(
                name="shoulder", kind="ball", parent="body", segment="upper", displacements=("flex", "lift", "turn")
            ),
            TemplateJoint(name="elbow", kind="revolute", parent="upper", segment="lower", displacements=("bend",)),
        ),
    ),
)
SEGMENTS = ("body",) * 4 + ("upper",) * 3 + ("lower",) * 3
NAMES = tuple(f"{segment}{number}" for number, segment in enumerate(SEGMENTS))
HEIGHTS = {"body": 0.1, "upper": -0.15, "lower": -0.45}  # [m] of the markers against the shoulder
FRAMES, RATE = 200, 50.0


def made_up_arm() -> Skeleton:
    """Return an arm with known geometry and limits."""
    blank = blank_skeleton(TEMPLATE, NAMES, SEGMENTS)
    markers = np.random.default_rng(0).uniform(-0.06, 0.06, size=(len(NAMES), 3))
    markers[:, 2] += [HEIGHTS[segment] for segment in SEGMENTS]
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, -0.3]])
    axes = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    return blank.with_geometry(axes, points, markers).with_limits([-2.0] * 4, [2.0] * 4)


def made_up_motion(skeleton: Skeleton) -> FloatArray:
    """Return the markers (frames, m, 3) [m] of a motion of all joints."""
    times = np.arange(FRAMES)[:, None] / RATE
    displacements = 0.8 * np.sin(2.0 * times * (1.0 + 0.3 * np.arange(4))) * np.minimum(times, 1.0)
    markers = forward(skeleton.tree, skeleton.coordinates(displacements))
    return np.asarray(markers + 1e-4 * np.random.default_rng(1).normal(size=markers.shape))


def warm_up_tracking() -> None:
    """Track a few frames."""
    skeleton = made_up_arm()
    tracker = SkeletonTracker(skeleton, NAMES)
    status = np.zeros(len(NAMES), dtype=np.uint8)
    for number, positions in enumerate(made_up_motion(skeleton)[:4]):
        tracker.update(MarkerFrame(number / RATE, number, number / RATE, positions, status))


def warm_up_calibration() -> None:
    """Calibrate once."""
    recording = Recording(NAMES, SEGMENTS, RATE, made_up_motion(made_up_arm()), Path(TEMPLATE.name))
    with contextlib.suppress(HandoverError):  # how well the made-up arm can be fitted does not matter
        calibrate(recording, TEMPLATE, settings=CalibrationSettings(max_frames=FRAMES))
