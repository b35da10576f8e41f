"""biorbd's extended Kalman filter on our skeleton: the same axes, points and markers written as a bioMod file."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from handover_ros.skeleton.tree import Skeleton


def model_text(skeleton: Skeleton) -> str:
    """Return a bioMod file of a skeleton of revolute joints; segment frames stand at the axes and turn about z."""
    tree = skeleton.tree
    poses = [np.eye(4)]
    lines = ["version 4", ""]
    for index, joint in enumerate(skeleton.joints):
        pose = np.eye(4)
        pose[:3, :3] = Rotation.align_vectors(tree.axis[index][None], [[0.0, 0.0, 1.0]])[0].as_matrix()
        pose[:3, 3] = joint.point
        poses.append(pose)
        parent = int(tree.parent[index])
        relative = np.linalg.inv(poses[parent + 1]) @ pose
        name = "root" if parent < 0 else skeleton.joints[parent].segment
        rows = "\n".join(" ".join(f"{value:.17g}" for value in row) for row in relative)
        lines += [f"segment {joint.segment}", f"parent {name}", "rtinmatrix 1", "rt", rows, "rotations z", "mass 1"]
        lines += ["inertia 1 0 0 0 1 0 0 0 1", "com 0 0 0", "endsegment", ""]
    for number, marker in enumerate(skeleton.marker_names):
        joint_index = int(tree.marker_joint[number])
        local = np.linalg.inv(poses[joint_index + 1]) @ np.append(skeleton.markers[number], 1.0)
        lines += [f"marker {marker}", f"parent {skeleton.joints[joint_index].segment}"]
        lines += ["position " + " ".join(f"{value:.17g}" for value in local[:3])]
        lines += ["technical 1", "anatomical 0", "endmarker", ""]
    return "\n".join(lines)


class BiorbdFilter:
    """biorbd's filter for one skeleton.

    Args:
        biorbd: The module.
        skeleton: Revolute joints only.
        folder: Where the model file goes.
    """

    def __init__(self, biorbd: Any, skeleton: Skeleton, folder: Path) -> None:
        self.biorbd = biorbd
        path = folder / "person.bioMod"
        path.write_text(model_text(skeleton), encoding="utf-8")
        self.model = biorbd.Model(str(path))

    def markers(self, displacements: np.ndarray) -> np.ndarray:
        """Return the markers (m, 3) [m] of one posture."""
        return np.array([marker.to_array() for marker in self.model.markers(displacements)])

    def follow(
        self,
        markers: np.ndarray,
        rate: float,
        start: np.ndarray,
        noise_factor: float | None = None,
        error_factor: float | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return displacements (frames, n) of markers (frames, m, 3), and the seconds of each frame.

        Measurements go in as a flat vector, its quickest way; a missing marker is zeros, its sign of one.
        """
        if noise_factor is None or error_factor is None:
            parameters = self.biorbd.KalmanParam(rate)
        else:
            parameters = self.biorbd.KalmanParam(rate, noise_factor, error_factor)
        kalman = self.biorbd.KalmanReconsMarkers(self.model, parameters)
        count = self.model.nbQ()
        q, qdot, qddot = (
            self.biorbd.GeneralizedCoordinates(count),
            self.biorbd.GeneralizedVelocity(count),
            self.biorbd.GeneralizedAcceleration(count),
        )
        kalman.setInitState(
            self.biorbd.GeneralizedCoordinates(start),
            self.biorbd.GeneralizedVelocity(np.zeros(count)),
            self.biorbd.GeneralizedAcceleration(np.zeros(count)),
        )
        flat = np.nan_to_num(markers, nan=0.0).reshape(len(markers), -1)
        result, seconds = np.empty((len(markers), count)), np.empty(len(markers))
        for frame, values in enumerate(flat):
            began = time.perf_counter()
            kalman.reconstructFrame(self.model, values, q, qdot, qddot)
            seconds[frame] = time.perf_counter() - began
            result[frame] = q.to_array()
        return result, seconds
