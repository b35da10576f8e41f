"""Task Space Regions: the sets of hand poses with which an object can be grasped.

A region is T0_w, Tw_e and Bw of D. Berenson, S. Srinivasa, J. Kuffner, "Task Space Regions", IJRR 30(12), 2011.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from handover_ros.errors import BadModelError
from handover_ros.geometry import FloatArray, invert_transform, rotation_angle, transform_from_xyz_rpy

FULL_TURN = 2.0 * np.pi


@dataclass(frozen=True, eq=False)
class TaskSpaceRegion:
    """Hand poses ``object_from_region @ displacement @ region_from_hand`` with a bounded displacement.

    Attributes:
        name: What an operator calls the region, e.g. ``handle``.
        object_from_region: Region frame in the object frame, shape (4, 4) (Berenson's T0_w).
        region_from_hand: Hand at zero displacement in the region frame, shape (4, 4) (Tw_e).
        bounds: Least and greatest x, y, z [m] and roll, pitch, yaw about fixed axes [rad] of the displacement,
            shape (6, 2) (Bw).
    """

    name: str
    object_from_region: FloatArray
    region_from_hand: FloatArray
    bounds: FloatArray

    def __post_init__(self) -> None:
        """Check the shapes and make the arrays read-only."""
        for field, shape in (("object_from_region", (4, 4)), ("region_from_hand", (4, 4)), ("bounds", (6, 2))):
            array = np.array(getattr(self, field), dtype=float)
            if array.shape != shape or not np.all(np.isfinite(array)):
                raise BadModelError(f"region {self.name!r}: {field} must be finite numbers of shape {shape}")
            array.setflags(write=False)
            object.__setattr__(self, field, array)
        if np.any(self.bounds[:, 0] > self.bounds[:, 1]):
            raise BadModelError(f"region {self.name!r}: a lower bound is above its upper bound")
        if np.any(self.bounds[3:, 1] - self.bounds[3:, 0] > FULL_TURN + 1e-6):
            raise BadModelError(f"region {self.name!r}: an angle range is wider than a full turn (6.2832 rad)")

    def pose(self, offset: npt.ArrayLike) -> FloatArray:
        """Return object_from_hand (4, 4) of a displacement (6,): x, y, z [m], roll, pitch, yaw [rad]."""
        values = np.asarray(offset, dtype=float)
        return self.object_from_region @ transform_from_xyz_rpy(values[:3], values[3:]) @ self.region_from_hand

    def poses(self, offsets: npt.ArrayLike) -> FloatArray:
        """Return object_from_hand (n, 4, 4) of displacements (n, 6)."""
        values = np.asarray(offsets, dtype=float).reshape(-1, 6)
        displacement = np.tile(np.eye(4), (len(values), 1, 1))
        if len(values):
            displacement[:, :3, :3] = Rotation.from_euler("xyz", values[:, 3:]).as_matrix()
            displacement[:, :3, 3] = values[:, :3]
        return self.object_from_region @ displacement @ self.region_from_hand

    def centre(self) -> FloatArray:
        """Return object_from_hand (4, 4) in the middle of the bounds."""
        return self.pose(self.bounds.mean(axis=1))

    def sample(self, rng: np.random.Generator, n: int) -> FloatArray:
        """Return ``n`` poses object_from_hand (n, 4, 4), displacements uniform within the bounds."""
        return self.poses(rng.uniform(self.bounds[:, 0], self.bounds[:, 1], size=(n, 6)))

    def grid(self, step_length: float, step_angle: float) -> FloatArray:
        """Return the poses object_from_hand (n, 4, 4) of a regular grid over the bounds, always the same ones.

        Args:
            step_length: Largest distance between neighbours along x, y, z [m], > 0.
            step_angle: Largest angle between neighbours in roll, pitch, yaw [rad], > 0.
        """
        steps = [step_length] * 3 + [step_angle] * 3
        axes = [
            _axis(low, high, step, turns=index >= 3)
            for index, ((low, high), step) in enumerate(zip(self.bounds, steps, strict=True))
        ]
        mesh = np.meshgrid(*axes, indexing="ij")
        return self.poses(np.stack([values.ravel() for values in mesh], axis=1))

    def offset(self, object_from_hand: FloatArray) -> FloatArray:
        """Return the displacement (6,) of a hand pose; the roll-pitch-yaw form nearest to the bounds."""
        displacement = invert_transform(self.object_from_region) @ object_from_hand
        displacement = displacement @ invert_transform(self.region_from_hand)
        candidates = []
        for angles in _euler_forms(displacement[:3, :3]):
            wrapped = self._wrapped(angles)
            outside = np.linalg.norm(wrapped - np.clip(wrapped, self.bounds[3:, 0], self.bounds[3:, 1]))
            candidates.append((outside, wrapped))
        best = min(candidates, key=lambda candidate: candidate[0])[1]
        return np.concatenate([displacement[:3, 3], best])

    def distance(self, object_from_hand: FloatArray) -> tuple[float, float]:
        """Return how far a hand pose is outside the region.

        Args:
            object_from_hand: Hand pose in the object frame, shape (4, 4).

        Returns:
            Metres between the displacement and its nearest point within the bounds, and the angle [rad] between the two
            rotations; (0, 0) inside.
        """
        offset = self.offset(object_from_hand)
        nearest = np.clip(offset, self.bounds[:, 0], self.bounds[:, 1])
        turned = Rotation.from_euler("xyz", offset[3:]).as_matrix()
        inside = Rotation.from_euler("xyz", nearest[3:]).as_matrix()
        return float(np.linalg.norm(offset[:3] - nearest[:3])), rotation_angle(turned, inside)

    def _wrapped(self, angles: FloatArray) -> FloatArray:
        """Return the angles (3,) [rad] turned by full turns to be nearest to the middle of their bounds."""
        middle = self.bounds[3:].mean(axis=1)
        return middle + (angles - middle + np.pi) % FULL_TURN - np.pi


def _axis(low: float, high: float, step: float, turns: bool) -> FloatArray:
    """Return grid values from ``low`` to ``high``; a full turn has no second end."""
    count = int(np.ceil((high - low) / step - 1e-9))
    if count < 1:
        return np.array([(low + high) / 2.0])
    full = turns and high - low >= FULL_TURN - 1e-6
    return np.linspace(low, high, count, endpoint=False) if full else np.linspace(low, high, count + 1)


def _euler_forms(rotation: FloatArray) -> list[FloatArray]:
    """Return the two roll-pitch-yaw triples [rad] of a 3x3 rotation (only one at a pitch of 90 deg)."""
    pitch = np.arctan2(-rotation[2, 0], np.hypot(rotation[0, 0], rotation[1, 0]))
    if np.hypot(rotation[0, 0], rotation[1, 0]) < 1e-9:
        return [np.array([0.0, pitch, np.arctan2(-rotation[0, 1], rotation[1, 1])])]
    roll = np.arctan2(rotation[2, 1], rotation[2, 2])
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    return [np.array([roll, pitch, yaw]), np.array([roll + np.pi, np.pi - pitch, yaw + np.pi])]
