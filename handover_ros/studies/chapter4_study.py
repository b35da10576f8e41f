"""Chapter 4 as a study: its claims and figures."""

from __future__ import annotations

from pathlib import Path

from handover_ros.studies import chapter4, chapter4_claims
from handover_ros.studies.chapter4_curves import draw_learning, draw_objects, draw_users
from handover_ros.studies.chapter4_pictures import draw_all_pictures
from handover_ros.studies.chapter4_settings import Chapter4Settings, load_chapter4_settings
from handover_ros.studies.claims import Claim
from handover_ros.studies.study import Figure, Study
from handover_ros.studies.tables import Rows

CAPTIONS = {
    "4.2": "Planar arm of two joints: measures against the number of queries; bands: 95 % confidence of the mean.",
    "4.3": "Two artificial feasible sets, the truth, the person's choice, and its likelihood function (grey).",
    "4.4": "The belief (grey) after each query that active learning chooses from the two sets of figure 4.3.",
    "4.5": "Planar objects that differ only in shape; their feasible sets, a choice and its likelihood (grey).",
    "4.6": "One planar object at several poses; its feasible sets, a choice and its likelihood (grey).",
    "4.7": "Beliefs (grey) of active and passive learning with the same menu.",
    "4.8": "Arm of seven joints, handlebars and U-lock: measures against the number of queries.",
    "4.8b": "What each strategy offers to the arm of seven joints; the dashed line is the share of the menu.",
    "4.9": "An offer of each object: where the hand is, and the feasible set in four of seven joints.",
    "4.10": "Simulated user study, of which only the grasp region is seen.",
}


def settings(quick: bool) -> Chapter4Settings:
    """Return the settings, quick or in full."""
    loaded = load_chapter4_settings()
    return loaded.quickened() if quick else loaded


def claims(given: Chapter4Settings, tables: dict[str, Rows]) -> list[Claim]:
    """Return the claims."""
    return chapter4_claims.claims(tables, tuple(given.arm.grasps))


def figures(given: Chapter4Settings, tables: dict[str, Rows], seed: int, folder: Path) -> list[Figure]:
    """Draw all figures."""
    rows, objects = tables["learning"], tuple(given.arm.grasps)
    files = {
        "4.2": draw_learning(folder, rows, "planar", given.strategies, "figure_4_2_planar_learning"),
        **draw_all_pictures(folder, given, rows, seed),
        "4.8": draw_learning(folder, rows, "arm", given.strategies, "figure_4_8_arm_learning"),
        "4.8b": draw_objects(folder, rows, given.strategies, objects, "figure_4_8b_objects"),
        "4.10": draw_users(folder, rows, objects, "figure_4_10_user_study"),
    }
    return [Figure(number, CAPTIONS[number], tuple(files[number])) for number in CAPTIONS]


def notes(given: Chapter4Settings) -> list[str]:
    """Return what was simulated."""
    return [
        f"{given.people} simulated persons of each scenario answer by eq. 4.3 with rationality {given.rationality:g}; "
        "what they prefer is even over the bounds, as is the first belief. All strategies get the same persons, menus "
        "and chance.",
        f"Menus of {given.menu} queries; {given.particles} particles. Density and distance are those of the learned "
        "coordinates, which for w are logarithms.",
        "`active` is exact mutual information, `active_grid` the dissertation's grid entropy with the most likely "
        "answer (4.8), `hybrid` eq. 1.6.",
        "Before any answer (0 queries) the middle of the bounds stands for the mode.",
    ]


CHAPTER4 = Study(
    name="chapter4",
    title="Chapter 4: active learning of human ergonomic preferences",
    settings=settings,
    units=chapter4.units,
    work=chapter4.work,
    claims=claims,
    figures=figures,
    notes=notes,
)
