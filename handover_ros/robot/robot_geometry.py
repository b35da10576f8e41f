"""The robot's own collision solids and the pairs of them that are worth a check."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from handover_ros.geometry import transform_from_xyz_rpy
from handover_ros.robot.model import RobotModel
from handover_ros.robot.shapes import Solid

SELF_SAMPLES = 300
ALWAYS_SHARE = 0.95  # share of random configurations in which a pair collides to be called always colliding


class RobotGeometry:
    """The robot's own collision solids and the pairs of them that are worth a check; made once a robot.

    Attributes:
        robot: The robot.
        base: Collision solids as a pinocchio geometry model, pairs included.
        movable: Places of the solids that some arm joint moves.
        margin: Extra distance kept [m].
    """

    def __init__(self, robot: RobotModel, seed: int = 0) -> None:
        self.robot = robot
        self.margin = robot.description.collision.margin
        self.base = _robot_solids(robot)
        moved = _moved_joints(robot)
        self._joints = moved
        self.movable = frozenset().union(*(self.solids_of(arm) for arm in robot.arm_names))
        _add_self_pairs(robot, self.base, set(self.movable), seed)

    def solids_of(self, arm: str) -> frozenset[int]:
        """Return the places of the solids that move with an arm."""
        return frozenset(i for i, s in enumerate(self.base.geometryObjects) if s.parentJoint in self._joints[arm])

    def hand(self, arm: str) -> frozenset[int]:
        """Return the places of the solids that the arm's last joint and its fingers carry."""
        model = self.robot.pinocchio_model
        last = model.getJointId(self.robot.arm(arm).joint_names[-1])
        joints = {last, *(model.getJointId(name) for name in self.robot.arm(arm).finger_joints)}
        return frozenset(i for i, solid in enumerate(self.base.geometryObjects) if solid.parentJoint in joints)


def _robot_solids(robot: RobotModel) -> pin.GeometryModel:
    """Return the URDF's collision solids without ignored links, and with boxes for the listed meshes."""
    model, settings = robot.pinocchio_model, robot.description.collision
    loaded = pin.buildGeomFromUrdf(
        model, str(robot.urdf_path), pin.GeometryType.COLLISION, package_dirs=[str(robot.package_directory)]
    )
    dropped = {*settings.ignore_links, *settings.boxes}
    solids = pin.GeometryModel()
    for solid in loaded.geometryObjects:
        if model.frames[solid.parentFrame].name in dropped:
            continue
        kept = solid.copy()
        if solid.parentJoint == 0:
            kept.placement = pin.SE3(robot.world_from_base) * solid.placement
        if hasattr(kept.geometry, "buildConvexHull"):
            kept.geometry.buildConvexHull(True, "Qt")
            kept.geometry = kept.geometry.convex
        solids.addGeometryObject(kept)
    for link, boxes in settings.boxes.items():
        frame = model.frames[model.getFrameId(link)]
        for i, box in enumerate(boxes):
            solid = Solid(link, "box", box.size, transform_from_xyz_rpy(box.xyz, box.rpy))
            placement = np.array(frame.placement.homogeneous) @ solid.parent_from_solid
            solids.addGeometryObject(solid.geometry_object(f"{link}_{i}", frame.parentJoint, placement))
    return solids


def _moved_joints(robot: RobotModel) -> dict[str, set[int]]:
    """Return the joints of each arm and those it carries, its fingers."""
    model = robot.pinocchio_model
    moved = {arm: {model.getJointId(name) for name in robot.arm(arm).joint_names} for arm in robot.arm_names}
    for joints in moved.values():
        for joint in range(1, model.njoints):
            if model.parents[joint] in joints:
                joints.add(joint)
    return moved


def _add_self_pairs(robot: RobotModel, solids: pin.GeometryModel, movable: set[int], seed: int) -> None:
    """Add the pairs of robot solids that can collide but do not always.

    Left out: solids of the same or of neighbouring joints, fingers among themselves, pairs that touch in nearly all
    random configurations or with all arms at home.
    """
    model = robot.pinocchio_model
    fingers = {
        robot.arm(arm).name: {model.getJointId(name) for name in robot.arm(arm).finger_joints}
        for arm in robot.arm_names
    }
    finger_joints = set().union(*fingers.values())
    ignored = [set(pair) for pair in robot.description.collision.ignore_pairs]
    candidates = []
    for i, first in enumerate(solids.geometryObjects):
        for j in range(i + 1, len(solids.geometryObjects)):
            a, b = first.parentJoint, solids.geometryObjects[j].parentJoint
            neighbours = a == b or model.parents[a] == b or model.parents[b] == a
            same_hand = any({a, b} <= joints for joints in fingers.values())
            carried = finger_joints & {a, b}
            if carried and not same_hand:
                # A finger counts as part of its wrist: the wrist's neighbour is the finger's.
                other = b if a in carried else a
                wrist = model.parents[next(iter(carried))]
                neighbours = neighbours or other == wrist or model.parents[wrist] == other
            links = {solids.geometryObjects[k].name.rsplit("_", 1)[0] for k in (i, j)}
            neighbours = neighbours or links in ignored
            if (i in movable or j in movable) and not neighbours and not same_hand:
                candidates.append((i, j))
    for i, j in candidates:
        solids.addCollisionPair(pin.CollisionPair(i, j))
    results, data = pin.GeometryData(solids), model.createData()
    rng = np.random.default_rng(seed)
    counts = np.zeros(len(candidates))
    home = robot.configuration({})
    lower, upper = model.lowerPositionLimit, model.upperPositionLimit
    for sample in range(SELF_SAMPLES + 1):
        configuration = home if sample == 0 else rng.uniform(lower, upper)
        pin.computeCollisions(model, data, solids, results, configuration, False)
        hits = np.array([result.isCollision() for result in results.collisionResults], dtype=float)
        counts += hits * (SELF_SAMPLES if sample == 0 else 1.0)
    for (i, j), count in zip(candidates, counts, strict=True):
        if count >= ALWAYS_SHARE * SELF_SAMPLES:
            solids.removeCollisionPair(pin.CollisionPair(i, j))
