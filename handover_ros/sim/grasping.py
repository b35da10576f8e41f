"""Who holds what: grippers and hands take hold of objects by welds that close without a jerk and open again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from handover_ros.geometry import FloatArray, invert_transform, make_transform
from handover_ros.objects.regions import TaskSpaceRegion
from handover_ros.sim.grippers import Grippers
from handover_ros.sim.world import World

# A gripper holds when its frame is this near to a grasp region and its fingers touch: the fingers are wider than long.
GRIPPER_TOLERANCE = (0.015, 0.20)  # [m], [rad]
# A hand is soft: it closes around a grip that it meets less exactly.
HAND_TOLERANCE = (0.03, 0.50)  # [m], [rad]
LEAST_SQUEEZE = 0.001  # [m] between the fingers' opening and their command when something blocks them
LEAST_FORCE = 0.5  # [N] of fingers that press on something
FARTHEST_ORIGIN = 0.6  # [m] from a gripper to the origin of an object that it can hold
TOUCH_GAP = 0.0015  # [m] between the fingers' opening and the object's width when they touch
DEEPEST_SQUEEZE = 0.006  # [m] that the opening may be below the width and still hold
RELEASE_GAP = 0.003  # [m] that the opening must grow to let go

#: The left hand uses a human region turned by half a turn about the hand's z.
LEFT_FROM_RIGHT = make_transform(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))


@dataclass(frozen=True)
class GraspChange:
    """Something was taken hold of or let go: ``holder`` is ``robot:<arm>`` or ``person:<hand>``."""

    holder: str
    object_name: str
    held: bool
    region: str = ""


class Grasping:
    """Opens and closes the welds between holders and objects.

    Args:
        world: The cell.
        grippers: The robot's fingers.
    """

    def __init__(self, world: World, grippers: Grippers) -> None:
        self._world = world
        self._grippers = grippers
        self.held_by_robot: dict[str, str] = {}  # object to arm
        self.held_by_hand: dict[str, str] = {}  # hand to object
        self._opening_at_grasp: dict[str, float] = {}

    def reset(self, data: mujoco.MjData) -> None:
        """Let go of everything at once."""
        for weld in (*self._world.gripper_welds.values(), *self._world.hand_welds.values()):
            data.eq_active[weld] = 0
        self.held_by_robot.clear()
        self.held_by_hand.clear()
        self._opening_at_grasp.clear()

    def holders(self, name: str) -> tuple[str, ...]:
        """Return who holds an object: ``robot:<arm>`` first, then ``person:<hand>``."""
        arms = [f"robot:{arm}" for item, arm in self.held_by_robot.items() if item == name]
        hands = [f"person:{hand}" for hand, item in sorted(self.held_by_hand.items()) if item == name]
        return (*arms, *hands)

    def update_grippers(self, data: mujoco.MjData) -> list[GraspChange]:
        """Close welds of grippers whose fingers closed on an object, open those whose fingers opened."""
        changes = []
        for arm in self._world.gripper_sites:
            held = next((name for name, by in self.held_by_robot.items() if by == arm), None)
            if held is None:
                changes += self._try_gripper(data, arm)
            elif self._grippers.opening(data, arm) > self._opening_at_grasp[arm] + RELEASE_GAP:
                data.eq_active[self._world.gripper_welds[arm, held]] = 0
                del self.held_by_robot[held]
                changes.append(GraspChange(f"robot:{arm}", held, held=False))
        return changes

    def update_hands(self, data: mujoco.MjData, requests: Mapping[str, str | None]) -> list[GraspChange]:
        """Close and open welds of the person's hands.

        Args:
            data: State of the simulation.
            requests: Hand (left, right) to the object it wants to hold now, None: nothing.
        """
        changes = []
        for hand in self._world.hand_sites:
            wanted, held = requests.get(hand), self.held_by_hand.get(hand)
            if held is not None and wanted != held:
                data.eq_active[self._world.hand_welds[hand, held]] = 0
                del self.held_by_hand[hand]
                changes.append(GraspChange(f"person:{hand}", held, held=False))
                held = None
            if held is None and wanted in self._world.objects:
                changes += self._try_hand(data, hand, str(wanted))
        return changes

    def _try_gripper(self, data: mujoco.MjData, arm: str) -> list[GraspChange]:
        """Take hold of the object between the closing fingers of an arm, if there is one."""
        commanded = self._grippers.commanded(arm)
        if commanded >= self._grippers.range(arm)[1]:
            return []
        opening = self._grippers.opening(data, arm)
        if opening - commanded < LEAST_SQUEEZE or self._grippers.force(data, arm) < LEAST_FORCE:
            return []
        site = self._world.gripper_sites[arm]
        for name, item in self._world.objects.items():
            if np.linalg.norm(data.xpos[self._world.object_bodies[name]] - data.site_xpos[site]) > FARTHEST_ORIGIN:
                continue
            for grasp in item.robot_grasps:
                if not -DEEPEST_SQUEEZE <= opening - grasp.width <= TOUCH_GAP:
                    continue
                object_from_gripper = self._object_from_site(data, name, site)
                if _is_near(grasp.region, object_from_gripper, GRIPPER_TOLERANCE):
                    self._close(data, self._world.gripper_welds[arm, name])
                    self.held_by_robot.pop(name, None)
                    self.held_by_robot[name] = arm
                    self._opening_at_grasp[arm] = opening
                    return [GraspChange(f"robot:{arm}", name, held=True, region=grasp.region.name)]
        return []

    def _try_hand(self, data: mujoco.MjData, hand: str, name: str) -> list[GraspChange]:
        """Take hold of an object with a hand that is at one of its human regions."""
        object_from_hand = self._object_from_site(data, name, self._world.hand_sites[hand])
        if hand == "left":
            object_from_hand = object_from_hand @ LEFT_FROM_RIGHT
        for region in self._world.objects[name].human_grasps:
            if _is_near(region, object_from_hand, HAND_TOLERANCE):
                self._close(data, self._world.hand_welds[hand, name])
                self.held_by_hand[hand] = name
                return [GraspChange(f"person:{hand}", name, held=True, region=region.name)]
        return []

    def _object_from_site(self, data: mujoco.MjData, name: str, site: int) -> FloatArray:
        """Return the pose of a site in an object's frame."""
        body = self._world.object_bodies[name]
        world_from_object = make_transform(data.xmat[body].reshape(3, 3), data.xpos[body])
        world_from_site = make_transform(data.site_xmat[site].reshape(3, 3), data.site_xpos[site])
        return invert_transform(world_from_object) @ world_from_site

    def _close(self, data: mujoco.MjData, weld: int) -> None:
        """Activate a weld at the bodies' present relative pose, so that nothing moves by it."""
        model = self._world.model
        holder, item = model.eq_obj1id[weld], model.eq_obj2id[weld]
        holder_from_world, relative = np.zeros(4), np.zeros(4)
        mujoco.mju_negQuat(holder_from_world, data.xquat[holder])
        mujoco.mju_mulQuat(relative, holder_from_world, data.xquat[item])
        model.eq_data[weld, :3] = 0.0
        model.eq_data[weld, 3:6] = data.xmat[holder].reshape(3, 3).T @ (data.xpos[item] - data.xpos[holder])
        model.eq_data[weld, 6:10] = relative
        data.eq_active[weld] = 1


def _is_near(region: TaskSpaceRegion, object_from_hand: FloatArray, tolerance: tuple[float, float]) -> bool:
    """Return whether a hand pose is within metres and radians of a region."""
    metres, radians = region.distance(object_from_hand)
    return metres <= tolerance[0] and radians <= tolerance[1]
