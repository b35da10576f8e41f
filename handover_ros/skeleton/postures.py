"""Postures of single frames for a skeleton that is known: damped least squares, one frame after the other."""

from __future__ import annotations

import math

import numba
import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.skeleton.kernels import BALL, FREE, REVOLUTE, ancestors, joint_poses, move
from handover_ros.skeleton.normal_equations import add_marker, cholesky_in_place, product, robust_loss, tangent_twists
from handover_ros.skeleton.tree import FlatTree, IntArray

FIRST_DAMPING = 1e-3
STILL = 1e-9  # [m^2] a posture that no marker sees stays where it is
CONVERGED = 1e-9  # relative decrease of the loss
WORSE = 1.02  # times the loss of a frame before a step: the step does not suit this frame
SETTLE_ITERATIONS = 4
BAD_FRAME = 4.0  # times the median loss
PULL = 1e-6  # [m^2/rad^2] what a joint's turn costs when two postures are compared
FAR = 2.2  # [rad]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def frame_equations(
    tree: FlatTree,
    chains: IntArray,
    q: FloatArray,
    observed: FloatArray,
    inverse_scale: float,
    a: FloatArray,
    v: FloatArray,
) -> float:
    """Fill J^T J (nv, nv), lower triangle, and J^T e (nv,) of one frame and return its loss [m^2].

    Args as in ``normal_equations.eliminate_frames``, for one frame: q (nq,), observed (m, 3).
    """
    joints = tree.kind.shape[0]
    rotation, translation = np.empty((joints + 1, 3, 3)), np.empty((joints + 1, 3))
    local = np.empty((joints, 3, 3))
    moment, wrench = np.zeros((joints, 6, 6)), np.zeros((joints, 6))
    tangents, count = np.empty((joints, 6, 6)), np.empty(joints, dtype=np.int64)
    x, error, carried = np.empty(3), np.empty(3), np.empty(6)
    joint_poses(tree, q, rotation, translation, local)
    total = 0.0
    for i in range(tree.marker.shape[0]):
        if math.isnan(observed[i, 0]):
            continue
        joint = tree.marker_joint[i]
        squared = 0.0
        for r in range(3):
            x[r] = translation[joint + 1, r]
            for c in range(3):
                x[r] += rotation[joint + 1, r, c] * tree.marker[i, c]
            error[r] = x[r] - observed[i, r]
            squared += error[r] * error[r]
        loss, weight = robust_loss(squared, inverse_scale)
        total += loss
        if joint >= 0:
            add_marker(moment[joint], wrench[joint], x, error, weight)
    a[:] = 0.0
    v[:] = 0.0
    for j in range(joints - 1, -1, -1):
        count[j] = tangent_twists(tree, j, rotation, translation, q, tangents[j])
        p = tree.parent[j]
        if p >= 0:
            for r in range(6):
                wrench[p, r] += wrench[j, r]
                for c in range(r, 6):
                    moment[p, r, c] += moment[j, r, c]
        for r in range(6):
            for c in range(r):
                moment[j, r, c] = moment[j, c, r]
    for j in range(joints):
        for s in range(count[j]):
            own = tree.tangent[j] + s
            v[own] += product(tangents[j, s], wrench[j])
            for r in range(6):
                carried[r] = product(moment[j, r], tangents[j, s])
            for level in range(chains.shape[1]):
                i = chains[j, level]
                if i < 0:
                    break
                for u in range(s + 1 if i == j else count[i]):
                    a[own, tree.tangent[i] + u] += product(tangents[i, u], carried)
    return total


@numba.njit(cache=True, nogil=True, error_model="numpy")
def solve_frame(
    tree: FlatTree, chains: IntArray, q: FloatArray, observed: FloatArray, inverse_scale: float, iterations: int
) -> float:
    """Move q (nq,) in place to the nearest minimum of one frame's loss and return it [m^2]."""
    nv = 0
    for j in range(tree.kind.shape[0]):
        nv += 3 if tree.kind[j] == BALL else 6 if tree.kind[j] == FREE else 1
    a, v, factor, step = np.empty((nv, nv)), np.empty(nv), np.empty((nv, nv)), np.empty(nv)
    other_a, other_v = np.empty((nv, nv)), np.empty(nv)
    trial = np.empty_like(q)
    loss = frame_equations(tree, chains, q, observed, inverse_scale, a, v)
    damping, growth = FIRST_DAMPING, 2.0
    for _ in range(iterations):
        for r in range(nv):
            for c in range(r + 1):
                factor[r, c] = a[r, c]
            factor[r, r] += damping * a[r, r] + STILL
            step[r] = -v[r]
        cholesky_in_place(factor)
        for r in range(nv):
            for c in range(r):
                step[r] -= factor[r, c] * step[c]
            step[r] /= factor[r, r]
        for r in range(nv - 1, -1, -1):
            for c in range(r + 1, nv):
                step[r] -= factor[c, r] * step[c]
            step[r] /= factor[r, r]
        trial[:] = q
        move(tree, trial, step)
        trial_loss = frame_equations(tree, chains, trial, observed, inverse_scale, other_a, other_v)
        if trial_loss <= loss:
            gained = loss - trial_loss
            q[:] = trial
            a[:] = other_a
            v[:] = other_v
            done = gained <= CONVERGED * loss
            loss = trial_loss
            damping, growth = damping * 0.2, 2.0
            if done:
                break
        else:
            damping, growth = damping * growth, growth * 2.0
            if damping > 1e8:
                break
    return loss


@numba.njit(cache=True, nogil=True, error_model="numpy")
def turned_far(tree: FlatTree, q: FloatArray) -> tuple[float, float]:
    """Return the sum of squares and the largest of the revolute displacements [rad] of a posture q (nq,)."""
    total, largest = 0.0, 0.0
    for j in range(tree.kind.shape[0]):
        if tree.kind[j] == REVOLUTE:
            angle = q[tree.coordinate[j]]
            total += angle * angle
            largest = max(largest, abs(angle))
    return total, largest


@numba.njit(cache=True, nogil=True, error_model="numpy")
def solve_in_order(
    tree: FlatTree,
    chains: IntArray,
    q: FloatArray,
    observed: FloatArray,
    inverse_scale: float,
    iterations: int,
    order: IntArray,
    neighbour: IntArray,
    losses: FloatArray,
) -> None:
    """Solve frames in ``order``, each from its own guess or from its neighbour's solution, whichever fits better.

    Where few markers are seen two postures may fit equally well; the one nearer to the zero posture is taken then, and
    a posture with a joint turned very far is tried again from zero.

    Args:
        tree: The skeleton.
        chains: Its ancestors.
        q: First guesses, changed in place, shape (frames, nq).
        observed: Markers [m], shape (frames, m, 3).
        inverse_scale: As in ``eliminate_frames``.
        iterations: Largest number for one frame.
        order: Frame numbers, shape (frames,).
        neighbour: For each frame the one solved before that is nearest in time, -1: none. Shape (frames,).
        losses: Filled with each frame's loss [m^2], shape (frames,).
    """
    other = np.empty(q.shape[1])
    for index in range(order.shape[0]):
        k = order[index]
        n = neighbour[k]
        if n >= 0:
            other[:] = q[n]
        losses[k] = solve_frame(tree, chains, q[k], observed[k], inverse_scale, iterations)
        pull, largest = turned_far(tree, q[k])
        if n >= 0:
            loss = solve_frame(tree, chains, other, observed[k], inverse_scale, iterations)
            other_pull, other_largest = turned_far(tree, other)
            if loss + PULL * other_pull <= losses[k] + PULL * pull:
                q[k] = other
                losses[k], pull, largest = loss, other_pull, other_largest
        if largest > FAR:
            other[:] = q[k]
            for j in range(tree.kind.shape[0]):
                if tree.kind[j] == REVOLUTE:
                    other[tree.coordinate[j]] = 0.0
            loss = solve_frame(tree, chains, other, observed[k], inverse_scale, iterations)
            other_pull, other_largest = turned_far(tree, other)
            if loss + PULL * other_pull <= losses[k] + PULL * pull:
                q[k] = other
                losses[k] = loss


@numba.njit(cache=True, nogil=True, error_model="numpy")
def frame_losses(tree: FlatTree, q: FloatArray, observed: FloatArray, inverse_scale: float, losses: FloatArray) -> None:
    """Fill the loss of each frame (frames,) [m^2]; q (frames, nq), observed (frames, m, 3), NaN = not measured."""
    joints = tree.kind.shape[0]
    rotation, translation = np.empty((joints + 1, 3, 3)), np.empty((joints + 1, 3))
    local = np.empty((joints, 3, 3))
    for k in range(q.shape[0]):
        joint_poses(tree, q[k], rotation, translation, local)
        total = 0.0
        for i in range(tree.marker.shape[0]):
            if math.isnan(observed[k, i, 0]):
                continue
            j = tree.marker_joint[i] + 1
            squared = 0.0
            for r in range(3):
                error = translation[j, r] - observed[k, i, r]
                for c in range(3):
                    error += rotation[j, r, c] * tree.marker[i, c]
                squared += error * error
            total += robust_loss(squared, inverse_scale)[0]
        losses[k] = total


@numba.njit(cache=True, nogil=True, error_model="numpy")
def settle_frames(
    tree: FlatTree,
    chains: IntArray,
    q: FloatArray,
    before: FloatArray,
    observed: FloatArray,
    inverse_scale: float,
    previous: FloatArray,
    frozen: int,
    losses: FloatArray,
) -> None:
    """Fill the losses of frames after a common step; a frame that got worse is solved again by itself.

    A frame in which few markers are seen bends more than a linear step allows; one such frame must not make the whole
    step fail.

    Args:
        tree: The skeleton after the step.
        chains: Its ancestors.
        q: Postures after the step, changed in place, shape (frames, nq).
        before: Postures before the step, shape (frames, nq).
        observed: Markers [m], shape (frames, m, 3).
        inverse_scale: As in ``eliminate_frames``.
        previous: Losses before the step, shape (frames,).
        frozen: Frame that stays as it is, -1: none.
        losses: Filled, shape (frames,).
    """
    frame_losses(tree, q, observed, inverse_scale, losses)
    other = np.empty(q.shape[1])
    for k in range(q.shape[0]):
        if k != frozen and not losses[k] <= WORSE * previous[k]:
            other[:] = before[k]
            loss = solve_frame(tree, chains, other, observed[k], inverse_scale, SETTLE_ITERATIONS)
            if not losses[k] <= loss:
                q[k] = other
                losses[k] = loss


def solve_postures(
    tree: FlatTree,
    coordinates: FloatArray,
    observed: FloatArray,
    robust_scale: float = np.inf,
    start: int = 0,
    iterations: int = 30,
) -> tuple[FloatArray, FloatArray]:
    """Return the postures (frames, nq) that fit each frame best, and their losses (frames,) [m^2].

    Frames follow each other in time: each is solved from its own guess and from the solution of the frame beside it
    towards ``start``, and the better one is taken.

    Args:
        tree: The skeleton.
        coordinates: First guesses, shape (frames, nq), or (nq,) for all.
        observed: Markers [m], shape (frames, m, 3), NaN = not measured.
        robust_scale: Cauchy scale [m]; inf: least squares.
        start: Frame to begin with.
        iterations: Largest number for one frame.
    """
    frames = len(observed)
    q = np.array(np.broadcast_to(coordinates, (frames, np.shape(coordinates)[-1])), dtype=float)
    order = np.concatenate([np.arange(start, frames), np.arange(start - 1, -1, -1)])
    neighbour = np.arange(frames) - np.sign(np.arange(frames) - start)
    neighbour[start] = -1
    losses = np.empty(frames)
    inverse_scale = 0.0 if np.isinf(robust_scale) else 1.0 / robust_scale**2
    chains, observed = ancestors(tree), np.ascontiguousarray(observed)
    solve_in_order(tree, chains, q, observed, inverse_scale, iterations, order, neighbour, losses)
    # A frame that fits badly gets other tries: from the frames on both sides, and without letting markers go.
    for side in (1, -1, 1):
        bad = np.flatnonzero(losses > BAD_FRAME * np.median(losses))[::-side]
        if not len(bad):
            break
        beside = (np.arange(frames) + side).clip(0, frames - 1)
        solve_in_order(tree, chains, q, observed, inverse_scale, iterations, bad, beside, losses)
        if inverse_scale > 0.0:
            other, other_losses, alone = q.copy(), losses.copy(), np.full(frames, -1)
            solve_in_order(tree, chains, other, observed, 0.0, iterations, bad, beside, other_losses)
            solve_in_order(tree, chains, other, observed, inverse_scale, iterations, bad, alone, other_losses)
            better = bad[other_losses[bad] < losses[bad]]
            q[better], losses[better] = other[better], other_losses[better]
    return q, losses
