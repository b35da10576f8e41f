"""The calibration motions say enough: from their markers alone every axis of the arms is found."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from handover_ros.mocap.marker_sets import load_marker_set
from handover_ros.sim.calibration_recording import calibration_recording
from handover_ros.sim.person_spec import JOINTS, load_person
from handover_ros.skeleton.calibration import CalibrationSettings, calibrate
from handover_ros.skeleton.templates import load_template


@pytest.mark.parametrize("seed", range(4))
def test_elbow_and_forearm_are_told_apart(seed):
    """Bending with one turn of the palm only, and turning at one bend, the two could change places at no cost."""
    spec = load_person("adult")
    recording = calibration_recording(spec, seed, 60.0, 0.0004)
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
