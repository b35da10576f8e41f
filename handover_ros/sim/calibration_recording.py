"""What motion capture sees of the calibration motions, without physics: markers of the smooth way through them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from handover_ros.mocap.frames import Recording
from handover_ros.sim.calibration_motions import calibration_plan
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.sim.person_spec import JOINTS, PersonSpec
from handover_ros.skeleton.kernels import forward

WANDER = 0.01  # [m], [rad] by which everything has drifted at the end
SHOULDERS = 1.4  # [m] height of the torso frame


def calibration_recording(
    person: PersonSpec, seed: int, rate: float = 120.0, noise: float = 0.001, missing: float = 0.01
) -> Recording:
    """Return the markers of a person who makes all calibration motions in order and wanders a little meanwhile.

    Args:
        person: The person.
        seed: Of noise, gaps and wandering.
        rate: [Hz].
        noise: Standard deviation of a marker's coordinate [m].
        missing: Share of the samples.
    """
    rng, skeleton = np.random.default_rng(seed), skeleton_of(person)
    parts = []
    for plan in calibration_plan(person):
        times = np.arange(0.0, plan.duration, 1.0 / rate)
        parts.append(PchipInterpolator(plan.times, plan.postures)(times))
    postures = np.concatenate(parts)
    postures += WANDER * np.cumsum(rng.normal(size=postures.shape), axis=0) / np.sqrt(len(postures))
    poses = np.tile(np.eye(4), (len(postures), 1, 1))
    poses[:, :3, 3] = postures[:, :3] + [0.0, 0.0, SHOULDERS]
    poses[:, :3, :3] = Rotation.from_euler("zyx", postures[:, 3:6]).as_matrix()
    columns = [JOINTS.index(name) for name in skeleton.displacement_names]
    markers = forward(skeleton.tree, skeleton.coordinates(postures[:, columns], poses))
    markers += noise * rng.normal(size=markers.shape)
    markers[rng.random(markers.shape[:2]) < missing] = np.nan
    return Recording(skeleton.marker_names, skeleton.marker_segments, rate, markers, Path("calibration motions"))
