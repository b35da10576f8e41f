"""Soft wishes about a skeleton's shape, heard where the markers leave it open.

Markers sit on skin, and skin moves over the bones with the posture. Two axes that are nearly parallel, turned far and
against each other, imitate any third one and follow that motion better than true axes do: the fit becomes closer and
the angles worthless. Bestick 2017, section 2.5, names the remedy, a regularisation of the angle between the axes. A
template says which axes it wants at right angles, and which axis runs towards another joint; against white noise the
markers keep the last word.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.skeleton.layout import Layout
from handover_ros.skeleton.rigid_motion import rigid_motion
from handover_ros.skeleton.tree import FlatTree, IntArray


@dataclass(frozen=True)
class Wishes:
    """Wishes about the axes of joints, by index; strength times their squared violation is added to the loss.

    Attributes:
        right_angles: Pairs of joints in series whose axes should be at right angles: violation a . b.
        towards: Pairs (joint, other): the joint's axis should run through the other's point: violation the distance of
            the other's point from the axis over the distance of the two points.
        strength: [m^2].
    """

    right_angles: tuple[tuple[int, int], ...] = ()
    towards: tuple[tuple[int, int], ...] = ()
    strength: float = 0.0

    def loss(self, tree: FlatTree) -> float:
        """Return what the wishes add to the loss [m^2]."""
        total = sum(float(tree.axis[i] @ tree.axis[j]) ** 2 for i, j in self.right_angles)
        for i, j in self.towards:
            offset = tree.point[j] - tree.point[i]
            along = float(tree.axis[i] @ offset)
            total += 1.0 - along**2 / max(float(offset @ offset), 1e-12)
        return self.strength * total

    def add_to(
        self, tree: FlatTree, layout: Layout, matrix: FloatArray, vector: FloatArray, diagonal: FloatArray
    ) -> None:
        """Add the wishes' part of the normal equations (Gauss-Newton), in place."""
        for i, j in self.right_angles:
            row = np.zeros(layout.count)
            for own, other in ((i, j), (j, i)):
                if (column := layout.axis_column[own]) >= 0:
                    row[column : column + 2] += layout.axis_basis[own].T @ tree.axis[other]
            self._add(row, float(tree.axis[i] @ tree.axis[j]), matrix, vector, diagonal)
        for i, j in self.towards:
            offset = tree.point[j] - tree.point[i]
            length = max(float(np.linalg.norm(offset)), 1e-6)
            for k in range(2):
                across = layout.axis_basis[i, :, k] / length
                row = np.zeros(layout.count)
                if (column := layout.axis_column[i]) >= 0:
                    row[column + k] -= float(tree.axis[i] @ offset) / length
                for own, sign in ((j, 1.0), (i, -1.0)):
                    if (column := layout.point_column[own]) >= 0:
                        size = layout.point_size[own]
                        row[column : column + size] += sign * (layout.point_basis[own, :, :size].T @ across)
                self._add(row, float(across @ offset), matrix, vector, diagonal)

    def _add(
        self, row: FloatArray, violation: float, matrix: FloatArray, vector: FloatArray, diagonal: FloatArray
    ) -> None:
        matrix += self.strength * np.outer(row, row)
        diagonal += self.strength * row**2
        vector += self.strength * violation * row

    def within(self, joints: tuple[int, ...], shift: int, strength: float) -> Wishes:
        """Return the wishes that concern some joints only, in their numbering plus ``shift``, with a strength."""

        def kept(pairs: tuple[tuple[int, int], ...]) -> tuple[tuple[int, int], ...]:
            return tuple(
                (joints.index(i) + shift, joints.index(j) + shift) for i, j in pairs if i in joints and j in joints
            )

        return Wishes(kept(self.right_angles), kept(self.towards), strength)


NO_WISHES = Wishes()
SKIN_OVER_BONE = 30.0  # times farther than over itself; 20 to 40 give elbows within a degree on real reaching trials
PAIRS = 400  # neighbouring frames that are compared
CHANCE = 0.05  # correlation that white noise may show by chance


def wish_strength(observed: FloatArray, marker_joint: IntArray) -> float:
    """Return the strength [m^2] for each marker sample that wishes deserve against the markers' own say.

    Noise of the device differs from frame to frame and averages out; skin does not, its motion follows the posture. How
    much of what remains of the markers after each segment's best rigid motion is alike in neighbouring frames tells the
    two apart: that share of its variance, times a factor since skin moves farther over the bone than over itself.

    Args:
        observed: Markers of frames that follow each other [m], shape (frames, m, 3), NaN = not measured.
        marker_joint: The joint that carries each marker, shape (m,).
    """
    first = np.linspace(0, max(len(observed) - 2, 0), min(PAIRS, max(len(observed) - 1, 1))).astype(int)
    pairs = np.ravel(np.column_stack([first, np.minimum(first + 1, len(observed) - 1)]))
    products = squares = 0.0
    count = 0
    for joint in np.unique(marker_joint):
        own = observed[pairs][:, marker_joint == joint]
        if joint < 0 or own.shape[1] < 3:
            continue
        residual = rigid_residuals(own)
        now, then = residual[::2], residual[1::2]
        together = np.isfinite(now[:, :, 0]) & np.isfinite(then[:, :, 0])
        products += float(np.sum((now * then)[together]))
        squares += float(np.sum(0.5 * (now**2 + then**2)[together]))
        count += 3 * int(together.sum())
    if squares <= 0.0 or count == 0:
        return 0.0
    share = max(products / squares - CHANCE, 0.0)
    return 3.0 * share * SKIN_OVER_BONE**2 * squares / count


def rigid_residuals(observed: FloatArray) -> FloatArray:
    """Return what remains of a segment's markers (frames, k, 3) [m] after its best rigid motion, NaN where unknown."""
    poses, shape = rigid_motion(observed, int(np.argmax(np.isfinite(observed[:, :, 0]).sum(axis=1))))
    residual = observed - (np.einsum("fab,kb->fka", poses[:, :3, :3], shape) + poses[:, None, :3, 3])
    residual[np.isfinite(observed[:, :, 0]).sum(axis=1) < 3] = np.nan
    return residual
