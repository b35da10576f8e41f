"""The personal scheme: the posture that this person prefers puts the object where it is offered (dissertation 2.2)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator
from scipy.spatial.transform import Rotation

from handover_ros.arm.model import SIDES
from handover_ros.ergonomics.costs import COSTS, PreferredPosture
from handover_ros.errors import BadRequestError, ErrorCode, InfeasibleError
from handover_ros.geometry import FloatArray, invert_transform, make_transform, transform_points
from handover_ros.objects.catalogue import ObjectModel
from handover_ros.planning.facing import object_corners
from handover_ros.planning.grasp_set import HALF_TURN, LEAST_APART
from handover_ros.planning.offers import HandoverTask, Offer, levelled
from handover_ros.planning.posture_words import posture_words
from handover_ros.planning.taking_postures import (
    Hold,
    PostureSearch,
    TakingPostures,
    Zone,
    body_distance,
    infeasible,
)
from handover_ros.planning.types import ExpectedPosture, TrackedPerson
from handover_ros.skeleton.tree import Skeleton
from handover_ros.yaml_file import Schema

START_STEP = 0.2  # [rad] to which the posture before is rounded: a swaying person gets the same answer
GRID_LENGTH, GRID_ANGLE = 0.05, 0.5  # [m], [rad]
GRASPS_PER_REGION = 5
PEOPLE = 8  # searches that are kept
UP = np.array([0.0, 0.0, 1.0])

Metres = Annotated[float, Field(ge=-2.0, le=2.0)]


def _known_cost(name: str) -> str:
    """Refuse a cost that does not exist."""
    if name not in COSTS:
        raise ValueError(f"unknown posture cost; known: {', '.join(COSTS)}")
    return name


class ZoneFile(Schema):
    """Where a hand may be expected; see ``Zone``."""

    heights: tuple[Metres, Metres] = (-0.50, -0.05)
    in_front: Metres = 0.20
    clearance: Annotated[float, Field(ge=0.0, le=1.0)] = 0.10
    limit_margin: Annotated[float, Field(ge=0.0, le=1.0)] = 0.05

    @model_validator(mode="after")
    def _check(self) -> ZoneFile:
        """Refuse heights that cross."""
        if self.heights[0] >= self.heights[1]:
            raise ValueError(f"heights: the lower one {self.heights[0]:g} must be below {self.heights[1]:g}")
        return self


class PersonalFile(Schema):
    """Content of a file of a personal scheme.

    Attributes:
        kind: Tells it from the others.
        cost: Which posture a person prefers, as in ``ergonomics.costs.COSTS``.
        hand: ``cheaper`` lets all hands compete, ``dominant`` asks the others only where that one cannot.
        level: Ignore how the torso leans, use its heading only.
        zone: Where a hand may be expected.
        leans: How far the top of an object between two hands leans away from the person [rad]; not for objects that
            must stay upright.
        alternatives: Postures kept for each way to hold the object.
        most_offers: Offers at most.
    """

    kind: Literal["personal"]
    cost: Annotated[str, AfterValidator(_known_cost)] = PreferredPosture.name
    hand: Literal["cheaper", "dominant"] = "cheaper"
    level: bool = True
    zone: ZoneFile = ZoneFile()
    leans: tuple[Annotated[float, Field(ge=-1.6, le=1.6)], ...] = (0.0, 0.5, 0.9)
    alternatives: Annotated[int, Field(ge=1, le=200)] = 12
    most_offers: Annotated[int, Field(ge=1, le=2000)] = 160


@dataclass(frozen=True, eq=False)
class Grasp:
    """One way to hold an object: the hands on it, and what that demands of a posture."""

    region: str
    hold: Hold
    object_from_hands: tuple[FloatArray, ...]


@dataclass(frozen=True)
class PersonalScheme:
    """Offers where the person's own preferred posture has the hand, the cheapest posture first.

    Attributes:
        name: As in ``config/schemes``.
        content: What the file says.
    """

    name: str
    content: PersonalFile
    needs_person: bool = True

    def offers(self, task: HandoverTask) -> list[Offer]:
        """Return the offers for this person.

        Raises:
            StaleDataError: Nobody is tracked.
            BadRequestError: No profile is active; says what to do.
            BadModelError: The profile's skeleton cannot be used.
            InfeasibleError: The person cannot take the object in front of the body.
        """
        model, person = task.model, task.tracked_person(self.name)
        search = self.search(person)
        order = _hands_in_order(search, person)
        grasps = object_grasps(model, order, self.content.leans)
        if not grasps:
            raise InfeasibleError(
                f"{model.name} needs two hands, and the skeleton of {person.profile or 'the person'} has the "
                f"{' and '.join(search.sides)} hand only; calibrate with template upper_body, or choose scheme "
                "relative",
                ErrorCode.NOT_FEASIBLE_FOR_PERSON,
            )
        found = search.postures([grasp.hold for grasp in grasps], self.content.alternatives)
        ranked = []
        for number, (grasp, postures) in enumerate(zip(grasps, found, strict=True)):
            rank = order.index(grasp.hold.sides[0])
            first = rank if self.content.hand == "dominant" else 0
            ranked += [(first, cost, rank, number, index) for index, cost in enumerate(postures.costs.tolist())]
        frame = levelled(person.world_from_torso) if self.level else person.world_from_torso
        corners = object_corners(model)
        offers: list[Offer] = []
        least = np.inf  # cost of the first offer
        for _, cost, _, number, index in sorted(ranked):
            torso_from_object = _object_pose(grasps[number], found[number], index)
            if np.min(body_distance(transform_points(torso_from_object, corners))) < self.content.zone.clearance:
                continue
            least = cost if not offers else least
            nominal = cost <= least
            offers.append(self._offer(search, frame, torso_from_object, grasps[number], found[number], index, nominal))
            if len(offers) == self.content.most_offers:
                break
        if not offers:
            raise infeasible(f"{model.name} for {person.profile or 'the person'}", self.zone)
        return offers

    @property
    def level(self) -> bool:
        """Whether only the torso's heading counts."""
        return self.content.level

    @property
    def zone(self) -> Zone:
        """Where a hand may be expected."""
        return Zone(**self.content.zone.model_dump())

    def search(self, person: TrackedPerson) -> PostureSearch:
        """Return the search for a person's postures, remembered from one request to the next.

        Raises:
            BadRequestError: No profile is active.
            BadModelError: The profile's skeleton cannot be used.
        """
        if person.skeleton is None:
            reason = person.profile_problem or "no profile is active"
            raise BadRequestError(
                f"scheme {self.name!r} needs the skeleton of the person, and {reason}: calibrate the person or "
                "activate a profile (calibration/activate_profile), or choose scheme relative"
            )
        start: tuple[float, ...] | None = None
        # The preferred posture (2.11) is the same wherever the person is before.
        if self.content.cost != PreferredPosture.name and person.displacements is not None:
            start = tuple((START_STEP * np.round(np.asarray(person.displacements) / START_STEP)).tolist())
        return _search(person.skeleton, self.content.cost, person.mass, start, self.zone)

    def _offer(
        self,
        search: PostureSearch,
        world_from_torso: FloatArray,
        torso_from_object: FloatArray,
        grasp: Grasp,
        postures: TakingPostures,
        index: int,
        nominal: bool,
    ) -> Offer:
        """Return the offer of one posture."""
        world_from_object = world_from_torso @ torso_from_object
        hands = {
            side: world_from_object @ object_from_hand
            for side, object_from_hand in zip(grasp.hold.sides, grasp.object_from_hands)
        }
        limbs = {side: transform_points(world_from_torso, postures.limbs[side][index]) for side in hands}
        # The forearms come from there, and the gripper must not.
        come = sum((points[3] - points[1] for points in limbs.values()), np.zeros(3))
        if np.hypot(come[0], come[1]) < 0.05:
            come = world_from_torso[:3, 0]
        reach = np.array([come[0], come[1], 0.0]) / np.hypot(come[0], come[1])
        displacements = postures.displacements[index]
        expected = ExpectedPosture(
            hands=hands,
            limbs=limbs,
            displacements=displacements,
            cost=float(postures.costs[index]),
            cost_name=search.cost.name,
            words=posture_words(search.skeleton.displacement_names, displacements, grasp.hold.sides),
        )
        placed = tuple(hands.values())
        other = placed[1] if len(placed) == 2 else None
        return Offer(world_from_object, grasp.region, placed[0], reach, nominal, other, expected)


@lru_cache(maxsize=PEOPLE)
def _search(
    skeleton: Skeleton, cost: str, body_mass: float, start: tuple[float, ...] | None, zone: Zone
) -> PostureSearch:
    """Return the search for a person; the same one for the same arguments, with what it found before."""
    return PostureSearch(skeleton, cost, body_mass, None if start is None else np.array(start), zone)


def _hands_in_order(search: PostureSearch, person: TrackedPerson) -> tuple[str, ...]:
    """Return the person's hands, the dominant one first."""
    first = person.dominant or SIDES[0]
    return tuple(sorted(search.sides, key=lambda side: (side != first, side)))


@lru_cache(maxsize=64)
def object_grasps(model: ObjectModel, sides: tuple[str, ...], leans: tuple[float, ...]) -> tuple[Grasp, ...]:
    """Return the ways to hold an object with the given hands, in the order of regions and hands.

    An object that may lean comes free, then upright; between two hands its top also leans away from the person.
    """
    hands = {side: _poses(model, side) for side in sides}
    grasps = []
    ways = (True,) if model.keep_upright else (False, True)
    if model.hands == 1:
        for side, upright in product(sides, ways):
            for region, pose in hands[side]:
                up = _in_hand(UP if upright else None, pose)
                grasps.append(Grasp(region, Hold((side,), up), (pose,)))
        return tuple(grasps)
    if len(sides) < 2:
        return ()
    for (region, first), (other, second) in product(*(_centres(model, side) for side in SIDES)):
        across = second[:2, 3] - first[:2, 3]
        if region == other or np.linalg.norm(across) < LEAST_APART:
            continue
        apart = tuple(np.round(invert_transform(first) @ second, 9).ravel().tolist())
        forward = np.array([across[1], -across[0], 0.0]) / np.linalg.norm(across)
        ups: list[FloatArray | None] = [UP] if model.keep_upright else [None]
        ups += [] if model.keep_upright else [np.cos(lean) * UP - np.sin(lean) * forward for lean in leans]
        for direction in ups:
            grasps.append(Grasp(region, Hold(SIDES, _in_hand(direction, first), apart), (first, second)))
    return tuple(grasps)


def _in_hand(up: FloatArray | None, object_from_hand: FloatArray) -> tuple[float, float, float] | None:
    """Return a direction (3,) of the object in the frame of a hand on it."""
    if up is None:
        return None
    x, y, z = np.round(up @ object_from_hand[:3, :3], 4).tolist()
    return x, y, z


def _centres(model: ObjectModel, side: str) -> list[tuple[str, FloatArray]]:
    """Return the middle of each region, for one hand."""
    turn = HALF_TURN if side == "left" else np.eye(4)
    return [(region.name, region.centre() @ turn) for region in model.human_grasps]


def _poses(model: ObjectModel, side: str) -> list[tuple[str, FloatArray]]:
    """Return hand poses spread over each region, its middle first."""
    turn = HALF_TURN if side == "left" else np.eye(4)
    poses = []
    for region in model.human_grasps:
        grid = region.grid(GRID_LENGTH, GRID_ANGLE)
        if len(grid) > GRASPS_PER_REGION:
            grid = grid[np.unique(np.linspace(0, len(grid) - 1, GRASPS_PER_REGION).round().astype(int))]
        middle = region.centre()
        others = [pose for pose in grid if np.abs(pose - middle).max() > 1e-6]
        poses += [(region.name, pose @ turn) for pose in (middle, *others)]
    return poses


def _object_pose(grasp: Grasp, postures: TakingPostures, index: int) -> FloatArray:
    """Return torso_from_object (4, 4) of a posture; exactly as upright as the hold demands."""
    hand = postures.hands[grasp.hold.sides[0]][index]
    pose = hand @ invert_transform(grasp.object_from_hands[0])
    if grasp.hold.up is None:
        return pose
    pointing = hand[:3, :3] @ np.array(grasp.hold.up)
    rotation = Rotation.align_vectors(UP[None], pointing[None])[0].as_matrix() @ pose[:3, :3]
    return make_transform(rotation, hand[:3, 3] - rotation @ grasp.object_from_hands[0][:3, 3])
