"""A first guess of a skeleton from marker frames, with no prior lengths, axes or angles: from the root outwards.

The root's pose follows from its own markers. Then, for each segment that carries markers, the joints between it and the
nearest segment already placed are fitted alone (``group_fit``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from handover_ros.geometry import FloatArray
from handover_ros.skeleton.group_fit import NOISE_FLOOR, Group, GroupFit, Pair, fit_group, free_motion_sigma
from handover_ros.skeleton.kernels import segment_poses
from handover_ros.skeleton.rigid_motion import rigid_motion
from handover_ros.skeleton.tree import COORDINATES, FlatTree, JointKind
from handover_ros.skeleton.wishes import NO_WISHES, Wishes


@dataclass(frozen=True, eq=False)
class InitialGuess:
    """Where minimisation starts.

    Attributes:
        tree: Axes, points and markers.
        coordinates: Posture of each frame, shape (frames, nq).
        seeds: Number of starting axes tried, by the last joint of each group.
        rivals: Other fits of a group that explain its markers almost as well.
    """

    tree: FlatTree
    coordinates: FloatArray
    seeds: dict[int, int]
    rivals: tuple[tuple[Group, GroupFit], ...]


def groups_of(tree: FlatTree) -> list[Group]:
    """Return the groups of a tree in the order in which they can be fitted; a free root is none of them."""
    placed = {-1} | {j for j, kind in enumerate(tree.kind) if kind == JointKind.FREE}
    groups = []
    for j in range(len(tree.kind)):
        markers = np.flatnonzero(tree.marker_joint == j)
        if j in placed or not len(markers):
            continue
        chain, at = [], j
        while at not in placed:
            chain.append(at)
            at = int(tree.parent[at])
        groups.append(Group(tuple(reversed(chain)), at, markers))
        placed |= set(chain)
    return groups


def first_guess(
    tree: FlatTree,
    observed: FloatArray,
    reference: int,
    meets: dict[int, int],
    world_from_zero: FloatArray | None = None,
    hints: FloatArray | None = None,
    wishes: Wishes = NO_WISHES,
    seed: int = 0,
) -> InitialGuess:
    """Return a first guess; the posture of frame ``reference`` becomes the zero posture.

    Args:
        tree: The tree; its axes, points and markers are not used, except the axes of ball joints.
        observed: Markers [m], shape (frames, m, 3), NaN = not measured.
        reference: The frame whose posture is zero.
        meets: Joint whose axis goes through the point of another, by index.
        world_from_zero: The zero frame in the world at frame ``reference`` (4, 4); None: the world's axes at the middle
            of the root's markers.
        hints: Directions (joints, 3) that make a rival where the markers leave two fits open; zero: none.
        wishes: About the shape; their strength is that for each marker sample.
        seed: Of the starting axes.
    """
    rng = np.random.default_rng(seed)
    joints, frames = len(tree.kind), len(observed)
    axis, point, marker = tree.axis.copy(), np.zeros((joints, 3)), np.zeros((len(tree.marker_joint), 3))
    coordinates = np.zeros((frames, int(sum(COORDINATES[JointKind(kind)] for kind in tree.kind))))
    poses = np.tile(np.eye(4), (joints + 1, frames, 1, 1))
    if joints and tree.kind[0] == JointKind.FREE:
        own = np.flatnonzero(tree.marker_joint == 0)
        poses[1], marker[own] = rigid_motion(observed[:, own], reference, world_from_zero)
        coordinates[:, :3] = poses[1, :, :3, 3]
        coordinates[:, 3:7] = Rotation.from_matrix(poses[1, :, :3, :3]).as_quat()
    world = np.flatnonzero(tree.marker_joint == -1)
    if len(world):
        marker[world] = np.nan_to_num(np.nanmedian(observed[:, world], axis=0))
    noise = NOISE_FLOOR
    if joints and tree.kind[0] == JointKind.FREE:
        noise = max(noise, free_motion_sigma(observed[:, own], marker[own]))
    tried, rivals = {}, []
    for group in groups_of(tree):
        base_markers = np.flatnonzero((tree.marker_joint == group.base) & (group.base >= 0))
        base = poses[group.base + 1]
        pair = Pair(marker[base_markers], observed[:, base_markers], base, observed[:, group.markers], noise)
        own_hints = None if hints is None else hints[list(group.joints)]
        fits, tried[group.joints[-1]] = fit_group(tree, group, pair, reference, meets, rng, own_hints, wishes)
        rivals += [(group, fit) for fit in fits[1:]]
        place_group(tree, group, fits[0], axis, point, marker, coordinates)
        motion = segment_poses(fits[0].tree, fits[0].coordinates)
        for index, j in enumerate(group.joints):
            poses[j + 1] = base @ motion[:, index]
    for j, kind in enumerate(tree.kind):
        # Joints beyond the last marker stay at zero.
        if kind == JointKind.BALL and not coordinates[:, tree.coordinate[j] : tree.coordinate[j] + 4].any():
            coordinates[:, tree.coordinate[j] + 3] = 1.0
    return InitialGuess(tree._replace(axis=axis, point=point, marker=marker), coordinates, tried, tuple(rivals))


def place_group(
    tree: FlatTree,
    group: Group,
    fit: GroupFit,
    axis: FloatArray,
    point: FloatArray,
    marker: FloatArray,
    coordinates: FloatArray,
) -> None:
    """Write a group's fit into the arrays of the whole tree, in place."""
    for index, j in enumerate(group.joints):
        axis[j], point[j] = fit.tree.axis[index], fit.tree.point[index]
        size = COORDINATES[JointKind(tree.kind[j])]
        start, own = tree.coordinate[j], fit.tree.coordinate[index]
        coordinates[:, start : start + size] = fit.coordinates[:, own : own + size]
    marker[group.markers] = fit.tree.marker
