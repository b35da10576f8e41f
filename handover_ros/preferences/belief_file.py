"""Beliefs as files: one a person, written whole or not at all, checked when read.

A file is a ZIP archive of NumPy arrays (``.npz``, no pickles), so that a file cut short shows in its checksums; the
array ``header`` is JSON with the version, whose belief it is, what is learned, and which handovers were counted.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from handover_ros.errors import BadModelError, HandoverError
from handover_ros.files import write_whole
from handover_ros.geometry import FloatArray
from handover_ros.preferences.belief import Belief, Observation, Summary
from handover_ros.preferences.prior import Normal, Prior
from handover_ros.preferences.query import Answer, Query
from handover_ros.preferences.space import PreferenceSpace
from handover_ros.yaml_file import Schema

VERSION = 1
SUFFIX = ".npz"
MOST_BYTES = 512 * 2**20


class _Header(Schema):
    """Content of the array ``header``."""

    version: int
    profile_id: str
    joints: tuple[str, ...]
    rationality_bounds: tuple[float, float]
    log_evidence: float
    observations: int
    retention: float
    seed: int
    summary_log_mass: float | None
    remembered: tuple[tuple[str, tuple[str, ...]], ...]
    handover_ids: tuple[str, ...]
    surprises: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class PersonBelief:
    """The belief about one person, with what keeps it in order.

    Attributes:
        profile_id: Whose.
        belief: What is believed.
        handover_ids: Of all answers taken in; one is counted once.
        surprises: ``surprise.unlikeliness`` of the answers, the newest last.
    """

    profile_id: str
    belief: Belief
    handover_ids: tuple[str, ...] = ()
    surprises: tuple[float, ...] = ()


def write_belief(path: Path, person: PersonBelief) -> None:
    """Write a belief whole or not at all.

    Raises:
        OSError: The folder cannot be written to, or the disk is full; the old file is as it was.
    """
    buffer = io.BytesIO()
    np.savez(buffer, **_arrays(person))
    write_whole(path, buffer.getvalue())


def read_belief(path: Path, profile_id: str) -> PersonBelief:
    """Return the belief about one person.

    Raises:
        BadModelError: The file is cut short, of another version or another person, or its numbers do not fit.
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise BadModelError(f"{path}: larger than {MOST_BYTES >> 20} MiB; this is no belief")
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except BadModelError:
        raise
    except Exception as error:  # zipfile, zlib and NumPy raise a dozen kinds for a damaged archive
        raise BadModelError(f"{path}: cannot be read as a belief, it may be cut short ({error})") from None
    try:
        person = _person(arrays)
    except ValidationError as error:
        first = error.errors()[0]
        raise BadModelError(f"{path}: header: {'.'.join(map(str, first['loc']))}: {first['msg']}") from None
    except HandoverError as error:
        raise BadModelError(f"{path}: {error}") from None
    except (KeyError, ValueError, TypeError) as error:
        raise BadModelError(f"{path}: is no belief: {error!r}") from None
    if person.profile_id != profile_id:
        raise BadModelError(f"{path}: is the belief about {person.profile_id!r}, not about {profile_id!r}")
    return person


def _arrays(person: PersonBelief) -> dict[str, Any]:
    """Return all arrays of a file."""
    belief, space = person.belief, person.belief.prior.space
    header = _Header(
        version=VERSION,
        profile_id=person.profile_id,
        joints=space.joints,
        rationality_bounds=space.rationality_bounds,
        log_evidence=belief.log_evidence,
        observations=belief.observations,
        retention=belief.retention,
        seed=belief.seed,
        summary_log_mass=None if belief.summary is None else belief.summary.log_mass,
        remembered=tuple((each.query.name, each.query.regions) for each in belief.history),
        handover_ids=person.handover_ids,
        surprises=person.surprises,
    )
    arrays: dict[str, Any] = {
        "header": np.array(header.model_dump_json()),
        "neutral_bounds": space.neutral_bounds,
        "weight_bounds": space.weight_bounds,
        "particles": belief.particles,
        "log_weights": belief.log_weights,
        "fit": belief.fit,
    }
    for name, normal in (
        ("population", belief.prior.population),
        ("summary", None if belief.summary is None else belief.summary.posterior),
    ):
        if normal is not None:
            arrays |= {f"{name}_mean": normal.mean, f"{name}_covariance": normal.covariance}
    for number, each in enumerate(belief.history):
        arrays |= {
            f"configurations_{number}": each.query.configurations,
            f"measures_{number}": each.query.measures,
            f"region_{number}": each.query.region,
            f"places_{number}": each.answer.places,
            f"shares_{number}": each.answer.shares,
        }
    return arrays


def _person(arrays: Mapping[str, Any]) -> PersonBelief:
    """Return the belief of a file's arrays."""
    text = str(arrays["header"])
    version = json.loads(text).get("version")
    if version != VERSION:
        raise BadModelError(f"version: is {version}, this program reads {VERSION}")
    header = _Header.model_validate_json(text)
    space = PreferenceSpace(header.joints, arrays["neutral_bounds"], arrays["weight_bounds"], header.rationality_bounds)
    prior = Prior(space, _normal(arrays, "population"))
    summary = None
    if header.summary_log_mass is not None:
        posterior = _normal(arrays, "summary")
        if posterior is None:
            raise BadModelError("summary_mean: is missing")
        summary = Summary(posterior, header.summary_log_mass)
    particles = _finite(arrays, "particles", (-1, space.bounds.shape[1]))
    count = len(particles)
    history = tuple(_observation(arrays, number, *each) for number, each in enumerate(header.remembered))
    if not 0.0 < header.retention <= 1.0 or count < 2:
        raise BadModelError(f"retention {header.retention} or number of particles {count} is out of range")
    belief = Belief(
        prior,
        particles,
        _finite(arrays, "log_weights", (count,)),
        _finite(arrays, "fit", (count,)),
        header.log_evidence,
        history,
        summary,
        header.observations,
        header.retention,
        header.seed,
    )
    if abs(belief.weights.sum() - 1.0) > 1e-6:
        raise BadModelError(f"log_weights: the weights sum to {belief.weights.sum():g}, not to 1")
    return PersonBelief(header.profile_id, belief, header.handover_ids, header.surprises)


def _observation(arrays: Mapping[str, Any], number: int, name: str, regions: tuple[str, ...]) -> Observation:
    """Return one remembered answer."""
    query = Query(
        arrays[f"configurations_{number}"], arrays[f"measures_{number}"], arrays[f"region_{number}"], regions, name
    )
    places = np.asarray(arrays[f"places_{number}"], dtype=np.int64)
    shares = _finite(arrays, f"shares_{number}", places.shape)
    if not places.size or places.min() < 0 or places.max() >= len(query) or (shares <= 0.0).any():
        raise BadModelError(f"places_{number}: do not fit the query")
    return Observation(query, Answer(places, shares))


def _normal(arrays: Mapping[str, Any], name: str) -> Normal | None:
    """Return a stored normal distribution, or None."""
    if f"{name}_mean" not in arrays:
        return None
    mean = _finite(arrays, f"{name}_mean", (-1,))
    covariance = _finite(arrays, f"{name}_covariance", (len(mean), len(mean)))
    if np.linalg.eigvalsh(covariance).min() <= 0.0:
        raise BadModelError(f"{name}_covariance: is not positive definite")
    return Normal(mean, covariance)


def _finite(arrays: Mapping[str, Any], name: str, shape: tuple[int, ...]) -> FloatArray:
    """Return an array of finite numbers of a shape; -1: any length."""
    array = np.asarray(arrays[name], dtype=float)
    fits = array.ndim == len(shape) and all(want in (-1, have) for want, have in zip(shape, array.shape))
    if not fits or not np.isfinite(array).all():
        raise BadModelError(f"{name}: needs finite numbers of shape {shape}, got shape {array.shape}")
    return array
