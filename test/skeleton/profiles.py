"""A profile as a calibration would make it, for tests."""

from __future__ import annotations

import math

import numpy as np
from people import random_person

from handover_ros.skeleton.calibration_report import CalibrationReport, JointQuality, MarkerError
from handover_ros.skeleton.profile import Profile
from handover_ros.skeleton.tree import Skeleton


def report_of(skeleton: Skeleton, advice: tuple[str, ...] = (), problems: tuple[str, ...] = ()) -> CalibrationReport:
    """Return a report with figures for every marker and displacement; one marker was never seen in left-out frames."""
    rng = np.random.default_rng(3)
    markers = tuple(
        MarkerError(name, segment, float(rng.uniform(1e-3, 4e-3)), float(rng.uniform(1e-3, 5e-3)) if row else math.nan)
        for row, (name, segment) in enumerate(zip(skeleton.marker_names, skeleton.marker_segments))
    )
    joints = tuple(
        JointQuality(
            skeleton.joints[joint].name, name, float(lower), float(upper), float(rng.uniform(0.2, 2.5)), 0.01, 0.002
        )
        for joint, name, lower, upper in zip(
            skeleton.displacement_joints, skeleton.displacement_names, skeleton.lower, skeleton.upper
        )
    )
    return CalibrationReport(1200, 300, 0.1, 0.0021, 0.0034, 1.7, markers, joints, problems, advice)


def profile_of(profile_id: str = "anna", seed: int = 1, person: str = "Anna Åström") -> Profile:
    """Return the profile of a random person; one limit is not known."""
    skeleton = random_person(seed)
    lower = skeleton.lower.copy()
    lower[2] = -np.inf
    skeleton = skeleton.with_limits(lower, skeleton.upper)
    return Profile(
        profile_id=profile_id,
        person=person,
        created="2026-01-31T12:00:00Z",
        marker_set="upper_body_24",
        template="upper_body",
        skeleton=skeleton,
        report=report_of(skeleton, ("right elbow moved 9 deg: move it through its full range",)),
        notes=("right elbow moved 9 deg: move it through its full range",),
        source="trial_1.c3d",
        versions={"handover_ros": "0.1.0"},
    )
