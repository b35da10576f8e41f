"""Compiled normal equations of prediction error minimisation (eq. 2.5, 2.6), every frame's posture eliminated.

The unknowns are the parameters x (twists, markers) and the tangent t_k of each frame's posture. A frame's markers
depend on its own t_k only, so J^T J is an arrow: blocks A_k = L_k L_k^T of the frames, a border B_k, and C for the
parameters. With W_k = L_k^-1 B_k and y_k = L_k^-1 b_k the parameters solve
(C - sum W_k^T W_k) dx = -(c - sum W_k^T y_k), and then dt_k = -L_k^-T (y_k + W_k dx). Time and
memory are linear in the number of frames.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.skeleton.kernels import BALL, FREE, PRISMATIC, REVOLUTE, joint_poses, move
from handover_ros.skeleton.layout import Layout
from handover_ros.skeleton.tree import FlatTree, IntArray

STEP_DAMPING = 1e-6  # [m^2] a posture that no marker sees does not move


@numba.njit(cache=True, nogil=True, error_model="numpy")
def tangent_twists(
    tree: FlatTree, j: int, rotation: FloatArray, translation: FloatArray, q: FloatArray, out: FloatArray
) -> int:
    """Fill ``out`` (6, 6) with the world twists (linear, angular) of joint j's tangents; return how many rows.

    A twist (v, w) moves a world point x by v + w x x: the adjoint column of the dissertation's D_theta.
    """
    p = tree.parent[j] + 1
    kind = tree.kind[j]
    out[:] = 0.0
    if kind == FREE:
        start = tree.coordinate[j]
        for k in range(3):
            out[k, k] = 1.0
            out[3 + k, 3 + k] = 1.0
        turn_twist(out[3], q[start], q[start + 1], q[start + 2])
        turn_twist(out[4], q[start], q[start + 1], q[start + 2])
        turn_twist(out[5], q[start], q[start + 1], q[start + 2])
        return 6
    cx, cy, cz = translation[p, 0], translation[p, 1], translation[p, 2]
    for c in range(3):
        cx += rotation[p, 0, c] * tree.point[j, c]
        cy += rotation[p, 1, c] * tree.point[j, c]
        cz += rotation[p, 2, c] * tree.point[j, c]
    if kind == BALL:
        for k in range(3):
            for r in range(3):
                out[k, 3 + r] = rotation[p, r, k]
            turn_twist(out[k], cx, cy, cz)
        return 3
    first = 0 if kind == PRISMATIC else 3
    for r in range(3):
        for c in range(3):
            out[0, first + r] += rotation[p, r, c] * tree.axis[j, c]
    if kind == REVOLUTE:
        turn_twist(out[0], cx, cy, cz)
    return 1


@numba.njit(cache=True, nogil=True, error_model="numpy")
def turn_twist(twist: FloatArray, cx: float, cy: float, cz: float) -> None:
    """Set the linear part of a twist (6,) so that the point (cx, cy, cz) stays: v = c x w."""
    wx, wy, wz = twist[3], twist[4], twist[5]
    twist[0], twist[1], twist[2] = cy * wz - cz * wy, cz * wx - cx * wz, cx * wy - cy * wx


@numba.njit(cache=True, nogil=True, error_model="numpy")
def parameter_twists(
    tree: FlatTree,
    layout: Layout,
    j: int,
    rotation: FloatArray,
    translation: FloatArray,
    q: FloatArray,
    columns: IntArray,
    out: FloatArray,
) -> int:
    """Fill ``out`` (5, 6) with the world twists of joint j's parameters and ``columns`` (5,); return their number.

    With the joint turning by theta about w through c in its parent's frame R_p: a shift b of the centre moves what it
    carries by R_p b - R_j b, a tilt b of the axis turns it about the centre by
    R_p (sin(theta) b + (1 - cos(theta)) w x b), a tilt of a prismatic axis shifts it by theta R_p b: the matrices A_j
    of the dissertation's D_xi, in closed form.
    """
    p = tree.parent[j] + 1
    kind = tree.kind[j]
    n = 0
    column = layout.axis_column[j]
    if column >= 0:
        theta = q[tree.coordinate[j]]
        sine, versine = math.sin(theta), 1.0 - math.cos(theta)
        wx, wy, wz = tree.axis[j, 0], tree.axis[j, 1], tree.axis[j, 2]
        cx, cy, cz = translation[p, 0], translation[p, 1], translation[p, 2]
        for c in range(3):
            cx += rotation[p, 0, c] * tree.point[j, c]
            cy += rotation[p, 1, c] * tree.point[j, c]
            cz += rotation[p, 2, c] * tree.point[j, c]
        for k in range(2):
            bx, by, bz = layout.axis_basis[j, 0, k], layout.axis_basis[j, 1, k], layout.axis_basis[j, 2, k]
            columns[n] = column + k
            if kind == PRISMATIC:
                for r in range(3):
                    out[n, r] = theta * (rotation[p, r, 0] * bx + rotation[p, r, 1] * by + rotation[p, r, 2] * bz)
                    out[n, 3 + r] = 0.0
            else:
                ux = sine * bx + versine * (wy * bz - wz * by)
                uy = sine * by + versine * (wz * bx - wx * bz)
                uz = sine * bz + versine * (wx * by - wy * bx)
                for r in range(3):
                    out[n, 3 + r] = rotation[p, r, 0] * ux + rotation[p, r, 1] * uy + rotation[p, r, 2] * uz
                turn_twist(out[n], cx, cy, cz)
            n += 1
    column = layout.point_column[j]
    if column >= 0:
        for k in range(layout.point_size[j]):
            columns[n] = column + k
            for r in range(3):
                value = 0.0
                for c in range(3):
                    value += (rotation[p, r, c] - rotation[j + 1, r, c]) * layout.point_basis[j, c, k]
                out[n, r] = value
                out[n, 3 + r] = 0.0
            n += 1
    return n


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_marker(moment: FloatArray, wrench: FloatArray, x: FloatArray, error: FloatArray, weight: float) -> None:
    """Add one marker at x (3,) with its error (3,) to what its segment carries.

    moment (6, 6) becomes the sum of w [1, -x^]^T [1, -x^], upper triangle, wrench (6,) that of w [e, x x e].
    """
    px, py, pz = x[0], x[1], x[2]
    ex, ey, ez = weight * error[0], weight * error[1], weight * error[2]
    wrench[0] += ex
    wrench[1] += ey
    wrench[2] += ez
    wrench[3] += py * ez - pz * ey
    wrench[4] += pz * ex - px * ez
    wrench[5] += px * ey - py * ex
    moment[0, 0] += weight
    moment[1, 1] += weight
    moment[2, 2] += weight
    moment[0, 4] += weight * pz
    moment[0, 5] -= weight * py
    moment[1, 3] -= weight * pz
    moment[1, 5] += weight * px
    moment[2, 3] += weight * py
    moment[2, 4] -= weight * px
    moment[3, 3] += weight * (py * py + pz * pz)
    moment[4, 4] += weight * (px * px + pz * pz)
    moment[5, 5] += weight * (px * px + py * py)
    moment[3, 4] -= weight * px * py
    moment[3, 5] -= weight * px * pz
    moment[4, 5] -= weight * py * pz


@numba.njit(cache=True, nogil=True, error_model="numpy")
def robust_loss(squared: float, inverse_scale: float) -> tuple[float, float]:
    """Return the Cauchy loss of a squared distance and its weight; inverse_scale [1/m^2] 0: the square itself."""
    if inverse_scale == 0.0:
        return squared, 1.0
    ratio = squared * inverse_scale
    return math.log1p(ratio) / inverse_scale, 1.0 / (1.0 + ratio)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def cholesky_in_place(a: FloatArray) -> bool:
    """Replace a positive definite matrix (n, n) by its lower Cholesky factor; return whether that worked."""
    n = a.shape[0]
    for i in range(n):
        for j in range(i):
            total = a[i, j]
            for k in range(j):
                total -= a[i, k] * a[j, k]
            a[i, j] = total / a[j, j]
        total = a[i, i]
        for k in range(i):
            total -= a[i, k] * a[i, k]
        if not total > 0.0:
            return False
        a[i, i] = math.sqrt(total)
    return True


@numba.njit(cache=True, nogil=True, error_model="numpy")
def eliminate_frames(
    tree: FlatTree,
    chains: IntArray,
    layout: Layout,
    q: FloatArray,
    observed: FloatArray,
    inverse_scale: float,
    damping: float,
    frozen: int,
    c_block: FloatArray,
    c_vector: FloatArray,
    factors: FloatArray,
    borders: FloatArray,
    rights: FloatArray,
) -> float:
    """Build the normal equations of some frames and eliminate their postures; return their loss [m^2].

    Args:
        tree: The skeleton.
        chains: ``kernels.ancestors`` of it.
        layout: Its parameters; may have none.
        q: Coordinates, shape (frames, nq).
        observed: Markers [m], shape (frames, m, 3), NaN = not measured.
        inverse_scale: 1 / square of the Cauchy scale [1/m^2]; 0: least squares.
        damping: Levenberg-Marquardt damping, relative to the diagonal.
        frozen: Frame whose posture is held (it fixes the gauge), -1: none.
        c_block: Added to: undamped C, upper triangle, shape (count, count).
        c_vector: Added to: c, shape (count,).
        factors: Filled with L_k, shape (frames, nv, nv).
        borders: Filled with W_k, shape (frames, nv, count).
        rights: Filled with y_k, shape (frames, nv).
    """
    joints, count, nv = tree.kind.shape[0], layout.count, rights.shape[1]
    depth = chains.shape[1]
    rotation, translation = np.empty((joints + 1, 3, 3)), np.empty((joints + 1, 3))
    local = np.empty((joints, 3, 3))
    # Sums over all markers that a joint moves, and the twists of its tangents and parameters.
    moment, wrench = np.empty((joints, 6, 6)), np.empty((joints, 6))
    tangents, tangent_count = np.empty((joints, 6, 6)), np.empty(joints, dtype=np.int64)
    parameters, parameter_count = np.empty((joints, 5, 6)), np.empty(joints, dtype=np.int64)
    columns = np.empty((joints, 5), dtype=np.int64)
    x, error, carried = np.empty(3), np.empty(3), np.empty(6)
    total = 0.0
    for k in range(q.shape[0]):
        a, b, v = factors[k], borders[k], rights[k]
        a[:] = 0.0
        b[:] = 0.0
        v[:] = 0.0
        moment[:] = 0.0
        wrench[:] = 0.0
        joint_poses(tree, q[k], rotation, translation, local)
        for j in range(joints):
            tangent_count[j] = tangent_twists(tree, j, rotation, translation, q[k], tangents[j])
            if k == frozen:
                tangent_count[j] = 0
            parameter_count[j] = 0
            if count > 0:
                parameter_count[j] = parameter_twists(
                    tree, layout, j, rotation, translation, q[k], columns[j], parameters[j]
                )
        for i in range(tree.marker.shape[0]):
            if math.isnan(observed[k, i, 0]):
                continue
            joint = tree.marker_joint[i]
            squared = 0.0
            for r in range(3):
                x[r] = translation[joint + 1, r]
                for c in range(3):
                    x[r] += rotation[joint + 1, r, c] * tree.marker[i, c]
                error[r] = x[r] - observed[k, i, r]
                squared += error[r] * error[r]
            loss, weight = robust_loss(squared, inverse_scale)
            total += loss
            if joint < 0:
                continue
            add_marker(moment[joint], wrench[joint], x, error, weight)
            column = layout.marker_column[i]
            if column < 0:
                continue
            turn = rotation[joint + 1]
            for s in range(3):
                c_block[column + s, column + s] += weight
                c_vector[column + s] += weight * (turn[0, s] * error[0] + turn[1, s] * error[1] + turn[2, s] * error[2])
            for level in range(depth):
                j = chains[joint, level]
                if j < 0:
                    break
                for s in range(tangent_count[j]):
                    add_marker_row(b[tree.tangent[j] + s], column, tangents[j, s], x, turn, weight)
                for s in range(parameter_count[j]):
                    # Joints' columns come before markers'.
                    add_marker_row(c_block[columns[j, s]], column, parameters[j, s], x, turn, weight)
        for j in range(joints - 1, -1, -1):
            p = tree.parent[j]
            if p >= 0:
                for r in range(6):
                    wrench[p, r] += wrench[j, r]
                    for c in range(r, 6):
                        moment[p, r, c] += moment[j, r, c]
            for r in range(6):
                for c in range(r):
                    moment[j, r, c] = moment[j, c, r]
        # As in the composite-rigid-body algorithm: a pair of columns meets in the markers beyond the outer joint.
        for j in range(joints):
            for s in range(tangent_count[j] + parameter_count[j]):
                is_tangent = s < tangent_count[j]
                place = s if is_tangent else s - tangent_count[j]
                twist = tangents[j, place] if is_tangent else parameters[j, place]
                own = tree.tangent[j] + place if is_tangent else columns[j, place]
                gradient = 0.0
                for r in range(6):
                    gradient += twist[r] * wrench[j, r]
                    carried[r] = 0.0
                    for c in range(6):
                        carried[r] += moment[j, r, c] * twist[c]
                if is_tangent:
                    v[own] += gradient
                else:
                    c_vector[own] += gradient
                for level in range(depth):
                    i = chains[j, level]
                    if i < 0:
                        break
                    tangents_here, parameters_here = tangent_count[i], parameter_count[i]
                    if i == j:
                        # Within a joint every pair once: tangents before parameters.
                        tangents_here = place + 1 if is_tangent else tangents_here
                        parameters_here = 0 if is_tangent else place + 1
                    for u in range(tangents_here):
                        value = product(tangents[i, u], carried)
                        other = tree.tangent[i] + u
                        if is_tangent:
                            a[own, other] += value
                        else:
                            b[other, own] += value
                    for u in range(parameters_here):
                        value = product(parameters[i, u], carried)
                        other = columns[i, u]
                        if is_tangent:
                            b[own, other] += value
                        elif other == own and i != j:
                            c_block[own, own] += 2.0 * value  # two joints share the parameter: both orders
                        elif other <= own:
                            c_block[other, own] += value
                        else:
                            c_block[own, other] += value
        for s in range(nv):
            a[s, s] += damping * a[s, s] + STEP_DAMPING
        cholesky_in_place(a)
        for s in range(nv):
            row = b[s]
            for u in range(s):
                factor = a[s, u]
                if factor != 0.0:
                    v[s] -= factor * v[u]
                    subtract(row, factor, b[u])
            inverse = 1.0 / a[s, s]
            v[s] *= inverse
            for c in range(count):
                row[c] *= inverse
    return total


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def product(first: FloatArray, second: FloatArray) -> float:
    """Return the scalar product of two vectors (6,)."""
    return (
        first[0] * second[0]
        + first[1] * second[1]
        + first[2] * second[2]
        + first[3] * second[3]
        + first[4] * second[4]
        + first[5] * second[5]
    )


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def subtract(row: FloatArray, factor: float, other: FloatArray) -> None:
    """Subtract factor * other from row, in place."""
    for c in range(row.shape[0]):
        row[c] -= factor * other[c]


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def add_marker_row(
    row: FloatArray, column: int, twist: FloatArray, x: FloatArray, turn: FloatArray, weight: float
) -> None:
    """Add to row[column:column + 3] the products of a twist's motion of a marker at x and the marker's own shifts."""
    dx = weight * (twist[0] + twist[4] * x[2] - twist[5] * x[1])
    dy = weight * (twist[1] + twist[5] * x[0] - twist[3] * x[2])
    dz = weight * (twist[2] + twist[3] * x[1] - twist[4] * x[0])
    for s in range(3):
        row[column + s] += turn[0, s] * dx + turn[1, s] * dy + turn[2, s] * dz


@numba.njit(cache=True, nogil=True, error_model="numpy")
def substitute_frames(
    tree: FlatTree,
    q: FloatArray,
    factors: FloatArray,
    borders: FloatArray,
    rights: FloatArray,
    step: FloatArray,
    result: FloatArray,
) -> float:
    """Fill ``result`` (frames, nq) with q moved by dt_k = -L_k^-T (y_k + W_k dx); return the sum of |L_k^T dt_k|^2."""
    nv = rights.shape[1]
    right = np.empty(nv)
    norm = 0.0
    for k in range(q.shape[0]):
        for s in range(nv):
            total = rights[k, s]
            for c in range(step.shape[0]):
                total += borders[k, s, c] * step[c]
            right[s] = -total
            norm += total * total
        for s in range(nv - 1, -1, -1):
            total = right[s]
            for u in range(s + 1, nv):
                total -= factors[k, u, s] * right[u]
            right[s] = total / factors[k, s, s]
        result[k] = q[k]
        move(tree, result[k], right)
    return norm
