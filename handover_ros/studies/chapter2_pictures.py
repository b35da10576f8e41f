"""Figures of chapter 2: workspaces (2.7) and torso rotations (2.8)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter, zoom

from handover_ros.arm.workspace import Workspace
from handover_ros.arm.workspace_picture import VIEWS, stick_figure
from handover_ros.geometry import FloatArray
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.studies.chapter2_claims import by_subject, values
from handover_ros.studies.chapter2_settings import USUAL, Chapter2Settings
from handover_ros.studies.chapter2_subjects import CONDITIONS, subject
from handover_ros.studies.chapter2_trials import SCHEMES
from handover_ros.studies.chapter2_workspaces import workspace
from handover_ros.studies.figure_style import save, styled
from handover_ros.studies.statistics import interval
from handover_ros.studies.tables import Rows, only

# Colours that colour-blind readers can tell apart, as in figure_style.
COLOURS = {"constant": "#d55e00", "relative": "#e69f00", "personal": "#0072b2"}
MARKERS = {"constant": "s", "relative": "D", "personal": "o"}
TITLES = {"free": "free arms", "strapped": "dominant arm strapped"}
PAIR = ("#0072b2", "#d55e00")
BODY = "#30343b"
BINS = 30
FINE = 4  # pixels a voxel of an outline


def draw_workspaces(folder: Path, settings: Chapter2Settings, rows: Rows, seed: int) -> list[Path]:
    """Draw figure 2.7 of the two subjects whose restricted workspaces overlap least."""
    least = min(only(rows, condition="strapped"), key=lambda row: row["shared"])
    pair = (int(least["subject"]), int(least["other"]))
    half = 0.05 + max(np.abs(workspace(settings, number, seed, "free").centres).max() for number in pair)
    with styled() as pyplot:
        figure, table = pyplot.subplots(len(CONDITIONS), len(VIEWS), figsize=(9.0, 6.6), layout="constrained")
        for line, condition in zip(table, CONDITIONS):
            spaces = [workspace(settings, number, seed, condition) for number in pair]
            for axes, (name, shown, signs, labels) in zip(line, VIEWS):
                for space, colour in zip(spaces, PAIR):
                    _outline(axes, space, shown, signs, colour)
                _draw_body(axes, settings, pair[0], seed, shown, signs)
                axes.set(title=f"{name}: {TITLES[condition]}", xlabel=labels[0], ylabel=labels[1])
                axes.set(xlim=(-half, half), ylim=(-half, half), aspect="equal")
        handles = [pyplot.Line2D([], [], color=colour, linewidth=2.0) for colour in PAIR]
        names = [f"subject {number + 1}" for number in pair]
        figure.legend(handles, names, loc="outside lower center", ncols=2, frameon=False)
        return save(pyplot, figure, folder, "figure_2_7_workspaces")


def _outline(axes: Any, space: Workspace, shown: tuple[int, int], signs: tuple[float, float], colour: str) -> None:
    """Draw the projection of a volume."""
    right, up = shown
    image = space.filled.any(axis=3 - right - up).astype(float)
    image = image.T if right < up else image
    smooth = gaussian_filter(zoom(image, FINE, order=1, grid_mode=True, mode="grid-constant"), 0.8 * FINE)
    across, along = (
        sign * (space.corner[axis] + (np.arange(count * FINE) + 0.5) / FINE) * space.voxel
        for sign, axis, count in zip(signs, shown, (image.shape[1], image.shape[0]))
    )
    axes.contourf(across, along, smooth, [0.5, 2.0], colors=[colour], alpha=0.22)
    axes.contour(across, along, smooth, [0.5], colors=[colour], linewidths=1.4)


def _draw_body(
    axes: Any, settings: Chapter2Settings, number: int, seed: int, shown: tuple[int, int], signs: tuple[float, float]
) -> None:
    """Draw a subject as a stick figure."""
    lines, _ = stick_figure(skeleton_of(subject(settings, number, seed, "free")))
    for line in lines:
        axes.plot(signs[0] * line[:, shown[0]], signs[1] * line[:, shown[1]], color=BODY, linewidth=2.0, alpha=0.8)


def draw_rotations(folder: Path, rows: Rows) -> list[Path]:
    """Draw figure 2.8: the distributions of all trials, and each subject's means beside them."""
    own = only(rows, taste=USUAL)
    largest = max(float(np.nanmax(values(own, condition, scheme))) for condition in CONDITIONS for scheme in SCHEMES)
    bins = np.linspace(0.0, max(largest, 1.0), BINS + 1)
    with styled() as pyplot:
        figure, table = pyplot.subplots(
            len(CONDITIONS), 2, figsize=(8.6, 5.4), layout="constrained", width_ratios=(1.7, 1.0)
        )
        for (left, right), condition in zip(table, CONDITIONS):
            for scheme in SCHEMES:
                measured = values(own, condition, scheme)
                measured = measured[np.isfinite(measured)]
                look: dict[str, Any] = {"bins": bins, "color": COLOURS[scheme]}
                left.hist(measured, **look, alpha=0.22)
                left.hist(measured, **look, histtype="step", linewidth=1.6, label=f"{scheme} (n = {len(measured)})")
                if len(measured):
                    left.axvline(measured.mean(), color=COLOURS[scheme], linestyle="--", linewidth=1.2)
            left.set(title=TITLES[condition], xlabel="torso rotation [deg]", ylabel="trials", xlim=(0.0, bins[-1]))
            left.legend(frameon=False)
            _draw_subjects(right, own, condition)
            right.set_ylim(0.0, bins[-1])
        return save(pyplot, figure, folder, "figure_2_8_torso_rotation")


def _draw_subjects(axes: Any, rows: Rows, condition: str) -> None:
    """Draw a line for each subject through their means by scheme, and the mean of all with its interval."""
    means = np.array([by_subject(rows, condition, scheme) for scheme in SCHEMES])
    axes.plot(range(len(SCHEMES)), means, color="#9a9a9a", linewidth=0.9, marker=".", alpha=0.8)
    for place, scheme in enumerate(SCHEMES):
        _draw_mean(axes, place, means[place], scheme)
    axes.set(xticks=range(len(SCHEMES)), xticklabels=SCHEMES, xlim=(-0.4, len(SCHEMES) - 0.6))
    axes.set(ylabel="torso rotation [deg]", title=f"means of subjects, {TITLES[condition]}")


def _draw_mean(axes: Any, place: float, means: FloatArray, scheme: str, label: str | None = None) -> None:
    """Draw the mean of subjects' means with its 95 % confidence interval."""
    kept = means[np.isfinite(means)]
    if not len(kept):
        return
    low, high = interval(kept)
    middle = float(kept.mean())
    error = [[middle - low], [high - middle]]
    axes.errorbar(
        place, middle, error, color=COLOURS[scheme], marker=MARKERS[scheme], markersize=6.0, capsize=3.0, label=label
    )


def draw_sensitivity(folder: Path, rows: Rows, tastes: Sequence[str]) -> list[Path]:
    """Draw how the rotation depends on what the simulated persons find comfortable."""
    with styled() as pyplot:
        figure, line = pyplot.subplots(1, len(CONDITIONS), figsize=(8.6, 3.4), layout="constrained", sharey=True)
        for axes, condition in zip(line, CONDITIONS):
            for place, taste in enumerate(tastes):
                own = only(rows, taste=taste)
                for index, scheme in enumerate(SCHEMES):
                    label = scheme if place == 0 else None
                    _draw_mean(axes, place + 0.2 * (index - 1), by_subject(own, condition, scheme), scheme, label)
            axes.set(title=TITLES[condition], xticks=range(len(tastes)))
            axes.set_xticklabels([taste.replace("_", "\n") for taste in tastes])
        line[0].set_ylim(bottom=0.0)
        line[0].set_ylabel("torso rotation [deg]")
        line[0].legend(frameon=False)
        return save(pyplot, figure, folder, "figure_2_8b_costs")


def draw_reprojection(folder: Path, rows: Rows) -> list[Path]:
    """Draw the median reprojection error of every marker: one dot for each calibration, a line through the means."""
    names = sorted({row["marker"] for row in rows})
    with styled() as pyplot:
        figure, axes = pyplot.subplots(figsize=(8.6, 3.0), layout="constrained")
        for condition, colour, aside in zip(CONDITIONS, PAIR, (-0.15, 0.15)):
            for place, name in enumerate(names):
                errors = [row["median_mm"] for row in only(rows, marker=name, condition=condition)]
                label = TITLES[condition] if place == 0 else None
                where = np.full(len(errors), place + aside)
                axes.plot(where, errors, ".", color=colour, alpha=0.5, label=label)
                axes.plot(place + aside, np.mean(errors), "_", color=colour, markersize=9.0, markeredgewidth=1.8)
        axes.set_xticks(range(len(names)), names, rotation=60, ha="right")
        axes.set(ylabel="median error [mm]")
        axes.set_ylim(bottom=0.0)
        axes.legend(frameon=False, loc="lower right")
        return save(pyplot, figure, folder, "figure_2_3r_reprojection")
