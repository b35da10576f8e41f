"""A small cell for tests of the person: a floor, a table, one object, and a mocap body that stands for the robot."""

from __future__ import annotations

import mujoco
import numpy as np

from handover_ros.geometry import invert_transform, transform_from_xyz_rpy
from handover_ros.objects import load_catalogue
from handover_ros.sim.person import Person, PersonView
from handover_ros.sim.person_model import add_person
from handover_ros.sim.person_spec import HANDS, PersonSpec

VOLUME = {
    "box": lambda s: s[0] * s[1] * s[2],
    "cylinder": lambda s: np.pi * s[0] ** 2 * s[1],
    "capsule": lambda s: np.pi * s[0] ** 2 * s[1],
    "sphere": lambda s: 4.0 * s[0] ** 3,
}
GEOM = {
    "box": (mujoco.mjtGeom.mjGEOM_BOX, lambda s: [s[0] / 2, s[1] / 2, s[2] / 2]),
    "cylinder": (mujoco.mjtGeom.mjGEOM_CYLINDER, lambda s: [s[0], s[1] / 2, 0]),
    "capsule": (mujoco.mjtGeom.mjGEOM_CAPSULE, lambda s: [s[0], s[1] / 2, 0]),
    "sphere": (mujoco.mjtGeom.mjGEOM_SPHERE, lambda s: [s[0], 0, 0]),
}
WORLD_FROM_FEET = transform_from_xyz_rpy((1.45, 0.0, 0.0), (0.0, 0.0, np.pi))
TABLE = {"centre": (1.42, 0.72), "size": (0.5, 0.6), "height": 0.90}


class PersonCell:
    """Runs a person with one object that a mocap body offers."""

    def __init__(
        self,
        person: PersonSpec,
        object_name: str = "mug",
        offer: np.ndarray | None = None,
        goal: np.ndarray | None = None,
        seed: int = 0,
        mass: float | None = None,
    ) -> None:
        self.object_name = object_name
        self.catalogue = load_catalogue()
        thing = self.catalogue[object_name]
        self.offer = transform_from_xyz_rpy((0.98, 0.0, 1.10)) if offer is None else offer
        self.goal = transform_from_xyz_rpy((1.32, 0.56, TABLE["height"])) if goal is None else goal
        spec = mujoco.MjSpec()
        spec.option.timestep = 0.002
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.visual.global_.offwidth, spec.visual.global_.offheight = 1600, 1000
        world = spec.worldbody
        world.add_light(pos=[0.5, -1.5, 3.2], dir=[0.3, 0.4, -1.0], diffuse=[0.6] * 3)
        fixed = {"contype": 4, "conaffinity": 2}
        world.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[4, 4, 0.1], rgba=[0.75, 0.77, 0.8, 1], **fixed)
        top = [*TABLE["centre"], TABLE["height"] - 0.015]
        size = [TABLE["size"][0] / 2, TABLE["size"][1] / 2, 0.015]
        world.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, pos=top, size=size, rgba=[0.7, 0.58, 0.42, 1], **fixed)
        position, quaternion = _mujoco_pose(self.offer)
        body = world.add_body(name=f"object/{object_name}", pos=position, quat=quaternion)
        body.add_freejoint(name=f"object/{object_name}/free")
        volume = sum(VOLUME[primitive.type](primitive.size) for primitive in thing.primitives)
        for primitive in thing.primitives:
            shape, half = GEOM[primitive.type]
            place, turn = _mujoco_pose(primitive.object_from_primitive)
            share = (mass or thing.mass) * VOLUME[primitive.type](primitive.size) / volume
            body.add_geom(
                type=shape, size=half(primitive.size), pos=place, quat=turn, rgba=primitive.colour, mass=share,
                contype=2, conaffinity=6,
            )  # fmt: skip
        robot = world.add_body(name="robot", mocap=True, pos=position, quat=quaternion)
        gripper = thing.robot_grasps[0].region.centre()
        place, turn = _mujoco_pose(gripper)
        robot.add_site(name="robot/left_gripper", pos=place, quat=turn)
        ends = [*(place - 0.04 * gripper[:3, 2]), *(place - 0.20 * gripper[:3, 2])]
        robot.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=ends, size=[0.035, 0, 0], rgba=[0.8, 0.2, 0.15, 1],
            contype=0, conaffinity=0,
        )  # fmt: skip
        add_person(spec, person, WORLD_FROM_FEET)
        for holder in ("robot", *(f"person/{hand}_hand" for hand in HANDS)):
            weld = spec.add_equality(
                name=f"hold/{holder}", type=mujoco.mjtEq.mjEQ_WELD, name1=holder, name2=f"object/{object_name}"
            )
            weld.objtype = mujoco.mjtObj.mjOBJ_BODY
            weld.active = holder == "robot"
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.person = Person(self.model, person, np.random.default_rng(seed), self.catalogue)
        self.person.place(self.data)
        mujoco.mj_forward(self.model, self.data)
        self.held: dict[str, str] = {}
        self.grip_errors: dict[str, tuple[float, float]] = {}
        self.robot_holds = True
        self._backed_off = 0.0
        self.offered_from = 0.2
        self.events: list[tuple[float, str]] = []
        self._set_weld("robot", True)

    @property
    def time(self) -> float:
        return float(self.data.time)

    def object_pose(self) -> np.ndarray:
        body = self.model.body(f"object/{self.object_name}").id
        return _pose(self.data.xpos[body], self.data.xmat[body])

    def release(self) -> None:
        """The robot lets go."""
        self.robot_holds = False
        self._set_weld("robot", False)

    def view(self) -> PersonView:
        name = self.object_name
        offered = name if self.robot_holds and self.time >= self.offered_from else None
        velocity = self.data.joint(f"object/{name}/free").qvel[:3]
        return PersonView(
            objects={name: self.object_pose()},
            held_by_robot={name: "left"} if self.robot_holds else {},
            held_by_hand=dict(self.held),
            object_speed={name: float(np.linalg.norm(velocity))},
            offered=offered,
            goals={name: self.goal},
        )

    def _back_off(self) -> None:
        """Move the gripper that let go away, at 0.3 m/s along its own axis, by 0.4 m."""
        if not self.robot_holds and self._backed_off < 0.4:
            site = self.model.site("robot/left_gripper").id
            self.data.mocap_pos[0] -= 0.003 * self.data.site_xmat[site].reshape(3, 3)[:, 2]
            self._backed_off += 0.003

    def step(self) -> None:
        """One update of the person (10 ms) with its five physics steps."""
        self._back_off()
        before = self.person.phase
        self.person.update(self.data, self.time, self.view())
        if self.person.phase != before:
            self.events.append((self.time, self.person.phase))
        for hand in HANDS:
            wanted = self.person.grip_request[hand]
            if wanted is not None and hand not in self.held:
                self._try_grip(hand, wanted)
            elif wanted is None and hand in self.held:
                self._set_weld(f"person/{hand}_hand", False)
                del self.held[hand]
        for _ in range(5):
            mujoco.mj_step(self.model, self.data)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 100)):
            self.step()

    def run_until(self, phase: str, limit: float = 20.0) -> bool:
        """Run until the person enters a phase; False after ``limit`` simulated seconds."""
        end = self.time + limit
        while self.time < end:
            self.step()
            if self.person.phase == phase:
                return True
        return False

    def hand_pose(self, hand: str) -> np.ndarray:
        site = self.model.site(f"person/{hand}_hand_grip").id
        return _pose(self.data.site_xpos[site], self.data.site_xmat[site])

    def _try_grip(self, hand: str, name: str) -> None:
        object_from_hand = invert_transform(self.object_pose()) @ self.hand_pose(hand)
        regions = self.catalogue[name].human_grasps
        if hand == "left":
            object_from_hand = object_from_hand @ np.diag([-1.0, -1.0, 1.0, 1.0])
        errors = [region.distance(object_from_hand) for region in regions]
        nearest = min(errors, key=lambda error: error[0] + 0.1 * error[1])
        if nearest[0] < 0.015 and nearest[1] < 0.2:
            self.grip_errors[hand] = nearest
            self.held[hand] = name
            self._set_weld(f"person/{hand}_hand", True)

    def _set_weld(self, holder: str, active: bool) -> None:
        """Switch a weld; the pose it holds is the one of this moment."""
        index = self.model.equality(f"hold/{holder}").id
        if active:
            body = self.model.body(holder).id
            relative = invert_transform(_pose(self.data.xpos[body], self.data.xmat[body])) @ self.object_pose()
            place, turn = _mujoco_pose(relative)
            self.model.eq_data[index, :3] = 0.0
            self.model.eq_data[index, 3:6] = place
            self.model.eq_data[index, 6:10] = turn
            self.model.eq_data[index, 10] = 1.0
        self.data.eq_active[index] = active


def _pose(position: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = matrix.reshape(3, 3)
    pose[:3, 3] = position
    return pose


def _mujoco_pose(pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(pose[:3, :3]).ravel())
    return pose[:3, 3].copy(), quaternion
