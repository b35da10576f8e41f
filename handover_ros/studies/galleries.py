"""Feasible sets themselves: what planar objects tell by shape and pose (4.5, 4.6), and two real objects (4.9)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from handover_ros.arm.planar import PlanarObject, any_object, random_planar_object
from handover_ros.geometry import FloatArray
from handover_ros.preferences.information import outlook
from handover_ros.preferences.likelihood import log_likelihood
from handover_ros.preferences.query import Query, chosen
from handover_ros.preferences.space import PreferenceSpace
from handover_ros.studies import feasible_shape
from handover_ros.studies.arm_courses import offering, seven_space
from handover_ros.studies.chapter4_settings import Chapter4Settings
from handover_ros.studies.heldout import choice
from handover_ros.studies.planar_courses import ARM, planar_query, planar_space
from handover_ros.studies.seeds import anybody, generator
from handover_ros.studies.tables import Rows

GRID = 60  # points of a likelihood function in each direction
BELIEVED = 500  # persons for the information of a feasible set
CENTRE = np.array([0.32, 0.12])  # [m] of the objects that differ only in shape
PAIRS = 200


def grid(space: PreferenceSpace, points: int = GRID) -> FloatArray:
    """Return points (points^2, 2) in the middle of cells over the bounds of a space of two coordinates."""
    share = (np.arange(points) + 0.5) / points
    lower, upper = space.bounds
    first, second = np.meshgrid(share, share, indexing="ij")
    return np.asarray(lower + np.column_stack([first.ravel(), second.ravel()]) * (upper - lower))


def shape_gallery(settings: Chapter4Settings, seed: int) -> list[PlanarObject]:
    """Return objects at the same place that differ in shape (figure 4.5)."""
    rng = generator(seed, "shapes")
    return _takeable(settings, lambda: replace(any_object(ARM, rng), centre=CENTRE))


def pose_gallery(settings: Chapter4Settings, seed: int) -> list[PlanarObject]:
    """Return an object at random poses (figure 4.6)."""
    rng = generator(seed, "poses")
    shape = random_planar_object(ARM, rng)
    return _takeable(
        settings,
        lambda: replace(shape, centre=any_object(ARM, rng).centre, turn=float(rng.uniform(-np.pi, np.pi))),
    )


def _takeable(settings: Chapter4Settings, make: Callable[[], PlanarObject]) -> list[PlanarObject]:
    """Return as many objects as the gallery shows, of those that can be taken."""
    found: list[PlanarObject] = []
    while len(found) < settings.gallery.objects:
        made = make()
        if len(made.feasible(ARM)) >= 3:
            found.append(made)
    return found


def planar_sets(settings: Chapter4Settings, seed: int) -> Rows:
    """Return shape and information of many random planar objects' feasible sets, for q* and for w."""
    rng = generator(seed, "planar_sets")
    rows: Rows = []
    spaces = {"neutral": planar_space(settings, "neutral"), "weights": planar_space(settings, "weights")}
    people = {name: space.people(space.spread(BELIEVED, rng)) for name, space in spaces.items()}
    even = np.full(BELIEVED, 1.0 / BELIEVED)
    for number in range(settings.gallery.looked_at):
        query = planar_query(random_planar_object(ARM, rng).feasible(ARM))
        told = {f"information_{name}": outlook(each, even, query).information for name, each in people.items()}
        rows.append({"kind": "planar", "object": f"object {number}"} | shape_of(query) | told)
    return rows


def arm_sets(settings: Chapter4Settings, seed: int) -> Rows:
    """Return shape and information of the feasible sets of handlebars and lock at random poses (figure 4.9)."""
    rng = generator(seed, "arm_sets")
    offers = offering(settings.arm)
    rows: Rows = []
    spaces = {"neutral": seven_space(settings, "neutral"), "weights": seven_space(settings, "weights")}
    people = {name: space.people(space.spread(BELIEVED, rng)) for name, space in spaces.items()}
    even = np.full(BELIEVED, 1.0 / BELIEVED)
    for _ in range(settings.gallery.looked_at // 2):
        for model in offers.models:
            query = offers.query(model, rng)
            told = {f"information_{name}": outlook(each, even, query).information for name, each in people.items()}
            rows.append({"kind": "arm", "object": model.name} | shape_of(query) | told)
    return rows


def shape_of(query: Query) -> dict[str, float | int]:
    """Return size, spread [rad] and number of parts of a feasible set."""
    q = query.configurations
    return {"size": len(q), "spread": feasible_shape.spread(q), "parts": feasible_shape.parts(q)}


def likelihood_distances(settings: Chapter4Settings, seed: int) -> Rows:
    """Return how far apart likelihood functions of q* are: of two objects, and of two answers to the same object.

    The person is the same in a pair. The distance is the total variation of the normalised likelihoods on a grid.
    """
    rng = generator(seed, "likelihoods")
    space = planar_space(settings, "neutral")
    points = space.people(grid(space))
    rows: Rows = []
    for kind, objects in (("shape", shape_gallery), ("pose", pose_gallery)):
        queries = [planar_query(each.feasible(ARM)) for each in objects(settings, seed)]
        for number in range(PAIRS):
            person = space.people(anybody(space, rng)[None])
            first, second = rng.choice(len(queries), 2, replace=False)
            functions = []
            for place in (first, first, second):
                answer = chosen(choice(queries[place], person, rng.random()))
                functions.append(_normalised(log_likelihood(points, queries[place], answer)))
            same, other = (0.5 * float(np.abs(functions[0] - each).sum()) for each in functions[1:])
            rows.append({"kind": kind, "pair": number, "same_object": same, "other_object": other})
    return rows


def _normalised(log: FloatArray) -> FloatArray:
    """Return a likelihood function (n,) that sums to one."""
    share = np.exp(log - log.max())
    return np.asarray(share / share.sum())


def likelihood_of(
    settings: Chapter4Settings, postures: FloatArray, level: float, truth: FloatArray
) -> tuple[int, FloatArray]:
    """Return which configuration a person with neutral posture ``truth`` (2,) takes, and the likelihood on the grid."""
    space, query = planar_space(settings, "neutral"), planar_query(postures)
    place = choice(query, space.people(truth[None]), level)
    return place, _normalised(log_likelihood(space.people(grid(space)), query, chosen(place)))
