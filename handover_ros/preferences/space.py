"""What is to be learned of a person's preference lambda = [q*, w] (Bestick 2017, eq. 4.2), and within which bounds.

A particle is a point of the learned coordinates: neutral displacements [rad], logarithms of weights, and the logarithm
of the rationality if that is not known. Multiplying w by a number and dividing the rationality by it changes no choice,
so weights and rationality are never learned together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.stats import qmc

from handover_ros.arm.model import JOINT_NAMES
from handover_ros.ergonomics.arm_costs import Preference
from handover_ros.errors import BadRequestError
from handover_ros.geometry import FloatArray

WEIGHT_BOUNDS = (0.05, 3.0)  # [1/rad2] a joint ten times as dear as another is rare; the rest is left to the data
RATIONALITY_BOUNDS = (1.0, 100.0)  # [1/cost]


@dataclass(frozen=True, eq=False)
class People:
    """Believed persons, one a row.

    Attributes:
        neutral: q* [rad], shape (n, d).
        weights: w [1/rad2], shape (n, d).
        rationality: [1/cost], shape (n,).
    """

    neutral: FloatArray
    weights: FloatArray
    rationality: FloatArray

    def __len__(self) -> int:
        """Return their number."""
        return len(self.neutral)

    def costs(self, configurations: FloatArray) -> FloatArray:
        """Return C(q; lambda) (n, k) of configurations (k, d), eq. 4.2."""
        costs = np.zeros((len(self), len(configurations)))
        for q, neutral, weight in zip(configurations.T, self.neutral.T, self.weights.T):  # never n k d numbers at once
            costs += weight[:, None] * np.square(q - neutral[:, None])
        return costs


@dataclass(frozen=True, eq=False)
class PreferenceSpace:
    """The coordinates that are learned.

    Attributes:
        joints: Names of the d displacements.
        neutral_bounds: Lower and upper [rad], shape (2, d); equal: known.
        weight_bounds: Lower and upper [1/rad2], > 0, shape (2, d); equal: known.
        rationality_bounds: Lower and upper [1/cost]; equal: known.
    """

    joints: tuple[str, ...]
    neutral_bounds: FloatArray
    weight_bounds: FloatArray
    rationality_bounds: tuple[float, float] = (10.0, 10.0)

    def __post_init__(self) -> None:
        """Check the bounds and make the arrays read-only.

        Raises:
            BadRequestError: A shape or a bound is wrong, nothing is to be learned, or weights and rationality both.
        """
        count = len(self.joints)
        for name in ("neutral_bounds", "weight_bounds"):
            bounds = np.array(getattr(self, name), dtype=float)
            if bounds.shape != (2, count) or not np.isfinite(bounds).all() or (bounds[0] > bounds[1]).any():
                raise BadRequestError(f"{name}: needs finite bounds (2, {count}), lower before upper, got {bounds}")
            bounds.setflags(write=False)
            object.__setattr__(self, name, bounds)
        if (self.weight_bounds <= 0.0).any():
            raise BadRequestError(f"weight_bounds: must be positive, got {self.weight_bounds.tolist()}")
        low, high = self.rationality_bounds
        if not 0.0 < low <= high < np.inf:
            raise BadRequestError(f"rationality_bounds: need 0 < lower <= upper, got {self.rationality_bounds}")
        lower, upper = self._all_bounds()
        if not (upper > lower).any():
            raise BadRequestError("preference: nothing is to be learned, all bounds are equal")
        if high > low and (upper > lower)[count : 2 * count].any():
            raise BadRequestError(
                "preference: weights and rationality cannot be learned together (only their product shows); fix one"
            )

    def _all_bounds(self) -> tuple[FloatArray, FloatArray]:
        """Return lower and upper bounds (2d + 1,) of all coordinates, learned or not."""
        columns = zip(self.neutral_bounds, np.log(self.weight_bounds), np.log(self.rationality_bounds))
        lower, upper = (np.append(np.concatenate(parts[:2]), parts[2]) for parts in columns)
        return lower, upper

    @property
    def learned(self) -> npt.NDArray[np.bool_]:
        """Which of neutral (d), log weights (d), log rationality are learned, shape (2d + 1,)."""
        lower, upper = self._all_bounds()
        return np.asarray(upper > lower)

    @property
    def bounds(self) -> FloatArray:
        """Of the learned coordinates, shape (2, p)."""
        return np.array(self._all_bounds())[:, self.learned]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the learned coordinates: ``neutral_<joint>`` [rad], ``log_weight_<joint>``, ``log_rationality``."""
        every = [f"neutral_{j}" for j in self.joints] + [f"log_weight_{j}" for j in self.joints] + ["log_rationality"]
        return tuple(name for name, learned in zip(every, self.learned) if learned)

    def people(self, particles: FloatArray) -> People:
        """Return the persons of particles (n, p)."""
        count = len(self.joints)
        every = np.tile(self._all_bounds()[0], (len(particles), 1))
        every[:, self.learned] = particles
        return People(every[:, :count], np.exp(every[:, count : 2 * count]), np.exp(every[:, 2 * count]))

    def coordinates(self, neutral: FloatArray, weights: FloatArray, rationality: float) -> FloatArray:
        """Return the learned coordinates (p,) of a person."""
        every = np.concatenate([neutral, np.log(weights), [np.log(rationality)]])
        return np.asarray(every[self.learned])

    def spread(self, number: int, rng: np.random.Generator) -> FloatArray:
        """Return particles (number, p), evenly spread over the bounds."""
        lower, upper = self.bounds
        points = qmc.Halton(len(lower), rng=rng).random(number)
        return np.asarray(lower + points * (upper - lower))


def arm_space(
    limits: FloatArray,
    learn: Sequence[str] = ("neutral", "weights"),
    known: Preference | None = None,
    rationality: float | tuple[float, float] = 10.0,
) -> PreferenceSpace:
    """Return what can be learned of a person's arm of seven joints.

    Args:
        limits: Within which the neutral posture lies [rad], shape (2, 7).
        learn: ``neutral``, ``weights`` or both.
        known: The parts that are not learned; default: those of anybody.
        rationality: Known [1/cost], or bounds to average over.

    Raises:
        BadRequestError: ``learn`` is not known, or asks for too much.
    """
    unknown = set(learn) - {"neutral", "weights"}
    if unknown:
        raise BadRequestError(f"learn: unknown {', '.join(sorted(unknown))}; can be neutral, weights or both")
    given = known or Preference()
    weights = np.clip(given.weights, *WEIGHT_BOUNDS)
    both = (rationality, rationality) if isinstance(rationality, int | float) else rationality
    return PreferenceSpace(
        JOINT_NAMES,
        limits if "neutral" in learn else np.array([given.neutral] * 2),
        np.tile(np.array(WEIGHT_BOUNDS)[:, None], 7) if "weights" in learn else np.array([weights] * 2),
        (float(both[0]), float(both[1])),
    )
