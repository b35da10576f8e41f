"""The planar arm of two joints of Bestick 2017, section 4.5: its inverse kinematics, and random planar objects."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from handover_ros.geometry import FloatArray

JOINTS = ("shoulder", "elbow")
POINTS = 60  # of an object's outline
LEAST_POSTURES = 3  # with which a random object can be taken


@dataclass(frozen=True, eq=False)
class PlanarArm:
    """Two links in a plane; zero: stretched along x, angles counter-clockwise.

    Attributes:
        upper_arm: [m].
        forearm: [m].
        limits: Lower and upper limits of shoulder and elbow [rad], shape (2, 2).
    """

    upper_arm: float = 0.33
    forearm: float = 0.33
    limits: FloatArray = field(default_factory=lambda: np.array([[-1.2, -2.6], [2.6, 2.6]]))

    def hand(self, displacements: FloatArray) -> FloatArray:
        """Return the hand's places (n, 2) [m] of displacements (n, 2) [rad]."""
        shoulder, both = displacements[:, 0], displacements.sum(axis=1)
        return np.column_stack(
            [
                self.upper_arm * np.cos(shoulder) + self.forearm * np.cos(both),
                self.upper_arm * np.sin(shoulder) + self.forearm * np.sin(both),
            ]
        )

    def inverse(self, places: FloatArray) -> FloatArray:
        """Return all displacements (k, 2) [rad] within limits with the hand at one of places (n, 2) [m]."""
        squared = np.square(places).sum(axis=1)
        cosine = (squared - self.upper_arm**2 - self.forearm**2) / (2.0 * self.upper_arm * self.forearm)
        near = np.abs(cosine) <= 1.0
        found = []
        for side in (1.0, -1.0):
            elbow = side * np.arccos(cosine[near])
            beside = np.arctan2(self.forearm * np.sin(elbow), self.upper_arm + self.forearm * np.cos(elbow))
            shoulder = np.arctan2(places[near, 1], places[near, 0]) - beside
            found.append(np.column_stack([np.mod(shoulder + np.pi, 2.0 * np.pi) - np.pi, elbow]))
        postures = np.concatenate(found)
        within = ((postures >= self.limits[0]) & (postures <= self.limits[1])).all(axis=1)
        return np.asarray(postures[within])


@dataclass(frozen=True, eq=False)
class PlanarObject:
    """A closed outline in the plane, some of which can be grasped.

    Attributes:
        radius: Of the outline's points about the object's centre, at equal angles [m], shape (n,).
        graspable: Which points can be grasped, shape (n,).
        centre: Where the object is [m], shape (2,).
        turn: How it is turned [rad].
    """

    radius: FloatArray
    graspable: npt.NDArray[np.bool_]
    centre: FloatArray
    turn: float = 0.0

    @property
    def outline(self) -> FloatArray:
        """The outline's points (n, 2) [m]."""
        angle = self.turn + np.linspace(0.0, 2.0 * np.pi, len(self.radius), endpoint=False)
        return np.asarray(self.centre + self.radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))

    def feasible(self, arm: PlanarArm) -> FloatArray:
        """Return all displacements (k, 2) [rad] with the hand at a graspable point."""
        return arm.inverse(self.outline[self.graspable])


def any_object(arm: PlanarArm, rng: np.random.Generator, points: int = POINTS) -> PlanarObject:
    """Return a random object at a random place, within reach or not.

    The outline is a closed curve of random size and shape; one to three stretches of it can be grasped, so that
    feasible sets may fall into parts (figures 4.5 and 4.6).
    """
    reach = arm.upper_arm + arm.forearm
    distance, bearing = reach * rng.uniform(0.35, 1.0), rng.uniform(-np.pi, np.pi)
    centre = distance * np.array([np.cos(bearing), np.sin(bearing)])
    size, wobble, phase = reach * rng.uniform(0.1, 0.35), rng.uniform(0.0, 0.4), rng.uniform(0.0, 2.0 * np.pi)
    angle = np.linspace(0.0, 2.0 * np.pi, points, endpoint=False)
    radius = size * (1.0 + wobble * np.cos(rng.integers(2, 5) * angle + phase))
    graspable = np.zeros(points, dtype=bool)
    for _ in range(rng.integers(1, 4)):
        start, length = rng.integers(points), rng.integers(points // 12, points // 3)
        graspable[np.arange(start, start + length) % points] = True
    return PlanarObject(radius, graspable, centre)


def random_planar_object(arm: PlanarArm, rng: np.random.Generator, points: int = POINTS) -> PlanarObject:
    """Return a random object that can be taken in three ways or more."""
    while True:
        found = any_object(arm, rng, points)
        if len(found.feasible(arm)) >= LEAST_POSTURES:
            return found


def random_object(arm: PlanarArm, rng: np.random.Generator, points: int = POINTS) -> FloatArray:
    """Return the feasible set (k, 2) [rad] of a random object within reach: the graspable parts of its outline."""
    return random_planar_object(arm, rng, points).feasible(arm)
