"""Feasible workspaces of chapter 2 subjects (figure 2.7), and how much of them two subjects share."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from handover_ros.arm.workspace import Workspace, hand_workspace
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.studies.chapter2_markers import known
from handover_ros.studies.chapter2_settings import Chapter2Settings
from handover_ros.studies.chapter2_subjects import CONDITIONS, Condition, subject
from handover_ros.studies.tables import Rows


def mirrored(workspace: Workspace) -> Workspace:
    """Return the volume as seen in the plane between left and right."""
    corner = workspace.corner.copy()
    corner[1] = -(workspace.corner[1] + workspace.filled.shape[1])
    return Workspace(workspace.voxel, corner, workspace.filled[:, ::-1])


def rear(workspace: Workspace) -> float:
    """Return the volume [litres] behind the shoulders."""
    return float((workspace.centres[:, 0] < 0.0).sum() * workspace.voxel**3 * 1e3)


def workspace(
    settings: Chapter2Settings, number: int, seed: int, condition: Condition, true: bool = False
) -> Workspace:
    """Return where the dominant hand of a subject reaches, torso frame, as if it were the right one.

    Args:
        settings: Of the study.
        number: Of the subject.
        seed: Of the study.
        condition: Free or strapped.
        true: Of the simulated body instead of the calibrated skeleton.
    """
    return _workspace(settings.model_dump_json(), number, seed, condition, true)


@lru_cache(maxsize=16)
def _workspace(content: str, number: int, seed: int, condition: Condition, true: bool) -> Workspace:
    """Return the workspace; settings are given as text because that can be remembered."""
    settings = Chapter2Settings.model_validate_json(content)
    person = subject(settings, number, seed, condition)
    skeleton = skeleton_of(person) if true else known(settings, number, seed, condition).skeleton
    found = hand_workspace(skeleton, person.dominant, settings.workspace_voxel, seed)
    return mirrored(found) if person.dominant == "left" else found


def workspace_rows(settings: Chapter2Settings, number: int, seed: int) -> Rows:
    """Return what a subject's workspaces are like, and how they compare with the next subject's."""
    rows: Rows = []
    other = (number + 1) % settings.subjects
    for condition in CONDITIONS:
        own = workspace(settings, number, seed, condition)
        next_one = workspace(settings, other, seed, condition)
        truth = workspace(settings, number, seed, condition, true=True)
        rows.append(
            {
                "subject": number,
                "other": other,
                "condition": condition,
                "litres": own.litres,
                "true_litres": truth.litres,
                "other_litres": next_one.litres,
                "rear_litres": rear(own),
                "true_rear_litres": rear(truth),
                "other_rear_litres": rear(next_one),
                "shared": float(own.overlap(next_one).filled.sum() / np.maximum(own.union(next_one).filled.sum(), 1)),
                "found_of_truth": float(own.overlap(truth).filled.sum() / truth.filled.sum()),
            }
        )
    return rows
