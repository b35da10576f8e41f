"""The studies by name."""

from __future__ import annotations

from handover_ros.errors import BadRequestError, UnknownNameError
from handover_ros.studies.chapter4_study import CHAPTER4
from handover_ros.studies.study import Study

STUDIES = {study.name: study for study in (CHAPTER4,)}
TO_COME = ("chapter2", "chapter3", "all")  # names that a study will have


def study_named(name: str) -> Study:
    """Return a study.

    Raises:
        BadRequestError: It is not there yet.
        UnknownNameError: There is no such study.
    """
    if name in TO_COME and name not in STUDIES:
        raise BadRequestError(f"study {name}: is not there yet; there is {', '.join(STUDIES)}")
    if name not in STUDIES:
        raise UnknownNameError("study", name, [*STUDIES])
    return STUDIES[name]
