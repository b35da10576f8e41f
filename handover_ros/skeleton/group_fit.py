"""The joints between two segments that carry markers, fitted alone: few unknowns, so that many starts can be tried.

Starting axes come from the segment's rotations and from all directions; the best fit is kept, and a rival that explains
the markers almost as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from handover_ros.geometry import FloatArray
from handover_ros.skeleton.group_starts import (
    free_motion_sigma,
    nearest_seen,
    on_free_base,
    serial_tree,
    spread,
    starting_axes,
    starting_centres,
    zero_coordinates,
)
from handover_ros.skeleton.kernels import ancestors
from handover_ros.skeleton.layout import parameter_layout
from handover_ros.skeleton.postures import frame_losses, solve_frame, solve_postures
from handover_ros.skeleton.prediction_error import Fit, FitSettings, minimise
from handover_ros.skeleton.tree import FlatTree, IntArray, JointKind
from handover_ros.skeleton.wishes import NO_WISHES, Wishes

TRIAL_FRAMES = 48
TRIAL_ITERATIONS = 15
GOOD_ENOUGH = 1.2  # times the noise that remains when the segment may move freely: no better axes to be found
RIVAL = 1.1  # a second minimum whose noise is at most this much larger is kept as a rival
NOISE_FLOOR = 3e-4  # [m] below it nothing is worth another try
BAD_TRIAL = 5.0  # times the median loss of the trial's frames
START_ANGLES = (-1.2, 0.0, 1.2)  # [rad]
SAME_AXIS = 0.9  # cosine of the angle between two axes above which they are taken for one


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
    centres = starting_centres(pair.seen, pair.base_markers, markers)
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


def other_axes(first: FlatTree, second: FlatTree, joints: list[int]) -> bool:
    """Return whether two fits of a group have clearly different axes."""
    cosines = np.abs(np.einsum("ja,ja->j", first.axis[joints], second.axis[joints]))
    return bool(cosines.min() < SAME_AXIS)


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
