"""Figures 4.3 to 4.7 and 4.9: feasible sets in configuration space, likelihoods and beliefs behind them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from handover_ros.arm.planar import PlanarObject
from handover_ros.geometry import FloatArray
from handover_ros.preferences.likelihood import log_likelihood
from handover_ros.preferences.query import chosen
from handover_ros.preferences.space import PreferenceSpace
from handover_ros.studies.arm_courses import offering
from handover_ros.studies.chapter4_settings import Chapter4Settings
from handover_ros.studies.feasible_shape import parts, spread
from handover_ros.studies.figure_style import CHOICE, FEASIBLE, TRUTH, save, styled
from handover_ros.studies.galleries import GRID, grid, likelihood_of, pose_gallery, shape_gallery
from handover_ros.studies.learning import Course
from handover_ros.studies.planar_courses import ARM, artificial_course, planar_course, planar_space
from handover_ros.studies.seeds import generator
from handover_ros.studies.tables import Rows, only

SHOWN = 4  # iterations of the sequences
LEGEND = ((TRUTH, "*", "truth q*"), (CHOICE, "o", "choice of the person"), (FEASIBLE, ".", "feasible"))


def draw_background(axes: Any, space: PreferenceSpace, density: FloatArray) -> None:
    """Draw a function on the grid of a space of two coordinates in grey."""
    lower, upper = space.bounds
    image = density.reshape(GRID, GRID).T
    axes.imshow(
        image,
        origin="lower",
        extent=(lower[0], upper[0], lower[1], upper[1]),
        cmap="Greys",
        aspect="auto",
        vmin=0.0,
        vmax=1.15 * float(image.max()),
    )
    axes.grid(visible=False)


def draw_set(axes: Any, postures: FloatArray, place: int, truth: FloatArray) -> None:
    """Draw a feasible set (k, 2), what was chosen of it and the truth (2,)."""
    axes.plot(*postures.T, ".", color=FEASIBLE, markersize=3.5)
    axes.plot(*truth, "*", color=TRUTH, markersize=11.0, markeredgecolor="white", markeredgewidth=0.6)
    axes.plot(*postures[place], "o", color=CHOICE, markersize=6.0, markeredgecolor="white", markeredgewidth=0.6)


def draw_sequences(folder: Path, course: Course, rows: Rows, strategies: Sequence[str], name: str) -> list[Path]:
    """Draw the belief (exact, on a grid) after each of the first queries of one person, a row for each strategy."""
    points = course.space.people(grid(course.space))
    shown = min(SHOWN, len(course.levels))
    with styled() as pyplot:
        figure, table = pyplot.subplots(
            len(strategies),
            shown,
            figsize=(2.7 * shown, 2.6 * len(strategies) + 0.3),
            layout="constrained",
            sharex=True,
            sharey=True,
            squeeze=False,
        )
        for line, strategy in zip(table, strategies):
            log = np.zeros(GRID * GRID)
            taught = only(rows, scenario=course.scenario, strategy=strategy, person=course.person)
            for axes, row in zip(line, taught[1:]):
                query = course.menu[row["place"]]
                log += log_likelihood(points, query, chosen(row["answer"]))
                draw_background(axes, course.space, np.exp(log - log.max()))
                draw_set(axes, query.configurations, row["answer"], course.truth)
                axes.set_title(f"{strategy}, query {row['iteration']}: {query.name}")
            line[0].set_ylabel("elbow [rad]")
        _finish(figure, table)
        return save(pyplot, figure, folder, name)


def draw_two_sets(folder: Path, course: Course, name: str) -> list[Path]:
    """Draw the two artificial feasible sets with one choice each and its likelihood function (figure 4.3)."""
    points = course.space.people(grid(course.space))
    with styled() as pyplot:
        figure, table = pyplot.subplots(1, 2, figsize=(5.6, 3.1), layout="constrained", sharey=True, squeeze=False)
        for axes, query in zip(table[0], course.menu):
            place = int(np.argmin(course.true_person.costs(query.configurations)[0]))
            log = log_likelihood(points, query, chosen(place))
            draw_background(axes, course.space, np.exp(log - log.max()))
            draw_set(axes, query.configurations, place, course.truth)
            axes.set_title(query.name)
        table[0, 0].set_ylabel("elbow [rad]")
        _finish(figure, table)
        return save(pyplot, figure, folder, name)


def draw_gallery(
    folder: Path, settings: Chapter4Settings, objects: Sequence[PlanarObject], seed: int, name: str
) -> list[Path]:
    """Draw planar objects (top) and their feasible sets with a choice and its likelihood (bottom)."""
    rng = generator(seed, name)
    truth = np.array(settings.planar.known_neutral)
    space = planar_space(settings, "neutral")
    with styled() as pyplot:
        figure, table = pyplot.subplots(
            2, len(objects), figsize=(2.1 * len(objects), 4.6), layout="constrained", squeeze=False
        )
        for upper, lower, each in zip(table[0], table[1], objects):
            postures = each.feasible(ARM)
            place, likelihood = likelihood_of(settings, postures, float(rng.random()), truth)
            draw_object(upper, each, postures, place)
            draw_background(lower, space, likelihood)
            draw_set(lower, postures, place, truth)
            lower.set_title(f"{parts(postures)} parts, spread {spread(postures):.1f} rad")
            lower.set_xlabel("shoulder [rad]")
            if each is not objects[0]:
                upper.set_yticklabels([])
                lower.set_yticklabels([])
        table[0, 0].set_ylabel("y [m]")
        table[1, 0].set_ylabel("elbow [rad]")
        _legend(figure)
        return save(pyplot, figure, folder, name)


def draw_object(axes: Any, shown: PlanarObject, postures: FloatArray, place: int) -> None:
    """Draw an object's outline, where it can be grasped, and the arm that took it."""
    outline = np.vstack([shown.outline, shown.outline[:1]])
    axes.plot(*outline.T, color="#9a9a9a", linewidth=1.0)
    axes.plot(*ARM.hand(postures).T, ".", color=FEASIBLE, markersize=3.5)
    turn = postures[place, 0]
    elbow = ARM.upper_arm * np.array([np.cos(turn), np.sin(turn)])
    joints = np.array([[0.0, 0.0], elbow, ARM.hand(postures[place][None])[0]])
    axes.plot(*joints.T, "-o", color=CHOICE, linewidth=2.0)
    axes.set_xlim(-0.45, 0.85)
    axes.set_ylim(-0.85, 0.85)
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")


def draw_offers(folder: Path, settings: Chapter4Settings, seed: int, name: str) -> list[Path]:
    """Draw one offer of each real object: grips of the hand in space, and feasible sets in three of seven joints."""
    offers = offering(settings.arm)
    rng = generator(seed, name)
    queries = [offers.query(model, rng) for model in offers.models]
    views = (("shoulder_flexion", "elbow_flexion", 0, 3), ("shoulder_rotation", "forearm_pronation", 2, 4))
    with styled() as pyplot:
        figure, table = pyplot.subplots(2, 3, figsize=(9.0, 5.4), layout="constrained")
        for line, query in zip(table, queries):
            hands = offers.arm.hand_pose(query.configurations)[:, :3, 3]
            for number, region in enumerate(query.regions):
                kept = query.region == number
                colour = (FEASIBLE, CHOICE, TRUTH, "#cc79a7")[number % 4]
                line[0].plot(*hands[kept, :2].T, ".", color=colour, label=region.replace("_", " "))
                for axes, (_, _, first, second) in zip(line[1:], views):
                    axes.plot(*query.configurations[kept][:, [first, second]].T, ".", color=colour)
            size = f"{parts(query.configurations)} parts, spread {spread(query.configurations):.1f} rad"
            line[0].set_title(f"{query.name}: hand in the torso frame")
            line[0].plot(*offers.arm.shoulder[:2], "o", color="#9a9a9a", label="shoulder")
            line[0].set(xlabel="x [m]", ylabel="y [m]", aspect="equal", xlim=(-0.2, 0.9), ylim=(-0.8, 0.45))
            line[0].legend(frameon=False, loc="upper right")
            for axes, (across, up, first, second) in zip(line[1:], views):
                axes.set(xlabel=f"{across.replace('_', ' ')} [rad]", ylabel=f"{up.replace('_', ' ')} [rad]")
                axes.set(xlim=offers.arm.limits[:, first], ylim=offers.arm.limits[:, second])
            line[1].set_title(size)
        return save(pyplot, figure, folder, name)


def draw_all_pictures(folder: Path, settings: Chapter4Settings, rows: Rows, seed: int) -> dict[str, list[Path]]:
    """Draw all of them, of the first simulated person; return files by figure."""
    artificial, planar = artificial_course(settings, 0, seed), planar_course(settings, "neutral", 0, seed)
    return {
        "4.3": draw_two_sets(folder, artificial, "figure_4_3_artificial_sets"),
        "4.4": draw_sequences(folder, artificial, rows, ("active",), "figure_4_4_alternation"),
        "4.5": draw_gallery(folder, settings, shape_gallery(settings, seed), seed, "figure_4_5_shapes"),
        "4.6": draw_gallery(folder, settings, pose_gallery(settings, seed), seed, "figure_4_6_poses"),
        "4.7": draw_sequences(folder, planar, rows, ("active", "passive"), "figure_4_7_active_and_passive"),
        "4.9": draw_offers(folder, settings, seed, "figure_4_9_feasible_sets"),
    }


def _finish(figure: Any, table: Any) -> None:
    """Name the shoulder's axis and add the legend."""
    for axes in table[-1]:
        axes.set_xlabel("shoulder [rad]")
    _legend(figure)


def _legend(figure: Any) -> None:
    """Put the legend of symbols below the figure."""
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=colour, marker=marker, linestyle="none", markersize=8.0, label=label)
        for colour, marker, label in LEGEND
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)
