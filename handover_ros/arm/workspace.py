"""The feasible workspace of a hand: everywhere its grip can be with all displacements within the person's limits.

Bestick 2017, figure 2.7. Found by sampling: a low-discrepancy sequence over the displacements between root and hand,
then, round by round, neighbours of the postures that reached the rim of what is known, until the volume stays.
The frame is the root's (the torso); limits of the joints are all that is regarded, not the body in the way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.ndimage import binary_closing, binary_erosion, binary_fill_holes
from scipy.stats import qmc

from handover_ros.arm.hand import hand_frames
from handover_ros.errors import BadModelError, BadRequestError, UnknownNameError
from handover_ros.geometry import FloatArray
from handover_ros.skeleton.jacobian import Frame
from handover_ros.skeleton.kernels import segment_poses
from handover_ros.skeleton.tree import IntArray, Skeleton

BoolArray = npt.NDArray[np.bool_]

VOXEL = 0.03  # [m]
SAMPLES_LOG2 = 16
MOST_ROUNDS, NEIGHBOURS = 40, 16
NEIGHBOUR_RANGE = 0.12  # of a displacement's range, around a posture at the rim
GROWTH_TO_STOP = 2e-3
CHUNK = 1 << 15
MARGIN = 2  # voxels of air around what is reached
SMALLEST_VOXEL, LARGEST_VOXEL = 0.005, 0.3  # [m]


@dataclass(frozen=True, eq=False)
class Workspace:
    """A volume of voxels; grids of one voxel size have their walls at its multiples, so that they can be compared.

    Attributes:
        voxel: Edge of a voxel [m].
        corner: Index of the first voxel: it spans corner * voxel to (corner + 1) * voxel, shape (3,).
        filled: Which voxels are reached, shape (nx, ny, nz); the outermost layers are not.
    """

    voxel: float
    corner: IntArray
    filled: BoolArray

    @cached_property
    def volume(self) -> float:
        """Volume [m3]. A voxel that the surface crosses is on average half inside, so it counts half.

        Those are the voxels with an empty one among their 26 neighbours, for walls along the grid and across it.
        """
        inner = binary_erosion(self.filled, np.ones((3, 3, 3)))
        return float(0.5 * (self.filled.sum() + inner.sum()) * self.voxel**3)

    @property
    def litres(self) -> float:
        """Volume [litres]."""
        return 1e3 * self.volume

    def contains(self, points: npt.ArrayLike) -> BoolArray:
        """Return whether points (..., 3) [m], root frame, lie in the volume, shape (...)."""
        values = np.asarray(points, dtype=float)
        index = np.floor(values / self.voxel).astype(np.int64) - self.corner
        inside = ((index >= 0) & (index < self.filled.shape)).all(axis=-1)
        i, j, k = np.moveaxis(np.where(np.expand_dims(inside, -1), index, 0), -1, 0)
        return np.asarray(inside & self.filled[i, j, k])

    @property
    def centres(self) -> FloatArray:
        """Middles (k, 3) [m] of the voxels that are reached."""
        return np.asarray((np.argwhere(self.filled) + self.corner + 0.5) * self.voxel, dtype=float)

    def overlap(self, other: Workspace) -> Workspace:
        """Return what both reach.

        Raises:
            BadRequestError: The voxels are of different sizes.
        """
        mine, theirs, corner = _same_grid(self, other)
        return Workspace(self.voxel, corner, mine & theirs)

    def difference(self, other: Workspace) -> Workspace:
        """Return what this one reaches and the other does not.

        Raises:
            BadRequestError: The voxels are of different sizes.
        """
        mine, theirs, corner = _same_grid(self, other)
        return Workspace(self.voxel, corner, mine & ~theirs)

    def union(self, other: Workspace) -> Workspace:
        """Return what one of them reaches.

        Raises:
            BadRequestError: The voxels are of different sizes.
        """
        mine, theirs, corner = _same_grid(self, other)
        return Workspace(self.voxel, corner, mine | theirs)


def hand_workspace(skeleton: Skeleton, side: str, voxel: float = VOXEL, seed: int = 0) -> Workspace:
    """Return the workspace of the grip of one hand, in the root frame.

    Args:
        skeleton: With limits of all displacements between root and hand.
        side: ``left`` or ``right``.
        voxel: Edge of a voxel [m].
        seed: Of the sampling sequence; the same seed gives the same volume.

    Raises:
        UnknownNameError: The skeleton has no hand on that side.
        BadModelError: A limit is unknown, or the skeleton's hand cannot be derived.
        BadRequestError: The voxel is too small or too large.
    """
    hands = hand_frames(skeleton)
    if side not in hands:
        raise UnknownNameError("hand", side, list(hands))
    return frame_workspace(skeleton, hands[side].frame, voxel, seed)


def frame_workspace(skeleton: Skeleton, frame: Frame, voxel: float = VOXEL, seed: int = 0) -> Workspace:
    """Return the workspace of the origin of a frame, like ``hand_workspace``."""
    if not SMALLEST_VOXEL <= voxel <= LARGEST_VOXEL:
        raise BadRequestError(f"voxel {voxel:g} m: must lie between {SMALLEST_VOXEL:g} and {LARGEST_VOXEL:g} m")
    arm = _chain_of(skeleton, frame.segment)
    lower, upper = arm.lower, arm.upper
    if not len(lower):
        raise BadModelError(f"skeleton {skeleton.name!r}: segment {frame.segment!r} does not move against the root")
    if not (known := np.isfinite(lower) & np.isfinite(upper)).all():
        unknown = [name for name, is_known in zip(arm.displacement_names, known) if not is_known]
        raise BadModelError(
            f"skeleton {skeleton.name!r}: the limits of {', '.join(unknown)} are unknown, so there is no workspace; "
            "calibrate with motions that move these joints"
        )

    def reached(postures: FloatArray) -> IntArray:
        """Return the voxel (k, 3) that each posture (k, n) reaches."""
        return np.floor(_origins(arm, frame, postures) / voxel).astype(np.int64)

    sampler = qmc.Sobol(len(lower), seed=seed)
    postures = qmc.scale(sampler.random_base2(SAMPLES_LOG2), lower, upper + 1e-12)
    voxels, first = _unique(reached(postures))
    postures = postures[first]
    spread = NEIGHBOUR_RANGE * (upper - lower)
    generator = np.random.default_rng(seed)
    for _ in range(MOST_ROUNDS):
        near = postures[_at_rim(voxels)]
        offsets = generator.uniform(-1.0, 1.0, (len(near), NEIGHBOURS, len(lower)))
        tried = np.clip(near[:, None] + spread * offsets, lower, upper).reshape(-1, len(lower))
        everything = np.concatenate([voxels, reached(tried)])
        before = len(voxels)
        voxels, first = _unique(everything)
        postures = np.concatenate([postures, tried])[first]
        if len(voxels) - before <= GROWTH_TO_STOP * before:
            break
    corner = voxels.min(axis=0) - MARGIN
    filled = np.zeros(voxels.max(axis=0) - corner + 1 + MARGIN, dtype=bool)
    filled[tuple((voxels - corner).T)] = True
    # Pores that sampling left: enclosed, and no larger than a voxel or two; a real cavity is larger and stays.
    pores = binary_fill_holes(filled) & binary_closing(filled)
    return Workspace(voxel, corner, filled | pores)


def _unique(voxels: IntArray) -> tuple[IntArray, IntArray]:
    """Return the different rows of voxels (k, 3), and where each comes first."""
    corner = voxels.min(axis=0)
    extent = voxels.max(axis=0) - corner + 1
    keys = np.ravel_multi_index(tuple((voxels - corner).T), tuple(extent))
    _, first = np.unique(keys, return_index=True)
    return voxels[first], first


def _chain_of(skeleton: Skeleton, segment: str) -> Skeleton:
    """Return the joints between the root and a segment as a skeleton of their own, without markers."""
    chain = skeleton.chain(segment)
    rows = np.isin(skeleton.displacement_joints, chain)
    return replace(
        skeleton,
        joints=tuple(skeleton.joints[joint] for joint in chain),
        marker_names=(),
        marker_segments=(),
        markers=np.zeros((0, 3)),
        lower=skeleton.lower[rows],
        upper=skeleton.upper[rows],
        hands=(),
    )


def _origins(arm: Skeleton, frame: Frame, postures: FloatArray) -> FloatArray:
    """Return the origin (k, 3) [m] of a frame on the arm's last segment at displacements (k, n)."""
    origin = frame.zero_from_frame[:3, 3]
    result = np.empty((len(postures), 3))
    for start in range(0, len(postures), CHUNK):
        part = slice(start, start + CHUNK)
        poses = segment_poses(arm.tree, arm.coordinates(postures[part]))[:, -1]
        result[part] = poses[:, :3, :3] @ origin + poses[:, :3, 3]
    return result


def _at_rim(voxels: IntArray) -> BoolArray:
    """Return which of some voxels (k, 3) have one of their six neighbours missing."""
    corner = voxels.min(axis=0) - 1
    filled = np.zeros(voxels.max(axis=0) - corner + 2, dtype=bool)
    index = tuple((voxels - corner).T)
    filled[index] = True
    return np.asarray(~binary_erosion(filled)[index])


def _same_grid(one: Workspace, other: Workspace) -> tuple[BoolArray, BoolArray, IntArray]:
    """Return both volumes on one grid, and its corner."""
    if one.voxel != other.voxel:
        raise BadRequestError(
            f"workspaces with voxels of {one.voxel:g} m and {other.voxel:g} m cannot be compared; use one size"
        )
    corner = np.minimum(one.corner, other.corner)
    end = np.maximum(one.corner + one.filled.shape, other.corner + other.filled.shape)
    grids = []
    for each in (one, other):
        grid = np.zeros(end - corner, dtype=bool)
        start = each.corner - corner
        grid[tuple(slice(s, s + n) for s, n in zip(start, each.filled.shape))] = each.filled
        grids.append(grid)
    return grids[0], grids[1], corner
