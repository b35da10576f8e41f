"""A query: what a person can choose from when an object is offered; an answer: what is known of their choice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from handover_ros.errors import BadRequestError
from handover_ros.geometry import FloatArray

IntArray = npt.NDArray[np.int64]
SPREAD = 0.05  # [rad] of a posture whose uncertainty is not known: tracking, and the distance to the next sample
FARTHEST = 5.0  # standard deviations from the nearest configuration at which a posture is not an answer
LEAST_SHARE = 1e-9  # of the likeliest configuration, below which one is not regarded


@dataclass(frozen=True, eq=False)
class Query:
    """The feasible set of one offered handover, as samples.

    Attributes:
        configurations: Arm displacements [rad], shape (k, d), k > 0.
        measures: What each stands for, > 0, shape (k,): the length of arc, times what is known of its attraction.
        region: Number of the grasp region of each, shape (k,).
        regions: Names of the grasp regions.
        name: For people: the object and how it is offered.
    """

    configurations: FloatArray
    measures: FloatArray
    region: IntArray
    regions: tuple[str, ...]
    name: str = ""
    rows: FloatArray = field(init=False, repr=False)  # (d, k), for the kernels
    attraction: FloatArray = field(init=False, repr=False)  # log of the measures (k,)

    def __post_init__(self) -> None:
        """Check the set and make the arrays read-only.

        Raises:
            BadRequestError: It is empty, a number is not finite, or shapes do not fit.
        """
        q = np.array(self.configurations, dtype=float)
        measures, region = np.array(self.measures, dtype=float), np.array(self.region, dtype=np.int64)
        what = f"query {self.name}" if self.name else "query"
        if q.ndim != 2 or not q.size:
            raise BadRequestError(f"{what}: the feasible set is empty; the person cannot take the object there")
        if measures.shape != q.shape[:1] or region.shape != q.shape[:1]:
            raise BadRequestError(
                f"{what}: {len(q)} configurations need as many measures and regions, got {measures.shape} and "
                f"{region.shape}"
            )
        if not np.isfinite(q).all() or not np.isfinite(measures).all() or (measures <= 0.0).any():
            raise BadRequestError(f"{what}: configurations must be finite, measures finite and positive")
        if region.min() < 0 or region.max() >= len(self.regions):
            raise BadRequestError(
                f"{what}: region numbers must lie below {len(self.regions)}, got up to {region.max()}"
            )
        arrays = {"configurations": q, "measures": measures, "region": region}
        for name, array in {**arrays, "rows": np.ascontiguousarray(q.T), "attraction": np.log(measures)}.items():
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        """Return the number of configurations."""
        return len(self.configurations)


@dataclass(frozen=True)
class Chart:
    """Coordinates in which tracked and feasible postures are compared.

    Attributes:
        offsets: Of a posture (d,) and configurations (k, d): how far they are apart, (k, d) [rad].
        jacobian: Of a posture (d,): derivative of the offsets with respect to the configuration, there (d, d).
    """

    offsets: Callable[[FloatArray, FloatArray], FloatArray]
    jacobian: Callable[[FloatArray], FloatArray]


ANGLES = Chart(lambda posture, configurations: configurations - posture, lambda posture: np.eye(len(posture)))


@dataclass(frozen=True, eq=False)
class Answer:
    """What is known of a choice: how well each configuration of the query explains what was seen.

    Attributes:
        places: Configurations that may have been chosen, shape (m,).
        shares: Likelihood of what was seen, given each of them, > 0, shape (m,); only ratios matter.
    """

    places: IntArray
    shares: FloatArray


def chosen(place: int) -> Answer:
    """Return the answer of which the configuration is known exactly."""
    return Answer(np.array([place]), np.ones(1))


def region_answer(query: Query, region: str) -> Answer:
    """Return the answer of which only the grasp region is known: any of its configurations (exact, no substitute).

    Raises:
        BadRequestError: The query has no configuration in such a region.
    """
    if region not in query.regions:
        raise BadRequestError(f"region {region!r}: not on offer; the query has {', '.join(query.regions)}")
    places = np.flatnonzero(query.region == query.regions.index(region))
    if not len(places):
        raise BadRequestError(f"region {region!r}: the person cannot take the object there in this query")
    return Answer(places, np.ones(len(places)))


def posture_answer(
    query: Query,
    posture: npt.ArrayLike,
    covariance: npt.ArrayLike | None = None,
    region: str = "",
    spread: float = SPREAD,
    chart: Chart = ANGLES,
) -> Answer:
    """Return the answer of a tracked posture: the feasible configurations near it, by their likelihood.

    Args:
        query: The offer.
        posture: As tracked (d,) [rad].
        covariance: Of the tracked posture (d, d) [rad2].
        region: Grasp region, if it is known; empty: any.
        spread: Standard deviation [rad] that is added for what lies between the samples, and for the model.
        chart: What tells postures apart.

    Raises:
        BadRequestError: Not finite, of another size, or far from everything that was feasible.
    """
    q = np.asarray(posture, dtype=float)
    size = query.configurations.shape[1]
    if q.shape != (size,) or not np.isfinite(q).all():
        raise BadRequestError(f"posture: needs {size} finite displacements [rad], got {np.asarray(posture).tolist()}")
    spreading = np.eye(size) * spread**2
    if covariance is not None:
        given = np.asarray(covariance, dtype=float)
        if given.shape != (size, size) or not np.isfinite(given).all() or np.linalg.eigvalsh(given).min() < -1e-9:
            raise BadRequestError(f"covariance: needs a finite, positive semidefinite ({size}, {size}) matrix [rad2]")
        jacobian = chart.jacobian(q)
        spreading = spreading + jacobian @ given @ jacobian.T
    places = np.arange(len(query)) if not region else region_answer(query, region).places
    offsets = chart.offsets(q, query.configurations[places])
    squared = np.einsum("ki,ki->k", offsets, np.linalg.solve(spreading, offsets.T).T)
    if squared.min() > FARTHEST**2 * size:
        nearest = float(np.linalg.norm(offsets, axis=1).min())
        raise BadRequestError(
            f"posture: {nearest:.2f} rad from the nearest of {len(places)} feasible configurations"
            f"{f' of region {region}' if region else ''}: not an answer to this offer (limit "
            f"{FARTHEST * np.sqrt(size):.0f} standard deviations)"
        )
    shares = np.exp(-0.5 * (squared - squared.min()))
    kept = shares >= LEAST_SHARE
    return Answer(places[kept], shares[kept])
