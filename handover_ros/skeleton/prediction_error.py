"""Prediction error minimisation (eq. 2.6) by Levenberg-Marquardt on the reduced normal equations."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise

import numpy as np
import scipy.linalg
from threadpoolctl import ThreadpoolController

from handover_ros.geometry import FloatArray
from handover_ros.skeleton.kernels import ancestors, forward
from handover_ros.skeleton.layout import Layout, moved, tangent_basis
from handover_ros.skeleton.normal_equations import eliminate_frames, substitute_frames
from handover_ros.skeleton.postures import frame_losses, settle_frames
from handover_ros.skeleton.tree import FlatTree
from handover_ros.skeleton.wishes import NO_WISHES, Wishes

CHUNKS = 8  # fixed, so that sums do not depend on the number of cores
FEW_FRAMES = 64  # not worth a second thread
LARGEST_DAMPING = 1e12
STALL_GAIN = 1e-3  # a step that gains less than this share of what it promised says that the model is bad here


@cache
def blas_controller() -> ThreadpoolController:
    """Return what limits the threads of the linear algebra libraries that are loaded."""
    return ThreadpoolController()


@dataclass(frozen=True)
class FitSettings:
    """How the error is minimised.

    Attributes:
        robust_scale: Distance [m] at which a marker begins to count less (Cauchy loss); inf: plain squares.
        tolerance: Relative decrease of the loss below which it has converged.
        iterations: Largest number of iterations.
        damping: First damping, relative to the diagonal of the normal matrix.
    """

    robust_scale: float = np.inf
    tolerance: float = 1e-7
    iterations: int = 60
    damping: float = 1e-3


@dataclass(frozen=True, eq=False)
class Fit:
    """A minimum of the prediction error.

    Attributes:
        tree: Axes, points and markers.
        coordinates: Posture of each frame, shape (frames, nq).
        loss: Sum of the losses of all measured markers [m^2].
        iterations: Iterations made.
        converged: Whether it ended because nothing more was to be gained.
        losses: The loss after each iteration.
    """

    tree: FlatTree
    coordinates: FloatArray
    loss: float
    iterations: int
    converged: bool
    losses: tuple[float, ...] = field(default=())

    def residuals(self, observed: FloatArray) -> FloatArray:
        """Return the distances (frames, m) [m] between model and measurement, NaN where not measured."""
        return np.linalg.norm(forward(self.tree, self.coordinates) - observed, axis=2)


class NormalEquations:
    """The reduced normal equations of a set of frames, built chunk by chunk on all cores.

    Args:
        tangents: Length of a tangent vector, nv.
        observed: Markers [m], shape (frames, m, 3), NaN = not measured.
        layout: The parameters.
        frozen: Frame whose posture is held, -1: none.
        robust_scale: Cauchy scale [m].
    """

    def __init__(self, tangents: int, observed: FloatArray, layout: Layout, frozen: int, robust_scale: float) -> None:
        self.observed = np.ascontiguousarray(observed)
        frames = len(observed)
        self.inverse_scale = 0.0 if np.isinf(robust_scale) else 1.0 / robust_scale**2
        self.frozen = frozen
        self._factors = np.empty((frames, tangents, tangents))
        self._borders = np.empty((frames, tangents, layout.count))
        self._rights = np.empty((frames, tangents))
        chunks = CHUNKS if frames >= FEW_FRAMES else 1
        bounds = np.linspace(0, frames, chunks + 1).astype(int)
        self._slices = [slice(a, b) for a, b in pairwise(bounds)]
        self._pool = ThreadPoolExecutor(min(chunks, os.cpu_count() or 1)) if chunks > 1 else None

    def close(self) -> None:
        """End the threads."""
        if self._pool:
            self._pool.shutdown()

    def losses(self, tree: FlatTree, coordinates: FloatArray) -> FloatArray:
        """Return the loss of each frame [m^2], shape (frames,)."""
        result = np.empty(len(coordinates))
        self._map(
            lambda part: frame_losses(tree, coordinates[part], self.observed[part], self.inverse_scale, result[part]),
            self._slices,
        )
        return result

    def build(
        self, tree: FlatTree, layout: Layout, coordinates: FloatArray, damping: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return (reduced matrix without damping of C, right-hand side, diagonal of C) of the parameters' equations."""
        chains = ancestors(tree)
        count = layout.count

        def work(part: slice) -> tuple[FloatArray, FloatArray, FloatArray]:
            c_block, c_vector = np.zeros((count, count)), np.zeros(count)
            frozen = self.frozen - part.start if part.start <= self.frozen < part.stop else -1
            factors, borders, rights = self._factors[part], self._borders[part], self._rights[part]
            eliminate_frames(
                tree,
                chains,
                layout,
                coordinates[part],
                self.observed[part],
                self.inverse_scale,
                damping,
                frozen,
                c_block,
                c_vector,
                factors,
                borders,
                rights,
            )
            border = borders.reshape(borders.shape[0] * borders.shape[1], count)
            diagonal = c_block.diagonal().copy()
            matrix = c_block + np.triu(c_block, 1).T - border.T @ border
            return matrix, c_vector - border.T @ rights.ravel(), diagonal

        parts = self._map(work, self._slices)
        matrix, vector, diagonal = (np.sum([part[index] for part in parts], axis=0) for index in range(3))
        return matrix, vector, diagonal

    def substitute(
        self, tree: FlatTree, trial_tree: FlatTree, coordinates: FloatArray, step: FloatArray, losses: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the coordinates and the losses of the frames after a step (count,) of the parameters."""
        chains = ancestors(tree)
        result, trial_losses = np.empty_like(coordinates), np.empty(len(coordinates))

        def work(part: slice) -> None:
            frozen = self.frozen - part.start if part.start <= self.frozen < part.stop else -1
            before, after = coordinates[part], result[part]
            substitute_frames(tree, before, self._factors[part], self._borders[part], self._rights[part], step, after)
            settle_frames(
                trial_tree,
                chains,
                after,
                before,
                self.observed[part],
                self.inverse_scale,
                losses[part],
                frozen,
                trial_losses[part],
            )

        self._map(work, self._slices)
        return result, trial_losses

    def promised(self, vector: FloatArray, step: FloatArray) -> float:
        """Return the decrease of the squared error that the linear model of the last ``build`` promises."""
        return float(np.sum(self._rights**2) - vector @ step)

    def _map(self, function, parts):  # type: ignore[no-untyped-def]
        return list(self._pool.map(function, parts)) if self._pool else [function(part) for part in parts]


def minimise(
    tree: FlatTree,
    layout: Layout,
    coordinates: FloatArray,
    observed: FloatArray,
    settings: FitSettings | None = None,
    frozen: int = -1,
    wishes: Wishes = NO_WISHES,
) -> Fit:
    """Return the nearest minimum of the prediction error over parameters and postures.

    Args:
        tree: First guess of axes, points and markers.
        layout: Which of them are estimated.
        coordinates: First guess of the postures, shape (frames, nq).
        observed: Markers [m], shape (frames, m, 3), NaN = not measured.
        settings: How.
        frozen: Frame whose posture is held: it fixes the gauge when axes *and* markers are estimated; -1: none.
        wishes: About the shape, as far as the markers leave it open.
    """
    settings = settings or FitSettings()
    tangents = int(sum(1 if kind < 2 else 3 if kind == 2 else 6 for kind in tree.kind))
    equations = NormalEquations(tangents, observed, layout, frozen, settings.robust_scale)
    try:
        # The frames are shared out among our own threads; those of the linear algebra would only get in their way.
        with blas_controller().limit(limits=1, user_api="blas"):
            return _descend(equations, tree, layout, np.array(coordinates, dtype=float), settings, wishes)
    finally:
        equations.close()


def _descend(
    equations: NormalEquations,
    tree: FlatTree,
    layout: Layout,
    coordinates: FloatArray,
    settings: FitSettings,
    wishes: Wishes,
) -> Fit:
    """Levenberg-Marquardt with Nielsen's rule for the damping (Madsen, Nielsen, Tingleff 2004, algorithm 3.16)."""
    frame_loss = equations.losses(tree, coordinates)
    loss = float(frame_loss.sum()) + wishes.loss(tree)
    losses, damping, growth, small_steps = [loss], settings.damping, 2.0, 0
    for iteration in range(1, settings.iterations + 1):
        matrix, vector, diagonal = equations.build(tree, layout, coordinates, damping)
        wishes.add_to(tree, layout, matrix, vector, diagonal)
        matrix[np.diag_indices_from(matrix)] += damping * diagonal + 1e-12 * (diagonal.max(initial=0.0) + 1e-12)
        try:
            step = -scipy.linalg.solve(matrix, vector, assume_a="pos", check_finite=False) if layout.count else vector
        except np.linalg.LinAlgError:
            damping, growth = damping * growth, 2.0 * growth
            continue
        trial_tree = moved(tree, layout, step)
        trial, trial_losses = equations.substitute(tree, trial_tree, coordinates, step, frame_loss)
        trial_loss = float(trial_losses.sum()) + wishes.loss(trial_tree)
        promised = max(equations.promised(vector, step), 1e-30)
        gain = (loss - trial_loss) / promised
        if np.isfinite(trial_loss) and trial_loss <= loss:
            decrease = (loss - trial_loss) / max(loss, 1e-30)
            tree, coordinates, loss, frame_loss = trial_tree, trial, trial_loss, trial_losses
            layout = renewed(layout, tree)
            losses.append(loss)
            damping = max(damping * max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3), 1e-12)
            growth = 2.0
            small_steps = small_steps + 1 if decrease < settings.tolerance else 0
            if small_steps >= 2 or promised < settings.tolerance * loss or loss < 1e-22:
                return Fit(tree, coordinates, loss, iteration, True, tuple(losses))
        else:
            damping, growth = damping * growth, 2.0 * growth
            if damping > LARGEST_DAMPING or promised < settings.tolerance * loss:
                return Fit(tree, coordinates, loss, iteration, True, tuple(losses))
    return Fit(tree, coordinates, loss, settings.iterations, False, tuple(losses))


def renewed(layout: Layout, tree: FlatTree) -> Layout:
    """Return the layout with the tilt directions of the tree's present axes."""
    basis = tangent_basis(tree.axis)
    point_basis = layout.point_basis.copy()
    two = layout.point_size == 2
    point_basis[two, :, :2] = basis[two]
    return layout._replace(axis_basis=basis, point_basis=point_basis)
