"""Figures 4.2, 4.8 and 4.10: measures against the number of queries, with 95 % confidence bands."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from handover_ros.studies.chapter4 import USER_STRATEGIES, USERS
from handover_ros.studies.figure_style import COLOURS, NAMES, draw_band, save, styled
from handover_ros.studies.statistics import interval
from handover_ros.studies.tables import Rows, curves, shares

MEASURES = {
    "log_density": r"$\log P(\lambda^*)$",
    "distance": r"$\|\arg\max P(\lambda) - \lambda^*\|$",
    "test_log_likelihood": "test log likelihood",
    "true_cost": r"true cost $E[C_{ergo}(q_H)]$",
}
LEARNED = {"neutral": "neutral posture $q^*$", "weights": "weights $w$"}


def draw_learning(folder: Path, rows: Rows, arm: str, strategies: Sequence[str], name: str) -> list[Path]:
    """Draw the four measures for q* (top) and w (bottom) of one arm."""
    with styled() as pyplot:
        figure, grid = pyplot.subplots(2, 4, figsize=(12.0, 5.4), layout="constrained")
        for line, learned in zip(grid, LEARNED):
            for axes, measure in zip(line, MEASURES):
                for strategy in strategies:
                    table = curves(rows, f"{arm}_{learned}", strategy, measure)
                    first = int(np.isnan(table[:, 0]).any())  # costs are of queries: there is none before the first
                    draw_band(axes, np.arange(first, table.shape[1]), table[:, first:], strategy)
                axes.set_title(f"{MEASURES[measure]}, {LEARNED[learned]}")
                axes.xaxis.get_major_locator().set_params(integer=True)
            line[-1].set_ylim(bottom=0.0)
        for axes in grid[1]:
            axes.set_xlabel("queries answered")
        _legend(figure, grid[0, 0], len(strategies))
        return save(pyplot, figure, folder, name)


def draw_users(folder: Path, rows: Rows, objects: Sequence[str], name: str) -> list[Path]:
    """Draw the simulated user study: test log likelihood, log P(lambda*), and which object was offered."""
    with styled() as pyplot:
        figure, line = pyplot.subplots(1, 3, figsize=(10.0, 3.3), layout="constrained")
        for axes, measure in zip(line, ("test_log_likelihood", "log_density")):
            for strategy in USER_STRATEGIES:
                table = curves(rows, USERS, strategy, measure)
                draw_band(axes, np.arange(table.shape[1]), table, strategy)
            axes.set_title(f"{MEASURES[measure]}, grasp regions seen")
            axes.set_xlabel("queries answered")
            axes.xaxis.get_major_locator().set_params(integer=True)
        draw_shares(line[2], rows, (USERS,), USER_STRATEGIES, objects)
        _legend(figure, line[0], len(USER_STRATEGIES))
        return save(pyplot, figure, folder, name)


def draw_objects(folder: Path, rows: Rows, strategies: Sequence[str], objects: Sequence[str], name: str) -> list[Path]:
    """Draw which object each strategy offers to the arm of seven joints."""
    with styled() as pyplot:
        figure, axes = pyplot.subplots(figsize=(6.0, 3.4), layout="constrained")
        draw_shares(axes, rows, ("arm_neutral", "arm_weights"), strategies, objects)
        _legend(figure, axes, len(strategies))
        return save(pyplot, figure, folder, name)


def draw_shares(
    axes: Any, rows: Rows, scenarios: Sequence[str], strategies: Sequence[str], objects: Sequence[str]
) -> None:
    """Draw bars of the share of queries that offered the first object; the line is its share of the menu."""
    width = 0.8 / len(strategies)
    for index, strategy in enumerate(strategies):
        for place, scenario in enumerate(scenarios):
            share = 100.0 * shares(rows, scenario, strategy, objects[0])
            low, high = interval(share)
            axes.bar(
                place + (index - 0.5 * (len(strategies) - 1)) * width,
                share.mean(),
                0.9 * width,
                yerr=[[share.mean() - low], [high - share.mean()]],
                color=COLOURS[strategy],
                error_kw={"elinewidth": 1.0, "capsize": 2.0},
                label=NAMES.get(strategy, strategy) if place == 0 else None,
            )
    axes.axhline(50.0, color="#444444", linewidth=0.8, linestyle="--")
    labels = [LEARNED.get(scenario.split("_")[-1], "simulated user study") for scenario in scenarios]
    axes.set_xticks(range(len(scenarios)), labels)
    axes.set_ylim(0.0, 100.0)
    axes.set_ylabel("queries [%]")
    axes.set_title(f"queries that offer {objects[0]}, the rest {objects[1]}")
    axes.grid(visible=False, axis="x")


def _legend(figure: Any, axes: Any, columns: int) -> None:
    """Put one legend below the figure."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)
