"""Motions of one arm in the cell as it is: what is an obstacle, free paths, straight retreats, timing."""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np

from handover_ros.errors import BadRequestError, ErrorCode, InfeasibleError, UnknownNameError
from handover_ros.geometry import FloatArray, invert_transform
from handover_ros.objects.catalogue import ObjectModel
from handover_ros.objects.scene import Scene
from handover_ros.planning.types import CellSnapshot, PlannerSettings
from handover_ros.robot.collision import CollisionChecker, HeldObject, Reason, Surroundings
from handover_ros.robot.inverse_kinematics import InverseKinematics
from handover_ros.robot.model import RobotModel
from handover_ros.robot.path import PathSettings, Validity, plan_path, straight_line
from handover_ros.robot.reach import Reach, Reasons
from handover_ros.robot.robot_geometry import RobotGeometry
from handover_ros.robot.shapes import Solid, object_solids, person_solids
from handover_ros.robot.trajectory import Trajectory, parameterise

START_TOLERANCE = 0.02  # [rad] that a measured displacement may lie outside its limits
HELD_DISTANCE = 0.02  # [m] from between the fingertips to the object in a closed gripper
RETREAT_LEANS = (0.0, 0.45, -0.45)  # [rad] from straight back, in the plane between the open fingers
RETREAT_SHARES = (1.0, 0.75, 0.5)  # of the distance that is wanted
UP = np.array([0.0, 0.0, 1.0])
UPRIGHT_SEARCH = PathSettings(iterations=700)
FREE_SEARCH = PathSettings(iterations=2000)


class MotionPlanner:
    """Plans motions of one arm at a time; the other arms stand where they are.

    Attributes:
        robot: The robot.
        scene: Its fixed surroundings.
        catalogue: Known objects by name.
        settings: How to plan.
        boxes: Of the scene, as solids.
    """

    def __init__(
        self,
        robot: RobotModel,
        scene: Scene,
        catalogue: Mapping[str, ObjectModel],
        settings: PlannerSettings | None = None,
    ) -> None:
        self.robot = robot
        self.scene = scene
        self.catalogue = catalogue
        self.settings = settings or PlannerSettings()
        self.geometry = RobotGeometry(robot)
        self.reaches = {
            name: Reach(robot, name, InverseKinematics(robot, name, self.settings.seed)) for name in robot.arm_names
        }
        for name, reach in self.reaches.items():  # compiles the kernels before the first request
            reach.inverse_kinematics.solve(robot.gripper_pose(name, robot.arm(name).home), wanted=1)
        self.boxes = tuple(Solid(box.name, "box", tuple(box.size), box.world_from_box) for box in scene.boxes)

    def object_model(self, name: str) -> ObjectModel:
        """Return an object of the catalogue.

        Raises:
            UnknownNameError: There is no such object.
        """
        if name not in self.catalogue:
            raise UnknownNameError("object", name, tuple(self.catalogue))
        return self.catalogue[name]

    def object_pose(self, snapshot: CellSnapshot, name: str) -> FloatArray:
        """Return ``world_from_object`` of an object that is seen.

        Raises:
            UnknownNameError: There is no such object.
            InfeasibleError: Nobody sees it.
        """
        self.object_model(name)
        if name not in snapshot.objects:
            seen = ", ".join(sorted(snapshot.objects)) or "nothing"
            raise InfeasibleError(
                f"object {name!r} is not seen; seen: {seen}; put it into view of the cameras",
                ErrorCode.OBJECT_NOT_FOUND,
            )
        return snapshot.objects[name]

    def start_of(self, arm: str, snapshot: CellSnapshot) -> FloatArray:
        """Return where an arm is [rad] (n,), brought inside its limits.

        Raises:
            BadRequestError: Not known, not finite or clearly outside the limits.
        """
        model = self.robot.arm(arm)
        if arm not in snapshot.arms:
            raise BadRequestError(f"the displacements of the {arm} arm are not known")
        start = model.check(snapshot.arms[arm], "present displacements", START_TOLERANCE)
        return np.clip(start, model.lower, model.upper)

    def held_by(self, arm: str, snapshot: CellSnapshot) -> str:
        """Return the name of the object in an arm's closed gripper; empty: none that is seen."""
        if arm not in snapshot.gripping or arm not in snapshot.arms:
            return ""
        fingertips = self.robot.gripper_pose(arm, snapshot.arms[arm])[:3, 3]
        distances = {
            name: min(solid.distance(fingertips) for solid in object_solids(self.catalogue[name], pose))
            for name, pose in snapshot.objects.items()
            if name in self.catalogue
        }
        nearest = min(distances, key=lambda name: distances[name], default="")
        return nearest if nearest and distances[nearest] <= HELD_DISTANCE else ""

    def standing(self, snapshot: CellSnapshot) -> FloatArray:
        """Return the whole configuration (nq,) with all arms where they are."""
        return self.robot.configuration(snapshot.arms)

    def checker(
        self, arm: str, snapshot: CellSnapshot, held: HeldObject | None = None, touched: str = ""
    ) -> CollisionChecker:
        """Return the collision checks of an arm's motion.

        Args:
            arm: The arm that moves.
            snapshot: The cell.
            held: What it holds.
            touched: Object that the arm's hand may touch.
        """
        torso = snapshot.world_from_torso
        surroundings = Surroundings(
            boxes=self.boxes,
            objects={
                name: object_solids(self.catalogue[name], pose)
                for name, pose in snapshot.objects.items()
                if name in self.catalogue
            },
            person=() if torso is None else person_solids(torso),
            held=held,
            touched=touched,
            touching_arm=arm,
            person_distance=self.settings.person_distance,
            held_person_distance=self.settings.held_person_distance,
        )
        return CollisionChecker(self.geometry, surroundings, arm)

    def held_object(self, arm: str, name: str, gripper_from_object: FloatArray) -> HeldObject:
        """Return an object as held by an arm's gripper."""
        return HeldObject(arm, name, object_solids(self.object_model(name), gripper_from_object))

    def upright(self, arm: str, gripper_from_object: FloatArray, valid: Validity) -> Validity:
        """Return ``valid`` narrowed to displacements at which the held object leans no more than the tilt limit."""
        least = float(np.cos(self.settings.tilt_limit))
        axis = gripper_from_object[:3, :3] @ UP

        def valid_and_upright(displacements: FloatArray) -> bool:
            pose = self.reaches[arm].inverse_kinematics.gripper_pose(displacements)
            return bool(pose[2, :3] @ axis >= least) and valid(displacements)

        return valid_and_upright

    def free_path(
        self,
        arm: str,
        start: FloatArray,
        goal: FloatArray,
        valid: Validity,
        deadline: float,
        settings: PathSettings = FREE_SEARCH,
    ) -> FloatArray | None:
        """Return a path (k, n) between displacements through valid ones, or None."""
        model = self.robot.arm(arm)
        rng = np.random.default_rng(self.settings.seed)
        return plan_path(valid, start, goal, (model.planning_lower, model.planning_upper), rng, deadline, settings)

    def line(self, arm: str, start: FloatArray, shift: FloatArray, valid: Validity) -> FloatArray | None:
        """Return displacements (k, n) that shift the gripper straight by ``shift`` [m] in the world, or None."""
        kinematics = self.reaches[arm].inverse_kinematics
        pose = kinematics.gripper_pose(start)
        goal = pose.copy()
        goal[:3, 3] += shift
        return straight_line(kinematics, valid, start, pose, goal)

    def back_off(self, arm: str, start: FloatArray, valid: Validity) -> FloatArray | None:
        """Return displacements (k, n) that draw the gripper back, as straight and as far as that is possible, or None.

        Where straight back is not possible the gripper leans away from it between its open fingers, which slide past
        the object then.
        """
        turn = self.reaches[arm].inverse_kinematics.gripper_pose(start)[:3, :3]
        for lean in RETREAT_LEANS:
            backwards = turn @ np.array([np.sin(lean), 0.0, -np.cos(lean)])
            for share in RETREAT_SHARES:
                path = self.line(arm, start, share * self.settings.retreat_distance * backwards, valid)
                if path is not None:
                    return path
        return None

    def draws_back(self, arm: str, start: FloatArray) -> bool:
        """Return whether the gripper can draw back from ``start`` at all, collisions aside."""
        model = self.robot.arm(arm)
        lower, upper = model.lower - 1e-9, model.upper + 1e-9
        return self.back_off(arm, start, lambda q: bool(np.all(q >= lower) and np.all(q <= upper))) is not None

    def leave(self, arm: str, start: FloatArray, snapshot: CellSnapshot) -> FloatArray:
        """Return displacements (k, n) from ``start`` to where no object is between the fingers; k = 1: none is."""
        checker = self.checker(arm, snapshot)
        whole = self.standing(snapshot)
        touched = [label for reason, label in checker.problems(whole) if reason is Reason.OBJECT]
        for name in touched:
            freed = self.checker(arm, snapshot, touched=name)
            freed.tolerate_start(whole)
            path = self.back_off(arm, start, self.reaches[arm].validity(freed, whole))
            if path is not None:
                return path
        return start[None]

    def timed(self, arm: str, path: FloatArray, valid: Validity | None = None, speed: float = 1.0) -> Trajectory:
        """Return the trajectory of a path; corners are rounded as far as they stay valid.

        Args:
            arm: The arm.
            path: Waypoints (k, n) [rad].
            valid: Test of the rounded corners; left out: they are taken to be valid.
            speed: Share of the planning velocities.
        """
        model = self.robot.arm(arm)
        limits = speed * model.planning_velocity, min(1.0, 2.0 * speed) * model.acceleration
        for blend in (self.settings.blend, self.settings.blend / 4.0):
            trajectory = parameterise(path, *limits, blend)
            if valid is None or len(path) == 2 or all(valid(point) for point in trajectory.positions[1:]):
                return trajectory
        return parameterise(path, *limits)

    def motion(
        self, arm: str, goal: FloatArray, snapshot: CellSnapshot, held_name: str = "", time_budget: float = 0.0
    ) -> Trajectory:
        """Return a collision-free trajectory of an arm from where it is to displacements.

        Two things too close at the start may be so, but come no closer; open fingers first draw back from an object.

        Args:
            arm: Name of the arm.
            goal: Displacements (n,) [rad].
            snapshot: The cell.
            held_name: Object in the gripper, moved along; empty: what the closed gripper is seen to hold, if anything.
            time_budget: Wall time [s]; 0: the default.

        Raises:
            UnknownNameError: No such arm or object.
            BadRequestError: The goal is outside the limits.
            InfeasibleError: The goal collides or no path was found.
        """
        model = self.robot.arm(arm)
        goal = model.check(goal)
        held_name = held_name or self.held_by(arm, snapshot)
        start = self.start_of(arm, snapshot)
        deadline = time.monotonic() + (time_budget or self.settings.time_budget)
        whole = self.standing(snapshot)
        lead = start[None] if held_name else self.leave(arm, start, snapshot)
        checker, gripper_from_object = self._carrying(arm, start, snapshot, held_name)
        whole[self.robot.arm_indices(arm)] = lead[-1]
        checker.tolerate_start(whole)
        valid = self.reaches[arm].validity(checker, self.standing(snapshot))
        path = None
        if gripper_from_object is not None:
            upright = self.upright(arm, gripper_from_object, valid)
            careful = self.object_model(held_name).keep_upright and upright(start)
            path = self.free_path(arm, lead[-1], goal, upright, deadline, UPRIGHT_SEARCH) if careful else None
        if path is None:
            path = self.free_path(arm, lead[-1], goal, valid, deadline)
        if path is None:
            self._refuse_goal(arm, goal, checker, snapshot)
        assert path is not None
        speed = self.settings.present_speed if held_name else 1.0
        return self.timed(arm, np.vstack([lead, path[1:]]), valid if len(lead) == 1 else None, speed)

    def put_back(
        self, arm: str, name: str, world_from_place: FloatArray, snapshot: CellSnapshot, time_budget: float = 0.0
    ) -> Trajectory:
        """Return a trajectory that puts the object in the gripper down at a place: above it, then straight down.

        Args:
            arm: The arm that holds it.
            name: The object.
            world_from_place: Object pose there, e.g. where it was taken from. Shape (4, 4).
            snapshot: The cell.
            time_budget: Wall time [s]; 0: the default.

        Raises:
            UnknownNameError: No such arm or object.
            InfeasibleError: It is not seen, or the place cannot be reached.
        """
        start = self.start_of(arm, snapshot)
        deadline = time.monotonic() + (time_budget or self.settings.time_budget)
        checker, gripper_from_object = self._carrying(arm, start, snapshot, name)
        assert gripper_from_object is not None
        whole = self.standing(snapshot)
        down_pose = world_from_place @ invert_transform(gripper_from_object)
        reach, reasons = self.reaches[arm], Reasons()
        carry = self.reaches[arm].validity(checker, whole)
        checker.tolerate_start(whole)
        upright = self.upright(arm, gripper_from_object, carry)
        careful = self.object_model(name).keep_upright and upright(start)
        for placed in reach.inverse_kinematics.solve(down_pose, start):
            landing = self._carrying(arm, start, snapshot, name)[0]
            at_place = whole.copy()
            at_place[self.robot.arm_indices(arm)] = placed
            landing.ignore_support(at_place)
            valid = reach.validity(landing, whole)
            up = self.line(arm, placed, self.settings.lift_height * UP, valid) if valid(placed) else None
            if up is None:
                reasons.add(*(landing.why(at_place) or (Reason.JOINT_LIMITS, "straight way down")))
                continue
            path = self.free_path(arm, start, up[-1], upright, deadline, UPRIGHT_SEARCH) if careful else None
            if path is None:
                path = self.free_path(arm, start, up[-1], carry, deadline)
            if path is not None:
                whole_path = np.vstack([path, up[-2::-1]])
                return self.timed(arm, whole_path, None, self.settings.careful_speed)
        raise InfeasibleError(
            f"the {arm} arm finds no way to put {name} back at {np.round(world_from_place[:3, 3], 2).tolist()} m: "
            f"{reasons.sentence()}; take it out of the gripper by hand",
            reasons.code,
        )

    def _carrying(
        self, arm: str, displacements: FloatArray, snapshot: CellSnapshot, held_name: str
    ) -> tuple[CollisionChecker, FloatArray | None]:
        """Return the checks of an arm with what it holds, and ``gripper_from_object`` as seen now."""
        if not held_name:
            return self.checker(arm, snapshot), None
        world_from_object = self.object_pose(snapshot, held_name)
        world_from_gripper = self.reaches[arm].inverse_kinematics.gripper_pose(displacements)
        gripper_from_object = invert_transform(world_from_gripper) @ world_from_object
        held = self.held_object(arm, held_name, gripper_from_object)
        return self.checker(arm, snapshot, held), gripper_from_object

    def _refuse_goal(self, arm: str, goal: FloatArray, checker: CollisionChecker, snapshot: CellSnapshot) -> None:
        """Raise the InfeasibleError that says why a goal was not reached."""
        whole = self.standing(snapshot)
        whole[self.robot.arm_indices(arm)] = goal
        problem = checker.why(whole)
        if problem is not None:
            raise InfeasibleError(
                f"the {arm} arm would be in trouble at its goal: {problem[0].value} ({problem[1]})",
                ErrorCode.IN_COLLISION,
            )
        raise InfeasibleError(
            f"no collision-free path of the {arm} arm was found in {self.settings.time_budget:g} s; clear its way or "
            "allow more time",
            ErrorCode.NO_PATH,
        )
