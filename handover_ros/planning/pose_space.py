"""The object poses that a plan may choose from: where in front of the person, and how the object may be turned."""

from __future__ import annotations

import warnings
from collections import Counter
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation
from scipy.stats import qmc

from handover_ros.errors import BadModelError
from handover_ros.geometry import FloatArray
from handover_ros.objects.catalogue import ObjectModel
from handover_ros.planning.facing import object_centre, object_corners
from handover_ros.planning.taking_postures import body_distance

VIEW_DOWN = 0.6  # [rad] below the horizon: eyes and head follow the hands
EYES = np.array([0.08, 0.0, 0.24])  # [m] in the torso frame of a person who stands upright
FULL_TURN = 2.0 * np.pi


@dataclass(frozen=True)
class PoseSpace:
    """Poses of an object in the level torso frame (x forward, y left, z up, origin between the shoulders).

    A pose is six numbers: the object's centre x, y, z [m], its turn about the vertical [rad], how far its top leans in
    that direction [rad], and its spin about its own axis [rad]. An object that must stay upright only turns.

    Attributes:
        lower: Of the centre [m], (x, y, z).
        upper: Of the centre [m].
        most_lean: [rad], for objects that may lean.
        clearance: Of the object from trunk and head [m].
        view: Half angle of the cone around straight ahead and down to the hands in which the object must be seen [rad].
    """

    lower: tuple[float, float, float] = (0.22, -0.55, -0.55)
    upper: tuple[float, float, float] = (0.75, 0.45, 0.05)
    most_lean: float = np.pi
    clearance: float = 0.10
    view: float = 1.25

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            BadModelError: Bounds cross, an angle or distance is out of range.
        """
        for axis, low, high in zip("xyz", self.lower, self.upper):
            if not low < high:
                raise BadModelError(f"pose space: bounds of {axis} are {low} to {high} m; the lower must be less")
        if not 0.0 <= self.most_lean <= np.pi or not 0.0 < self.view <= np.pi or not self.clearance >= 0.0:
            raise BadModelError(
                f"pose space: most_lean {self.most_lean}, view {self.view}, clearance {self.clearance}; angles lie "
                "between 0 and 3.1416 rad, the clearance is 0 or more"
            )

    def bounds(self, model: ObjectModel) -> FloatArray:
        """Return the least and greatest six numbers of a pose, shape (2, 6)."""
        lean, spin = (0.0, 0.0) if model.keep_upright else (self.most_lean, np.pi)
        return np.array([[*self.lower, -np.pi, 0.0, -spin], [*self.upper, np.pi, lean, spin]])

    def spread(self, model: ObjectModel, count: int, seed: int) -> FloatArray:
        """Return ``count`` poses (count, 6) that fill the space evenly (a scrambled Sobol sequence)."""
        low, high = self.bounds(model)
        free = high > low
        points = np.tile(low, (count, 1))
        sequence = qmc.Sobol(int(free.sum()), seed=np.random.default_rng(seed))
        points[:, free] = (
            low[free] + sequence.random_base2(max(1, (count - 1).bit_length()))[:count] * (high - low)[free]
        )
        return points

    def grid(self, model: ObjectModel, spacing: float, angle: float) -> FloatArray:
        """Return all poses (n, 6) of a regular grid: neighbours at most ``spacing`` [m] and ``angle`` [rad] apart."""
        low, high = self.bounds(model)
        axes = []
        for index, step in enumerate((spacing, spacing, spacing, angle, angle, angle)):
            count = int(np.ceil((high[index] - low[index]) / step - 1e-9))
            turns = index in (3, 5) and count > 0
            axes.append(np.linspace(low[index], high[index], count + (0 if turns else 1), endpoint=not turns))
        return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)

    def clip(self, model: ObjectModel, points: FloatArray) -> FloatArray:
        """Return poses (n, 6) brought inside the bounds; a turn goes on round the circle."""
        low, high = self.bounds(model)
        clipped = np.clip(points, low, high)
        for index in (3, 5):
            if high[index] > low[index]:
                clipped[:, index] = (points[:, index] + np.pi) % FULL_TURN - np.pi
        return clipped

    def points_of(self, model: ObjectModel, torso_from_object: FloatArray) -> FloatArray:
        """Return the poses (n, 6) nearest to transforms (n, 4, 4); their centres stay unless they are out of bounds."""
        rotations = torso_from_object[:, :3, :3]
        points = np.zeros((len(rotations), 6))
        points[:, :3] = rotations @ object_centre(model) + torso_from_object[:, :3, 3]
        if model.keep_upright:
            points[:, 3] = np.arctan2(rotations[:, 1, 0] - rotations[:, 0, 1], rotations[:, 0, 0] + rotations[:, 1, 1])
        else:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # upright: turn and spin are one, and any share of it will do
                points[:, 3:] = Rotation.from_matrix(rotations).as_euler("ZYZ")
        return self.clip(model, points)

    def transforms(self, model: ObjectModel, points: FloatArray) -> FloatArray:
        """Return torso_from_object (n, 4, 4) of poses (n, 6)."""
        (turn, lean, spin), poses = points[:, 3:].T, np.zeros((len(points), 4, 4))
        cosines, sines = (np.cos(turn), np.cos(lean), np.cos(spin)), (np.sin(turn), np.sin(lean), np.sin(spin))
        rotations = poses[:, :3, :3]  # Rz(turn) Ry(lean) Rz(spin)
        rotations[:, 0, 0] = cosines[0] * cosines[1] * cosines[2] - sines[0] * sines[2]
        rotations[:, 0, 1] = -cosines[0] * cosines[1] * sines[2] - sines[0] * cosines[2]
        rotations[:, 0, 2] = cosines[0] * sines[1]
        rotations[:, 1, 0] = sines[0] * cosines[1] * cosines[2] + cosines[0] * sines[2]
        rotations[:, 1, 1] = -sines[0] * cosines[1] * sines[2] + cosines[0] * cosines[2]
        rotations[:, 1, 2] = sines[0] * sines[1]
        rotations[:, 2, 0], rotations[:, 2, 1], rotations[:, 2, 2] = (
            -sines[1] * cosines[2],
            sines[1] * sines[2],
            cosines[1],
        )
        poses[:, :3, 3], poses[:, 3, 3] = points[:, :3] - rotations @ object_centre(model), 1.0
        return poses

    def allowed(
        self, model: ObjectModel, torso_from_object: FloatArray, refused: Counter[str] | None = None
    ) -> npt.NDArray[np.bool_]:
        """Return whether an object at poses (n, 4, 4) keeps its distance from the body and is seen, shape (n,).

        Args:
            model: The object.
            torso_from_object: Its poses.
            refused: Counts why the others are not.
        """
        corners = object_corners(model)
        rotated = (torso_from_object[:, :3, :3].reshape(-1, 3) @ corners.T).reshape(-1, 3, len(corners))
        placed = np.swapaxes(rotated + torso_from_object[:, :3, 3, None], 1, 2)
        clear = body_distance(placed.reshape(-1, 3)).reshape(placed.shape[:2]).min(axis=1) >= self.clearance
        centres = torso_from_object[:, :3, :3] @ object_centre(model) + torso_from_object[:, :3, 3]
        sight = centres - EYES
        ahead = np.array([np.cos(VIEW_DOWN), 0.0, -np.sin(VIEW_DOWN)])
        seen = sight @ ahead >= np.cos(self.view) * np.linalg.norm(sight, axis=1)
        if refused is not None:
            refused["too near to trunk or head"] += int((~clear).sum())
            refused["out of the person's view"] += int((clear & ~seen).sum())
        return np.asarray(clear & seen)
