"""The belief about a person's preference: weighted particles, updated with every answer (Bestick 2017, eq. 4.4, 4.5).

Plain resampling lets particles collapse onto few. Here an answer is taken in by degrees, so small that half of the
particles keep counting, and after each resampling the particles move by Markov chains that leave the posterior of all
answers so far as it is (resample-move: Gilks and Berzuini 2001; tempered: Del Moral, Doucet and Jasra 2006). What
comes out is the posterior itself, with its normalisation: density and entropy follow without a grid or a kernel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit, logsumexp

from handover_ros.errors import BadRequestError
from handover_ros.geometry import FloatArray
from handover_ros.preferences.likelihood import log_likelihood, log_likelihoods
from handover_ros.preferences.prior import Normal, Prior
from handover_ros.preferences.query import Answer, IntArray, Query
from handover_ros.preferences.space import People

PARTICLES = 5000
LEAST_EFFECTIVE = 0.5  # share of the particles below which they are resampled
MOST_REMEMBERED = 64  # answers kept as they are; then the belief itself stands for them
MOVES = 3.0  # accepted moves of a particle, on average, after a resampling
MOST_ROUNDS = 16
STRETCH = 2.38  # of a random walk over its dimension's root: Roberts, Gelman and Gilks 1997
SCALES = (1.0, 0.5, 0.15)
EDGE = 1e-9  # share of the bounds nearer than which no particle comes to them
JUMPS = 0.1  # share of moves by the whole difference of two others: from one mode to another


@dataclass(frozen=True, eq=False)
class Observation:
    """A query and its answer."""

    query: Query
    answer: Answer


@dataclass(frozen=True, eq=False)
class Summary:
    """What stands for answers that are not remembered: prior times exp(fit) is ``posterior`` times exp(log_mass).

    Attributes:
        posterior: After them.
        log_mass: Log evidence of them.
    """

    posterior: Normal
    log_mass: float

    def fit(self, particles: FloatArray, prior: Prior) -> FloatArray:
        """Return their log likelihood (n,) of particles (n, p)."""
        return self.posterior.log_density(particles) - prior.log_density(particles) + self.log_mass


@dataclass(frozen=True, eq=False)
class Belief:
    """What is believed after some answers. A value: ``updated`` returns another one.

    Attributes:
        prior: The first belief.
        particles: In the coordinates of ``prior.space``, shape (n, p).
        log_weights: Normalised, shape (n,).
        fit: Log likelihood of all answers, forgotten as they age, for each particle (n,).
        log_evidence: Log of the mean likelihood under the prior.
        history: The remembered answers, the newest last.
        summary: Of those before, or None.
        observations: Number of answers so far.
        retention: What an answer still counts one answer later; 1: nothing is forgotten.
        seed: Of all random draws.
    """

    prior: Prior
    particles: FloatArray
    log_weights: FloatArray
    fit: FloatArray
    log_evidence: float = 0.0
    history: tuple[Observation, ...] = ()
    summary: Summary | None = None
    observations: int = 0
    retention: float = 1.0
    seed: int = 0

    @property
    def people(self) -> People:
        """The believed persons."""
        return self.prior.space.people(self.particles)

    @property
    def weights(self) -> FloatArray:
        """Of the particles, sum 1, shape (n,)."""
        return np.asarray(np.exp(self.log_weights))

    @property
    def effective_particles(self) -> float:
        """Effective sample size (sum w)^2 / sum w^2."""
        return float(np.exp(-logsumexp(2.0 * self.log_weights)))

    @property
    def mean(self) -> FloatArray:
        """Posterior mean of the coordinates (p,)."""
        return np.asarray(self.weights @ self.particles)

    @property
    def covariance(self) -> FloatArray:
        """Posterior covariance of the coordinates (p, p)."""
        offsets = self.particles - self.mean
        return np.asarray(offsets.T @ (offsets * self.weights[:, None]))

    @property
    def mode(self) -> FloatArray:
        """The most probable particle (p,)."""
        return np.asarray(self.particles[int(np.argmax(self.prior.log_density(self.particles) + self.fit))])

    @property
    def entropy(self) -> float:
        """Differential entropy of the posterior [nat]."""
        return float(self.log_evidence - self.weights @ (self.prior.log_density(self.particles) + self.fit))

    def log_density(self, particles: FloatArray) -> FloatArray:
        """Return the log of the posterior density (n,) at any points (n, p) of the space."""
        past = _past_fit(self, particles)
        return np.asarray(self.prior.log_density(particles) + past - self.log_evidence)

    def updated(self, query: Query, answer: Answer) -> Belief:
        """Return the belief after one more answer (4.4)."""
        rng = np.random.default_rng((self.seed, self.observations))
        return _Update(self, query, answer, rng).run()


def first_belief(prior: Prior, particles: int = PARTICLES, retention: float = 1.0, seed: int = 0) -> Belief:
    """Return the belief before any answer.

    Args:
        prior: What is believed of anybody.
        particles: Their number.
        retention: What an answer still counts one answer later, in (0, 1]; below 1 for people who change.
        seed: Of all random draws.

    Raises:
        BadRequestError: A number is out of range.
    """
    if particles < 2:
        raise BadRequestError(f"particles: need 2 or more, got {particles}")
    if not 0.0 < retention <= 1.0:
        raise BadRequestError(f"retention: must lie in (0, 1], got {retention}")
    drawn = prior.sample(particles, np.random.default_rng(seed))
    return Belief(
        prior, drawn, np.full(particles, -np.log(particles)), np.zeros(particles), retention=retention, seed=seed
    )


def _past_fit(belief: Belief, particles: FloatArray) -> FloatArray:
    """Return the log likelihood (n,) of all answers so far at particles (n, p), as ``Belief.fit`` counts them."""
    people = belief.prior.space.people(particles)
    fit = np.zeros(len(particles))
    if belief.summary is not None:
        fit = belief.summary.fit(particles, belief.prior)
    for likelihood in log_likelihoods(people, ((each.query, each.answer) for each in belief.history)):
        fit = belief.retention * fit + likelihood
    return fit


class _Update:
    """Takes one answer into a belief: along the path past + s (retention past + newest - past), s from 0 to 1."""

    def __init__(self, belief: Belief, query: Query, answer: Answer, rng: np.random.Generator) -> None:
        self.belief, self.query, self.answer, self.rng = belief, query, answer, rng
        self.particles, self.log_weights = belief.particles, belief.log_weights
        self.past = belief.fit
        self.newest = log_likelihood(belief.people, query, answer)
        self.log_evidence = belief.log_evidence

    def run(self) -> Belief:
        """Return the new belief."""
        step = 0.0
        while step < 1.0:
            change = (self.belief.retention - 1.0) * self.past + self.newest
            size = self._largest_step(change, 1.0 - step)
            step += size
            raised = self.log_weights + size * change
            total = float(logsumexp(raised))
            self.log_evidence += total
            self.log_weights = raised - total
            if step < 1.0 or np.exp(-logsumexp(2.0 * self.log_weights)) < LEAST_EFFECTIVE * len(raised):
                self._resample()
                self._move(step)
        return self._closed()

    def _largest_step(self, change: FloatArray, most: float) -> float:
        """Return the largest part of the change that leaves enough particles effective, found by bisection."""
        count = len(change)
        now = np.exp(-logsumexp(2.0 * self.log_weights))
        wanted = min(LEAST_EFFECTIVE * count, 0.9 * now)

        def effective(size: float) -> float:
            raised = self.log_weights + size * change
            return float(np.exp(2.0 * logsumexp(raised) - logsumexp(2.0 * raised)))

        if effective(most) >= wanted:
            return most
        low, high = 0.0, most
        for _ in range(30):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if effective(middle) >= wanted else (low, middle)
        return max(low, 1e-6 * most)

    def _resample(self) -> None:
        """Draw the particles anew, systematically, so that all weigh the same."""
        count = len(self.particles)
        kept = systematic(np.exp(self.log_weights), self.rng)
        self.particles, self.past, self.newest = self.particles[kept], self.past[kept], self.newest[kept]
        self.log_weights = np.full(count, -np.log(count))

    def _move(self, step: float) -> None:
        """Move the particles by Markov chains whose equilibrium is the posterior at this step.

        They walk in coordinates without bounds, by steps like the particles' own spread and differences.
        """
        belief, rng = self.belief, self.rng
        count, size = self.particles.shape
        bounds = belief.prior.space.bounds
        free, stretched = unbounded(self.particles, bounds)
        others = free.copy()
        spread = np.cov(others, rowvar=False).reshape(size, size) + 1e-9 * np.eye(size)
        factor: FloatArray = np.asarray(np.linalg.cholesky(spread), dtype=float)
        keep = 1.0 + step * (belief.retention - 1.0)
        density = belief.prior.log_density(self.particles) + stretched
        moved = 0.0
        for number in range(MOST_ROUNDS):
            change = self._differences(others, factor) if number % 2 else self._walk(factor)
            proposed, stretched = bounded(free + change, bounds)
            past = _past_fit(belief, proposed)
            newest = log_likelihood(belief.prior.space.people(proposed), self.query, self.answer)
            there = belief.prior.log_density(proposed) + stretched
            gain = there - density + keep * (past - self.past) + step * (newest - self.newest)
            accepted = np.log(rng.random(count)) < gain
            self.particles = np.where(accepted[:, None], proposed, self.particles)
            free = np.where(accepted[:, None], free + change, free)
            self.past = np.where(accepted, past, self.past)
            self.newest = np.where(accepted, newest, self.newest)
            density = np.where(accepted, there, density)
            moved += float(accepted.mean())
            if moved >= MOVES:
                break

    def _walk(self, factor: FloatArray) -> FloatArray:
        """Return random steps (n, p) shaped as the particles' spread, of several lengths."""
        count, size = self.particles.shape
        scale = STRETCH / np.sqrt(size) * self.rng.choice(SCALES, count)
        return np.asarray(scale[:, None] * (self.rng.standard_normal((count, size)) @ factor.T))

    def _differences(self, others: FloatArray, factor: FloatArray) -> FloatArray:
        """Return steps (n, p) along differences of two other particles (ter Braak 2006), some of them in full."""
        count, size = self.particles.shape
        first, second = others[self.rng.integers(count, size=(2, count))]
        part = STRETCH / np.sqrt(2.0 * size) * self.rng.random(count)
        stretch = np.where(self.rng.random(count) < JUMPS, 1.0, part)
        blur = 1e-3 * (self.rng.standard_normal((count, size)) @ factor.T)
        return np.asarray(stretch[:, None] * (first - second) + blur)

    def _closed(self) -> Belief:
        """Return the belief with the answer remembered; when there are too many, the belief itself replaces them."""
        belief = self.belief
        fit = belief.retention * self.past + self.newest
        history = (*belief.history, Observation(self.query, self.answer))
        result = replace(
            belief,
            particles=self.particles,
            log_weights=self.log_weights,
            fit=fit,
            log_evidence=self.log_evidence,
            history=history,
            observations=belief.observations + 1,
        )
        if len(history) <= MOST_REMEMBERED:
            return result
        floor = np.square(1e-4 * np.diff(belief.prior.space.bounds, axis=0)[0])
        posterior = Normal(result.mean, result.covariance + np.diag(floor))
        summary = Summary(posterior, result.log_evidence)
        return replace(result, history=(), summary=summary, fit=summary.fit(result.particles, belief.prior))


def systematic(weights: FloatArray, rng: np.random.Generator, count: int | None = None) -> IntArray:
    """Return places (count,) drawn in proportion to weights (n,), by one random number; default: n of them."""
    number = count or len(weights)
    levels = np.cumsum(weights)
    places = np.searchsorted(levels / levels[-1], (np.arange(number) + rng.random()) / number)
    return np.asarray(np.minimum(places, len(weights) - 1))


def unbounded(points: FloatArray, bounds: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return points (n, p) in coordinates without bounds, log(s / (1 - s)) of the share s of the bounds (2, p).

    Also the log (n,) of what a volume there is in the bounds, up to a constant.
    """
    share = np.clip((points - bounds[0]) / (bounds[1] - bounds[0]), EDGE, 1.0 - EDGE)
    return np.log(share) - np.log1p(-share), (np.log(share) + np.log1p(-share)).sum(axis=1)


def bounded(free: FloatArray, bounds: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return points (n, p) from coordinates without bounds, and the log (n,) as ``unbounded`` does."""
    share = np.clip(expit(free), EDGE, 1.0 - EDGE)
    return bounds[0] + share * (bounds[1] - bounds[0]), (np.log(share) + np.log1p(-share)).sum(axis=1)
