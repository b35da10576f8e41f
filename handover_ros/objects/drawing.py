"""Solids, hands and grippers as shaded faces, painted from far to near: enough for pictures of an object or two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from handover_ros.geometry import FloatArray, invert_transform, make_transform, transform_points
from handover_ros.objects.catalogue import ObjectModel, Primitive

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, PALE, GROUND = "#30343b", "#c9ced6", "#f5f7fa"
REGION_COLOURS = ("#2f6db3", "#e07b39", "#3f8f6b", "#8a5fb0", "#d4a52a", "#b04a5f", "#4f93a8", "#7a6a4f")
METAL, JAWS = (0.62, 0.65, 0.70, 1.0), (0.25, 0.27, 0.30, 1.0)
COLOURS_KEPT = 255  # in a PNG
AROUND = 28  # faces around a round solid
FINE = 0.012  # [m] largest face of small things: faces are sorted by their middles
OUTSIDE = 0.0005  # [m] from a face of one solid where another one hides it
ON_TOP = 0.0015  # [m] by which a later solid of an object counts as nearer than an earlier one
AMBIENT, LIGHT = 0.58, np.array([0.25, 0.35, 0.9]) / np.linalg.norm([0.25, 0.35, 0.9])  # right, up, to the eye
# The hand: palm and fingers about the grip [m], x along the fingers, y from thumb to little finger, z out of the palm.
PALM = ((0.085, 0.075, 0.022), (-0.038, 0.0, -0.036))
FINGER_PLACES = (-0.028, -0.009, 0.010, 0.029)
FINGER = ((0.004, -0.036), (0.042, -0.014), (0.034, 0.022))  # x, z
THUMB = ((-0.060, -0.034, -0.034), (-0.022, -0.052, -0.004), (0.006, -0.042, 0.020))
FINGER_RADIUS = 0.0085  # [m]
PALM_FACE = (-0.038, 0.0, -0.025)

Rgba = Sequence[float]
Place = Sequence[float] | Sequence[Sequence[float]] | FloatArray


@dataclass(frozen=True, eq=False)
class Surface:
    """Flat faces.

    Attributes:
        faces: Corners [m], counter-clockwise from outside, a triangle repeats one. Shape (n, 4, 3).
        colours: Red, green, blue, opacity. Shape (n, 4).
        nearer: [m] by which they count as nearer to the eye than they are when it matters what hides what. Shape (n,).
    """

    faces: FloatArray
    colours: FloatArray
    nearer: FloatArray = field(default_factory=lambda: np.zeros(1))

    def __post_init__(self) -> None:
        """Give every face its own."""
        object.__setattr__(self, "colours", np.broadcast_to(self.colours, (len(self.faces), 4)))
        object.__setattr__(self, "nearer", np.broadcast_to(self.nearer, (len(self.faces),)))

    def placed(self, target_from_surface: FloatArray) -> Surface:
        """Return it at a pose."""
        faces = transform_points(target_from_surface, self.faces.reshape(-1, 3)).reshape(-1, 4, 3)
        return Surface(faces, self.colours, self.nearer)

    def brought(self, nearer: float) -> Surface:
        """Return it so much nearer to the eye [m]."""
        return Surface(self.faces, self.colours, self.nearer + nearer)


def joined(surfaces: Sequence[Surface]) -> Surface:
    """Return one surface of many, or of none."""
    faces = [np.zeros((0, 4, 3)), *(surface.faces for surface in surfaces)]
    colours = [np.zeros((0, 4)), *(surface.colours for surface in surfaces)]
    nearer = [np.zeros(0), *(surface.nearer for surface in surfaces)]
    return Surface(np.concatenate(faces), np.concatenate(colours), np.concatenate(nearer))


@dataclass(frozen=True, eq=False)
class View:
    """A parallel projection.

    Attributes:
        axes: Directions to the right, upwards and to the eye, as rows. Shape (3, 3).
    """

    axes: FloatArray

    @classmethod
    def towards(cls, heading: float, elevation: float) -> View:
        """Return the view from an eye at a heading about z and an elevation [rad], z upwards."""
        eye = np.array([np.cos(elevation) * np.cos(heading), np.cos(elevation) * np.sin(heading), np.sin(elevation)])
        right = np.array([-np.sin(heading), np.cos(heading), 0.0])
        return cls(np.stack([right, np.cross(eye, right), eye]))

    def project(self, points: FloatArray) -> FloatArray:
        """Return points (..., 3) [m] in the picture: right, up and distance to the eye (..., 3)."""
        return np.asarray(points @ self.axes.T)


def paint(plot: Axes, surface: Surface, view: View) -> None:
    """Add the faces that look to the eye to a plot, the far ones first."""
    from matplotlib.collections import PolyCollection

    seen = view.project(surface.faces)
    normals = np.cross(seen[:, 2] - seen[:, 0], seen[:, 3] - seen[:, 1])
    length = np.linalg.norm(normals, axis=1)
    front = (normals[:, 2] > 1e-9 * np.maximum(length, 1e-12)) & (length > 1e-14)
    order = np.flatnonzero(front)
    order = order[np.argsort(seen[order, :, 2].mean(axis=1) + surface.nearer[order], kind="stable")]
    shade = AMBIENT + (1.0 - AMBIENT) * np.clip(normals[order] @ LIGHT / length[order], 0.0, 1.0)
    colours = surface.colours[order].copy()
    colours[:, :3] *= shade[:, None]
    edges = colours.copy()
    edges[colours[:, 3] < 1.0] = 0.0  # translucent faces would show their seams twice
    corners: Any = seen[order, :, :2]  # an array is much faster than the sequence that is declared
    polygons = PolyCollection(corners, facecolors=colours, edgecolors=edges, linewidths=0.35)
    plot.add_collection(polygons)


def bounds(surface: Surface, view: View) -> FloatArray:
    """Return least and greatest place (2, 2) of a surface in the picture."""
    seen = view.project(surface.faces)[..., :2].reshape(-1, 2)
    return np.stack([seen.min(axis=0), seen.max(axis=0)])


def blank(plot: Axes, limits: FloatArray) -> None:
    """Make a plot an even ground for a picture with limits (2, 2), one metre as long in every direction."""
    plot.set(xlim=limits[:, 0], ylim=limits[:, 1], xticks=[], yticks=[], facecolor=GROUND)
    plot.set_aspect("equal", adjustable="box")
    plot.spines[:].set_visible(False)


def stretched(limits: FloatArray, ratio: float) -> FloatArray:
    """Return limits (2, 2) with the same middle that fill a plot ``ratio`` times as wide as high."""
    middle, size = limits.mean(axis=0), limits[1] - limits[0]
    half = np.array([ratio, 1.0]) * max(size[1], size[0] / ratio) / 2.0
    return np.stack([middle - half, middle + half])


def faded(colour: str | Rgba, opacity: float = 1.0, white: float = 0.0) -> tuple[float, float, float, float]:
    """Return a colour with an opacity, mixed with white."""
    from matplotlib.colors import to_rgb

    red, green, blue = to_rgb(colour) if isinstance(colour, str) else colour[:3]
    mixed = (1.0 - white) * np.array([red, green, blue]) + white
    return float(mixed[0]), float(mixed[1]), float(mixed[2]), opacity


def save(figure: Figure, path: Path) -> Path:
    """Write a figure that was drawn without a screen as a PNG of few colours, and return its path."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    image = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())
    path.parent.mkdir(parents=True, exist_ok=True)
    image.quantize(COLOURS_KEPT, dither=Image.Dither.NONE).save(path)
    return path


# Solids


def box(size: Place, pose: FloatArray, colour: Rgba, step: float = FINE) -> Surface:
    """Return a box of lengths (3,) at a pose."""
    half = np.asarray(size, dtype=float) / 2.0
    counts = np.maximum(1, np.ceil(2.0 * half / step).astype(int))
    faces = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        grid_u, grid_v = (np.linspace(-half[i], half[i], counts[i] + 1) for i in (u, v))
        low_u, low_v = (each.ravel() for each in np.meshgrid(grid_u[:-1], grid_v[:-1], indexing="ij"))
        high_u, high_v = (each.ravel() for each in np.meshgrid(grid_u[1:], grid_v[1:], indexing="ij"))
        for sign in (1.0, -1.0):
            face = np.empty((len(low_u), 4, 3))
            face[..., axis] = sign * half[axis]
            face[..., u] = np.stack([low_u, high_u, high_u, low_u], axis=1)
            face[..., v] = np.stack([low_v, low_v, high_v, high_v], axis=1)
            faces.append(face[:, :: int(sign)])
    return Surface(np.concatenate(faces), np.array(colour)).placed(pose)


def loft(rings: FloatArray, pose: FloatArray, colour: Rgba, around: int = AROUND) -> Surface:
    """Return a surface through ellipses: rows of half lengths along x and y and height (k, 3) [m], from below."""
    angles = np.linspace(0.0, 2.0 * np.pi, around + 1)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points = np.empty((len(rings), around + 1, 3))
    points[..., :2] = rings[:, None, :2] * circle
    points[..., 2] = rings[:, None, 2]
    corners = (points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1])
    return Surface(np.stack(corners, axis=2).reshape(-1, 4, 3), np.array(colour)).placed(pose)


def lathe(radii: Place, heights: Place, pose: FloatArray, colour: Rgba, around: int = AROUND) -> Surface:
    """Return a round surface about z: radii (k,) at heights (k,) [m], from below."""
    return loft(np.stack([np.asarray(radii), np.asarray(radii), np.asarray(heights)], axis=1), pose, colour, around)


def cylinder(radius: float, length: float, pose: FloatArray, colour: Rgba, step: float = FINE) -> Surface:
    """Return a cylinder along z."""
    along = np.linspace(-length / 2.0, length / 2.0, max(1, round(length / step)) + 1)
    inwards = np.linspace(0.0, radius, max(1, round(radius / step)) + 1)
    radii = np.concatenate([inwards[:-1], np.full(len(along), radius), inwards[-2::-1]])
    heights = np.concatenate([np.full(len(inwards) - 1, along[0]), along, np.full(len(inwards) - 1, along[-1])])
    return lathe(radii, heights, pose, colour)


def ball(radii: float | Place, centre: Place, colour: Rgba) -> Surface:
    """Return an ellipsoid with one or three radii."""
    angles = np.linspace(-np.pi / 2.0, np.pi / 2.0, 10)
    surface = lathe(np.cos(angles), np.sin(angles), np.eye(4), colour)
    return Surface(surface.faces * np.broadcast_to(radii, 3) + np.asarray(centre), surface.colours)


def tube(start: Place, end: Place, radii: tuple[float, float], colour: Rgba, around: int = 12) -> Surface:
    """Return a limb between two points, round at both ends, with a radius at each."""
    start, end = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    length = float(np.linalg.norm(end - start))
    axis = (end - start) / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    pose = make_transform(np.column_stack([across, np.cross(axis, across), axis]), start)
    cap = np.linspace(0.0, np.pi / 2.0, 4)
    inner = np.linspace(0.0, length, max(1, round(length / FINE)) + 1)
    heights = np.concatenate([-radii[0] * np.cos(cap[:-1]), inner, length + radii[1] * np.sin(cap[1:])])
    middle = radii[0] + (radii[1] - radii[0]) * inner / max(length, 1e-9)
    return lathe(
        np.concatenate([radii[0] * np.sin(cap[:-1]), middle, radii[1] * np.cos(cap[1:])]), heights, pose, colour, around
    )


def primitive_surface(part: Primitive, pose: FloatArray, colour: Rgba | None = None) -> Surface:
    """Return a solid of an object that is at a pose."""
    there, paint_with = pose @ part.object_from_primitive, part.colour if colour is None else colour
    if part.type == "box":
        return box(part.size, there, paint_with)
    if part.type == "cylinder":
        return cylinder(part.size[0], part.size[1], there, paint_with)
    if part.type == "sphere":
        return ball(part.size[0], there[:3, 3], paint_with)
    ends = transform_points(there, np.array([[0.0, 0.0, -0.5], [0.0, 0.0, 0.5]]) * part.size[1])
    return tube(ends[0], ends[1], (part.size[0], part.size[0]), paint_with)


def object_surface(model: ObjectModel, pose: FloatArray, white: float = 0.0) -> Surface:
    """Return an object at a pose, its colours mixed with white; what its solids hide of each other is left out."""
    parts = []
    for number, part in enumerate(model.primitives):
        surface = primitive_surface(part, np.eye(4), faded(part.colour, white=white))
        across = np.cross(surface.faces[:, 2] - surface.faces[:, 0], surface.faces[:, 3] - surface.faces[:, 1])
        length = np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-15)
        outside = (surface.faces + OUTSIDE * (across / length)[:, None]).reshape(-1, 3)
        hidden = np.zeros(len(surface.faces), dtype=bool)
        for other in model.primitives:
            if other is not part:
                hidden |= _inside(other, outside).reshape(-1, 4).all(axis=1)
        # What is written later lies on what is written earlier: a lid, a label, what is in a cup.
        parts.append(Surface(surface.faces[~hidden], surface.colours[~hidden], np.full(1, ON_TOP * min(number, 2))))
    return joined(parts).placed(pose)


def _inside(part: Primitive, points: FloatArray) -> npt.NDArray[np.bool_]:
    """Return whether points (n, 3) of the object frame lie in a solid."""
    local = transform_points(invert_transform(part.object_from_primitive), points)
    if part.type == "box":
        return np.asarray((np.abs(local) <= np.array(part.size) / 2.0).all(axis=1))
    if part.type == "cylinder":
        across = np.hypot(local[:, 0], local[:, 1])
        return np.asarray((across <= part.size[0]) & (np.abs(local[:, 2]) <= part.size[1] / 2.0))
    half = part.size[1] / 2.0 if part.type == "capsule" else 0.0
    local[:, 2] -= np.clip(local[:, 2], -half, half)
    return np.asarray(np.linalg.norm(local, axis=1) <= part.size[0])


# Hands


def hand_surface(pose: FloatArray, side: str, colour: Rgba) -> Surface:
    """Return a hand that grips at a pose: palm plate, four fingers and the thumb."""
    parts = [box(PALM[0], make_transform(np.eye(3), PALM[1]), colour)]
    fingers = [np.array([[x, y, z] for x, z in FINGER]) for y in FINGER_PLACES]
    for points in (*fingers, np.array(THUMB)):
        parts += [tube(*pair, (FINGER_RADIUS, FINGER_RADIUS), colour, 8) for pair in pairwise(points)]
    mirrored = joined(parts)
    if side == "left":  # thumb at the other edge; the order of the corners turns round
        mirrored = Surface(mirrored.faces[:, ::-1] * [1.0, -1.0, 1.0], mirrored.colours)
    return mirrored.placed(pose)


def hand_mark(pose: FloatArray, colour: Rgba) -> Surface:
    """Return a small mark of a hand: a plate at the palm and where the fingers point."""
    x, y, z = np.array(PALM_FACE)
    plate = box([0.030, 0.030, 0.004], make_transform(np.eye(3), [x, y, z - 0.010]), colour)
    finger = tube([x + 0.015, y, z - 0.010], [x + 0.045, y, z - 0.010], (0.0035, 0.0010), colour, 6)
    return joined([plate, finger]).placed(pose)


def gripper_mark(pose: FloatArray, width: float, colour: Rgba) -> Surface:
    """Return a small mark of a gripper: a fork."""
    half, back, end = width / 2.0 + 0.004, -0.045, 0.010
    corners = [[0.0, -half, end], [0.0, -half, back], [0.0, half, back], [0.0, half, end]]
    lines = [*pairwise(corners), ([0.0, 0.0, back], [0.0, 0.0, 2.0 * back])]
    return joined([tube(*line, (0.0022, 0.0022), colour, 6) for line in lines]).placed(pose)


def gripper_surface(pose: FloatArray, width: float, metal: Rgba = METAL, jaws: Rgba = JAWS) -> Surface:
    """Return a gripper of two jaws, ``width`` [m] apart, that closes along y and comes along z."""
    thick, reach, tip = 0.010, 0.075, 0.012
    parts = []
    for sign in (-1.0, 1.0):
        middle = [0.0, sign * (width + thick) / 2.0, tip - reach / 2.0]
        parts.append(box([0.018, thick, reach], make_transform(np.eye(3), middle), jaws))
    palm = make_transform(np.eye(3), [0.0, 0.0, tip - reach - 0.016])
    wrist = make_transform(np.eye(3), [0.0, 0.0, tip - reach - 0.050])
    parts.append(box([0.042, max(width + 2.0 * thick, 0.075), 0.032], palm, metal))
    parts.append(cylinder(0.024, 0.036, wrist, metal))
    return joined(parts).placed(pose)
