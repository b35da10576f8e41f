"""What is true in the simulated cell, for evaluation and the operator: who holds what, where objects lie, events."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from handover_ros.geometry import FloatArray
from handover_ros.sim.grasping import GraspChange, Grasping
from handover_ros.sim.robot import LimitCounts
from handover_ros.sim.scenery import SCENE_PREFIX
from handover_ros.sim.world import OBJECT_PREFIX, World

NOTHING, TABLE, GOAL, FLOOR = 0, 1, 2, 3
SUPPORT_NAMES = {NOTHING: "none", TABLE: "table", GOAL: "goal", FLOOR: "floor"}
AT_REST = 0.03  # [m/s] an object that lies


@dataclass(frozen=True)
class SimulationEvent:
    """Something an operator would notice.

    Attributes:
        time: [s] of the simulation's clock.
        kind: grasped, released, taken, placed, dropped, reset, fault or person.
        object_name: Object concerned; empty: none.
        holder: ``robot:<arm>`` or ``person:<hand>`` that holds or held it; empty: nobody.
        message: One sentence.
    """

    time: float
    kind: str
    message: str
    object_name: str = ""
    holder: str = ""


@dataclass(frozen=True, eq=False)
class Truth:
    """True state of the cell.

    Attributes:
        time: [s] of the simulation's clock.
        torso: world_from_torso (4, 4); None without a person.
        joint_names: The person's joints.
        displacements: Of these joints [m, rad].
        velocities: Of these joints [m/s, rad/s].
        objects: Object name to world_from_object (4, 4).
        holders: Object name to ``robot:<arm>``, ``person:<hand>`` (joined by ``+``), table, goal, floor or none.
        counts: How often the robot left its limits.
    """

    time: float
    torso: FloatArray | None
    joint_names: tuple[str, ...]
    displacements: FloatArray
    velocities: FloatArray
    objects: Mapping[str, FloatArray]
    holders: Mapping[str, str]
    counts: LimitCounts


class ObjectWatch:
    """Watches where the objects are: on what they lie, and when they were placed or dropped.

    Args:
        world: The cell.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        model = world.model
        self._names = tuple(world.objects)
        self._speeds_at = np.array([[start + axis for axis in range(3)] for _, start in world.object_joints.values()])
        self._object_of_geom = np.full(model.ngeom, -1)
        self._surface_of_geom = np.full(model.ngeom, NOTHING)
        for geom in range(model.ngeom):
            name = model.geom(geom).name
            if name.startswith(OBJECT_PREFIX):
                self._object_of_geom[geom] = self._names.index(name.split("/")[1])
            elif name == f"{SCENE_PREFIX}floor":
                self._surface_of_geom[geom] = FLOOR
            elif name == f"{SCENE_PREFIX}{world.scene.default_goal_surface}":
                self._surface_of_geom[geom] = GOAL
            elif name.startswith(SCENE_PREFIX):
                self._surface_of_geom[geom] = TABLE
        self.reset()

    def reset(self) -> None:
        """Forget what happened before."""
        self._supports = np.full(len(self._names), TABLE)
        self._loose: dict[str, str] = {}
        self._on_floor: set[str] = set()

    def let_go(self, name: str, holder: str) -> None:
        """Note that nobody holds an object any more; ``holder`` was the last one."""
        self._loose[name] = holder

    def update(self, data: mujoco.MjData, grasping: Grasping, time: float) -> list[SimulationEvent]:
        """Look at all contacts and return what was placed or dropped since the last time."""
        self._supports = self._find_supports(data)
        speeds = self.speeds(data)
        events = []
        for index, name in enumerate(self._names):
            if grasping.holders(name):
                self._loose.pop(name, None)
                self._on_floor.discard(name)
                continue
            if self._supports[index] == FLOOR:
                if name not in self._on_floor:
                    self._on_floor.add(name)
                    holder = self._loose.pop(name, "")
                    after = f" after {holder} let go" if holder else ""
                    events.append(
                        SimulationEvent(time, "dropped", f"the {name} fell to the floor{after}", name, holder)
                    )
            elif name in self._loose and self._supports[index] != NOTHING and speeds[name] < AT_REST:
                holder = self._loose.pop(name)
                where = "at its goal" if self._supports[index] == GOAL else "on a table"
                events.append(SimulationEvent(time, "placed", f"the {name} was put down {where}", name, holder))
        return events

    def speeds(self, data: mujoco.MjData) -> dict[str, float]:
        """Return the speed of each object's origin [m/s]."""
        if not self._names:
            return {}
        speeds = np.sqrt(np.square(data.qvel[self._speeds_at]).sum(axis=1))
        return dict(zip(self._names, speeds.tolist(), strict=True))

    def holder(self, name: str, grasping: Grasping) -> str:
        """Return who or what holds an object, as ``Truth.holders`` says it."""
        return "+".join(grasping.holders(name)) or SUPPORT_NAMES[int(self._supports[self._names.index(name)])]

    def _find_supports(self, data: mujoco.MjData) -> np.ndarray:
        """Return what each object touches: the floor before the goal before a table. Shape (objects,)."""
        supports = np.full(len(self._names), NOTHING)
        pairs = data.contact.geom
        for item, surface in ((pairs[:, 0], pairs[:, 1]), (pairs[:, 1], pairs[:, 0])):
            items = self._object_of_geom[item]
            touching = items >= 0
            np.maximum.at(supports, items[touching], self._surface_of_geom[surface[touching]])
        return supports


def object_poses(world: World, data: mujoco.MjData) -> dict[str, FloatArray]:
    """Return the true world_from_object (4, 4) of all objects."""
    bodies = list(world.object_bodies.values())
    poses = np.zeros((len(bodies), 4, 4))
    poses[:, :3, :3] = data.xmat[bodies].reshape(-1, 3, 3)
    poses[:, :3, 3] = data.xpos[bodies]
    poses[:, 3, 3] = 1.0
    return dict(zip(world.object_bodies, poses, strict=True))


def grasp_event(change: GraspChange, time: float) -> SimulationEvent:
    """Return the event that tells of a change of hold at a time [s]."""
    kind_of_holder, _, side = change.holder.partition(":")
    robot, name = kind_of_holder == "robot", change.object_name
    who = f"the robot's {side} gripper" if robot else f"the person's {side} hand"
    if not change.held:
        return SimulationEvent(time, "released", f"{who} let go of the {name}", name, change.holder)
    kind, verb = ("grasped", "grasped") if robot else ("taken", "took hold of")
    return SimulationEvent(time, kind, f"{who} {verb} the {name} at {change.region}", name, change.holder)
