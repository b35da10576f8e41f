"""Pictures of workspaces as in Bestick 2017, figure 2.7: three orthographic views and one in space, with the person."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from scipy.ndimage import gaussian_filter, zoom

from handover_ros.arm.workspace import Workspace
from handover_ros.arm.workspace_surface import surface
from handover_ros.geometry import FloatArray
from handover_ros.skeleton.jacobian import move_tree
from handover_ros.skeleton.landmarks import bones
from handover_ros.skeleton.tree import Skeleton

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = ("#2f6db3", "#e07b39")
BODY = "#30343b"
INK, PALE = "#30343b", "#c9ced6"
# View, the root-frame axes that run right and up in it, and their signs; x forward, y left, z up.
VIEWS = (
    ("Front", (1, 2), (1.0, 1.0), ("person's left [m]", "up [m]")),
    ("Side, from the right", (0, 2), (1.0, 1.0), ("forward [m]", "up [m]")),
    ("Top", (1, 0), (-1.0, 1.0), ("person's right [m]", "forward [m]")),
)
SUBSAMPLE = 4  # pixels of a projection for each voxel
EVEN_OUT = 1.2  # [voxels] width of the filter that takes the voxels' steps out of an outline
# Drawn for the eye, measured on nobody [m]: a head's size and height above the shoulders, the hips' depth below.
HEAD_RADIUS, HEAD_ABOVE, HIPS_BELOW = 0.11, 0.24, 0.48
TICKS = (-0.8, -0.4, 0.0, 0.4, 0.8)  # [m]


@dataclass(frozen=True)
class Shown:
    """A workspace in a picture.

    Attributes:
        workspace: The volume.
        label: What the legend calls it; the volume is added.
    """

    workspace: Workspace
    label: str


def draw_workspaces(
    path: Path, skeleton: Skeleton, shown: Sequence[Shown], title: str, posture: FloatArray | None = None
) -> None:
    """Write a picture (format by the suffix) of one or two workspaces and a person's stick figure, root frame.

    Args:
        path: The file to write.
        skeleton: The person drawn with them.
        shown: What to show, the larger first.
        title: Above the picture.
        posture: Displacements (n,) of the stick figure [rad, m]; default: zero, arms hanging.
    """
    matplotlib.use("Agg")
    from matplotlib import pyplot
    from matplotlib.patches import Patch

    figure_lines, shoulders = stick_figure(skeleton, posture)
    bounds = _bounds([each.workspace for each in shown], figure_lines)
    with pyplot.rc_context({"font.size": 9, "axes.edgecolor": PALE, "axes.linewidth": 0.8, "axes.labelcolor": INK}):
        figure = pyplot.figure(figsize=(10.0, 10.0), dpi=160)
        figure.suptitle(title, fontsize=13, color=INK, y=0.975)
        grid = figure.add_gridspec(2, 2, left=0.07, right=0.985, bottom=0.09, top=0.93, wspace=0.16, hspace=0.17)
        for (name, axes, signs, labels), cell in zip(VIEWS, (grid[0, 0], grid[0, 1], grid[1, 0])):
            plot = figure.add_subplot(cell)
            _draw_view(plot, shown, figure_lines, shoulders, bounds, axes, signs)
            plot.set_title(name, fontsize=10, color=INK)
            plot.set_xlabel(labels[0], labelpad=2)
            plot.set_ylabel(labels[1], labelpad=2)
        space = figure.add_subplot(grid[1, 1], projection="3d", computed_zorder=False)
        _draw_space(space, shown, figure_lines, shoulders, bounds)
        handles = [
            Patch(facecolor=colour, alpha=0.6, label=f"{each.label}: {each.workspace.litres:.0f} litres")
            for each, colour in zip(shown, COLOURS)
        ]
        figure.legend(handles=handles, loc="lower center", ncol=len(handles), frameon=False, fontsize=10)
        figure.savefig(path)
        pyplot.close(figure)


def stick_figure(skeleton: Skeleton, posture: FloatArray | None = None) -> tuple[list[FloatArray], FloatArray]:
    """Return the bones, each (2, 3) [m], of a posture in the root frame, and the middle between the shoulders."""
    displacements = np.zeros(len(skeleton.lower)) if posture is None else np.asarray(posture, dtype=float)
    poses = move_tree(skeleton, displacements).poses
    lines = []
    for segment, start, end in bones(skeleton):
        pose = poses[skeleton.joint_carrying(segment) + 1]
        lines.append(np.stack([start, end]) @ pose[:3, :3].T + pose[:3, 3])
    shoulders = next((line[0] for line, bone in zip(lines, bones(skeleton)) if bone[0] == skeleton.root), lines[0][0])
    spine = np.array([[0.0, 0.0, HEAD_ABOVE - HEAD_RADIUS], [0.0, 0.0, -HIPS_BELOW]])
    return [*lines, shoulders + spine], np.asarray(shoulders)


def _bounds(workspaces: list[Workspace], lines: list[FloatArray]) -> FloatArray:
    """Return the box (2, 3) [m] that holds everything drawn."""
    points = np.concatenate([*(each.centres for each in workspaces if each.filled.any()), *lines])
    return np.stack([points.min(axis=0) - 0.08, points.max(axis=0) + 0.08])


def _draw_view(
    plot: Axes,
    shown: Sequence[Shown],
    lines: list[FloatArray],
    shoulders: FloatArray,
    bounds: FloatArray,
    axes: tuple[int, int],
    signs: tuple[float, float],
) -> None:
    """Draw one orthographic view: outlines of the projections, darker where the volume is deeper."""
    from matplotlib.colors import LinearSegmentedColormap, to_rgb
    from matplotlib.patches import Circle

    right, up = axes
    hidden = 3 - right - up
    for each, colour in zip(shown, COLOURS):
        space = each.workspace
        if not space.filled.any():
            continue
        depth = space.filled.sum(axis=hidden) * space.voxel
        depth = depth.T if right < up else depth
        smooth, outline = (_enlarged(image) for image in (depth, (depth > 0.0).astype(float)))
        horizontal = signs[0] * (space.corner[right] + _pixels(depth.shape[1])) * space.voxel
        vertical = signs[1] * (space.corner[up] + _pixels(depth.shape[0])) * space.voxel
        inside = np.ma.masked_where(outline < 0.5, smooth)
        shades = LinearSegmentedColormap.from_list("depth", [(*to_rgb(colour), alpha) for alpha in (0.1, 0.5)])
        plot.pcolormesh(horizontal, vertical, inside, cmap=shades, vmin=0.0, rasterized=True, zorder=1)
        plot.contour(horizontal, vertical, outline, [0.5], colors=[colour], linewidths=1.4, zorder=2)
    head = shoulders + [0.0, 0.0, HEAD_ABOVE]
    plot.add_patch(Circle((signs[0] * head[right], signs[1] * head[up]), HEAD_RADIUS, color=BODY, alpha=0.85, zorder=3))
    for line in lines:
        plot.plot(
            signs[0] * line[:, right], signs[1] * line[:, up], color=BODY, lw=3.0, solid_capstyle="round", zorder=4
        )
        plot.plot(signs[0] * line[:, right], signs[1] * line[:, up], "o", color=BODY, ms=4.5, zorder=4)
    plot.set_aspect("equal", adjustable="box")
    plot.set_xlim(*sorted(signs[0] * bounds[:, right]))
    plot.set_ylim(*sorted(signs[1] * bounds[:, up]))
    plot.grid(color=PALE, lw=0.5, alpha=0.6)
    plot.set_axisbelow(True)
    plot.tick_params(colors=INK, length=2)


def _enlarged(image: FloatArray) -> FloatArray:
    """Return an image of one value a voxel with several pixels a voxel, without steps."""
    fine = zoom(image, SUBSAMPLE, order=1, grid_mode=True, mode="grid-constant")
    return np.asarray(gaussian_filter(fine, EVEN_OUT * SUBSAMPLE, mode="constant"))


def _pixels(count: int) -> FloatArray:
    """Return the middles of the pixels of ``count`` voxels, in voxels."""
    return (np.arange(count * SUBSAMPLE) + 0.5) / SUBSAMPLE


def _draw_space(
    plot: Any, shown: Sequence[Shown], lines: list[FloatArray], shoulders: FloatArray, bounds: FloatArray
) -> None:
    """Draw the view in space: translucent shaded surfaces around the person."""
    from matplotlib.colors import to_rgb
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    light = np.array([0.5, -0.35, 0.8]) / np.linalg.norm([0.5, -0.35, 0.8])
    plot.view_init(elev=20.0, azim=-48.0)
    plot.set_proj_type("ortho")
    for index, (each, colour) in enumerate(zip(shown, COLOURS)):
        if not each.workspace.filled.any():
            continue
        vertices, faces, normals = surface(each.workspace)
        shade = 0.55 + 0.45 * np.clip(normals @ light, -0.4, 1.0)
        colours = np.clip(shade[:, None] * np.array(to_rgb(colour)), 0.0, 1.0)
        alpha = 0.12 if index == 0 and len(shown) > 1 else 0.35
        faces_rgba = np.column_stack([colours, np.full(len(colours), alpha)])
        plot.add_collection3d(Poly3DCollection(vertices[faces], facecolors=faces_rgba, edgecolors="none", zorder=index))
    for line in lines:
        plot.plot(*line.T, color=BODY, lw=3.0, solid_capstyle="round", zorder=5)
    u, v = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 25), np.linspace(0.0, np.pi, 13))
    ball = np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)])
    head = (shoulders + [0.0, 0.0, HEAD_ABOVE])[:, None, None] + HEAD_RADIUS * ball
    plot.plot_surface(*head, color=BODY, shade=True, linewidth=0, zorder=5)
    plot.set_xlim(*bounds[:, 0])
    plot.set_ylim(*bounds[:, 1])
    plot.set_zlim(*bounds[:, 2])
    plot.set_box_aspect(np.diff(bounds, axis=0)[0], zoom=1.0)
    plot.set_title("From the front right", fontsize=10, color=INK, y=1.02)
    inside = [[tick for tick in TICKS if low < tick < high] for low, high in bounds.T]
    plot.set(xticks=inside[0], yticks=inside[1], zticks=inside[2])
    for axis, label in ((plot.xaxis, "forward [m]"), (plot.yaxis, "left [m]"), (plot.zaxis, "up [m]")):
        axis.set_label_text(label)
        axis.labelpad = -3
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis._axinfo["grid"].update(color=PALE, linewidth=0.4)
        axis.set_tick_params(labelsize=7, pad=-1, colors=INK)
