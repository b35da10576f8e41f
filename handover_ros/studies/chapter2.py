"""Chapter 2, personalized kinematic models: its units of work."""

from __future__ import annotations

from handover_ros.studies.chapter2_markers import known
from handover_ros.studies.chapter2_settings import Chapter2Settings
from handover_ros.studies.chapter2_subjects import CONDITIONS, Condition, subject
from handover_ros.studies.chapter2_trials import run_trials
from handover_ros.studies.chapter2_workspaces import workspace_rows
from handover_ros.studies.tables import Rows
from handover_ros.studies.units import Found, Unit

WORKSPACE = "workspace"
TORSO = ("CHEST", "BACK")  # how names of markers that are not on the arms begin


def units(settings: Chapter2Settings) -> list[Unit]:
    """Return all parts of the study: each subject's trials in each condition, and each subject's workspaces."""
    people = range(settings.subjects)
    trials = [Unit(condition, number) for number in people for condition in CONDITIONS]
    return trials + [Unit(WORKSPACE, number) for number in people]


def work(settings: Chapter2Settings, unit: Unit, seed: int) -> Found:
    """Return what one part found."""
    if unit.scenario == WORKSPACE:
        return {"workspaces": workspace_rows(settings, unit.number, seed)}
    condition: Condition = "free" if unit.scenario == "free" else "strapped"
    return {
        "reprojection": reprojection_rows(settings, unit.number, seed, condition),
        "trials": run_trials(settings, unit.number, seed, condition),
    }


def reprojection_rows(settings: Chapter2Settings, number: int, seed: int, condition: Condition) -> Rows:
    """Return the median reprojection error [mm] of each marker in the calibration motions of a subject."""
    person, found = subject(settings, number, seed, condition), known(settings, number, seed, condition)
    return [
        {
            "subject": number,
            "condition": condition,
            "stature": person.stature,
            "dominant": person.dominant,
            "marker": name,
            "arm": not name.startswith(TORSO),
            "median_mm": 1e3 * median,
            "problems": len(found.problems),
            "attempts": found.attempts,
        }
        for name, median in found.medians.items()
    ]
