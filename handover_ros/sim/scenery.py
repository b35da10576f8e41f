"""What does not move in a cell: floor, tables, lights, sky and the cameras of the pictures."""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from handover_ros.geometry import FloatArray
from handover_ros.objects.scene import Camera, Scene, SceneBox
from handover_ros.sim.robot_body import FIXED_BIT, OBJECT_BIT, ROBOT_BIT

SCENE_PREFIX = "scene/"
SCENE_GROUP = 0
PICTURE_SIZE = (1280, 960)  # largest picture [pixels]


def add_surroundings(spec: mujoco.MjSpec, scene: Scene) -> None:
    """Add floor, boxes, lights, sky and cameras."""
    visual = spec.visual
    visual.headlight.ambient = [0.36, 0.36, 0.38]
    visual.headlight.diffuse = [0.22, 0.22, 0.22]
    visual.headlight.specular = [0.0, 0.0, 0.0]
    visual.quality.shadowsize = 4096
    visual.quality.offsamples = 4
    getattr(visual, "global").offwidth, getattr(visual, "global").offheight = PICTURE_SIZE
    visual.map.znear, visual.map.zfar = 0.05, 8.0
    spec.stat.center, spec.stat.extent = [0.8, 0.0, 0.9], 3.0
    visual.map.shadowclip = 1.4
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.86, 0.89, 0.93],
        rgb2=[0.62, 0.67, 0.74],
        width=256,
        height=1536,
    )
    spec.add_texture(
        name="floor",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        mark=mujoco.mjtMark.mjMARK_EDGE,
        rgb1=[0.74, 0.75, 0.76],
        rgb2=[0.70, 0.71, 0.73],
        markrgb=[0.62, 0.63, 0.65],
        width=512,
        height=512,
    )
    floor = spec.add_material(
        name="floor", texrepeat=[1.0, 1.0], texuniform=True, reflectance=0.06, specular=0.1, shininess=0.2
    )
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "floor"
    ground = spec.worldbody.add_geom(
        name=f"{SCENE_PREFIX}floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[6.0, 6.0, 0.1],
        material="floor",
        group=SCENE_GROUP,
        contype=FIXED_BIT,
        conaffinity=ROBOT_BIT | OBJECT_BIT,
    )
    if hasattr(ground, "castshadow"):  # newer MuJoCo only; without it the floor is speckled with its own shadow
        ground.castshadow = False
    for box in scene.boxes:
        _add_box(spec, box)
    spec.worldbody.add_light(
        name="key",
        type=mujoco.mjtLightType.mjLIGHT_SPOT,
        pos=[3.0, -2.8, 5.0],
        dir=[-0.40, 0.47, -0.80],
        cutoff=80.0,
        exponent=0.5,
        castshadow=True,
        diffuse=[0.66, 0.64, 0.60],
        specular=[0.35, 0.35, 0.35],
    )
    spec.worldbody.add_light(
        name="fill",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=[1.0, 3.0, 3.5],
        dir=[-0.1, -0.7, -0.7],
        castshadow=False,
        diffuse=[0.20, 0.22, 0.26],
        specular=[0.0, 0.0, 0.0],
    )
    for camera in scene.cameras:
        element = spec.worldbody.add_camera(
            name=camera.name, pos=camera.position, fovy=float(np.degrees(camera.field_of_view))
        )
        element.quat = _looking_at(camera)


def _add_box(spec: mujoco.MjSpec, box: SceneBox) -> None:
    """Add a fixed box of the scene."""
    material = f"{SCENE_PREFIX}{box.name}"
    spec.add_material(name=material, rgba=list(box.colour), specular=0.15, shininess=0.3)
    geom = spec.worldbody.add_geom(
        name=f"{SCENE_PREFIX}{box.name}",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[length / 2.0 for length in box.size],
        material=material,
        group=SCENE_GROUP,
        contype=FIXED_BIT,
        conaffinity=ROBOT_BIT | OBJECT_BIT,
    )
    geom.pos, geom.quat = box.world_from_box[:3, 3], mujoco_quaternion(box.world_from_box)


def mujoco_quaternion(transform: FloatArray) -> list[float]:
    """Return a rotation as MuJoCo's quaternion w, x, y, z."""
    x, y, z, w = Rotation.from_matrix(transform[:3, :3]).as_quat()
    return [float(w), float(x), float(y), float(z)]


def _looking_at(camera: Camera) -> list[float]:
    """Return MuJoCo's quaternion of a camera (it looks along -z, x to the right)."""
    backward = np.array(camera.position) - np.array(camera.target)
    backward /= np.linalg.norm(backward)
    up = np.array([0.0, 0.0, 1.0]) if abs(backward[2]) < 0.999 else np.array([1.0, 0.0, 0.0])
    right = np.cross(up, backward)
    right /= np.linalg.norm(right)
    rotation = np.eye(4)
    rotation[:3, :3] = np.column_stack([right, np.cross(backward, right), backward])
    return mujoco_quaternion(rotation)
