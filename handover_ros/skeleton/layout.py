"""Which numbers of a skeleton are estimated, and how small changes of them move its axes, points and markers.

A joint's parameters r and the map t: r -> twists of eq. 2.12, with the gauge taken out: a revolute joint has 4
parameters (its axis tilts in two directions and shifts in two), a prismatic joint 2, a ball joint the 3 of its centre.
Two joints whose axes meet share the 3 of their common point. A marker has 3.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.skeleton.tree import FlatTree, IntArray, JointKind


class Layout(NamedTuple):
    """Columns of the parameters and the directions in which they move; -1: not estimated."""

    axis_column: IntArray  # (joints,) first of 2
    axis_basis: FloatArray  # (joints, 3, 2)
    point_column: IntArray  # (joints,)
    point_size: IntArray  # (joints,) number of columns
    point_basis: FloatArray  # (joints, 3, 3)
    marker_column: IntArray  # (m,) first of 3
    count: int  # type: ignore[assignment]  # a tuple's count is not used


def parameter_layout(
    tree: FlatTree, meets: Mapping[int, int] | None = None, joints: bool = True, markers: bool = True, held: int = 0
) -> Layout:
    """Return the parameters of a tree.

    Args:
        tree: The tree.
        meets: Joint whose axis goes through the point of another joint, by index.
        joints: Whether axes and points are estimated.
        markers: Whether marker positions are estimated; those fixed to the world never are.
        held: The first markers, whose positions are known.
    """
    meets = meets or {}
    number, count = len(tree.kind), 0
    axis_column, point_column = (np.full(number, -1, dtype=np.int64) for _ in range(2))
    point_size = np.zeros(number, dtype=np.int64)
    shared = set(meets) | set(meets.values())
    for j, kind in enumerate(tree.kind if joints else []):
        if kind in (JointKind.REVOLUTE, JointKind.PRISMATIC):
            axis_column[j], count = count, count + 2
        if j in meets:
            point_column[j], point_size[j] = point_column[meets[j]], 3
        elif kind == JointKind.BALL or j in shared:
            point_column[j], point_size[j], count = count, 3, count + 3
        elif kind == JointKind.REVOLUTE:
            point_column[j], point_size[j], count = count, 2, count + 2
    marker_column = np.full(len(tree.marker_joint), -1, dtype=np.int64)
    for i, joint in enumerate(tree.marker_joint if markers else []):
        if joint >= 0 and i >= held:
            marker_column[i], count = count, count + 3
    basis = tangent_basis(tree.axis)
    point_basis = np.zeros((number, 3, 3))
    point_basis[:] = np.eye(3)
    two = point_size == 2
    point_basis[two, :, :2] = basis[two]
    return Layout(axis_column, basis, point_column, point_size, point_basis, marker_column, count)


def tangent_basis(axis: FloatArray) -> FloatArray:
    """Return two unit vectors at right angles to each unit axis (n, 3), as columns: shape (n, 3, 2)."""
    helper = np.zeros_like(axis)
    helper[np.arange(len(axis)), np.argmin(np.abs(axis), axis=1)] = 1.0
    first = np.cross(axis, helper)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-12)
    return np.stack([first, np.cross(axis, first)], axis=2)


def moved(tree: FlatTree, layout: Layout, step: FloatArray) -> FlatTree:
    """Return a tree moved by a step (count,) of its parameters; axes stay of unit length."""
    axis, point, marker = tree.axis.copy(), tree.point.copy(), tree.marker.copy()
    for j in range(len(tree.kind)):
        if (column := layout.axis_column[j]) >= 0:
            axis[j] += layout.axis_basis[j] @ step[column : column + 2]
            axis[j] /= np.linalg.norm(axis[j])
        if (column := layout.point_column[j]) >= 0:
            size = layout.point_size[j]
            point[j] += layout.point_basis[j, :, :size] @ step[column : column + size]
    estimated = layout.marker_column >= 0
    columns = layout.marker_column[estimated, None] + np.arange(3)
    marker[estimated] += step[columns]
    return tree._replace(axis=axis, point=point, marker=marker)
