"""The loop as a whole as a study: its questions, answered by tests, and its figures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.studies import beyond
from handover_ros.studies.beyond_settings import BeyondSettings, load_beyond_settings
from handover_ros.studies.claims import Claim, settled
from handover_ros.studies.figure_style import COLOURS, NAMES, draw_band, save, styled
from handover_ros.studies.statistics import Comparison, interval, paired
from handover_ros.studies.study import Figure, Study
from handover_ros.studies.tables import Rows, column, only

ASKED = "not asked there"
CAPTIONS = {
    "B.1": "True expected cost of the planned handovers, over that of planning with the truth, while a strategy "
    "teaches; bands: 95 % confidence of the mean.",
    "B.2": "What a strategy costs the person while it teaches, against how well is planned afterwards.",
    "B.3": "The whole loop and each part left out; bars: 95 % confidence of the mean.",
    "B.4": "Postures seen against grasp regions seen, with the same strategy.",
}


def settings(quick: bool) -> BeyondSettings:
    """Return the settings, quick or in full."""
    loaded = load_beyond_settings()
    return loaded.quickened() if quick else loaded


def curve(rows: Rows, measure: str, strategy: str, answers: str = "posture") -> FloatArray:
    """Return a measure by person and handover (people, handovers + 1), NaN where there is none."""
    kept = only(rows, strategy=strategy, answers=answers)
    people, steps = sorted({row["person"] for row in kept}), sorted({row["handover"] for row in kept})
    table = np.full((len(people), len(steps)), np.nan)
    for row, value in zip(kept, column(kept, measure)):
        table[people.index(row["person"]), steps.index(row["handover"])] = value
    return table


def part(rows: Rows, condition: str) -> FloatArray:
    """Return the cost over that of planning with the truth, of every person (people,)."""
    return column(only(rows, condition=condition), "cost")


def claims(given: BeyondSettings, tables: dict[str, Rows]) -> list[Claim]:
    """Return what was asked and what came out."""
    courses, parts = tables["courses"], tables["parts"]
    found = []
    for condition in list(beyond.PARTS)[2:]:
        test = paired(part(parts, "whole loop"), part(parts, condition), "less")
        found.append(_claim(f"loop_{condition}", f"The whole loop costs the person less than {condition}", parts, test))
    last = {strategy: curve(courses, "planned", strategy)[:, -1] for strategy in given.strategies}
    paid = {strategy: np.nanmean(curve(courses, "paid", strategy)[:, 1:], axis=1) for strategy in given.strategies}
    postures = curve(courses, "planned", beyond.BEST)[:, 1:].mean(axis=1)
    regions = curve(courses, "planned", beyond.BEST, "region")[:, 1:].mean(axis=1)
    questions = [
        ("postures", "Seen postures teach faster than seen grasp regions (cost planned, mean of all handovers)",
         postures, regions),
        ("value", "Asking for what plans need (active_value) ends with better plans than asking for most information "
         "(active)", last["active_value"], last["active"]),
        ("active", "Asking for most information (active) ends with better plans than taking what is comfortable "
         "(passive)", last["active"], last["passive"]),
        ("hybrid_plans", "The hybrid strategy (1.6) ends with better plans than the passive one", last["hybrid"],
         last["passive"]),
        ("hybrid_cost", "The hybrid strategy (1.6) costs the person less than the active one while it teaches",
         paid["hybrid"], paid["active"]),
    ]  # fmt: skip
    for name, text, first, second in questions:
        test = paired(first, second, "less")
        found.append(_told(name, text, first, second, test))
    return found


def _claim(name: str, text: str, parts: Rows, test: Comparison) -> Claim:
    """Return a question about a part that is left out."""
    condition = name.removeprefix("loop_")
    missed = column(only(parts, condition=condition), "missed").sum()
    ours = (
        f"{part(parts, 'whole loop').mean():.3f} against {part(parts, condition).mean():.3f} of the cost of planning "
        f"with the truth ({missed:.0f} objects could not be taken); {test.told()}"
    )
    return settled(name.replace(" ", "_"), 0, text, ASKED, ours, [test])


def _told(name: str, text: str, first: FloatArray, second: FloatArray, test: Comparison) -> Claim:
    """Return a question about two strategies."""
    return settled(name, 0, text, ASKED, f"{first.mean():.3f} against {second.mean():.3f}; {test.told()}", [test])


def figures(given: BeyondSettings, tables: dict[str, Rows], seed: int, folder: Path) -> list[Figure]:
    """Draw all figures."""
    courses, parts = tables["courses"], tables["parts"]
    files = {
        "B.1": _draw_curves(folder, courses, given.strategies),
        "B.2": _draw_trade(folder, courses, given.strategies),
        "B.3": _draw_parts(folder, parts),
        "B.4": _draw_answers(folder, courses),
    }
    return [Figure(number, CAPTIONS[number], tuple(files[number])) for number in CAPTIONS]


def _draw_curves(folder: Path, rows: Rows, strategies: Sequence[str]) -> list[Path]:
    with styled() as pyplot:
        figure, axes = pyplot.subplots(figsize=(6.0, 3.6), layout="constrained")
        for strategy in strategies:
            table = curve(rows, "planned", strategy)
            draw_band(axes, np.arange(table.shape[1]), table, strategy)
        axes.axhline(1.1, color="#999999", linestyle="--", linewidth=0.8)
        axes.set_xlabel("handovers")
        axes.xaxis.get_major_locator().set_params(integer=True)
        axes.set_ylabel("cost planned / with the truth")
        axes.legend(frameon=False)
        return save(pyplot, figure, folder, "figure_b_1_planned_cost")


def _draw_trade(folder: Path, rows: Rows, strategies: Sequence[str]) -> list[Path]:
    with styled() as pyplot:
        figure, axes = pyplot.subplots(figsize=(5.0, 3.6), layout="constrained")
        for strategy in strategies:
            paid = np.nanmean(curve(rows, "paid", strategy)[:, 1:], axis=1)
            last = curve(rows, "planned", strategy)[:, -1]
            spans = [[[mean - low], [high - mean]] for mean, (low, high) in (_span(paid), _span(last))]
            axes.errorbar(
                paid.mean(), last.mean(), xerr=spans[0], yerr=spans[1], fmt="o", color=COLOURS[strategy], capsize=3,
                label=NAMES.get(strategy, strategy),
            )  # fmt: skip
        axes.set_xlabel("true cost paid in each handover while learning")
        axes.set_ylabel("cost planned afterwards / with the truth")
        axes.legend(frameon=False)
        return save(pyplot, figure, folder, "figure_b_2_trade")


def _span(values: FloatArray) -> tuple[float, tuple[float, float]]:
    """Return the mean and the ends of its confidence interval."""
    return float(values.mean()), interval(values)


def _draw_parts(folder: Path, rows: Rows) -> list[Path]:
    with styled() as pyplot:
        figure, axes = pyplot.subplots(figsize=(6.0, 3.2), layout="constrained")
        for place, condition in enumerate(beyond.PARTS):
            mean, (low, high) = _span(part(rows, condition))
            axes.barh(place, mean, color="#0072b2" if condition == "whole loop" else "#b0b0b0")
            axes.errorbar(mean, place, xerr=[[mean - low], [high - mean]], color="#222222", capsize=3)
        axes.set_yticks(range(len(beyond.PARTS)), list(beyond.PARTS))
        axes.invert_yaxis()
        axes.axvline(1.0, color="#222222", linewidth=0.8)
        axes.set_xlabel("true cost of the planned handovers / with the truth")
        return save(pyplot, figure, folder, "figure_b_3_parts")


def _draw_answers(folder: Path, rows: Rows) -> list[Path]:
    with styled() as pyplot:
        figure, axes = pyplot.subplots(figsize=(5.0, 3.2), layout="constrained")
        for answers, style in (("posture", "-"), ("region", "--")):
            table = curve(rows, "planned", beyond.BEST, answers)
            axes.plot(table.mean(axis=0), style, color=COLOURS[beyond.BEST], label=f"{answers}s seen")
            ends = np.array([interval(each) for each in table.T])
            axes.fill_between(np.arange(len(ends)), *ends.T, color=COLOURS[beyond.BEST], alpha=0.12, linewidth=0.0)
        axes.set_xlabel("handovers")
        axes.xaxis.get_major_locator().set_params(integer=True)
        axes.set_ylabel("cost planned / with the truth")
        axes.legend(frameon=False)
        return save(pyplot, figure, folder, "figure_b_4_answers")


def notes(given: BeyondSettings) -> list[str]:
    """Return what was simulated."""
    return [
        f"{given.people} simulated persons with limbs, ranges of motion, neutral postures and joint weights of their "
        f"own choose by eq. 4.3 with rationality {given.rationality:g}. Each is calibrated from noisy markers; every "
        "choice is read from markers by the tracking filter. There is no physics.",
        f"{given.handovers} handovers a strategy, from an uninformed belief; menus of {given.per_object} offers of "
        f"each of {', '.join(given.asked)}. Judged are the plans for {', '.join(given.judged)} with the scene's goals: "
        "true expected total cost (3.7).",
        f"What a person cannot take counts {given.missed:g} times the cost of planning with the truth. `without "
        "calibration` plans for anybody's arm with the preference that was learned with the calibrated one.",
        "These questions are not the dissertation's; the verdict says whether the expected answer came out.",
    ]


BEYOND = Study(
    name="beyond",
    title="Beyond: the whole loop, and each part left out",
    settings=settings,
    units=beyond.units,
    work=beyond.work,
    claims=claims,
    figures=figures,
    notes=notes,
)
