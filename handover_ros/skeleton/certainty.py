"""How certain a fitted skeleton and its postures are: standard errors from the normal equations."""

from __future__ import annotations

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.skeleton.gauge import gauge_directions
from handover_ros.skeleton.kernels import ancestors
from handover_ros.skeleton.layout import Layout
from handover_ros.skeleton.postures import frame_equations
from handover_ros.skeleton.prediction_error import NormalEquations, blas_controller, renewed
from handover_ros.skeleton.tree import FlatTree, JointKind, Skeleton

UNKNOWN = 1e-9  # share of the largest eigenvalue below which a direction counts as not seen at all
UNSEEN = 1e-9  # [m^2] information on a tangent that no marker sees


def standard_errors(
    tree: FlatTree, layout: Layout, coordinates: FloatArray, observed: FloatArray, noise: float
) -> tuple[FloatArray, FloatArray]:
    """Return standard errors (joints,) of every joint's axis [rad] and point [m]; 0 where not estimated.

    The inverse of the reduced normal matrix, with one frame's posture held, transformed so that no freedom of the zero
    posture enters (an S-transformation to the inner-constraint datum of the markers, Baarda 1973). Axes and points have
    no part in the datum: the axis of a joint that did not move is not known at all, and would spoil the others.

    Args:
        tree: The fitted tree.
        layout: Its parameters.
        coordinates: Postures of the fit, shape (frames, nq).
        observed: Markers [m], shape (frames, m, 3).
        noise: Standard deviation [m] of a marker coordinate.
    """
    layout = renewed(layout, tree)
    tangents = int(sum(1 if kind < JointKind.BALL else 3 if kind == JointKind.BALL else 6 for kind in tree.kind))
    held = int(np.argmax(np.isfinite(observed[:, :, 0]).sum(axis=1)))
    equations = NormalEquations(tangents, observed, layout, held, np.inf)
    try:
        with blas_controller().limit(limits=1, user_api="blas"):
            matrix, _, _ = equations.build(tree, layout, coordinates, 0.0)
    finally:
        equations.close()
    values, vectors = np.linalg.eigh(matrix)
    values = np.maximum(values, UNKNOWN * values[-1])
    directions = gauge_directions(tree, layout)
    markers = (layout.marker_column[layout.marker_column >= 0][:, None] + np.arange(3)).ravel()
    datum = np.linalg.pinv(directions[markers], rcond=UNKNOWN)
    root = (vectors - directions @ (datum @ vectors[markers])) / np.sqrt(values)
    covariance = noise**2 * (root @ root.T)
    axis_errors, point_errors = np.zeros(len(tree.kind)), np.zeros(len(tree.kind))
    for j in range(len(tree.kind)):
        if (column := layout.axis_column[j]) >= 0:
            axis_errors[j] = np.sqrt(np.linalg.eigvalsh(covariance[column : column + 2, column : column + 2])[-1])
        if (column := layout.point_column[j]) >= 0:
            size = int(layout.point_size[j])
            block = covariance[column : column + size, column : column + size]
            point_errors[j] = np.sqrt(max(float(np.trace(block)), 0.0))
    return axis_errors, point_errors


def posture_deviations(skeleton: Skeleton, coordinates: FloatArray, observed: FloatArray) -> FloatArray:
    """Return the standard deviation of each displacement (frames, n) for markers of unit noise and a known skeleton.

    Args:
        skeleton: The skeleton.
        coordinates: Postures, shape (frames, nq).
        observed: Markers [m], shape (frames, m, 3); which are NaN matters only.
    """
    tree, (_, tangents) = skeleton.tree, skeleton.size
    chains = ancestors(tree)
    displacements = skeleton.displacements(coordinates, near=np.zeros(len(skeleton.displacement_names)))
    information, v = np.zeros((len(coordinates), tangents, tangents)), np.empty(tangents)
    for k in range(len(coordinates)):
        frame_equations(tree, chains, coordinates[k], observed[k], 0.0, information[k], v)
    information += np.swapaxes(np.tril(information, -1), -1, -2)
    information[:, np.arange(tangents), np.arange(tangents)] += UNSEEN
    with blas_controller().limit(limits=1, user_api="blas"):
        covariance = displacement_covariance(
            skeleton, displacements, np.asarray(np.linalg.inv(information), dtype=float)
        )
    return np.sqrt(np.einsum("knn->kn", covariance))


def displacement_covariance(skeleton: Skeleton, displacements: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the covariance (..., n, n) of displacements (..., n), given that of the tangents (..., nv, nv)."""
    mapping = skeleton.displacement_mapping(displacements)
    return np.asarray(mapping @ covariance @ np.swapaxes(mapping, -1, -2))
