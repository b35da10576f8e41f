"""A first guess of a skeleton from marker frames, with no prior lengths, axes or angles: joint by joint from the root out.

The root's pose follows from its own markers. Then, for each segment that carries markers, the joints between it and the
nearest segment already placed are fitted alone, in the frame of that segment: few unknowns, so that many starting axes
can be tried, spread evenly over all directions; the best fit is kept.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from handover_ros.geometry import FloatArray
from handover_ros.skeleton.kernels import ancestors, segment_poses
from handover_ros.skeleton.layout import parameter_layout
from handover_ros.skeleton.postures import frame_losses, solve_frame, solve_postures
from handover_ros.skeleton.prediction_error import Fit, FitSettings, minimise
from handover_ros.skeleton.rigid_fit import kabsch
from handover_ros.skeleton.rigid_motion import rigid_motion
from handover_ros.skeleton.tree import COORDINATES, TANGENTS, FlatTree, IntArray, JointKind
from handover_ros.skeleton.wishes import NO_WISHES, Wishes

TRIAL_FRAMES = 48
TRIAL_ITERATIONS = 15
SEEDS = 8
CENTRE_PULL = 1e-6  # [m^2] variance of the markers' motion that outweighs the pull of their mean
GOOD_ENOUGH = 1.2  # times the noise that remains when the segment may move freely: no better axes to be found
RIVAL = 1.1  # a second minimum whose noise is at most this much larger is kept as a rival
NOISE_FLOOR = 3e-4  # [m] below it nothing is worth another try
BAD_TRIAL = 5.0  # times the median loss of the trial's frames
START_ANGLES = (-1.2, 0.0, 1.2)  # [rad]
SAME_AXIS = 0.9  # cosine of the angle between two axes above which they are taken for one


@dataclass(frozen=True, eq=False)
class InitialGuess:
    """Where minimisation starts.

    Attributes:
        tree: Axes, points and markers.
        coordinates: Posture of each frame, shape (frames, nq).
        seeds: Number of starting axes tried, by the last joint of each group.
        rivals: Other fits of a group that explain its markers almost as well.
    """

    tree: FlatTree
    coordinates: FloatArray
    seeds: dict[int, int]
    rivals: tuple[tuple[Group, GroupFit], ...]


@dataclass(frozen=True, eq=False)
class Group:
    """The joints between a segment that carries markers and the nearest placed one.

    Attributes:
        joints: Their indices, from the root out.
        base: Joint that carries the placed segment, -1: the world.
        markers: Indices of the markers on the segment.
    """

    joints: tuple[int, ...]
    base: int
    markers: IntArray


def groups_of(tree: FlatTree) -> list[Group]:
    """Return the groups of a tree in the order in which they can be fitted; a free root is none of them."""
    placed = {-1} | {j for j, kind in enumerate(tree.kind) if kind == JointKind.FREE}
    groups = []
    for j in range(len(tree.kind)):
        markers = np.flatnonzero(tree.marker_joint == j)
        if j in placed or not len(markers):
            continue
        chain, at = [], j
        while at not in placed:
            chain.append(at)
            at = int(tree.parent[at])
        groups.append(Group(tuple(reversed(chain)), at, markers))
        placed |= set(chain)
    return groups


def first_guess(
    tree: FlatTree,
    observed: FloatArray,
    reference: int,
    meets: dict[int, int],
    world_from_zero: FloatArray | None = None,
    hints: FloatArray | None = None,
    wishes: Wishes = NO_WISHES,
    seed: int = 0,
) -> InitialGuess:
    """Return a first guess; the posture of frame ``reference`` becomes the zero posture.

    Args:
        tree: The tree; its axes, points and markers are not used, except the axes of ball joints.
        observed: Markers [m], shape (frames, m, 3), NaN = not measured.
        reference: The frame whose posture is zero.
        meets: Joint whose axis goes through the point of another, by index.
        world_from_zero: The zero frame in the world at frame ``reference`` (4, 4); None: the world's axes at the middle
            of the root's markers.
        hints: Directions (joints, 3) that make a rival where the markers leave two fits open; zero: none.
        wishes: About the shape; their strength is that for each marker sample.
        seed: Of the starting axes.
    """
    rng = np.random.default_rng(seed)
    joints, frames = len(tree.kind), len(observed)
    axis, point, marker = tree.axis.copy(), np.zeros((joints, 3)), np.zeros((len(tree.marker_joint), 3))
    coordinates = np.zeros((frames, int(sum(COORDINATES[JointKind(kind)] for kind in tree.kind))))
    poses = np.tile(np.eye(4), (joints + 1, frames, 1, 1))
    if joints and tree.kind[0] == JointKind.FREE:
        own = np.flatnonzero(tree.marker_joint == 0)
        poses[1], marker[own] = rigid_motion(observed[:, own], reference, world_from_zero)
        coordinates[:, :3] = poses[1, :, :3, 3]
        coordinates[:, 3:7] = Rotation.from_matrix(poses[1, :, :3, :3]).as_quat()
    world = np.flatnonzero(tree.marker_joint == -1)
    if len(world):
        marker[world] = np.nan_to_num(np.nanmedian(observed[:, world], axis=0))
    noise = NOISE_FLOOR
    if joints and tree.kind[0] == JointKind.FREE:
        noise = max(noise, free_motion_sigma(observed[:, own], marker[own]))
    tried, rivals = {}, []
    for group in groups_of(tree):
        base_markers = np.flatnonzero((tree.marker_joint == group.base) & (group.base >= 0))
        base = poses[group.base + 1]
        pair = Pair(marker[base_markers], observed[:, base_markers], base, observed[:, group.markers], noise)
        own_hints = None if hints is None else hints[list(group.joints)]
        fits, tried[group.joints[-1]] = fit_group(tree, group, pair, reference, meets, rng, own_hints, wishes)
        rivals += [(group, fit) for fit in fits[1:]]
        place_group(tree, group, fits[0], axis, point, marker, coordinates)
        motion = segment_poses(fits[0].tree, fits[0].coordinates)
        for index, j in enumerate(group.joints):
            poses[j + 1] = base @ motion[:, index]
    for j, kind in enumerate(tree.kind):
        # Joints beyond the last marker stay at zero.
        if kind == JointKind.BALL and not coordinates[:, tree.coordinate[j] : tree.coordinate[j] + 4].any():
            coordinates[:, tree.coordinate[j] + 3] = 1.0
    return InitialGuess(tree._replace(axis=axis, point=point, marker=marker), coordinates, tried, tuple(rivals))


def place_group(
    tree: FlatTree,
    group: Group,
    fit: GroupFit,
    axis: FloatArray,
    point: FloatArray,
    marker: FloatArray,
    coordinates: FloatArray,
) -> None:
    """Write a group's fit into the arrays of the whole tree, in place."""
    for index, j in enumerate(group.joints):
        axis[j], point[j] = fit.tree.axis[index], fit.tree.point[index]
        size = COORDINATES[JointKind(tree.kind[j])]
        start, own = tree.coordinate[j], fit.tree.coordinate[index]
        coordinates[:, start : start + size] = fit.coordinates[:, own : own + size]
    marker[group.markers] = fit.tree.marker


@dataclass(frozen=True, eq=False)
class GroupFit:
    """A fitted group.

    Attributes:
        tree: Its joints alone, hanging on the world.
        coordinates: Their postures, shape (frames, their nq).
        sigma: Standard deviation [m] of a marker coordinate about the fit.
    """

    tree: FlatTree
    coordinates: FloatArray
    sigma: float


def fit_group(
    tree: FlatTree,
    group: Group,
    pair: Pair,
    reference: int,
    meets: dict[int, int],
    rng: np.random.Generator,
    hints: FloatArray | None = None,
    wishes: Wishes = NO_WISHES,
) -> tuple[list[GroupFit], int]:
    """Return the best fits of a group's joints, the best first, and the number of starting axes tried.

    A second fit is returned where another minimum explains the markers almost as well.

    Args:
        tree: The whole tree.
        group: The joints.
        pair: What is known of the segment the group hangs on, and its markers and the group's.
        reference: The frame whose posture is zero.
        meets: As in ``first_guess``.
        rng: Of the starting axes.
        hints: Directions of the group's axes to try as well, shape (joints of the group, 3).
        wishes: As in ``first_guess``.
    """
    kinds = [JointKind(tree.kind[j]) for j in group.joints]
    local_meets = {
        group.joints.index(a): group.joints.index(b)
        for a, b in meets.items()
        if a in group.joints and b in group.joints
    }
    markers = nearest_seen(pair.seen, reference)
    centres = starting_centres(pair, markers)
    blank = serial_tree(kinds, tree.axis[list(group.joints)], centres[0], markers)
    turning = [index for index, kind in enumerate(kinds) if kind != JointKind.BALL]
    few = spread(np.flatnonzero(np.isfinite(pair.seen[:, :, 0]).any(axis=1)), reference, TRIAL_FRAMES)
    trial = PairProblem(pair, few, list(few).index(reference), local_meets, wishes, group.joints)
    seeds = starting_axes(pair.seen[few], markers, len(turning), rng)
    good = GOOD_ENOUGH * max(pair.noise, free_motion_sigma(pair.seen[few], markers), NOISE_FLOOR)
    found: list[tuple[float, FlatTree, FloatArray]] = []
    tried = 0
    for axes, centre in ((axes, centre) for axes in seeds for centre in centres):
        tried += 1
        guess = blank.axis.copy()
        guess[turning] = axes
        found.append(trial.fit(blank._replace(axis=guess, point=np.tile(centre, (len(kinds), 1)))))
        if found[-1][0] < good:
            break
    found.sort(key=lambda each: each[0])
    if len(turning) == 2:
        # The two axes may have been found in the wrong order: it fits a little worse, and no small step leads out.
        best = found[0]
        swapped = best[1].axis.copy()
        swapped[turning] = swapped[turning[::-1]]
        others = [trial.fit(best[1]._replace(axis=swapped))]
        if hints is not None and np.linalg.norm(hints[turning], axis=1).min() > 0.5:
            hinted = blank.axis.copy()
            hinted[turning] = hints[turning]
            others += [trial.fit(blank._replace(axis=hinted, point=np.tile(c, (len(kinds), 1)))) for c in centres]
        tried += len(others)
        tries = sorted([best, *others], key=lambda each: each[0])
        found = [tries[0], *(each for each in tries[1:] if other_axes(each[1], tries[0][1], turning))]
    rivals = [each for each in found[1:4] if each[0] < RIVAL * found[0][0]]
    fits = []
    for sigma, own, q in [found[0], *rivals]:
        every, _ = solve_postures(own, q[trial.reference], pair.seen, start=reference)
        fits.append(GroupFit(own, every, sigma))
    return fits, tried


def starting_centres(pair: Pair, markers: FloatArray) -> list[FloatArray]:
    """Return points (3,) near which the joints of a group may lie.

    First the common centre of the spheres on which the markers move; the error of the placed segment's pose pushes it
    outwards, sometimes far. Then points between the markers of both segments.
    """
    own = markers.mean(axis=0)
    centres = [centre_of_rotation(pair.seen)]
    if len(pair.base_markers):
        centres += [own + share * (pair.base_markers.mean(axis=0) - own) for share in (0.25, 0.5)]
    return [*centres, own]


def other_axes(first: FlatTree, second: FlatTree, joints: list[int]) -> bool:
    """Return whether two fits of a group have clearly different axes."""
    cosines = np.abs(np.einsum("ja,ja->j", first.axis[joints], second.axis[joints]))
    return bool(cosines.min() < SAME_AXIS)


@dataclass(frozen=True, eq=False)
class Pair:
    """Two segments that carry markers, one placed, the other to be.

    Attributes:
        base_markers: Positions of the placed segment's markers in the zero frame [m], shape (b, 3).
        base_observed: Their measured positions in the world [m], shape (frames, b, 3); b may be 0.
        base_poses: world_from_zero of the placed segment, shape (frames, 4, 4).
        observed: The other segment's markers in the world [m], shape (frames, k, 3).
        noise: Standard deviation [m] of a marker coordinate, as far as known.
    """

    base_markers: FloatArray
    base_observed: FloatArray
    base_poses: FloatArray
    observed: FloatArray
    noise: float

    @property
    def seen(self) -> FloatArray:
        """The other segment's markers in the zero frame moved with the placed one [m], shape (frames, k, 3)."""
        shifted = self.observed - self.base_poses[:, None, :3, 3]
        return np.asarray(np.einsum("fba,fmb->fma", self.base_poses[:, :3, :3], shifted))


class PairProblem:
    """Fits a group's joints together with the pose of the segment they hang on, in some frames.

    The placed segment's pose is only as certain as its markers make it; fitted alone, its error would pass for motion
    of the joints.

    Args:
        pair: The two segments.
        frames: Frame numbers.
        reference: Index among them of the zero posture.
        meets: Joint of the group whose axis goes through another's point.
        wishes: About the whole tree, their strength that for each marker sample.
        joints: The group's joints in the whole tree.
    """

    def __init__(
        self,
        pair: Pair,
        frames: npt.NDArray[np.intp],
        reference: int,
        meets: dict[int, int],
        wishes: Wishes = NO_WISHES,
        joints: tuple[int, ...] = (),
    ) -> None:
        self.reference = reference
        self._seen = pair.seen[frames]
        self._poses = pair.base_poses[frames]
        self._base_markers = pair.base_markers
        self._free = len(pair.base_markers) >= 3
        self._observed = np.concatenate([pair.base_observed[frames], pair.observed[frames]], axis=1)
        self._meets = meets
        samples = int(np.isfinite(pair.observed[frames][:, :, 0]).sum())
        self._wishes = wishes.within(joints, 1 if self._free else 0, samples * wishes.strength)

    def fit(self, group: FlatTree) -> tuple[float, FlatTree, FloatArray]:
        """Return (sigma [m], the group's tree, its postures) after a short minimisation from a group's tree."""
        zero = zero_coordinates(group)
        q, _ = solve_postures(group, zero, self._seen, start=self.reference, iterations=6)
        q[self.reference] = zero
        if not self._free:
            whole, held, frozen, observed = group, 0, self.reference, self._seen
        else:
            base = Rotation.from_matrix(self._poses[:, :3, :3]).as_quat()
            q = np.hstack([self._poses[:, :3, 3], base, q])
            whole, held, frozen, observed = (
                on_free_base(group, self._base_markers),
                len(self._base_markers),
                -1,
                self._observed,
            )
        shift = 1 if self._free else 0
        layout = parameter_layout(whole, {a + shift: b + shift for a, b in self._meets.items()}, held=held)
        settings = FitSettings(iterations=TRIAL_ITERATIONS)
        fit = minimise(whole, layout, q, observed, settings, frozen, self._wishes)
        better = solved_from_everywhere(fit.tree, fit.coordinates, observed, self.reference)
        if better is not None:
            fit = minimise(fit.tree, layout, better, observed, settings, frozen, self._wishes)
        own = group._replace(axis=fit.tree.axis[shift:], point=fit.tree.point[shift:], marker=fit.tree.marker[held:])
        sigma = sigma_of(fit, observed, layout.count, 6 * shift + len(group.kind))
        return sigma, own, fit.coordinates[:, 7 * shift :]


def solved_from_everywhere(
    tree: FlatTree, coordinates: FloatArray, observed: FloatArray, reference: int
) -> FloatArray | None:
    """Return postures (frames, nq) of which those that fit badly were tried from many angles; None: none got better.

    Frames of a trial lie far apart in time, so that the posture of the frame before is no good start for some of them.
    """
    losses = np.empty(len(coordinates))
    frame_losses(tree, coordinates, observed, 0.0, losses)
    bad = np.flatnonzero(losses > BAD_TRIAL * max(float(np.median(losses)), 1e-12))
    bad = bad[bad != reference]
    turning = [int(start) for kind, start in zip(tree.kind, tree.coordinate) if kind == JointKind.REVOLUTE]
    if not len(bad) or not turning:
        return None
    chains, result, improved = ancestors(tree), coordinates.copy(), False
    for angles in product(START_ANGLES, repeat=len(turning)):
        for k in bad:
            start = coordinates[k].copy()
            start[turning] = angles
            loss = solve_frame(tree, chains, start, observed[k], 0.0, TRIAL_ITERATIONS)
            if loss < 0.7 * losses[k]:
                result[k], losses[k], improved = start, loss, True
    return result if improved else None


def sigma_of(fit: Fit, observed: FloatArray, parameters: int, tangents: int) -> float:
    """Return the standard deviation [m] of a marker coordinate about a fit, freedom taken into account."""
    numbers = 3 * int(np.isfinite(observed[:, :, 0]).sum())
    freedom = max(numbers - parameters - tangents * len(observed), 0.1 * numbers, 1.0)
    return float(np.sqrt(fit.loss / freedom))


def serial_tree(kinds: list[JointKind], axes: FloatArray, centre: FloatArray, markers: FloatArray) -> FlatTree:
    """Return joints in series through one point, hanging on the world, the last one carrying markers (k, 3)."""
    number = len(kinds)
    return FlatTree(
        kind=np.array(kinds, dtype=np.int64),
        parent=np.arange(-1, number - 1),
        axis=np.array(axes, dtype=float),
        point=np.tile(centre, (number, 1)),
        coordinate=np.cumsum([0, *(COORDINATES[kind] for kind in kinds)], dtype=np.int64)[:-1],
        tangent=np.cumsum([0, *(TANGENTS[kind] for kind in kinds)], dtype=np.int64)[:-1],
        marker_joint=np.full(len(markers), number - 1, dtype=np.int64),
        marker=markers,
    )


def on_free_base(group: FlatTree, base_markers: FloatArray) -> FlatTree:
    """Return a serial tree hung on a free segment that carries markers (b, 3); those come first."""
    return FlatTree(
        kind=np.concatenate([[int(JointKind.FREE)], group.kind]),
        parent=np.concatenate([[-1], group.parent + 1]),
        axis=np.vstack([np.zeros(3), group.axis]),
        point=np.vstack([np.zeros(3), group.point]),
        coordinate=np.concatenate([[0], group.coordinate + COORDINATES[JointKind.FREE]]),
        tangent=np.concatenate([[0], group.tangent + TANGENTS[JointKind.FREE]]),
        marker_joint=np.concatenate([np.zeros(len(base_markers), dtype=np.int64), group.marker_joint + 1]),
        marker=np.vstack([base_markers, group.marker]),
    )


def zero_coordinates(tree: FlatTree) -> FloatArray:
    """Return the coordinates (nq,) of the zero posture."""
    size = int(sum(COORDINATES[JointKind(kind)] for kind in tree.kind))
    zero = np.zeros(size)
    for kind, start in zip(tree.kind, tree.coordinate):
        if kind == JointKind.BALL:
            zero[start + 3] = 1.0
        elif kind == JointKind.FREE:
            zero[start + 6] = 1.0
    return zero


def starting_axes(seen: FloatArray, markers: FloatArray, count: int, rng: np.random.Generator) -> list[FloatArray]:
    """Return starting directions (each (count, 3)) of the axes of a group: first what the motion suggests, then any.

    The main directions of the segment's rotation vectors are a good guess when its joints were moved one at a time.
    """
    if count == 0:
        return [np.zeros((0, 3))]
    seeds = []
    if (vectors := rotation_vectors(seen, markers)) is not None:
        _, _, directions = np.linalg.svd(vectors, full_matrices=True)
        for order in ([0, 1, 2], [1, 0, 2], [0, 2, 1], [2, 0, 1]):
            seeds.append(np.resize(directions[order], (count, 3)))
    while len(seeds) < SEEDS:
        axes = rng.normal(size=(count, 3))
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        if count == 1 or np.abs(axes @ axes.T - np.eye(count)).max() < 0.8:
            seeds.append(axes)
    return seeds


def rotation_vectors(seen: FloatArray, markers: FloatArray) -> FloatArray | None:
    """Return the rotation vectors (k, 3) [rad] of a segment from its zero posture; None with fewer than three markers."""
    vectors = []
    for positions in seen:
        visible = np.isfinite(positions[:, 0])
        if visible.sum() >= 3:
            rotation, _, _ = kabsch(markers[visible], positions[visible], np.ones(int(visible.sum())))
            vectors.append(Rotation.from_matrix(rotation).as_rotvec())
    return np.array(vectors) if len(vectors) >= 3 else None


def free_motion_sigma(seen: FloatArray, markers: FloatArray) -> float:
    """Return the standard deviation [m] of a coordinate when the segment moves freely; 0 with less than three markers."""
    squared, count = 0.0, 0
    for positions in seen:
        visible = np.isfinite(positions[:, 0])
        number = int(visible.sum())
        if number >= 3:
            rotation, translation, _ = kabsch(markers[visible], positions[visible], np.ones(number))
            squared += float(np.sum((markers[visible] @ rotation.T + translation - positions[visible]) ** 2))
            count += 3 * number - 6
    return float(np.sqrt(squared / count)) if count else 0.0


def nearest_seen(seen: FloatArray, reference: int) -> FloatArray:
    """Return each marker's position (k, 3) [m] in the frame nearest to ``reference`` that shows it."""
    result = np.zeros(seen.shape[1:])
    for i in range(seen.shape[1]):
        frames = np.flatnonzero(np.isfinite(seen[:, i, 0]))
        if len(frames):
            result[i] = seen[frames[np.argmin(np.abs(frames - reference))], i]
    return result


def centre_of_rotation(seen: FloatArray) -> FloatArray:
    """Return the point (3,) from which every marker keeps its distance best (a sphere for each marker).

    Linear least squares of |y|^2 - 2 y c + s_i = 0. Where the markers hardly curve the centre is held at their mean.

    Args:
        seen: Markers of one segment as the segment it hangs on sees them [m], shape (frames, k, 3).
    """
    visible = np.isfinite(seen[:, :, 0])
    mean = np.nanmean(seen.reshape(-1, 3), axis=0) if visible.any() else np.zeros(3)
    normal, right = np.zeros((3, 3)), np.zeros(3)
    samples = 0
    for i in range(seen.shape[1]):
        y = seen[visible[:, i], i] - mean
        if len(y) < 4:
            continue
        squared = (y**2).sum(axis=1)
        y_centred, squared_centred = y - y.mean(axis=0), squared - squared.mean()
        normal += 4.0 * y_centred.T @ y_centred
        right += 2.0 * y_centred.T @ squared_centred
        samples += len(y)
    return np.asarray(mean + np.linalg.solve(normal + (4.0 * samples * CENTRE_PULL + 1e-12) * np.eye(3), right))


def spread(usable: npt.NDArray[np.intp], reference: int, count: int) -> npt.NDArray[np.intp]:
    """Return at most ``count`` frame numbers spread evenly over ``usable``, with ``reference`` among them, in order."""
    picked = usable[np.linspace(0, len(usable) - 1, min(count, len(usable))).astype(int)] if len(usable) else usable
    return np.unique(np.append(picked, reference))
