"""Chapter 3, planning for what people choose: its units of work."""

from __future__ import annotations

from handover_ros.studies.chapter3_cases import case_rows
from handover_ros.studies.chapter3_conditions import metric_rows, mismatch_rows
from handover_ros.studies.chapter3_settings import Chapter3Settings
from handover_ros.studies.chapter3_users import PROGRAMS, user_rows
from handover_ros.studies.units import Found, Unit

CASES, METRICS, MISMATCH, USERS = "cases", "metrics", "mismatch", "users"


def units(settings: Chapter3Settings) -> list[Unit]:
    """Return all parts: a person of the case studies, an object and goal, a goal of everything else."""
    metrics, mismatch, users = settings.metrics, settings.mismatch, settings.user_studies
    return [
        *(Unit(CASES, person) for person in range(settings.case_study.people)),
        *(Unit(f"{METRICS}_{name}", goal) for name in metrics.objects for goal in range(metrics.goals)),
        *(Unit(f"{MISMATCH}_{attitude}", goal) for attitude in mismatch.attitudes for goal in range(mismatch.goals)),
        *(Unit(f"{USERS}_{study}", goal) for study in PROGRAMS for goal in range(users.goals)),
    ]


def work(settings: Chapter3Settings, unit: Unit, seed: int) -> Found:
    """Return what one part found."""
    if unit.scenario == CASES:
        return case_rows(settings, unit.number, seed)
    kind, _, name = unit.scenario.partition("_")
    if kind == METRICS:
        return metric_rows(settings, name, unit.number, seed)
    if kind == MISMATCH:
        return mismatch_rows(settings, "any" if name == "any" else "upright", unit.number, seed)
    return user_rows(settings, name, unit.number, seed)
