"""Bodies, joints, servo actuators and sites of the robot, added to a MuJoCo specification.

Every moving joint of the URDF becomes one body ``robot/<joint>``; links fixed to each other share a body, as pinocchio
joins them. Gravity is compensated (Baxter's springs and controller do so), so an actuator's force is what is left:
motion, load and touch.
"""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt
import pinocchio as pin
from scipy.spatial.transform import Rotation

from handover_ros.errors import BadModelError
from handover_ros.geometry import FloatArray, make_transform, transform_from_xyz_rpy
from handover_ros.robot.model import RobotModel
from handover_ros.sim.assets import mesh_parts
from handover_ros.sim.urdf_shapes import LinkShape, link_shapes

PREFIX = "robot/"
ROBOT_BIT, OBJECT_BIT, FIXED_BIT = 1, 2, 4  # contact types of the cell; the person's 8 touches nothing
VISUAL_GROUP, COLLISION_GROUP = 1, 3
DISPLAY_SIZE = (1024, 600)  # Baxter's head display [pixels]
DISPLAY_TEXTURE = f"{PREFIX}display"

# Servo of a joint: stiffness as a multiple of the effort limit (the error at which it gives its all is 1/40 rad),
# damping critical for the inertia at zero displacements, armature of motor and gear [kg m2].
STIFFNESS_PER_EFFORT = 40.0
JOINT_ARMATURE = 0.1
GREATEST_EFFORT = 200.0  # [N m] for joints whose URDF limit is a placeholder (Baxter's head: 50,000)
FINGER_STIFFNESS = 4000.0  # [N/m]
FINGER_ARMATURE = 0.2  # [kg]
SMALLEST_SEEN = 0.03  # [m] Baxter's URDF marks frames of sensors with little coloured solids
SMALLEST_INERTIA = 1e-5  # [kg m2] of a body, so that light fingers stay well conditioned
DARKEST = 0.07  # the meshes' blacks would swallow all shape

MATERIAL_SHINE = {"specular": 0.35, "shininess": 0.45}


def add_robot(spec: mujoco.MjSpec, robot: RobotModel) -> None:
    """Add a robot to a simulation.

    Args:
        spec: Specification to add to.
        robot: The robot; its pinocchio model is placed in the world.

    Raises:
        BadModelError: A mesh or shape of its URDF cannot be used.
    """
    model = robot.pinocchio_model
    bodies = [spec.worldbody.add_body(name=f"{PREFIX}base")]
    for joint in range(1, model.njoints):
        bodies.append(_add_link(spec, bodies[model.parents[joint]], robot, joint))
    shapes = link_shapes(robot.urdf_path, robot.package_directory)
    description = robot.description.collision
    for shape in shapes:
        body, body_from_link = _placement(model, bodies, shape.link)
        if shape.role == "visual":
            _add_visual(spec, body, body_from_link @ shape.link_from_shape, shape, robot.display_link)
        elif shape.link not in description.ignore_links and shape.link not in description.boxes:
            _add_collision(body, body_from_link @ shape.link_from_shape, shape.type, shape.size)
    for link, boxes in description.boxes.items():
        body, body_from_link = _placement(model, bodies, link)
        for box in boxes:
            _add_collision(body, body_from_link @ transform_from_xyz_rpy(box.xyz, box.rpy), "box", box.size)
    for name in robot.arm_names:
        body, body_from_link = _placement(model, bodies, robot.arm(name).tip_frame)
        site = body.add_site(name=f"{PREFIX}{name}_gripper", group=4, size=[0.005] * 3)
        _place(site, body_from_link)


def _add_link(spec: mujoco.MjSpec, parent: mujoco.MjsBody, robot: RobotModel, joint: int) -> mujoco.MjsBody:
    """Add the body that one joint moves, with its joint and actuator."""
    model = robot.pinocchio_model
    name = model.names[joint]
    inertia = model.inertias[joint]
    body = parent.add_body(name=f"{PREFIX}{name}", gravcomp=1.0, explicitinertial=True)
    _place(body, np.array(model.jointPlacements[joint].homogeneous))
    body.mass = max(float(inertia.mass), 1e-3)
    body.ipos = np.array(inertia.lever)
    tensor = np.array(inertia.inertia) + SMALLEST_INERTIA * np.eye(3)
    body.fullinertia = [tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2]]

    index = model.joints[joint].idx_q
    kind, axis = _joint_kind(model.joints[joint], robot)
    fingers = {finger for arm in robot.arm_names for finger in robot.arm(arm).finger_joints}
    effort = min(float(model.effortLimit[index]), GREATEST_EFFORT)
    body.add_joint(
        name=f"{PREFIX}{name}",
        type=kind,
        axis=axis,
        range=[float(model.lowerPositionLimit[index]), float(model.upperPositionLimit[index])],
        limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        armature=FINGER_ARMATURE if name in fingers else JOINT_ARMATURE,
    )
    actuator = spec.add_actuator(
        name=f"{PREFIX}{name}",
        target=f"{PREFIX}{name}",
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        forcelimited=mujoco.mjtLimited.mjLIMITED_TRUE,
        forcerange=[-effort, effort],
    )
    stiffness = FINGER_STIFFNESS if name in fingers else STIFFNESS_PER_EFFORT * effort
    actuator.set_to_position(kp=stiffness, dampratio=1.0)
    return body


def _joint_kind(joint: pin.JointModel, robot: RobotModel) -> tuple[mujoco.mjtJoint, npt.NDArray[np.float64]]:
    """Return MuJoCo's joint type and the axis of a pinocchio joint with one degree of freedom."""
    name = joint.shortname()
    axes = {"X": [1.0, 0.0, 0.0], "Y": [0.0, 1.0, 0.0], "Z": [0.0, 0.0, 1.0]}
    if name.startswith("JointModelR") and name[-1] in axes:
        return mujoco.mjtJoint.mjJNT_HINGE, np.array(axes[name[-1]])
    if name.startswith("JointModelP") and name[-1] in axes:
        return mujoco.mjtJoint.mjJNT_SLIDE, np.array(axes[name[-1]])
    if name in ("JointModelRevoluteUnaligned", "JointModelPrismaticUnaligned"):
        hinge = name == "JointModelRevoluteUnaligned"
        motion = joint.createData().S  # constant: the axis itself
        column = np.array(motion)[3:, 0] if hinge else np.array(motion)[:3, 0]
        return (mujoco.mjtJoint.mjJNT_HINGE if hinge else mujoco.mjtJoint.mjJNT_SLIDE), column
    raise BadModelError(f"{robot.urdf_path}: joint type {name} cannot be simulated; use revolute or prismatic joints")


def _placement(model: pin.Model, bodies: list[mujoco.MjsBody], link: str) -> tuple[mujoco.MjsBody, FloatArray]:
    """Return the body that carries a link, and the link's frame in it."""
    frame = model.frames[model.getFrameId(link)]
    return bodies[frame.parentJoint], np.array(frame.placement.homogeneous)


def _add_visual(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, body_from_shape: FloatArray, shape: LinkShape, display_link: str
) -> None:
    """Add what is seen of one shape; the display becomes a textured face."""
    if shape.link == display_link and shape.type == "box":
        _add_display(spec, body, body_from_shape, shape.size)
        return
    if shape.mesh is None:
        if max(shape.size) > SMALLEST_SEEN:
            geom = _add_solid(body, body_from_shape, shape.type, shape.size)
            geom.group, geom.contype, geom.conaffinity = VISUAL_GROUP, 0, 0
            geom.material = _material(spec, shape.colour)
        return
    scale = np.array(shape.size, dtype=float)
    for part in mesh_parts(shape.mesh):
        mesh_name = f"{PREFIX}{part.file.parent.name}/{part.file.stem}/{'_'.join(f'{value:g}' for value in scale)}"
        if spec.mesh(mesh_name) is None:
            mesh = spec.add_mesh(name=mesh_name, file=str(part.file), scale=scale)
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        geom = body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh_name, group=VISUAL_GROUP, contype=0, conaffinity=0, mass=0.0
        )
        geom.material = _material(spec, part.colour or shape.colour)
        _place(geom, body_from_shape)


def _add_collision(body: mujoco.MjsBody, body_from_shape: FloatArray, kind: str, size: tuple[float, ...]) -> None:
    """Add one simple solid for contact and line of sight; a mesh without a box in the robot's file is left out."""
    if kind == "mesh":
        return
    geom = _add_solid(body, body_from_shape, kind, size)
    geom.group = COLLISION_GROUP
    geom.contype, geom.conaffinity = ROBOT_BIT, OBJECT_BIT | FIXED_BIT
    geom.friction = [1.2, 0.01, 0.0001]


def _add_solid(body: mujoco.MjsBody, body_from_shape: FloatArray, kind: str, size: tuple[float, ...]) -> mujoco.MjsGeom:
    """Add a massless box, cylinder or sphere."""
    types = {
        "box": (mujoco.mjtGeom.mjGEOM_BOX, lambda s: [s[0] / 2, s[1] / 2, s[2] / 2]),
        "cylinder": (mujoco.mjtGeom.mjGEOM_CYLINDER, lambda s: [s[0], s[1] / 2, 0.0]),
        "sphere": (mujoco.mjtGeom.mjGEOM_SPHERE, lambda s: [s[0], 0.0, 0.0]),
    }
    geom_type, geom_size = types[kind]
    geom = body.add_geom(type=geom_type, size=geom_size(size), mass=0.0)
    _place(geom, body_from_shape)
    return geom


def _add_display(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, body_from_display: FloatArray, size: tuple[float, ...]
) -> None:
    """Add the head display: one rectangle facing along z of its link, with a texture that can be drawn anew."""
    width, height = DISPLAY_SIZE
    texture = spec.add_texture(
        name=DISPLAY_TEXTURE, type=mujoco.mjtTexture.mjTEXTURE_2D, width=width, height=height, nchannel=3
    )
    texture.data = np.full(width * height * 3, 18, dtype=np.uint8).tobytes()
    material = spec.add_material(name=DISPLAY_TEXTURE, emission=0.9, specular=0.0, shininess=0.0)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = DISPLAY_TEXTURE
    x, y = size[0] / 2.0, size[1] / 2.0
    mesh = spec.add_mesh(
        name=DISPLAY_TEXTURE,
        uservert=[-x, -y, 0, x, -y, 0, x, y, 0, -x, y, 0],
        userface=[0, 1, 2, 0, 2, 3],
        usertexcoord=[0, 0, 1, 0, 1, 1, 0, 1],
    )
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    geom = body.add_geom(
        name=DISPLAY_TEXTURE,
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=DISPLAY_TEXTURE,
        material=DISPLAY_TEXTURE,
        group=VISUAL_GROUP,
        contype=0,
        conaffinity=0,
        mass=0.0,
    )
    _place(geom, body_from_display @ make_transform(np.eye(3), [0.0, 0.0, size[2] / 2.0]))


def _material(spec: mujoco.MjSpec, colour: tuple[float, float, float, float]) -> str:
    """Return the name of a material of this colour, added when it is new."""
    lifted = (*(max(value, DARKEST) for value in colour[:3]), 1.0)
    name = PREFIX + "_".join(f"{value:.3f}" for value in lifted)
    if spec.material(name) is None:
        spec.add_material(name=name, rgba=list(lifted), **MATERIAL_SHINE)
    return name


def _place(element: mujoco.MjsBody | mujoco.MjsGeom | mujoco.MjsSite, parent_from_element: FloatArray) -> None:
    """Set position and orientation of an element."""
    x, y, z, w = Rotation.from_matrix(parent_from_element[:3, :3]).as_quat()
    element.pos = parent_from_element[:3, 3]
    element.quat = [w, x, y, z]
