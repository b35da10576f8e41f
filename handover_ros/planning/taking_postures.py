"""The postures in which a person would like to take something: cheap, within the limits, a hand in front of the body.

Everything is in the frame of the person's torso, standing upright. A posture must keep its hands in a comfortable zone
and, if the object demands it, hold a direction of the hand upright, or two hands in a given pose to each other.
Postures that do are found by projection: the point nearest to a given posture that fulfils all, by sequential quadratic
programming with the identity as Hessian, for many postures at once. The projection of the preferred posture is the
optimum of eq. 2.11; for other costs the cheapest projections of a low-discrepancy sequence are refined.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation
from scipy.stats import qmc

from handover_ros.arm.hand import hand_frames
from handover_ros.ergonomics.costs import load_cost
from handover_ros.ergonomics.hand_targets import ANGLE_LENGTH
from handover_ros.errors import BadModelError, ErrorCode, InfeasibleError
from handover_ros.geometry import FloatArray
from handover_ros.robot.shapes import HEAD_HEIGHT, HEAD_RADIUS, TRUNK_RADIUS
from handover_ros.skeleton.jacobian import Frame, Motion, frame_pose, jacobian_of, move_tree
from handover_ros.skeleton.tree import Skeleton

BoolArray = npt.NDArray[np.bool_]

HEAD = np.array([0.0, 0.0, HEAD_HEIGHT])  # [m] of the head's centre, torso frame
TRUNK_TOP = -TRUNK_RADIUS / 2.0  # [m] where the axis of the trunk's capsule ends, as robot.shapes has it
STEPS, PASSES, ONLY_ADDING = 25, 5, 2
IDLE = 1e-9  # multiplier below which a demand is not needed
LONGEST_STEP = 0.5  # [rad]
DAMPING = 1e-6  # [m]
REACHED = 2e-4  # [m], angles times ANGLE_LENGTH
STILL = 1e-5  # [rad] of a step that ends the search
SPREADS = (0.15, 0.35, 1.0)  # of the ranges, around the preferred posture
SEEDS = 12  # per spread and hand
ROUNDS, PARENTS, CHILDREN = ((0.12, 4), (0.05, 2)), 3, 8  # refinement: spread and how many are kept to refine
DISTINCT_PLACE, DISTINCT_POSTURE = 0.04, 0.30  # [m], [rad]: postures nearer than both are one
APART = 0.12  # [m] between the hands of alternatives, beside the nearest ones


@dataclass(frozen=True)
class Zone:
    """Where a hand may be expected, torso frame [m], and how far from the joints' limits a posture stays [rad].

    Attributes:
        heights: Least and greatest height of the grip.
        in_front: Least distance of the grip in front of the shoulders.
        clearance: Of the grip from the surfaces of trunk and head.
        limit_margin: Distance of the displacements from their limits, at most a quarter of their range.
    """

    heights: tuple[float, float]
    in_front: float
    clearance: float
    limit_margin: float


@dataclass(frozen=True)
class Hold:
    """What an object demands of the hands that take it.

    Attributes:
        sides: The hands, ``left`` or ``right``, or both.
        up: Direction in the frame of the first hand that must point upwards; None: none. Unit vector.
        first_from_second: Pose of the second hand in the frame of the first, 16 numbers row by row; empty: one hand.
    """

    sides: tuple[str, ...]
    up: tuple[float, float, float] | None = None
    first_from_second: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class TakingPostures:
    """The answer: k postures, the cheapest first.

    Attributes:
        displacements: [rad, m], shape (k, n).
        costs: Ascending, shape (k,).
        hands: ``torso_from_hand`` by side, shape (k, 4, 4).
        limbs: Shoulder, elbow, wrist and grip by side [m], shape (k, 4, 3).
    """

    displacements: FloatArray
    costs: FloatArray
    hands: dict[str, FloatArray]
    limbs: dict[str, FloatArray]

    def __len__(self) -> int:
        return len(self.costs)


class PostureSearch:
    """Finds the postures of one person, and remembers them.

    Attributes:
        skeleton: The person.
        cost: What is minimised.
        preferred: The cheapest posture of all, the hands being free [rad, m], shape (n,).
        sides: Hands that the person has.
    """

    def __init__(
        self, skeleton: Skeleton, cost_name: str, body_mass: float, start: FloatArray | None, zone: Zone, seed: int = 0
    ) -> None:
        """Prepare the search.

        Args:
            skeleton: With a free root, hands, and limits of all displacements.
            cost_name: One of ``ergonomics.costs.COSTS``.
            body_mass: [kg].
            start: Where the person is before [rad, m], shape (n,); None: arms hanging.
            zone: Where hands may be.
            seed: Of the low-discrepancy sequence.

        Raises:
            BadModelError: The skeleton cannot be used; says why and what to do.
        """
        check_person(skeleton)
        self.skeleton, self.zone, self._seed = skeleton, zone, seed
        self._hands = hand_frames(skeleton)
        self.sides = tuple(self._hands)
        self._root = Frame(skeleton.root, np.eye(4))
        lower, upper = skeleton.lower, skeleton.upper
        margin = np.minimum(zone.limit_margin, 0.25 * (upper - lower))
        self._lower, self._upper = lower + margin, upper - margin
        self.cost = load_cost(cost_name, skeleton, body_mass)
        self._start = np.clip(np.zeros(len(lower)) if start is None else start, lower, upper)
        self._known: dict[Hold, TakingPostures] = {}
        # With the hands free, (2.11) is least in the middle of the limits, the costs of a reach where the person is.
        candidates = np.stack([skeleton.middle, np.clip(self._start, self._lower, self._upper)])
        self.preferred = candidates[int(np.argmin(self.cost.evaluate(self._start, candidates)))]

    def postures(self, holds: Sequence[Hold], kept: int) -> list[TakingPostures]:
        """Return the postures of each hold, at most ``kept``, none where there is none."""
        missing = [hold for hold in dict.fromkeys(holds) if hold not in self._known]
        for sides in dict.fromkeys(hold.sides for hold in missing):
            group = [hold for hold in missing if hold.sides == sides]
            self._known.update(zip(group, self._search(group), strict=True))
        return [_chosen(self._known[hold], kept) for hold in holds]

    def _search(self, holds: list[Hold]) -> list[TakingPostures]:
        """Return the postures of holds with the same sides."""
        rows = self._moved_by(holds[0].sides)
        seeds = self._seeds(rows)
        owner = np.repeat(np.arange(len(holds)), len(seeds))
        postures, good = self._project(np.tile(seeds, (len(holds), 1)), holds, owner)
        postures, owner = postures[good], owner[good]
        costs = self._costs(postures)
        for number, (spread, parents) in enumerate(ROUNDS):
            best = [np.flatnonzero(owner == index) for index in range(len(holds))]
            chosen = np.concatenate([each[np.argsort(costs[each], kind="stable")[:parents]] for each in best])
            if not len(chosen):
                break
            offsets = qmc.Halton(len(rows), seed=self._seed + 1 + number).random(CHILDREN) - 0.5
            children = np.repeat(postures[chosen], CHILDREN, axis=0)
            steps = 2.0 * spread * (self._upper - self._lower)[rows] * np.tile(offsets, (len(chosen), 1))
            children[:, rows] = np.clip(children[:, rows] + steps, self._lower[rows], self._upper[rows])
            owners = np.repeat(owner[chosen], CHILDREN)
            children, good = self._project(children, holds, owners)
            postures = np.concatenate([postures, children[good]])
            owner = np.concatenate([owner, owners[good]])
            costs = np.concatenate([costs, self._costs(children[good])])
        return [self._answer(hold, postures[owner == index], costs[owner == index]) for index, hold in enumerate(holds)]

    def _costs(self, postures: FloatArray) -> FloatArray:
        """Return the costs (k,) of postures (k, n), rounded so that mirror images cost the same."""
        return np.round(self.cost.evaluate(self._start, postures), 6) if len(postures) else np.zeros(0)

    def _moved_by(self, sides: tuple[str, ...]) -> npt.NDArray[np.int64]:
        """Return the displacements that move the hands."""
        chains = {joint for side in sides for joint in self.skeleton.chain(self._hands[side].segment)}
        return np.flatnonzero(np.isin(self.skeleton.displacement_joints, list(chains)))

    def _seeds(self, rows: npt.NDArray[np.int64]) -> FloatArray:
        """Return postures (k, n): the preferred one, the middle, and a sequence ever wider around the preferred."""
        middle = self.preferred.copy()
        middle[rows] = self.skeleton.middle[rows]
        seeds = [self.preferred[None], middle[None]]
        count = SEEDS * (1 if len(rows) < 10 else 3)
        ranges = (self._upper - self._lower)[rows]
        for number, spread in enumerate(SPREADS):
            sequence = qmc.Halton(len(rows), seed=self._seed + 17 * number).random(count) - 0.5
            postures = np.tile(middle if number % 2 else self.preferred, (count, 1))
            postures[:, rows] += spread * ranges * sequence
            seeds.append(np.clip(postures, self._lower, self._upper))
        return np.concatenate(seeds)

    def _project(
        self, anchors: FloatArray, holds: list[Hold], owner: npt.NDArray[np.int64]
    ) -> tuple[FloatArray, BoolArray]:
        """Return for each anchor (k, n) the nearest posture that fulfils its hold, and which of them do (k,)."""
        anchors = np.clip(anchors, self._lower, self._upper)
        postures, reached = anchors.copy(), np.zeros(len(anchors), dtype=bool)
        moving = np.arange(len(anchors))
        for _ in range(STEPS):
            if not len(moving):
                break
            now = postures[moving]
            values, slopes, equal = self._demands(now, [holds[index] for index in owner[moving]])
            wanted = self._nearest(now, anchors[moving], values, slopes, equal)
            step = wanted - now
            longest = np.abs(step).max(axis=1)
            step *= np.minimum(1.0, LONGEST_STEP / np.maximum(longest, 1e-12))[:, None]
            miss = np.where(equal, np.abs(values), np.maximum(values, 0.0)).max(axis=1)
            reached[moving] = miss < REACHED
            done = reached[moving] & (longest < STILL)
            postures[moving] = now + np.where(done[:, None], 0.0, step)
            moving = moving[~done]
        if len(moving):
            values, _, equal = self._demands(postures[moving], [holds[index] for index in owner[moving]])
            reached[moving] = np.where(equal, np.abs(values), np.maximum(values, 0.0)).max(axis=1) < REACHED
        return postures, reached

    def _nearest(
        self, now: FloatArray, anchors: FloatArray, values: FloatArray, slopes: FloatArray, equal: BoolArray
    ) -> FloatArray:
        """Return the postures (k, n) nearest to the anchors that fulfil the demands, linear about ``now``, and limits.

        Inequalities and limits that the answer would break become equations, pass by pass; those not needed are let go.
        """
        active, held, target = equal.copy(), np.zeros(now.shape, dtype=bool), anchors.copy()
        wanted, middle = anchors, 0.5 * (self._lower + self._upper)
        for number in range(PASSES):
            matrix = np.where(held[:, None, :], 0.0, slopes) * active[..., None]
            gap = values + (slopes @ (target - now)[..., None])[..., 0]
            normal = matrix @ np.swapaxes(matrix, 1, 2) + DAMPING * np.eye(values.shape[1])
            factors = np.linalg.solve(normal, np.where(active, gap, 0.0)[..., None])
            wanted = target - (np.swapaxes(matrix, 1, 2) @ factors)[..., 0]
            predicted = values + (slopes @ (wanted - now)[..., None])[..., 0]
            broken = (predicted > 0.5 * REACHED) & ~equal & ~active
            outside = ((wanted < self._lower - 1e-9) | (wanted > self._upper + 1e-9)) & ~held
            idle = np.zeros_like(active)
            free = np.zeros_like(held)
            if number < PASSES - ONLY_ADDING:
                # What only holds the posture back from its anchor is let go: its multiplier has the wrong sign.
                idle = active & ~equal & (factors[..., 0] < -IDLE)
                pull = wanted - anchors + (np.swapaxes(slopes * active[..., None], 1, 2) @ factors)[..., 0]
                free = held & (np.where(wanted > middle, pull, -pull) > IDLE)
            if not (broken.any() or outside.any() or idle.any() or free.any()):
                break
            active = (active | broken) & ~idle
            held = (held | outside) & ~free
            target = np.where(held, np.clip(wanted, self._lower, self._upper), anchors)
        return np.clip(wanted, self._lower, self._upper)

    def _demands(self, postures: FloatArray, holds: list[Hold]) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Return values (k, m), slopes (k, m, n), and which (k, m) must be zero; the others must not be positive."""
        motion = move_tree(self.skeleton, postures)
        sides = holds[0].sides
        poses = [self._pose(motion, side) for side in sides]
        jacobians = [jacobian_of(self.skeleton, motion, self._root, self._hands[side].frame) for side in sides]
        values: list[FloatArray] = []
        slopes: list[FloatArray] = []
        for pose, jacobian in zip(poses, jacobians):
            self._zone_demands(pose[:, :3, 3], jacobian[:, :3], values, slopes)
        inequalities = len(values)
        # Upright: the horizontal rotation vector that turns the direction upwards; without one a row of zeros.
        has_up = np.array([hold.up is not None for hold in holds])
        ups = np.array([hold.up or (0.0, 0.0, 1.0) for hold in holds])
        pointing = (poses[0][:, :3, :3] @ ups[..., None])[..., 0]
        horizontal = np.hypot(pointing[:, 0], pointing[:, 1])
        factor = np.where(horizontal < 1e-9, 1.0, np.arctan2(horizontal, pointing[:, 2]) / np.maximum(horizontal, 1e-9))
        for row, turn in enumerate((pointing[:, 1], -pointing[:, 0])):
            values.append(np.where(has_up, -ANGLE_LENGTH * factor * turn, 0.0))
            slopes.append(np.where(has_up[:, None], ANGLE_LENGTH * jacobians[0][:, 3 + row], 0.0))
        if len(sides) == 2:
            wanted = poses[0] @ np.array([hold.first_from_second for hold in holds]).reshape(-1, 4, 4)
            turn = Rotation.from_matrix(poses[1][:, :3, :3] @ np.swapaxes(wanted[:, :3, :3], 1, 2)).as_rotvec()
            lever = wanted[:, :3, 3] - poses[0][:, :3, 3]
            carried = jacobians[0][:, :3] + np.cross(jacobians[0][:, 3:], lever[..., None], axis=1)
            offset = poses[1][:, :3, 3] - wanted[:, :3, 3]
            for row in range(3):
                values += [offset[:, row], ANGLE_LENGTH * turn[:, row]]
                slopes += [
                    jacobians[1][:, row] - carried[:, row],
                    ANGLE_LENGTH * (jacobians[1][:, 3 + row] - jacobians[0][:, 3 + row]),
                ]
        equal = np.zeros((len(postures), len(values)), dtype=bool)
        equal[:, inequalities:] = True
        return np.stack(values, axis=1), np.stack(slopes, axis=1), equal

    def _zone_demands(
        self, grip: FloatArray, jacobian: FloatArray, values: list[FloatArray], slopes: list[FloatArray]
    ) -> None:
        """Append what the zone demands of a grip (k, 3) with its Jacobian (k, 3, n)."""
        low, high = self.zone.heights
        values += [grip[:, 2] - high, low - grip[:, 2], self.zone.in_front - grip[:, 0]]
        slopes += [jacobian[:, 2], -jacobian[:, 2], -jacobian[:, 0]]
        for away, radius in _body_offsets(grip):
            distance = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
            values.append(radius + self.zone.clearance - distance)
            slopes.append(-np.einsum("ki,kin->kn", away / distance[:, None], jacobian))

    def _pose(self, motion: Motion, side: str) -> FloatArray:
        """Return torso_from_hand (k, 4, 4) of moved postures."""
        return frame_pose(self.skeleton, motion, self._hands[side].frame)

    def _answer(self, hold: Hold, postures: FloatArray, costs: FloatArray) -> TakingPostures:
        """Return the different ones among postures (k, n), the cheapest first."""
        order = np.argsort(costs, kind="stable")
        postures, costs = postures[order], costs[order]
        motion = move_tree(self.skeleton, postures)
        hands = {side: self._pose(motion, side) for side in hold.sides}
        places = np.concatenate([pose[:, :3, 3] for pose in hands.values()], axis=1)
        kept: list[int] = []
        for index in range(len(postures)):
            near = np.abs(places[kept] - places[index]).max(axis=1) < DISTINCT_PLACE
            alike = np.abs(postures[kept] - postures[index]).max(axis=1) < DISTINCT_POSTURE
            if not (near & alike).any():
                kept.append(index)
        limbs = {side: self._limbs(motion, side)[kept] for side in hold.sides}
        return TakingPostures(postures[kept], costs[kept], {side: pose[kept] for side, pose in hands.items()}, limbs)

    def _limbs(self, motion: Motion, side: str) -> FloatArray:
        """Return shoulder, elbow, wrist and grip (k, 4, 3) [m] of moved postures."""
        hand = self._hands[side]
        upper_arm = self.skeleton.joints[self.skeleton.chain(hand.segment)[0]]
        for index in self.skeleton.chain(hand.segment):
            joint = self.skeleton.joints[index]
            if joint.segment == f"{side}_upper_arm":
                upper_arm = joint
        points = (
            (upper_arm.segment, upper_arm.point),
            (upper_arm.segment, hand.elbow),
            (hand.segment, hand.wrist),
            (hand.segment, hand.zero_from_hand[:3, 3]),
        )
        moved = []
        for segment, point in points:
            pose = motion.poses[..., self.skeleton.joint_carrying(segment) + 1, :, :]
            moved.append(pose[..., :3, :3] @ point + pose[..., :3, 3])
        return np.stack(moved, axis=-2)


def check_person(skeleton: Skeleton) -> None:
    """Refuse a skeleton that cannot stand anywhere or whose limits are not known.

    Raises:
        BadModelError: Says why and what to do.
    """
    if not skeleton.is_free:
        raise BadModelError(
            f"skeleton {skeleton.name!r} is fixed to the world, so it cannot follow the person's torso; calibrate "
            "with a template whose root is free, such as upper_body"
        )
    known = np.isfinite(skeleton.lower) & np.isfinite(skeleton.upper)
    if not known.all():
        names = [name for name, is_known in zip(skeleton.displacement_names, known) if not is_known]
        raise BadModelError(
            f"skeleton {skeleton.name!r}: the limits of {', '.join(names)} are unknown; calibrate with motions that "
            "move these joints"
        )


def body_distance(points: FloatArray) -> FloatArray:
    """Return the distance (...) [m] of points (..., 3), torso frame, from the surfaces of trunk and head."""
    return np.min([np.linalg.norm(away, axis=-1) - radius for away, radius in _body_offsets(points)], axis=0)


def infeasible(who: str, zone: Zone) -> InfeasibleError:
    """Return the error of a person who cannot bring a hand into the zone."""
    low, high = zone.heights
    return InfeasibleError(
        f"{who}: within the joint limits of the profile no hand that holds it comes {zone.in_front:g} m in front of "
        f"the body between {low:g} and {high:g} m of the shoulders' height; calibrate again, moving the joints through "
        "their whole range, or choose scheme relative",
        ErrorCode.NOT_FEASIBLE_FOR_PERSON,
    )


def _body_offsets(points: FloatArray) -> tuple[tuple[FloatArray, float], ...]:
    """Return the offsets (..., 3) of points from trunk axis and head centre, with the radii [m]."""
    trunk = points.copy()
    trunk[..., 2] = np.maximum(points[..., 2] - TRUNK_TOP, 0.0)
    return (trunk, TRUNK_RADIUS), (points - HEAD, HEAD_RADIUS)


def _chosen(postures: TakingPostures, kept: int) -> TakingPostures:
    """Return at most ``kept`` postures: the cheapest few, and the cheapest ones elsewhere, the hands ever farther."""
    places = np.concatenate([poses[:, :3, 3] for poses in postures.hands.values()], axis=1)
    rows = list(range(min((kept + 1) // 2, len(postures))))
    for index in range(len(rows), len(postures)):
        if len(rows) == kept:
            break
        if (np.abs(places[rows] - places[index]).max(axis=1) >= APART).all():
            rows.append(index)
    return TakingPostures(
        postures.displacements[rows],
        postures.costs[rows],
        {side: poses[rows] for side, poses in postures.hands.items()},
        {side: limbs[rows] for side, limbs in postures.limbs.items()},
    )
