"""The whole cell as one MuJoCo model: floor, tables, objects, robot, person, lights and cameras."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from handover_ros.errors import BadModelError
from handover_ros.geometry import FloatArray
from handover_ros.objects.catalogue import ObjectModel, Primitive
from handover_ros.objects.scene import Scene
from handover_ros.robot.model import RobotModel
from handover_ros.sim.person_model import PersonSpec, add_person
from handover_ros.sim.robot_body import FIXED_BIT, OBJECT_BIT, ROBOT_BIT, add_robot
from handover_ros.sim.scenery import SCENE_GROUP, add_surroundings, mujoco_quaternion

OBJECT_PREFIX = "object/"
HANDS = ("left", "right")
LONGEST_TIMESTEP = 0.005  # [s] the servos' fastest pole asks for less than this
# Welds of hands and fingers: stiff (time constant 8 ms), critically damped.
WELD_SOLREF = (0.008, 1.0)
WELD_SOLIMP = (0.95, 0.99, 0.001, 0.5, 2.0)
OBJECT_FRICTION = (0.9, 0.01, 0.0002)
OBJECT_SOLREF = (0.01, 1.0)  # contact: time constant [s], damping ratio
DECORATION_THICKNESS = 0.002  # [m] thinner solids are drawn only

IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class JointGroup:
    """Places of some joints in MuJoCo's arrays, each of shape (n,): positions, velocities and actuators."""

    names: tuple[str, ...]
    positions: IntArray
    velocities: IntArray
    actuators: IntArray


@dataclass(frozen=True, eq=False)
class World:
    """A compiled cell and where things are in it.

    Attributes:
        model: The MuJoCo model.
        scene: What it was built from.
        robot: The robot's kinematic model.
        objects: Objects of the scene by name.
        person: The person, None: nobody.
        arms: Arm name to its joints.
        fingers: Arm name to its finger joints.
        object_bodies: Object name to body number.
        object_joints: Object name to its free joint's first place in qpos and in qvel.
        gripper_sites: Arm name to the site of its gripper frame.
        hand_sites: Hand (left, right) to the site of its grip frame; empty without a person.
        gripper_welds: (arm, object) to equality number.
        hand_welds: (hand, object) to equality number.
    """

    model: mujoco.MjModel
    scene: Scene
    robot: RobotModel
    objects: Mapping[str, ObjectModel]
    person: PersonSpec | None
    arms: Mapping[str, JointGroup]
    fingers: Mapping[str, JointGroup]
    object_bodies: Mapping[str, int]
    object_joints: Mapping[str, tuple[int, int]]
    gripper_sites: Mapping[str, int]
    hand_sites: Mapping[str, int]
    gripper_welds: Mapping[tuple[str, str], int]
    hand_welds: Mapping[tuple[str, str], int]


def build_world(
    scene: Scene,
    robot: RobotModel,
    objects: Mapping[str, ObjectModel],
    person: PersonSpec | None,
    timestep: float = 0.002,
) -> World:
    """Return the cell of a scene.

    Args:
        scene: Tables, placements, cameras.
        robot: The robot.
        objects: Models of (at least) the objects that the scene places.
        person: Who stands at ``scene.person_pose``; None: nobody.
        timestep: Physics step [s].

    Raises:
        BadModelError: A mesh cannot be used, the time step is out of range, or MuJoCo refuses the model.
    """
    if not 0.0 < timestep <= LONGEST_TIMESTEP:
        raise BadModelError(
            f"physics time step {timestep} s is out of range; use more than 0 and at most {LONGEST_TIMESTEP} s"
        )
    spec = mujoco.MjSpec()
    spec.compiler.balanceinertia = True
    spec.compiler.degree = False
    spec.option.timestep = timestep
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    add_surroundings(spec, scene)
    add_robot(spec, robot)
    placed = {name: objects[name] for name in scene.placements}
    for name, item in placed.items():
        _add_object(spec, item, scene.placements[name])
    if person is not None:
        add_person(spec, person, scene.person_pose)
    _add_welds(spec, robot, tuple(placed), person is not None)
    try:
        model = spec.compile()
    except ValueError as error:
        raise BadModelError(f"scene {scene.name!r}: MuJoCo refuses the model: {' '.join(str(error).split())}") from None
    return _index(model, scene, robot, placed, person)


def _add_object(spec: mujoco.MjSpec, item: ObjectModel, world_from_object: FloatArray) -> None:
    """Add an object that moves freely; its mass is spread over its solids by volume."""
    body = spec.worldbody.add_body(name=f"{OBJECT_PREFIX}{item.name}")
    body.pos, body.quat = world_from_object[:3, 3], mujoco_quaternion(world_from_object)
    joint = body.add_freejoint()
    joint.name = f"{OBJECT_PREFIX}{item.name}/free"
    volumes = np.array([primitive_volume(primitive) for primitive in item.primitives])
    for index, primitive in enumerate(item.primitives):
        drawn_only = min(primitive.size) < DECORATION_THICKNESS
        colour = primitive.colour
        material = f"{OBJECT_PREFIX}{item.name}/{index}"
        spec.add_material(name=material, rgba=list(colour), specular=0.4, shininess=0.5)
        geom = body.add_geom(
            name=f"{OBJECT_PREFIX}{item.name}/{index}",
            material=material,
            group=SCENE_GROUP,
            mass=float(item.mass * volumes[index] / volumes.sum()),
            contype=0 if drawn_only else OBJECT_BIT,
            conaffinity=0 if drawn_only else ROBOT_BIT | OBJECT_BIT | FIXED_BIT,
            friction=OBJECT_FRICTION,
            solref=OBJECT_SOLREF,
            condim=4,
        )
        geom.type, geom.size = _mujoco_solid(primitive)
        geom.pos, geom.quat = primitive.object_from_primitive[:3, 3], mujoco_quaternion(primitive.object_from_primitive)


def _add_welds(spec: mujoco.MjSpec, robot: RobotModel, objects: tuple[str, ...], with_person: bool) -> None:
    """Add one inactive weld for each holder and object."""
    holders = [f"robot/{robot.pinocchio_model.names[_tip_joint(robot, arm)]}" for arm in robot.arm_names]
    names = [f"gripper/{arm}" for arm in robot.arm_names]
    if with_person:
        holders += [f"person/{hand}_hand" for hand in HANDS]
        names += [f"hand/{hand}" for hand in HANDS]
    for name, body in zip(names, holders, strict=True):
        for item in objects:
            weld = spec.add_equality(
                name=f"{name}/{item}",
                type=mujoco.mjtEq.mjEQ_WELD,
                objtype=mujoco.mjtObj.mjOBJ_BODY,
                name1=body,
                name2=f"{OBJECT_PREFIX}{item}",
                active=False,
                solref=WELD_SOLREF,
                solimp=WELD_SOLIMP,
            )
            weld.data[10] = 1.0  # weight of the orientation


def _index(
    model: mujoco.MjModel,
    scene: Scene,
    robot: RobotModel,
    objects: Mapping[str, ObjectModel],
    person: PersonSpec | None,
) -> World:
    """Return the world with the places of all things looked up."""
    hands = HANDS if person is not None else ()
    object_joints = {}
    for name in objects:
        joint = model.joint(f"{OBJECT_PREFIX}{name}/free").id
        object_joints[name] = (int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint]))
    return World(
        model=model,
        scene=scene,
        robot=robot,
        objects=objects,
        person=person,
        arms={arm: joint_group(model, robot.arm(arm).joint_names) for arm in robot.arm_names},
        fingers={arm: joint_group(model, robot.arm(arm).finger_joints) for arm in robot.arm_names},
        object_bodies={name: model.body(f"{OBJECT_PREFIX}{name}").id for name in objects},
        object_joints=object_joints,
        gripper_sites={arm: model.site(f"robot/{arm}_gripper").id for arm in robot.arm_names},
        hand_sites={hand: model.site(f"person/{hand}_hand_grip").id for hand in hands},
        gripper_welds={(a, o): model.equality(f"gripper/{a}/{o}").id for a in robot.arm_names for o in objects},
        hand_welds={(h, o): model.equality(f"hand/{h}/{o}").id for h in hands for o in objects},
    )


def joint_group(model: mujoco.MjModel, names: tuple[str, ...], prefix: str = "robot/") -> JointGroup:
    """Return the places of actuated joints with one degree of freedom each."""
    joints = [model.joint(prefix + name).id for name in names]
    return JointGroup(
        names=tuple(names),
        positions=model.jnt_qposadr[joints].astype(np.int64),
        velocities=model.jnt_dofadr[joints].astype(np.int64),
        actuators=np.array([model.actuator(prefix + name).id for name in names], dtype=np.int64),
    )


def primitive_volume(primitive: Primitive) -> float:
    """Return the volume [m3] of a solid."""
    size = primitive.size
    if primitive.type == "box":
        return float(np.prod(size))
    ball = 4.0 / 3.0 * np.pi * size[0] ** 3
    if primitive.type == "sphere":
        return float(ball)
    return float(np.pi * size[0] ** 2 * size[1] + (ball if primitive.type == "capsule" else 0.0))


def _mujoco_solid(primitive: Primitive) -> tuple[mujoco.mjtGeom, list[float]]:
    """Return MuJoCo's type and half sizes of a solid."""
    size = primitive.size
    if primitive.type == "box":
        return mujoco.mjtGeom.mjGEOM_BOX, [length / 2.0 for length in size]
    if primitive.type == "sphere":
        return mujoco.mjtGeom.mjGEOM_SPHERE, [size[0], 0.0, 0.0]
    kind = mujoco.mjtGeom.mjGEOM_CYLINDER if primitive.type == "cylinder" else mujoco.mjtGeom.mjGEOM_CAPSULE
    return kind, [size[0], size[1] / 2.0, 0.0]


def _tip_joint(robot: RobotModel, arm: str) -> int:
    """Return the number of the joint whose body carries an arm's gripper frame."""
    model = robot.pinocchio_model
    return int(model.frames[model.getFrameId(robot.arm(arm).tip_frame)].parentJoint)
