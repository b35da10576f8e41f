"""What the simulated person looks like: clothes, skin, a face, hands; and the plain solids that hide markers.

All sizes are fractions of the person's own segment lengths; the girth follows the body mass.
"""

from __future__ import annotations

import mujoco
import numpy as np

from handover_ros.sim.person_spec import PersonSpec

SEEN_GROUP = 2
HIDING_GROUP = 4
PERSON_BIT = 8
SKIN = (0.87, 0.67, 0.54, 1.0)
HAIR = (0.20, 0.13, 0.09, 1.0)
SHIRT = (0.16, 0.42, 0.50, 1.0)
COLLAR = (0.11, 0.32, 0.39, 1.0)
TROUSERS = (0.20, 0.22, 0.29, 1.0)
BELT = (0.13, 0.10, 0.08, 1.0)
SHOES = (0.27, 0.19, 0.14, 1.0)
WHITE = (0.96, 0.96, 0.95, 1.0)
DARK = (0.10, 0.08, 0.07, 1.0)
LIPS = (0.72, 0.40, 0.36, 1.0)
REFERENCE_GIRTH = 75.0 / 1.75
CAPSULE = mujoco.mjtGeom.mjGEOM_CAPSULE
ELLIPSOID = mujoco.mjtGeom.mjGEOM_ELLIPSOID
BOX = mujoco.mjtGeom.mjGEOM_BOX


class Painter:
    """Adds geoms in the person's size to bodies; ``girth`` scales everything across the limbs."""

    def __init__(self, person: PersonSpec) -> None:
        self.person = person
        self.lengths = person.lengths
        self.girth = float(np.sqrt(person.mass / person.stature / REFERENCE_GIRTH))

    def seen(self, body: mujoco.MjsBody, shape: int, colour: tuple[float, ...], **placement: object) -> None:
        """Add a geom that is only seen."""
        body.add_geom(type=shape, group=SEEN_GROUP, contype=0, conaffinity=0, mass=0.0, rgba=colour, **placement)

    def hiding(self, body: mujoco.MjsBody, shape: int, mass: float, **placement: object) -> None:
        """Add a geom that carries the mass [kg] and hides markers from cameras, but is not drawn."""
        body.add_geom(
            type=shape, group=HIDING_GROUP, contype=PERSON_BIT, conaffinity=0, mass=mass, rgba=SKIN, **placement
        )

    def both(
        self, body: mujoco.MjsBody, shape: int, colour: tuple[float, ...], mass: float, **placement: object
    ) -> None:
        """Add a geom that is seen, hides and has mass [kg]."""
        self.seen(body, shape, colour, **placement)
        self.hiding(body, shape, mass, **placement)

    def pelvis(self, body: mujoco.MjsBody, mass: float) -> None:
        """Add hips and belt to the pelvis, whose origin is the lumbar joint."""
        g = self.girth
        self.both(body, ELLIPSOID, TROUSERS, mass, pos=[-0.005, 0, -0.085], size=[0.115 * g, 0.165 * g, 0.13])
        self.seen(body, ELLIPSOID, BELT, pos=[0, 0, -0.012], size=[0.116 * g, 0.152 * g, 0.035])


def add_legs(stance: mujoco.MjsBody, paint: Painter, mass: float) -> None:
    """Add two standing legs with shoes to the body on the floor."""
    lengths, g = paint.lengths, paint.girth
    hip, knee, ankle = lengths.lumbar_height - 0.10, 0.49 * lengths.lumbar_height, 0.085
    for side in (-1.0, 1.0):
        at_hip = [0, side * lengths.hip_half_width, hip]
        at_knee = [0.012, side * (lengths.hip_half_width + 0.004), knee]
        at_ankle = [-0.012, side * (lengths.hip_half_width + 0.010), ankle]
        paint.hiding(stance, CAPSULE, mass / 2, fromto=[*at_hip, *at_ankle], size=[0.06 * g, 0, 0])
        paint.seen(stance, CAPSULE, TROUSERS, fromto=[*at_hip, *at_knee], size=[0.076 * g, 0, 0])
        middle = 0.5 * (np.array(at_hip) + at_knee)
        paint.seen(stance, ELLIPSOID, TROUSERS, pos=middle + [0, 0, 0.05], size=[0.092 * g, 0.088 * g, 0.25])
        paint.seen(stance, CAPSULE, TROUSERS, fromto=[*at_knee, *at_ankle], size=[0.054 * g, 0, 0])
        middle = 0.4 * np.array(at_ankle) + 0.6 * np.array(at_knee)
        paint.seen(stance, ELLIPSOID, TROUSERS, pos=middle - [0.014, 0, 0], size=[0.064 * g, 0.06 * g, 0.17])
        toe = [0.052, side * (lengths.hip_half_width + 0.018), 0.042]
        paint.seen(stance, ELLIPSOID, SHOES, pos=toe, size=[0.138, 0.050, 0.044])
        paint.seen(stance, ELLIPSOID, DARK, pos=[toe[0], toe[1], 0.014], size=[0.141, 0.053, 0.014])


def add_trunk(torso: mujoco.MjsBody, paint: Painter, mass: float) -> None:
    """Add chest, belly and shoulders to the torso, whose origin is between the shoulder joints."""
    lengths, g = paint.lengths, paint.girth
    t, w = lengths.trunk, lengths.shoulder_half_width
    chest = {"pos": [0.0, 0, -0.31 * t], "size": [0.118 * g, 0.93 * w * g, 0.46 * t]}
    belly = {"pos": [0.004, 0, -0.68 * t], "size": [0.112 * g, 0.86 * w * g, 0.50 * t]}
    paint.both(torso, ELLIPSOID, SHIRT, 0.65 * mass, **chest)
    paint.both(torso, ELLIPSOID, SHIRT, 0.35 * mass, **belly)
    for side in (-1.0, 1.0):
        slope = [0, side * 0.22 * w, 0.036, 0, side * 0.90 * w, 0.008]
        paint.seen(torso, CAPSULE, SHIRT, fromto=slope, size=[0.050 * g, 0, 0])
    paint.seen(torso, ELLIPSOID, COLLAR, pos=[0, 0, 0.062], size=[0.066 * g, 0.072 * g, 0.026])


def add_head(torso: mujoco.MjsBody, paint: Painter, mass: float) -> None:
    """Add neck and head with a simple face."""
    h, neck = paint.lengths.head, paint.lengths.neck
    s = h / 0.23
    centre = neck + 0.5 * h

    def at(x: float, y: float, z: float) -> list[float]:
        return [x * s + 0.01, y * s, centre + z * s]

    paint.seen(torso, CAPSULE, SKIN, fromto=[-0.005, 0, 0.03, *at(-0.012, 0, -0.05)], size=[0.052 * paint.girth, 0, 0])
    skull = {"pos": at(0.0, 0, 0.0), "size": [0.093 * s, 0.075 * s, 0.115 * s]}
    paint.both(torso, ELLIPSOID, SKIN, mass, **skull)
    paint.seen(torso, ELLIPSOID, SKIN, pos=at(0.025, 0, -0.062), size=[0.058 * s, 0.052 * s, 0.050 * s])
    paint.seen(torso, ELLIPSOID, HAIR, pos=at(-0.020, 0, 0.036), size=[0.091 * s, 0.081 * s, 0.090 * s])
    paint.seen(torso, ELLIPSOID, HAIR, pos=at(0.012, 0, 0.078), size=[0.080 * s, 0.071 * s, 0.045 * s])
    paint.seen(torso, ELLIPSOID, SKIN, pos=at(0.093, 0, -0.014), size=[0.017 * s, 0.011 * s, 0.018 * s])
    paint.seen(torso, ELLIPSOID, LIPS, pos=at(0.079, 0, -0.056), size=[0.007 * s, 0.023 * s, 0.0065 * s])
    for side in (-1.0, 1.0):
        paint.seen(torso, ELLIPSOID, SKIN, pos=at(-0.005, side * 0.077, -0.005), size=[0.020 * s, 0.008 * s, 0.029 * s])
        paint.seen(
            torso, ELLIPSOID, WHITE, pos=at(0.0795, side * 0.031, 0.012), size=[0.009 * s, 0.0145 * s, 0.010 * s]
        )
        paint.seen(torso, ELLIPSOID, DARK, pos=at(0.0865, side * 0.031, 0.012), size=[0.004 * s, 0.0065 * s, 0.007 * s])
        brow = [*at(0.086, side * 0.019, 0.0355), *at(0.075, side * 0.045, 0.0350)]
        paint.seen(torso, CAPSULE, HAIR, fromto=brow, size=[0.0038 * s, 0, 0])


def add_sleeve(body: mujoco.MjsBody, paint: Painter, segment: str, mass: float) -> None:
    """Add an upper arm in a short sleeve, or a bare forearm, hanging from the body's origin."""
    g = paint.girth
    if segment == "upper_arm":
        a = paint.lengths.upper_arm
        paint.hiding(body, CAPSULE, mass, fromto=[0, 0, 0, 0, 0, -a], size=[0.044 * g, 0, 0])
        paint.seen(body, CAPSULE, SKIN, fromto=[0, 0, 0, 0, 0, -a], size=[0.040 * g, 0, 0])
        paint.seen(body, ELLIPSOID, SHIRT, pos=[0, 0, -0.03], size=[0.062 * g, 0.060 * g, 0.095])
        sleeve = {"pos": [0, 0, -0.30 * a], "size": [0.054 * g, 0.26 * a, 0]}
        paint.seen(body, mujoco.mjtGeom.mjGEOM_CYLINDER, SHIRT, **sleeve)
        paint.seen(body, ELLIPSOID, SKIN, pos=[0, 0, -0.62 * a], size=[0.046 * g, 0.044 * g, 0.12])
        return
    f = paint.lengths.forearm
    paint.hiding(body, CAPSULE, mass, fromto=[0, 0, 0, 0, 0, -f], size=[0.037 * g, 0, 0])
    paint.seen(body, CAPSULE, SKIN, fromto=[0, 0, 0, 0, 0, -f], size=[0.030 * g, 0, 0])
    paint.seen(body, ELLIPSOID, SKIN, pos=[0, 0, -0.30 * f], size=[0.044 * g, 0.042 * g, 0.135])


def add_hand(body: mujoco.MjsBody, paint: Painter, hand: str, mass: float) -> tuple[mujoco.MjsBody, mujoco.MjsBody]:
    """Add palm, four fingers and thumb; return the bodies of fingers and thumb, which still need their joints.

    The body's origin is the wrist; hanging, the thumb points forward (+x), the right palm faces left (+y).
    """
    length = paint.lengths.hand
    palm = 1.0 if hand == "right" else -1.0
    knuckle = 0.47 * length
    paint.hiding(body, BOX, 0.8 * mass, pos=[0, palm * 0.004, -0.5 * length], size=[0.038, 0.012, 0.40 * length])
    paint.seen(body, ELLIPSOID, SKIN, pos=[0, 0, -0.01], size=[0.032, 0.024, 0.03])
    paint.seen(body, BOX, SKIN, pos=[0, 0, -0.27 * length], size=[0.036, 0.0115, 0.20 * length])
    paint.seen(body, ELLIPSOID, SKIN, pos=[0, 0, -0.27 * length], size=[0.044, 0.0165, 0.26 * length])
    paint.seen(body, ELLIPSOID, SKIN, pos=[0.024, palm * 0.010, -0.18 * length], size=[0.020, 0.017, 0.034])

    fingers = body.add_body(name=f"person/{hand}_finger_row", pos=[0, 0, -knuckle], gravcomp=1.0)
    for x, share in ((0.030, 0.92), (0.0105, 1.0), (-0.0095, 0.94), (-0.0285, 0.76)):
        first, second = 0.30 * length * share, 0.24 * length * share
        bend = [x, palm * 0.006, -first]
        tip = [x, palm * (0.006 + 0.45 * second), -first - 0.88 * second]
        paint.seen(fingers, CAPSULE, SKIN, fromto=[x, 0, 0, *bend], size=[0.0092, 0, 0])
        paint.seen(fingers, CAPSULE, SKIN, fromto=[*bend, *tip], size=[0.0083, 0, 0])
    _inertia(fingers, 0.15 * mass, [0, palm * 0.01, -0.03])

    thumb = body.add_body(name=f"person/{hand}_thumb_row", pos=[0.030, palm * 0.006, -0.14 * length], gravcomp=1.0)
    bend = [0.022, palm * 0.010, -0.030]
    tip = [0.030, palm * 0.022, -0.058]
    paint.seen(thumb, CAPSULE, SKIN, fromto=[0, 0, 0, *bend], size=[0.0115, 0, 0])
    paint.seen(thumb, CAPSULE, SKIN, fromto=[*bend, *tip], size=[0.0098, 0, 0])
    _inertia(thumb, 0.05 * mass, [0.01, palm * 0.01, -0.02])
    return fingers, thumb


def _inertia(body: mujoco.MjsBody, mass: float, centre: list[float]) -> None:
    """Give a body a mass [kg] and the inertia of a ball of 3 cm radius about it."""
    body.explicitinertial = True
    body.mass = mass
    body.ipos = centre
    body.inertia = [0.4 * mass * 0.03**2] * 3
