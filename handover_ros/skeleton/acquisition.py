"""Finds a posture in one marker frame, without the frames before: at the start, and after markers were lost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from handover_ros.geometry import FloatArray
from handover_ros.skeleton.gauge import within_a_turn
from handover_ros.skeleton.initial import groups_of
from handover_ros.skeleton.kernels import ancestors, forward
from handover_ros.skeleton.postures import frame_equations, solve_frame
from handover_ros.skeleton.rigid_fit import MIN_SPREAD, kabsch
from handover_ros.skeleton.tree import JointKind, Skeleton

ITERATIONS = 40
LOOSE_SCALE = 0.10  # [m] robust scale of the first search
TIGHT_SCALE = 0.015  # [m] of the second
GOOD_SHARE = 0.7  # of the measured markers must lie near the posture
NEAR = 10.0  # times the marker noise
BEYOND = 1e-4  # [m^2/rad^2] what a displacement beyond its limit costs
PRIOR = 1.0  # [rad] or [m] standard deviation of a tangent that no marker sees


@dataclass(frozen=True, eq=False)
class Acquisition:
    """A posture found.

    Attributes:
        coordinates: Shape (nq,).
        covariance: Of its tangent, shape (nv, nv).
        markers_used: Markers near it.
    """

    coordinates: FloatArray
    covariance: FloatArray
    markers_used: int


def acquire(
    skeleton: Skeleton, observed: FloatArray, last: FloatArray, noise: float, home: FloatArray
) -> Acquisition | None:
    """Return the posture that explains a frame, or None when its markers do not fix one.

    Tried are the last known posture, the middle of the limits and the zero posture, each with the root where its own
    markers are.

    Args:
        skeleton: The skeleton.
        observed: Markers [m], shape (m, 3), NaN = not measured, in the skeleton's order.
        last: Coordinates of the last known posture, shape (nq,).
        noise: Standard deviation of a marker coordinate [m].
        home: Displacements (n,) in the middle of what is possible.
    """
    tree = skeleton.tree
    seen = np.isfinite(observed[:, 0])
    if not enough_markers(skeleton, seen):
        return None
    root = root_pose(skeleton, observed, seen)
    if root is None:
        return None
    chains, observed = ancestors(tree), np.ascontiguousarray(observed)
    starts = [np.array(last), skeleton.coordinates(home, root), skeleton.coordinates(np.zeros(len(home)), root)]
    if skeleton.is_free:
        starts[0][:3], starts[0][3:7] = root[:3, 3], Rotation.from_matrix(root[:3, :3]).as_quat()
    best, least = starts[0], np.inf
    for start in starts:
        solve_frame(tree, chains, start, observed, 1.0 / LOOSE_SCALE**2, ITERATIONS)
        loss = solve_frame(tree, chains, start, observed, 1.0 / TIGHT_SCALE**2, ITERATIONS)
        start = within_a_turn(tree, start[None])[0]
        beyond = np.maximum(skeleton.displacements(start) - skeleton.upper, 0.0)
        beyond += np.maximum(skeleton.lower - skeleton.displacements(start), 0.0)
        # Of two postures that the markers explain alike, the one within the person's limits is meant.
        score = loss + BEYOND * float(beyond @ beyond)
        if score < least:
            best, least = start, score
    distances = np.linalg.norm(forward(tree, best) - observed, axis=1)
    near = distances[seen] < NEAR * noise
    if near.sum() < GOOD_SHARE * seen.sum():
        return None
    _, nv = skeleton.size
    information, gradient = np.zeros((nv, nv)), np.zeros(nv)
    frame_equations(tree, chains, best, observed, 1.0 / TIGHT_SCALE**2, information, gradient)
    full = information + np.tril(information, -1).T
    covariance = np.linalg.inv(full / noise**2 + np.eye(nv) / PRIOR**2)
    return Acquisition(best, covariance, int(near.sum()))


def enough_markers(skeleton: Skeleton, seen: np.ndarray) -> bool:
    """Return whether a free root shows three markers and every group of joints at least one."""
    tree = skeleton.tree
    if skeleton.is_free and np.count_nonzero(seen & (tree.marker_joint == 0)) < 3:
        return False
    return all(seen[group.markers].any() for group in groups_of(tree))


def root_pose(skeleton: Skeleton, observed: FloatArray, seen: np.ndarray) -> FloatArray | None:
    """Return the root's pose (4, 4) from its own markers; the identity for a fixed root; None: they lie on a line."""
    pose = np.eye(4)
    if not skeleton.is_free or skeleton.joints[0].kind is not JointKind.FREE:
        return pose
    own = seen & (skeleton.tree.marker_joint == 0)
    rotation, translation, spread = kabsch(skeleton.markers[own], observed[own], np.ones(int(own.sum())))
    if spread < MIN_SPREAD:
        return None
    pose[:3, :3], pose[:3, 3] = rotation, translation
    return pose
