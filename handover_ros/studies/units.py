"""A study in units that are worked on in any order, by any number of processes, and kept one file each."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed
from threadpoolctl import threadpool_limits

from handover_ros.errors import BadRequestError
from handover_ros.files import write_whole
from handover_ros.yaml_file import Schema

FORMAT = 1  # of the files; another one is not read
Found = dict[str, list[dict[str, Any]]]  # rows by table


@dataclass(frozen=True)
class Unit:
    """A part of a study that needs no other part.

    Attributes:
        scenario: What kind of part.
        number: Which one of its kind, e.g. the simulated person.
    """

    scenario: str
    number: int

    @property
    def name(self) -> str:
        """Of its file."""
        return f"{self.scenario}-{self.number:04d}"


Work = Callable[[Any, Unit, int], Found]  # settings, unit, seed; a module's function, so that processes can be sent it


@dataclass(frozen=True)
class UnitStore:
    """What finished units found, in a folder of their own for every seed and every content of the settings.

    Attributes:
        folder: Of the files.
    """

    folder: Path

    def read(self, unit: Unit) -> Found | None:
        """Return what a unit found; None if it is not finished or its file is damaged."""
        try:
            content = json.loads((self.folder / f"{unit.name}.json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        return content["found"] if isinstance(content, dict) and content.get("format") == FORMAT else None

    def write(self, unit: Unit, found: Found) -> None:
        """Keep what a unit found; whole or not at all."""
        write_whole(self.folder / f"{unit.name}.json", json.dumps({"format": FORMAT, "found": found}))


def unit_store(folder: Path, study: str, settings: Schema, seed: int) -> UnitStore:
    """Return where the units of a study are kept in its output folder."""
    content = f"{FORMAT} {study} {seed} {settings.model_dump_json()}"
    return UnitStore(folder / "units" / f"{study}-{hashlib.sha256(content.encode()).hexdigest()[:12]}")


def work_on(
    units: Sequence[Unit],
    work: Work,
    settings: Schema,
    seed: int,
    store: UnitStore,
    jobs: int,
    told: Callable[[int, int], None],
) -> list[Found]:
    """Return what all units found, in their order; those that are kept are not worked on again.

    Args:
        units: All of them.
        work: What is done for one.
        settings: Of the study.
        seed: Of all random numbers.
        store: Where they are kept.
        jobs: Number of processes; 1: this one.
        told: Is given the number of finished units and of all, whenever one is finished.

    Raises:
        BadRequestError: The folder cannot be written to.
    """
    missing = [unit for unit in units if store.read(unit) is None]
    done = len(units) - len(missing)
    told(done, len(units))
    try:
        # A backend that the caller has set, such as Dask's, is used instead of joblib's own processes.
        finished = Parallel(n_jobs=jobs, return_as="generator", pre_dispatch="2*n_jobs")(
            delayed(_work_on_one)(work, settings, unit, seed, store) for unit in missing
        )
        for _ in finished:
            done += 1
            told(done, len(units))
    except OSError as error:
        raise BadRequestError(f"{store.folder}: cannot be written to: {error.strerror or error}") from None
    found = [store.read(unit) for unit in units]
    if any(each is None for each in found):
        raise BadRequestError(f"{store.folder}: files have gone while the study ran; run it again")
    return [each for each in found if each is not None]


def _work_on_one(work: Work, settings: Schema, unit: Unit, seed: int, store: UnitStore) -> None:
    """Work on one unit and keep what it found.

    One thread for matrix products: their rounding depends on the number of threads, which depends on ``jobs``.
    """
    with threadpool_limits(1, user_api="blas"):
        store.write(unit, work(settings, unit, seed))
