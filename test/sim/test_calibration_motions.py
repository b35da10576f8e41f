"""The calibration motions say enough: from their markers alone every axis of the arms is found."""

from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from handover_ros.mocap.frames import Recording
from handover_ros.mocap.marker_sets import load_marker_set
from handover_ros.sim.calibration_motions import calibration_plan
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.sim.person_spec import JOINTS, load_person
from handover_ros.skeleton.calibration import CalibrationSettings, calibrate
from handover_ros.skeleton.kernels import forward
from handover_ros.skeleton.templates import load_template

RATE, NOISE, MISSING = 60.0, 0.0004, 0.007  # [Hz], [m], share of the samples


def recorded(spec, seed):
    """Return the markers of a person who makes all motions, swaying a little."""
    rng, skeleton = np.random.default_rng(seed), skeleton_of(spec)
    parts = []
    for plan in calibration_plan(spec):
        times = np.arange(0.0, plan.duration, 1.0 / RATE)
        parts.append(PchipInterpolator(plan.times, plan.postures)(times))
    postures = np.concatenate(parts)
    postures = postures + 0.01 * np.cumsum(rng.normal(size=postures.shape), axis=0) / np.sqrt(len(postures))
    poses = np.tile(np.eye(4), (len(postures), 1, 1))
    poses[:, :3, 3] = postures[:, :3] + [0.0, 0.0, 1.4]
    poses[:, :3, :3] = Rotation.from_euler("zyx", postures[:, 3:6]).as_matrix()
    columns = [JOINTS.index(name) for name in skeleton.displacement_names]
    markers = forward(skeleton.tree, skeleton.coordinates(postures[:, columns], poses))
    markers = markers + NOISE * rng.normal(size=markers.shape)
    markers[rng.random(markers.shape[:2]) < MISSING] = np.nan
    return Recording(skeleton.marker_names, skeleton.marker_segments, RATE, markers, Path("motions"))


@pytest.mark.parametrize("seed", range(4))
def test_elbow_and_forearm_are_told_apart(seed):
    """Bending with one turn of the palm only, and turning at one bend, the two could change places at no cost."""
    spec = load_person("adult")
    recording = recorded(spec, seed)
    torso = load_marker_set("upper_body_24").torso
    skeleton = calibrate(
        recording, load_template("upper_body"), torso, CalibrationSettings(max_frames=800, seed=seed)
    ).skeleton
    standing = dict(zip(JOINTS, spec.standing))
    for side in ("right", "left"):
        joint = next(joint for joint in skeleton.joints if joint.name == f"{side}_elbow")
        # Where the person stands, the upper arm leans a little: the elbow's axis is near minus y of the torso.
        lean = Rotation.from_euler("z", standing[f"{side}_shoulder_rotation"] * (1.0 if side == "right" else -1.0))
        assert np.degrees(np.arccos(np.clip(lean.apply([0.0, -1.0, 0.0]) @ joint.axes[0], -1.0, 1.0))) < 15.0
        column = skeleton.displacement_names.index(f"{side}_elbow_flexion")
        moved = skeleton.upper[column] - skeleton.lower[column]
        true = getattr(spec.limits, side).elbow_flexion
        assert np.degrees(abs(moved - (true[1] - true[0]))) < 8.0
