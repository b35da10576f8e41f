"""What markers alone cannot tell: which posture counts as zero, and which way an axis points. Both are fixed here.

Moving the zero of every displacement to another posture, and the zero frame with the root, changes no predicted marker.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from handover_ros.geometry import FloatArray, invert_transform
from handover_ros.skeleton.group_starts import zero_coordinates
from handover_ros.skeleton.kernels import ancestors, segment_poses
from handover_ros.skeleton.layout import Layout
from handover_ros.skeleton.tree import FlatTree, JointKind


def mean_posture(tree: FlatTree, coordinates: FloatArray) -> FloatArray:
    """Return the mean (nq,) of postures (frames, nq); the root's part is that of the first frame."""
    mean = coordinates.mean(axis=0)
    for kind, start in zip(tree.kind, tree.coordinate):
        if kind == JointKind.BALL:
            mean[start : start + 4] = Rotation.from_quat(coordinates[:, start : start + 4]).mean().as_quat()
        elif kind == JointKind.FREE:
            mean[start : start + 7] = coordinates[0, start : start + 7]
    return mean


def with_zero_at(tree: FlatTree, coordinates: FloatArray, posture: FloatArray) -> tuple[FlatTree, FloatArray]:
    """Return the tree and its postures (frames, nq) with ``posture`` (nq,) as the zero posture.

    The root's part of ``posture`` is not used. In the new zero frame every axis, point and marker stands where it stood
    at that posture.
    """
    at = zero_coordinates(tree)
    own = np.array(posture, dtype=float)
    if len(tree.kind) and tree.kind[0] == JointKind.FREE:
        own[:7] = at[:7]
    poses = segment_poses(tree, own[None])[0]
    parents = [np.eye(4) if parent < 0 else poses[parent] for parent in tree.parent]
    axis, point, marker = tree.axis.copy(), tree.point.copy(), tree.marker.copy()
    result = np.array(coordinates, dtype=float)
    for j, (kind, start) in enumerate(zip(tree.kind, tree.coordinate)):
        turn = parents[j][:3, :3]
        if kind == JointKind.FREE:
            continue
        point[j] = turn @ point[j] + parents[j][:3, 3]
        if kind == JointKind.BALL:
            now = Rotation.from_quat(result[:, start : start + 4])
            then = Rotation.from_quat(own[start : start + 4])
            frame = Rotation.from_matrix(turn)
            result[:, start : start + 4] = (frame * now * then.inv() * frame.inv()).as_quat()
        else:
            axis[j] = turn @ axis[j]
            result[:, start] -= own[start]
    for i, joint in enumerate(tree.marker_joint):
        if joint >= 0:
            marker[i] = poses[joint][:3, :3] @ marker[i] + poses[joint][:3, 3]
    return tree._replace(axis=axis, point=point, marker=marker), result


def with_root_frame(tree: FlatTree, coordinates: FloatArray, zero_from_new: FloatArray) -> tuple[FlatTree, FloatArray]:
    """Return the tree and its postures in another zero frame, whose pose (4, 4) in the present one is given."""
    new_from_zero = invert_transform(zero_from_new)
    turn, shift = new_from_zero[:3, :3], new_from_zero[:3, 3]
    result = np.array(coordinates, dtype=float)
    inner = Rotation.from_matrix(turn)
    for kind, start in zip(tree.kind, tree.coordinate):
        if kind == JointKind.FREE:
            rotation = Rotation.from_quat(result[:, start + 3 : start + 7])
            result[:, start : start + 3] += rotation.apply(zero_from_new[:3, 3])
            result[:, start + 3 : start + 7] = (rotation * Rotation.from_matrix(zero_from_new[:3, :3])).as_quat()
        elif kind == JointKind.BALL:
            own = Rotation.from_quat(result[:, start : start + 4])
            result[:, start : start + 4] = (inner * own * inner.inv()).as_quat()
    axis = tree.axis.copy()
    turning = tree.kind != JointKind.BALL
    axis[turning] = axis[turning] @ turn.T
    return tree._replace(axis=axis, point=tree.point @ turn.T + shift, marker=tree.marker @ turn.T + shift), result


def with_signs(tree: FlatTree, coordinates: FloatArray, directions: FloatArray) -> tuple[FlatTree, FloatArray]:
    """Return the tree and its postures with every axis on the side of ``directions`` (joints, 3)."""
    axis, result = tree.axis.copy(), np.array(coordinates, dtype=float)
    for j, (kind, start) in enumerate(zip(tree.kind, tree.coordinate)):
        if kind in (JointKind.REVOLUTE, JointKind.PRISMATIC) and axis[j] @ directions[j] < 0.0:
            axis[j] = -axis[j]
            result[:, start] = -result[:, start]
    return tree._replace(axis=axis), result


def within_a_turn(tree: FlatTree, coordinates: FloatArray) -> FloatArray:
    """Return postures (frames, nq) whose revolute joints lie within half a turn of zero: the same poses."""
    result = np.array(coordinates, dtype=float)
    for kind, start in zip(tree.kind, tree.coordinate):
        if kind == JointKind.REVOLUTE:
            result[:, start] -= 2.0 * np.pi * np.round(result[:, start] / (2.0 * np.pi))
    return result


def gauge_directions(tree: FlatTree, layout: Layout) -> FloatArray:
    """Return the parameter changes (count, tangents) that only move the zero of a displacement or of the root."""
    chains = ancestors(tree)
    columns = []
    for j, kind in enumerate(tree.kind):
        if kind == JointKind.FREE:
            twists = np.eye(6)
        elif kind == JointKind.BALL:
            twists = np.hstack([np.cross(tree.point[j], np.eye(3)), np.eye(3)])
        elif kind == JointKind.REVOLUTE:
            twists = np.concatenate([np.cross(tree.point[j], tree.axis[j]), tree.axis[j]])[None]
        else:
            twists = np.concatenate([tree.axis[j], np.zeros(3)])[None]
        for linear, angular in zip(twists[:, :3], twists[:, 3:]):
            column = np.zeros(layout.count)
            for i in range(len(tree.kind)):
                if j not in chains[i] or i == j:
                    continue
                if (start := layout.axis_column[i]) >= 0:
                    column[start : start + 2] = layout.axis_basis[i].T @ np.cross(angular, tree.axis[i])
                if (start := layout.point_column[i]) >= 0:
                    size = layout.point_size[i]
                    moved = linear + np.cross(angular, tree.point[i])
                    column[start : start + size] = layout.point_basis[i, :, :size].T @ moved
            for i, joint in enumerate(tree.marker_joint):
                if (start := layout.marker_column[i]) >= 0 and joint >= 0 and j in chains[joint]:
                    column[start : start + 3] = linear + np.cross(angular, tree.marker[i])
            columns.append(column)
    return np.array(columns).T
