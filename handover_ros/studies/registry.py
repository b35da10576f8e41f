"""The studies by name."""

from __future__ import annotations

from handover_ros.errors import UnknownNameError
from handover_ros.studies.beyond_study import BEYOND
from handover_ros.studies.chapter2_study import CHAPTER2
from handover_ros.studies.chapter3_study import CHAPTER3
from handover_ros.studies.chapter4_study import CHAPTER4
from handover_ros.studies.study import Study

STUDIES = {study.name: study for study in (CHAPTER2, CHAPTER3, CHAPTER4, BEYOND)}
ALL = "all"  # the name of all of them


def study_named(name: str) -> Study:
    """Return a study.

    Raises:
        UnknownNameError: There is no such study.
    """
    if name not in STUDIES:
        raise UnknownNameError("study", name, [*STUDIES, ALL])
    return STUDIES[name]
