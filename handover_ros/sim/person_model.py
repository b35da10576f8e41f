"""Bodies, joints, actuators and sites of the simulated person, added to a MuJoCo specification.

Segment masses are fractions of the body mass: D. A. Winter, "Biomechanics and Motor Control of Human Movement", 4th
ed., 2009, table 4.1. Joints have the names of ``person_spec.JOINTS`` with the prefix ``person/``. What is seen (group
2) is finer than what casts occlusion (group 4); neither collides with anything.
"""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from handover_ros.geometry import FloatArray
from handover_ros.sim.person_kinematics import TORSO_AXES, arm_axes, hand_axes
from handover_ros.sim.person_look import Painter, add_hand, add_head, add_legs, add_sleeve, add_trunk
from handover_ros.sim.person_spec import ARM_JOINTS, HANDS, TORSO_JOINTS, PersonSpec, load_person

__all__ = ["PREFIX", "PersonSpec", "add_person", "load_person"]

PREFIX = "person/"
MARKER_RADIUS = 0.007
MASS_FRACTION = {
    "legs": 0.322,
    "pelvis": 0.142,
    "trunk": 0.355,
    "head": 0.081,
    "upper_arm": 0.028,
    "forearm": 0.016,
    "hand": 0.006,
}
# Stiffness [N/m, N m/rad] and damping [N s/m, N m s/rad] of the servo of each joint, and armature [kg m2]; about
# critically damped with the limb's inertia, for an adult of 75 kg.
TORSO_SERVO = ((6e4, 4e3), (6e4, 4e3), (6e4, 4e3), (4e3, 160.0), (9e3, 500.0), (9e3, 500.0))
ARM_SERVO = (
    (900.0, 36.0, 0.02),
    (900.0, 36.0, 0.02),
    (350.0, 9.0, 0.01),
    (450.0, 15.0, 0.01),
    (120.0, 2.6, 0.006),
    (120.0, 2.6, 0.006),
    (120.0, 2.6, 0.006),
)
FINGER_SERVO = (4.0, 0.2, 0.002)
REFERENCE_MASS = 75.0
TRUNK_RANGE = {
    "torso_x": 10.0,
    "torso_y": 10.0,
    "torso_z": 2.0,
    "torso_yaw": 20.0,
    "torso_pitch": 1.5,
    "torso_roll": 1.5,
}


def servo_lag(joint: str) -> float:
    """Return the lag [s] of a joint's servo behind a steadily moving target: damping over stiffness."""
    if joint in TORSO_JOINTS:
        stiffness, damping = TORSO_SERVO[TORSO_JOINTS.index(joint)]
    else:
        stiffness, damping, _ = ARM_SERVO[ARM_JOINTS.index(joint.partition("_")[2])]
    return damping / stiffness


def add_person(spec: mujoco.MjSpec, person: PersonSpec, world_from_feet: FloatArray) -> None:
    """Add a person to a simulation.

    Args:
        spec: Specification to add to.
        person: Who it is.
        world_from_feet: Floor frame between the feet, x forward, shape (4, 4).
    """
    scale = person.mass / REFERENCE_MASS
    paint = Painter(person)
    x, y, z, w = Rotation.from_matrix(world_from_feet[:3, :3]).as_quat()
    stance = _body(spec.worldbody, "stance", world_from_feet[:3, 3])
    stance.quat = [w, x, y, z]
    for name, axis, servo in zip(TORSO_JOINTS[:2], TORSO_AXES, TORSO_SERVO):
        _joint(spec, stance, name, axis, (*servo, 0.0), scale, (-TRUNK_RANGE[name], TRUNK_RANGE[name]))
    add_legs(stance, paint, MASS_FRACTION["legs"] * person.mass)

    pelvis = _body(stance, "pelvis", [0.0, 0.0, person.lengths.lumbar_height])
    _joint(
        spec,
        pelvis,
        "torso_z",
        TORSO_AXES[2],
        (*TORSO_SERVO[2], 0.0),
        scale,
        (-TRUNK_RANGE["torso_z"], TRUNK_RANGE["torso_z"]),
    )
    paint.pelvis(pelvis, MASS_FRACTION["pelvis"] * person.mass)

    trunk = _body(pelvis, "trunk", [0.0, 0.0, 0.0])
    for name, axis, servo in zip(TORSO_JOINTS[3:], TORSO_AXES[3:], TORSO_SERVO[3:]):
        _joint(spec, trunk, name, axis, (*servo, 0.1), scale, (-TRUNK_RANGE[name], TRUNK_RANGE[name]))
    torso = _body(trunk, "torso", [0.0, 0.0, person.lengths.trunk])
    torso.add_site(name=f"{PREFIX}torso", group=4, size=[0.01] * 3)
    add_trunk(torso, paint, MASS_FRACTION["trunk"] * person.mass)
    add_head(torso, paint, MASS_FRACTION["head"] * person.mass)
    segments = {"torso": torso}
    for hand in HANDS:
        segments |= _add_arm(spec, torso, person, hand, paint, scale)
    for label, marker in person.markers.items():
        segments[marker.segment].add_site(
            name=f"{PREFIX}marker/{label}",
            pos=marker.position,
            size=[MARKER_RADIUS] * 3,
            rgba=[0.92, 0.94, 0.97, 1.0],
            group=2,
        )


def _add_arm(
    spec: mujoco.MjSpec, torso: mujoco.MjsBody, person: PersonSpec, hand: str, paint: Painter, scale: float
) -> dict[str, mujoco.MjsBody]:
    """Add one arm and return its segments by name."""
    lengths = person.lengths
    side = -1.0 if hand == "right" else 1.0
    limits = list(getattr(person.limits, hand).__dict__.values())
    axes = arm_axes(hand)

    def hinge(body: mujoco.MjsBody, index: int) -> None:
        _joint(spec, body, f"{hand}_{ARM_JOINTS[index]}", axes[index], ARM_SERVO[index], scale, limits[index])

    upper_arm = _body(torso, f"{hand}_upper_arm", [0.0, side * lengths.shoulder_half_width, 0.0])
    for index in range(3):
        hinge(upper_arm, index)
    add_sleeve(upper_arm, paint, "upper_arm", MASS_FRACTION["upper_arm"] * person.mass)
    forearm = _body(upper_arm, f"{hand}_forearm", [0.0, 0.0, -lengths.upper_arm])
    for index in (3, 4):
        hinge(forearm, index)
    add_sleeve(forearm, paint, "forearm", MASS_FRACTION["forearm"] * person.mass)
    palm = _body(forearm, f"{hand}_hand", [0.0, 0.0, -lengths.forearm])
    for index in (5, 6):
        hinge(palm, index)
    x, y, z, w = Rotation.from_matrix(hand_axes(hand)).as_quat()
    palm.add_site(
        name=f"{PREFIX}{hand}_hand_grip",
        pos=[0.0, -side * lengths.grip_out, -lengths.grip_along],
        quat=[w, x, y, z],
        group=4,
        size=[0.01] * 3,
    )
    fingers, thumb = add_hand(palm, paint, hand, MASS_FRACTION["hand"] * person.mass)
    # Curling turns the fingers towards the palm, the thumb across it.
    _joint(spec, fingers, f"{hand}_fingers", [-side, 0.0, 0.0], FINGER_SERVO, 1.0, (-0.1, 1.6))
    _joint(spec, thumb, f"{hand}_thumb", [0.0, 0.0, -side], FINGER_SERVO, 1.0, (-0.1, 1.6))
    return {f"{hand}_upper_arm": upper_arm, f"{hand}_forearm": forearm, f"{hand}_hand": palm}


def _body(parent: mujoco.MjsBody, name: str, position: object) -> mujoco.MjsBody:
    """Add a body whose weight is carried (a person holds itself up)."""
    return parent.add_body(name=f"{PREFIX}{name}", pos=np.asarray(position, dtype=float), gravcomp=1.0)


def _joint(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    name: str,
    axis: object,
    servo: tuple[float, float, float],
    scale: float,
    limits: tuple[float, float],
) -> None:
    """Add a joint and its position servo ``(stiffness, damping, armature)``, scaled with the body mass."""
    slide = name in TORSO_JOINTS[:3]
    stiffness, damping, armature = (value * scale for value in servo)
    unit = np.rad2deg(1.0) if spec.compiler.degree and not slide else 1.0
    body.add_joint(
        name=f"{PREFIX}{name}",
        type=mujoco.mjtJoint.mjJNT_SLIDE if slide else mujoco.mjtJoint.mjJNT_HINGE,
        axis=np.asarray(axis, dtype=float),
        range=unit * np.asarray(limits, dtype=float),
        limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        armature=armature,
    )
    actuator = spec.add_actuator(name=f"{PREFIX}{name}", target=f"{PREFIX}{name}", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    actuator.set_to_position(kp=stiffness, kv=damping)
