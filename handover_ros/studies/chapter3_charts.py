"""Bar charts of chapter 3: costs by objective, by assumption, and the measures of the simulated user studies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.studies.chapter3_claims_mismatch import ATTITUDES, pooled_costs
from handover_ros.studies.chapter3_claims_users import PART, by_program, infeasible_counts
from handover_ros.studies.chapter3_settings import PERSONS
from handover_ros.studies.chapter3_tables import beside, costs_by_person
from handover_ros.studies.chapter3_users import MEASURES, METRICS, MODELS, PARTS, PROGRAMS
from handover_ros.studies.figure_style import save, styled
from handover_ros.studies.statistics import interval
from handover_ros.studies.tables import Rows, only

# Orange, grey and black as in the dissertation's charts; blue for the fourth.
COLOURS = {
    "expected_cost": "#e69f00",
    "minimum_mean": "#9a9a9a",
    "maximum_feasibility": "#222222",
    "MN": "#e69f00",
    "MP": "#9a9a9a",
    "GN": "#56b4e9",
    "GP": "#222222",
    "M": "#e69f00",
    "G": "#222222",
    "N": "#e69f00",
    "P": "#9a9a9a",
}
NAMES = {
    "expected_cost": "expected cost",
    "minimum_mean": "average cost",
    "maximum_feasibility": "feasibility",
    "M": "myopic",
    "G": "global",
    "N": "noisy",
    "P": "perfect",
}
ORDER = ("maximum_feasibility", "minimum_mean", "expected_cost")
WIDTH = 0.8  # of a group of bars
Series = Mapping[str, FloatArray]  # values over blocks (b,) by name


def draw_bars(axes: Any, groups: Mapping[str, Series], names: Sequence[str] = ()) -> None:
    """Draw a group of bars for each name: means and their 95 % confidence.

    Args:
        axes: Of pyplot.
        groups: Series by the name under the group; all have the same blocks in one group.
        names: Given: the series are differences within blocks, and these are all names in order; else they are costs,
            from which each block's own level is taken out.
    """
    differences, names = bool(names), names or list(dict.fromkeys(name for each in groups.values() for name in each))
    for place, name in enumerate(names):
        shown = [number for number, series in enumerate(groups.values()) if name in series]
        series = [each for each in groups.values() if name in each]
        if not series:
            continue
        ends = np.array([interval(each[name] if differences else _without_levels(each)[name]) for each in series])
        means = ends.mean(axis=1)
        axes.bar(
            np.array(shown) + WIDTH * ((place + 0.5) / len(names) - 0.5),
            means,
            WIDTH / len(names),
            yerr=np.array([means - ends[:, 0], ends[:, 1] - means]),
            color=COLOURS[name],
            error_kw={"linewidth": 1.0, "ecolor": "#7a1f1f"},
            label=NAMES.get(name, name),
        )
    axes.set_xticks(range(len(groups)), [name.replace("_", " ") for name in groups])
    axes.grid(axis="x", visible=False)
    if not differences:
        axes.set_ylim(bottom=0.0)


def _without_levels(series: Series) -> dict[str, FloatArray]:
    """Return values less their block's mean plus the mean of all (D. Cousineau, 2005), measured blocks only."""
    table = np.array(list(series.values()))
    table = table[:, np.isfinite(table).all(axis=0)]
    return dict(zip(series, table - table.mean(axis=0) + table.mean()))


def draw_metrics(folder: Path, rows: Rows, factor: str, name: str) -> list[Path]:
    """Draw the costs of the three objectives for each goal (figure 3.4) or object (3.5)."""
    other = "object" if factor == "goal" else "goal"
    kinds = {row["goal"]: row["kind"].replace("_", " ") for row in rows}
    levels = (
        sorted({row["goal"] for row in rows}) if factor == "goal" else list(dict.fromkeys(r["object"] for r in rows))
    )
    groups: dict[str, Series] = {}
    for level in levels:
        costs = beside(only(rows, **{factor: level}), "objective", "cost", (other,))
        label = f"{level + 1}: {kinds[level]}" if factor == "goal" else str(level)
        groups[label] = {each: costs[each] for each in ORDER}
    whole = beside(rows, "objective", "cost", ("object", "goal"))
    groups["all"] = {each: whole[each] for each in ORDER}
    with styled() as pyplot:
        figure, axes = pyplot.subplots(figsize=(6.6, 3.2), layout="constrained")
        draw_bars(axes, groups)
        _legend_below(figure, axes, "objective")
        axes.set_ylabel("expected total cost")
        return save(pyplot, figure, folder, name)


def draw_mismatch(folder: Path, rows: Rows, trues: Sequence[str], name: str) -> list[Path]:
    """Draw what each true person pays for each assumption (figures 3.6 and 3.7), one column an attitude."""
    groups = {}
    for attitude in dict.fromkeys(row["attitude"] for row in rows):
        costs = costs_by_person(only(rows, attitude=attitude))
        groups[attitude] = {true: {each: costs[each, true] for each in PERSONS} for true in trues}
    return _draw_assumptions(folder, groups, {true: true for true in trues}, name)


def draw_one_assumption(folder: Path, rows: Rows, letter: int, name: str) -> list[Path]:
    """Draw myopia (``letter`` 0, figure 3.8) or noise (1, figure 3.9) alone, one column an attitude."""
    kinds, groups = ("MG", "NP")[letter], {}
    for attitude in dict.fromkeys(row["attitude"] for row in rows):
        costs = pooled_costs(costs_by_person(only(rows, attitude=attitude)), letter)
        groups[attitude] = {NAMES[true]: {each: costs[each, true] for each in kinds} for true in kinds}
    return _draw_assumptions(folder, groups, {NAMES[true]: true for true in kinds}, name)


def _draw_assumptions(
    folder: Path, groups: Mapping[str, Mapping[str, dict[str, FloatArray]]], right: Mapping[str, str], name: str
) -> list[Path]:
    """Draw costs by true person and assumption, and below by how much they exceed those of the right assumption.

    Args:
        folder: Of the files.
        groups: Costs over goals by attitude, true person and assumption.
        right: The right assumption by true person.
        name: Of the files.
    """
    most = max(len(series) for each in groups.values() for series in each.values())
    size = (1.0 + (1.0 + 0.3 * most * len(right)) * len(groups), 4.8)
    with styled() as pyplot:
        figure, panels = pyplot.subplots(
            2, len(groups), figsize=size, layout="constrained", squeeze=False, sharex="col"
        )
        for upper, lower, (attitude, people) in zip(panels[0], panels[1], groups.items()):
            draw_bars(upper, people)
            losses = {
                true: {each: values - series[right[true]] for each, values in series.items() if each != right[true]}
                for true, series in people.items()
            }
            draw_bars(lower, losses, names=list(dict.fromkeys(each for series in people.values() for each in series)))
            lower.axhline(0.0, color="#222222", linewidth=0.8)
            lower.set_xlabel("true person")
            upper.set_title(ATTITUDES[attitude])
        panels[0, 0].set_ylabel("expected total cost")
        panels[1, 0].set_ylabel("more than with\nthe right assumption")
        _legend_below(figure, panels[0, 0], "robot expects")
        return save(pyplot, figure, folder, name)


def draw_measures(folder: Path, rows: Rows, study: str, name: str) -> list[Path]:
    """Draw OM1 to OM4 of both programs, a panel each for people who do not and who do know the goal."""
    better, other = PROGRAMS[study]
    with styled() as pyplot:
        figure, panels = pyplot.subplots(1, 2, figsize=(7.0, 3.2), layout="constrained", sharey=True)
        for axes, part in zip(panels, PARTS):
            groups: dict[str, Series] = {}
            for measure in MEASURES:
                values = by_program(rows, study, part, measure)
                groups[measure] = {each: values[each] for each in (other, better)}
            draw_bars(axes, groups)
            axes.set_title(PART[part])
        panels[0].set_ylabel("estimated cost at the goal")
        _legend_below(figure, panels[0], "program" if study == METRICS else "robot expects")
        return save(pyplot, figure, folder, name)


def draw_infeasible(folder: Path, rows: Rows, name: str) -> list[Path]:
    """Draw OM5, the number of grasps of each subject with which the object cannot be placed (figure 3.16)."""
    groups: dict[str, Series] = {}
    for part in PARTS:
        values = infeasible_counts(rows, part)
        groups[PART[part]] = {each: values[each] for each in ("GP", "MN")}
    goals = len({row["goal"] for row in only(rows, study=MODELS)})
    with styled() as pyplot:
        figure, axes = pyplot.subplots(figsize=(4.2, 3.2), layout="constrained")
        draw_bars(axes, groups)
        _legend_below(figure, axes, "robot expects")
        axes.set_ylabel(f"infeasible grasps of {goals}, per subject")
        return save(pyplot, figure, folder, name)


def _legend_below(figure: Any, axes: Any, title: str) -> None:
    """Put one legend below all panels."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, title=title, loc="outside lower center", ncols=len(labels), frameon=False)
