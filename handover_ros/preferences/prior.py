"""What is believed of a person before their first answer: bounds, what is usual, or what a population showed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import logsumexp

from handover_ros.ergonomics.arm_costs import Preference
from handover_ros.errors import BadRequestError
from handover_ros.geometry import FloatArray
from handover_ros.preferences.space import PreferenceSpace

LEAST_DEVIATION = 0.02  # share of the bounds' width below which a population's spread is not believed
TYPICAL_SPREAD = (0.5, 0.8)  # [rad] between people's neutral displacements, and between logarithms of their weights
DRAWS = 4096  # for the mass of a normal distribution within the bounds


@dataclass(frozen=True, eq=False)
class Normal:
    """A multivariate normal distribution.

    Attributes:
        mean: Shape (p,).
        covariance: Positive definite, shape (p, p).
    """

    mean: FloatArray
    covariance: FloatArray

    @cached_property
    def factor(self) -> FloatArray:
        """The lower Cholesky factor of the covariance (p, p)."""
        return np.asarray(np.linalg.cholesky(self.covariance))

    def log_density(self, points: FloatArray) -> FloatArray:
        """Return the log density at points (n, p), shape (n,)."""
        whitened = np.linalg.solve(self.factor, (points - self.mean).T)
        constant = np.log(np.diag(self.factor)).sum() + 0.5 * len(self.mean) * np.log(2.0 * np.pi)
        return np.asarray(-0.5 * np.square(whitened).sum(axis=0) - constant)

    def sample(self, number: int, rng: np.random.Generator) -> FloatArray:
        """Return samples (number, p)."""
        return np.asarray(self.mean + rng.standard_normal((number, len(self.mean))) @ self.factor.T)


@dataclass(frozen=True, eq=False)
class Prior:
    """The first belief: even over the bounds, or a normal distribution cut off there.

    Attributes:
        space: What is learned.
        population: Of other people, in the space's coordinates; None: nothing is known.
    """

    space: PreferenceSpace
    population: Normal | None = None

    def log_density(self, particles: FloatArray) -> FloatArray:
        """Return the log density (n,) at particles (n, p); -inf outside of the bounds."""
        lower, upper = self.space.bounds
        inside = ((particles >= lower) & (particles <= upper)).all(axis=1)
        if self.population is None:
            return np.where(inside, -np.log(upper - lower).sum(), -np.inf)
        return np.where(inside, self.population.log_density(particles) - self._log_mass, -np.inf)

    def sample(self, number: int, rng: np.random.Generator) -> FloatArray:
        """Return particles (number, p) of equal weight."""
        if self.population is None:
            return self.space.spread(number, rng)
        lower, upper = self.space.bounds
        found = np.empty((0, len(lower)))
        for _ in range(1000):
            drawn = self.population.sample(4 * number, rng)
            found = np.concatenate([found, drawn[((drawn >= lower) & (drawn <= upper)).all(axis=1)]])
            if len(found) >= number:
                return found[:number]
        raise BadRequestError("prior: the population lies outside of the bounds of what can be learned")

    @cached_property
    def _log_mass(self) -> float:
        """Log of the share of the population within the bounds."""
        assert self.population is not None
        lower, upper = self.space.bounds
        drawn = self.population.sample(DRAWS, np.random.default_rng(0))
        return float(np.log(max(1, ((drawn >= lower) & (drawn <= upper)).all(axis=1).sum()) / DRAWS))


def typical_prior(space: PreferenceSpace, usual: Preference, spread: tuple[float, float] = TYPICAL_SPREAD) -> Prior:
    """Return what is to be believed of anybody: near to what is usual, as a wide normal distribution.

    Args:
        space: What is learned.
        usual: Neutral posture and weights; clipped to the bounds.
        spread: Standard deviations of neutral displacements [rad] and of the logarithms of weights.
    """
    lower, upper = space.bounds
    middle = space.coordinates(usual.neutral, usual.weights, float(np.sqrt(np.prod(space.rationality_bounds))))
    deviations = np.array([spread[0] if name.startswith("neutral_") else spread[1] for name in space.names])
    return Prior(space, Normal(np.clip(middle, lower, upper), np.diag(np.square(deviations))))


def population_prior(space: PreferenceSpace, beliefs: Sequence[tuple[FloatArray, FloatArray]]) -> Prior:
    """Return what is to be believed of the next person, after others.

    A normal distribution with mean and covariance of all their particles together: the spread between people and what
    is not known of each one.

    Args:
        space: What is learned.
        beliefs: Particles (n, p) in the space's coordinates and log weights (n,) of each person.

    Raises:
        BadRequestError: There is nobody, or a belief is of another space.
    """
    size = space.bounds.shape[1]
    if not beliefs:
        raise BadRequestError("population prior: needs the belief of one person at least")
    for particles, log_weights in beliefs:
        if particles.ndim != 2 or particles.shape[1] != size or log_weights.shape != particles.shape[:1]:
            raise BadRequestError(f"population prior: a belief has particles {particles.shape}, not (n, {size})")
    points = np.concatenate([particles for particles, _ in beliefs])
    weights = np.concatenate([np.exp(log - logsumexp(log)) for _, log in beliefs]) / len(beliefs)
    mean = weights @ points
    covariance = (points - mean).T @ ((points - mean) * weights[:, None])
    floor = np.square(LEAST_DEVIATION * np.diff(space.bounds, axis=0)[0])
    return Prior(space, Normal(mean, covariance + np.diag(floor)))
