"""How a simulated subject takes an object for two hands: the whole upper body's cheapest posture that holds it.

The cost is the subject's own and the planner does not know it: weighted squared displacements of trunk and arms from a
comfortable posture. Both hands are where the object can be held as well as the body allows; a miss costs too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from handover_ros.errors import BadModelError
from handover_ros.geometry import FloatArray
from handover_ros.objects.catalogue import ObjectModel
from handover_ros.objects.regions import TaskSpaceRegion
from handover_ros.sim.person_kinematics import PersonKinematics
from handover_ros.sim.person_reach import HALF_TURN
from handover_ros.sim.person_spec import ARM_SLICE, HANDS, JOINTS
from handover_ros.studies.chapter2_settings import HoldSettings, TasteSettings

STARTS = (-0.4, 0.4)  # [rad] of the trunk's turn from which the cheapest posture is looked for
EVALUATIONS, PRECISION = 60, 1e-5
STEP = 1e-6  # [m], [rad] of numerical derivatives
TORSO_YAW = JOINTS.index("torso_yaw")
SHOULDERS = ("shoulder_flexion", "shoulder_abduction", "shoulder_rotation")
COUNT = len(JOINTS)


@dataclass(frozen=True, eq=False)
class Taken:
    """A posture that takes an object.

    Attributes:
        displacements: Shape (20,), ordered as ``person_spec.JOINTS``; the torso's from where the feet stand.
        cost: Of the posture, misses left out.
        position_miss: The larger one of both hands [m].
        angle_miss: The same [rad], between hand axes.
    """

    displacements: FloatArray
    cost: float
    position_miss: float
    angle_miss: float

    def reaches(self, hold: HoldSettings) -> bool:
        """Return whether the object is held."""
        return self.position_miss <= hold.most_position and self.angle_miss <= hold.most_angle


def weights_of(kinematics: PersonKinematics, taste: TasteSettings) -> FloatArray:
    """Return the weights (20,) of the squared displacements [1/m2], [1/rad2] of a person with a taste."""
    factors = [taste.trunk] * 6
    factors += [taste.shoulder if name.split("_", 1)[1] in SHOULDERS else taste.forearm for name in JOINTS[6:]]
    return np.asarray(kinematics.person.weights * factors)


def ends_by_hand(
    model: ObjectModel, world_from_object: FloatArray, kinematics: PersonKinematics
) -> dict[str, TaskSpaceRegion]:
    """Return which region each hand takes: arms do not cross.

    Raises:
        BadModelError: The object is not one for two hands with two regions.
    """
    regions = model.human_grasps
    if model.hands != len(HANDS) or len(regions) != len(HANDS):
        raise BadModelError(
            f"object {model.name!r}: the study needs one for two hands with one region for each; choose box"
        )
    torso_y = kinematics.torso_pose(np.zeros(6))[:3, 1]
    aside = [float((world_from_object @ region.centre())[:3, 3] @ torso_y) for region in regions]
    return {"right": regions[int(np.argmin(aside))], "left": regions[int(np.argmax(aside))]}


class Taking:
    """What one person does with one offer; a problem of least squares.

    Args:
        kinematics: The person, standing where they stand.
        model: The object.
        world_from_object: Where it is offered, shape (4, 4).
        hold: What misses cost.
    """

    def __init__(
        self, kinematics: PersonKinematics, model: ObjectModel, world_from_object: FloatArray, hold: HoldSettings
    ) -> None:
        self._kinematics, self._pose = kinematics, world_from_object
        self._regions = ends_by_hand(model, world_from_object, kinematics)
        self._free = {
            hand: np.flatnonzero(np.ptp(region.bounds, axis=1) > 0.0) for hand, region in self._regions.items()
        }
        self._scales = np.repeat([1.0 / hold.costly_position, 1.0 / hold.costly_angle], [3, 6])
        bounds = [np.column_stack([kinematics.person.lower, kinematics.person.upper])]
        bounds += [self._regions[hand].bounds[self._free[hand]] for hand in HANDS]
        self._bounds = np.concatenate(bounds)
        self._last: tuple[bytes, dict[str, tuple[FloatArray, FloatArray]]] = (b"", {})

    def cheapest(self, neutral: FloatArray, weights: FloatArray) -> Taken:
        """Return the cheapest posture.

        Args:
            neutral: The posture found comfortable, shape (20,).
            weights: Of the squared displacements from it, shape (20,).
        """
        root = np.sqrt(weights)
        lower, upper = self._bounds.T
        inner = 1e-3 * (upper - lower)

        def residuals(values: FloatArray) -> FloatArray:
            misses = [self._scales * self._miss(hand, values) for hand in HANDS]
            return np.concatenate([root * (values[:COUNT] - neutral), *misses])

        def jacobian(values: FloatArray) -> FloatArray:
            own = np.zeros((COUNT, len(values)))
            own[:, :COUNT] = np.diag(root)
            return np.concatenate([own, *(self._scales[:, None] * self._slope(hand, values) for hand in HANDS)])

        best = None
        for start in self._starts(neutral):
            start = np.clip(start, lower + inner, upper - inner)
            found = least_squares(
                residuals,
                start,
                jacobian,
                (lower, upper),
                ftol=PRECISION,
                xtol=PRECISION,
                gtol=PRECISION,
                x_scale="jac",
                max_nfev=EVALUATIONS,
            )
            if best is None or found.cost < best.cost - 1e-9:
                best = found
        assert best is not None
        misses = np.array([self._miss(hand, best.x) for hand in HANDS])
        posture = best.x[:COUNT]
        return Taken(
            posture,
            float(weights @ (posture - neutral) ** 2),
            float(np.linalg.norm(misses[:, :3], axis=1).max()),
            float(np.linalg.norm(misses[:, 3:].reshape(-1, 3), axis=1).max()),
        )

    def _starts(self, neutral: FloatArray) -> list[FloatArray]:
        """Return where the search begins: the comfortable posture (20,), turned, and the middle of each grasp."""
        start = np.concatenate([neutral, self._bounds[COUNT:].mean(axis=1)])
        return [start + turn * (np.arange(len(start)) == TORSO_YAW) for turn in STARTS]

    def _grips(self, hand: str, values: FloatArray) -> FloatArray:
        """Return world_from_hand (1 + 2 k, 4, 4) on the object: as it is, each of k free offsets a step up, down."""
        free = self._free[hand]
        offset = self._regions[hand].bounds.mean(axis=1)
        before = COUNT + (0 if hand == HANDS[0] else len(self._free[HANDS[0]]))
        offset[free] = values[before : before + len(free)]
        steps = STEP * np.eye(6)[free]
        poses = self._regions[hand].poses(np.concatenate([offset[None], offset + steps, offset - steps]))
        return np.asarray(self._pose @ poses @ (HALF_TURN if hand == "left" else np.eye(4)))

    def _poses(self, hand: str, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return world_from_hand (4, 4) of the body, and ``_grips``; both are asked for twice for the same values."""
        key = values.tobytes()
        if self._last[0] != key:
            self._last = key, {}
        known = self._last[1]
        if hand not in known:
            torso = self._kinematics.torso_pose(values[:6])
            body = np.asarray(torso @ self._kinematics.arm_pose(hand, values[ARM_SLICE[hand]]))
            known[hand] = body, self._grips(hand, values)
        return known[hand]

    def _miss(self, hand: str, values: FloatArray) -> FloatArray:
        """Return how far a hand is from the object (9,): position [m], then its x and z axes."""
        body, grips = self._poses(hand, values)
        return _row(body) - _row(grips[0])

    def _slope(self, hand: str, values: FloatArray) -> FloatArray:
        """Return the derivatives (9, n) of ``_miss``."""
        slope = np.zeros((9, len(values)))
        jacobian, (pose, grips) = self._kinematics.jacobian(values[:COUNT], hand), self._poses(hand, values)
        slope[:3, :COUNT] = jacobian[:3]
        for row, axis in ((3, pose[:3, 0]), (6, pose[:3, 2])):
            slope[row : row + 3, :COUNT] = np.cross(jacobian[3:].T, axis).T
        count = len(self._free[hand])
        before = COUNT + (0 if hand == HANDS[0] else len(self._free[HANDS[0]]))
        for index in range(count):
            change = _row(grips[1 + index]) - _row(grips[1 + count + index])
            slope[:, before + index] = -change / (2.0 * STEP)
        return slope


def _row(pose: FloatArray) -> FloatArray:
    """Return position, x and z axis (9,) of a pose (4, 4)."""
    return np.concatenate([pose[:3, 3], pose[:3, 0], pose[:3, 2]])
