"""Fitting problems with a known answer: random trees with noisy markers."""

from dataclasses import dataclass

import numpy as np
from random_trees import random_pose, random_skeleton
from scipy.spatial.transform import Rotation

from handover_ros.skeleton.kernels import ancestors, forward, joint_poses
from handover_ros.skeleton.layout import moved, parameter_layout
from handover_ros.skeleton.normal_equations import parameter_twists, tangent_twists
from handover_ros.skeleton.tree import WORLD, Joint, JointKind, Skeleton


@dataclass(frozen=True)
class Problem:
    """A tree and layout, postures (frames, nq), measured markers (frames, m, 3), and the tree that made them."""

    skeleton: Skeleton
    layout: object
    coordinates: np.ndarray
    measured: np.ndarray
    truth: object
    true_coordinates: np.ndarray

    @property
    def tree(self):
        return self.skeleton.tree


def mixed_problem(seed, frames=4, free=True, missing=0.2, noise=0.05):
    """Return a random tree of all kinds of joints, some sharing a point, markers on every segment and on the world."""
    rng = np.random.default_rng(seed)
    skeleton = random_skeleton(seed, joints=6, free=free)
    places = [*(joint.segment for joint in skeleton.joints for _ in range(2)), WORLD]
    turning = [i for i, joint in enumerate(skeleton.joints) if joint.kind in (JointKind.REVOLUTE, JointKind.BALL)]
    meets = {}
    for index in turning[1:]:
        if rng.random() < 0.5:
            earlier = [i for i in turning if i < index and i not in meets]
            if earlier:
                meets[index] = int(rng.choice(earlier))
    points = skeleton.tree.point.copy()
    for index, other in meets.items():
        points[index] = points[other]
    skeleton = Skeleton(
        "mixed",
        skeleton.joints,
        tuple(f"m{i}" for i in range(len(places))),
        tuple(places),
        rng.normal(size=(len(places), 3)),
        skeleton.lower,
        skeleton.upper,
    ).with_geometry(skeleton.tree.axis, points, rng.normal(size=(len(places), 3)))
    theta = rng.uniform(-1.5, 1.5, (frames, len(skeleton.displacement_names)))
    poses = np.array([random_pose(rng) for _ in range(frames)])
    coordinates = skeleton.coordinates(theta, poses)
    measured = forward(skeleton.tree, coordinates) + noise * rng.normal(size=(frames, len(places), 3))
    measured[rng.random(measured.shape[:2]) < missing] = np.nan
    never = np.isnan(measured[:, :, 0]).all(axis=0)  # such a marker's place could be anywhere
    measured[0, never] = forward(skeleton.tree, coordinates[0])[never]
    layout = parameter_layout(skeleton.tree, meets)
    return Problem(skeleton, layout, coordinates, measured, skeleton.tree, coordinates)


def chain(axes, points, markers):
    """Return revolute joints in series on the world, markers (joints, k, 3) on each segment."""
    joints = tuple(
        Joint(
            f"joint{i}",
            JointKind.REVOLUTE,
            f"link{i - 1}" if i else WORLD,
            f"link{i}",
            (f"angle{i}",),
            axes[i : i + 1],
            points[i],
        )
        for i in range(len(axes))
    )
    segments = tuple(f"link{i}" for i in range(len(axes)) for _ in range(markers.shape[1]))
    size = len(axes)
    return Skeleton(
        "chain",
        joints,
        tuple(f"m{i}" for i in range(len(segments))),
        segments,
        markers.reshape(-1, 3),
        np.full(size, -3.0),
        np.full(size, 3.0),
    )


def chain_problem(seed, joints=10, frames=10, noise=0.001, markers=False):
    """Return a chain whose axes are off by 0.05 rad and points by 20 mm, with displacements to be found from zero.

    Markers (three on each link) are known unless they are said to be estimated; true displacements lie within 1 rad.
    """
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(joints, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    points = np.cumsum(rng.uniform(-0.15, 0.15, (joints, 3)), axis=0)
    spots = points[:, None] + rng.uniform(-0.1, 0.1, (joints, 3, 3))
    truth = chain(axes, points, spots)
    theta = rng.uniform(-1.0, 1.0, (frames, joints))
    measured = forward(truth.tree, theta) + noise * rng.normal(size=(frames, 3 * joints, 3))
    off = np.array([Rotation.from_rotvec(0.05 * across(axis, rng)).apply(axis) for axis in axes])
    shift = rng.normal(size=(joints, 3))
    shift *= 0.02 / np.linalg.norm(shift, axis=1, keepdims=True)
    skeleton = chain(off, points + shift, spots)
    layout = parameter_layout(skeleton.tree, markers=markers)
    return Problem(skeleton, layout, np.zeros((frames, joints)), measured, truth.tree, theta)


def across(axis, rng):
    """Return a random unit vector at right angles to a unit axis."""
    vector = np.cross(axis, rng.normal(size=3))
    return vector / np.linalg.norm(vector)


def marker_derivatives(tree, layout, q):
    """Return the derivatives of all markers by tangents (m, 3, nv) and by parameters (m, 3, count), from twists."""
    joints, count = len(tree.kind), layout.count
    rotation, translation, local = np.empty((joints + 1, 3, 3)), np.empty((joints + 1, 3)), np.empty((joints, 3, 3))
    joint_poses(tree, q, rotation, translation, local)
    size = sum(1 if kind < 2 else 3 if kind == 2 else 6 for kind in tree.kind)
    positions, chains = forward(tree, q), ancestors(tree)
    by_tangent, by_parameter = np.zeros((len(positions), 3, size)), np.zeros((len(positions), 3, count))
    tangents, parameters, columns = np.zeros((6, 6)), np.zeros((5, 6)), np.zeros(5, dtype=np.int64)
    for j in range(joints):
        moved_markers = [i for i, own in enumerate(tree.marker_joint) if own >= 0 and j in chains[own]]
        number = tangent_twists(tree, j, rotation, translation, q, tangents)
        for s in range(number):
            for i in moved_markers:
                rate = tangents[s, :3] + np.cross(tangents[s, 3:], positions[i])
                by_tangent[i, :, tree.tangent[j] + s] += rate
        number = parameter_twists(tree, layout, j, rotation, translation, q, columns, parameters)
        for s in range(number):
            for i in moved_markers:
                by_parameter[i, :, columns[s]] += parameters[s, :3] + np.cross(parameters[s, 3:], positions[i])
    for i, column in enumerate(layout.marker_column):
        if column >= 0:
            by_parameter[i, :, column : column + 3] = rotation[tree.marker_joint[i] + 1]
    return by_tangent, by_parameter


def shifted(tree, layout, column, step):
    """Return the tree with one parameter changed."""
    change = np.zeros(layout.count)
    change[column] = step
    return moved(tree, layout, change)
