"""Chapter 2 as a study: its claims and figures."""

from __future__ import annotations

from pathlib import Path

from handover_ros.sim.person_spec import load_person
from handover_ros.studies import chapter2, chapter2_claims
from handover_ros.studies.chapter2_pictures import (
    draw_reprojection,
    draw_rotations,
    draw_sensitivity,
    draw_workspaces,
)
from handover_ros.studies.chapter2_settings import Chapter2Settings, load_chapter2_settings
from handover_ros.studies.claims import Claim
from handover_ros.studies.study import Figure, Study
from handover_ros.studies.tables import Rows

CAPTIONS = {
    "2.3r": "Median reprojection error of each marker in the calibration motions (section 2.3); bars: means.",
    "2.7": "Feasible workspaces of the dominant hand by the calibrated skeletons of the two neighbouring subjects "
    "whose restricted ones overlap least; torso frame, left hands mirrored.",
    "2.8": "Torso rotation at the handover, tracked through markers. Left: all trials, dashed: means. Right: means of "
    "subjects (grey), of all with 95 % confidence.",
    "2.8b": "Torso rotation if the simulated persons choose their postures by other costs; 95 % confidence of the mean "
    "of subjects.",
}


def settings(quick: bool) -> Chapter2Settings:
    """Return the settings, quick or in full."""
    loaded = load_chapter2_settings()
    return loaded.quickened() if quick else loaded


def claims(given: Chapter2Settings, tables: dict[str, Rows]) -> list[Claim]:
    """Return the claims."""
    return chapter2_claims.claims(tables, tuple(given.tastes), given.alike, load_person(given.like).stature)


def figures(given: Chapter2Settings, tables: dict[str, Rows], seed: int, folder: Path) -> list[Figure]:
    """Draw all figures."""
    files = {
        "2.3r": draw_reprojection(folder, tables["reprojection"]),
        "2.7": draw_workspaces(folder, given, tables["workspaces"], seed),
        "2.8": draw_rotations(folder, tables["trials"]),
        "2.8b": draw_sensitivity(folder, tables["trials"], tuple(given.tastes)),
    }
    return [Figure(number, CAPTIONS[number], tuple(files[number])) for number in CAPTIONS]


def notes(given: Chapter2Settings) -> list[str]:
    """Return what was simulated."""
    markers, low, high = given.markers, *given.subject.stature
    return [
        f"{given.subjects} simulated subjects of {low:g} to {high:g} m, with limbs, limits, handedness and comfort of "
        f"their own, free and with the dominant arm within the limits of person `{given.strap}` (shifted by up to "
        f"{given.subject.strap_shift:g} rad). Feet stay on their marks.",
        f"Each is calibrated anew in both conditions from markers at {markers.rate:g} Hz with {1e3 * markers.noise:g} "
        f"mm of noise and {1e3 * markers.skin:g} mm of skin motion a coordinate, {100 * markers.missing:g} % missing. "
        "The errors of real skin, joints and suits are not known here: the reprojection error tells what was put in.",
        f"{given.repetitions} trials of each scheme in random order, each planned for the person as tracked then, with "
        f"the reach and the paths of the robot checked, object `{given.object}` taken with both hands. No physics: the "
        "person goes smoothly to the posture they choose.",
        "That posture has the least cost of the whole upper body, of weighted squared displacements from a comfortable "
        f"posture; the planner knows neither weights nor that posture. Costs: {', '.join(given.tastes)}; claims are "
        "about the first one where they do not name another. Offers are the same for all.",
        "Torso rotation: how far the tracked torso (unscented Kalman filter on the calibrated skeleton) has turned "
        "about the vertical between standing before the trial and the handover, either way.",
        "Tests by subject compare their means; pooled trials, as in the dissertation, count each subject many times.",
    ]


CHAPTER2 = Study(
    name="chapter2",
    title="Chapter 2: personalized kinematic models for handovers",
    settings=settings,
    units=chapter2.units,
    work=chapter2.work,
    claims=claims,
    figures=figures,
    notes=notes,
)
