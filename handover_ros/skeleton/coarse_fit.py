"""From a first guess to the right minimum: a fit to a few frames, in which rivals of a group of joints compete."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.skeleton.group_fit import Group, GroupFit
from handover_ros.skeleton.initial import InitialGuess, place_group
from handover_ros.skeleton.layout import Layout
from handover_ros.skeleton.postures import solve_postures
from handover_ros.skeleton.prediction_error import Fit, FitSettings, minimise
from handover_ros.skeleton.templates import NamedTemplate
from handover_ros.skeleton.tree import FlatTree, Skeleton
from handover_ros.skeleton.wishes import Wishes

COARSE_SCALE = 0.03  # [m] robust scale while the noise is not known
UNDECIDED = 16.0  # difference in chi-squared below which the markers do not decide between two fits
WORTH_MORE = 0.98  # of the loss: better postures of single frames are worth another minimisation
LEAST_STRENGTH = 1e-5  # [m^2] of wishes: what ten marker samples 1 mm off cost, lost where motion shows the axes


def coarse_fit(
    guess: InitialGuess,
    layout: Layout,
    observed: FloatArray,
    at: int,
    template: NamedTemplate,
    blank: Skeleton,
    wishes: Wishes,
) -> Fit:
    """Return the best minimum on a few frames; rivals of a group are tried in its place.

    Where the markers do not decide between two fits, the one nearer to the template's directions is taken.
    """
    settings = FitSettings(robust_scale=COARSE_SCALE, tolerance=1e-5, damping=1e-4)
    wishes = wishes_for(wishes, observed)

    def fitted(tree: FlatTree, coordinates: FloatArray) -> Fit:
        coordinates, _ = solve_postures(tree, coordinates, observed, COARSE_SCALE, at)
        fit = minimise(tree, layout, coordinates, observed, settings, at, wishes)
        again, losses = solve_postures(fit.tree, fit.coordinates, observed, COARSE_SCALE, at)
        if losses.sum() + wishes.loss(fit.tree) < WORTH_MORE * fit.loss:
            # Some frames had been caught in a wrong posture.
            fit = minimise(fit.tree, layout, again, observed, settings, at, wishes)
        return fit

    best = fitted(guess.tree, guess.coordinates)
    directions = template_directions(blank, template)
    for group, rival in guess.rivals:
        tree, coordinates = with_group(best, group, rival, guess)
        other = fitted(tree, coordinates)
        variance = best.loss / max(3 * np.isfinite(observed[:, :, 0]).sum(), 1)
        gain = (best.loss - other.loss) / max(variance, 1e-12)
        agrees = agreement(other.tree, directions, group) > agreement(best.tree, directions, group)
        if gain > UNDECIDED or (gain > -UNDECIDED and agrees):
            best = other
    return best


def with_group(fit: Fit, group: Group, rival: GroupFit, guess: InitialGuess) -> tuple[FlatTree, FloatArray]:
    """Return a fit's tree and postures with one group replaced."""
    tree = fit.tree
    axis, point, marker, coordinates = tree.axis.copy(), tree.point.copy(), tree.marker.copy(), fit.coordinates.copy()
    place_group(guess.tree, group, rival, axis, point, marker, coordinates)
    return tree._replace(axis=axis, point=point, marker=marker), coordinates


def agreement(tree: FlatTree, directions: FloatArray, group: Group) -> float:
    """Return how well a group's axes agree with directions (joints, 3), 1 for each axis that is parallel."""
    return float(sum(abs(tree.axis[j] @ directions[j]) for j in group.joints))


def template_directions(blank: Skeleton, template: NamedTemplate) -> FloatArray:
    """Return the first positive direction of every joint (joints, 3); zero where the template gives none."""
    directions = np.zeros((len(blank.joints), 3))
    for joint in template.content.joints:
        if joint.positive:
            directions[[each.name for each in blank.joints].index(joint.name)] = joint.directions[0]
    return directions


def template_wishes(blank: Skeleton, template: NamedTemplate, strength: float) -> Wishes:
    """Return a template's wishes, with their strength [m^2] for each marker sample."""
    index = {joint.name: number for number, joint in enumerate(blank.joints)}
    joints = template.content.joints
    return Wishes(
        tuple((index[j.right_angle_to], index[j.name]) for j in joints if j.right_angle_to is not None),
        tuple((index[j.name], index[j.towards]) for j in joints if j.towards is not None),
        strength,
    )


def wishes_for(wishes: Wishes, observed: FloatArray) -> Wishes:
    """Return wishes with the strength for all samples of some frames (frames, m, 3).

    Axes that nothing else tells, of a joint that did not move, still follow them.
    """
    return replace(wishes, strength=LEAST_STRENGTH + wishes.strength * int(np.isfinite(observed[:, :, 0]).sum()))


def meeting_joints(blank: Skeleton, template: NamedTemplate) -> dict[int, int]:
    """Return the joints whose axes meet, by index."""
    names = [joint.name for joint in blank.joints]
    return {names.index(j.name): names.index(j.meets) for j in template.content.joints if j.meets is not None}
