"""What the executive observes: the robot's arms and grippers, the objects, the person's hands and how they take."""

from __future__ import annotations

import contextlib
import threading

import numpy as np
from handover_msgs.msg import (
    ActiveProfile,
    GraspChoice,
    GripperState,
    HandoverPlan,
    MarkerFrame,
    MarkerSet,
    ObjectStates,
    SkeletonState,
)
from sensor_msgs.msg import JointState

from handover_ros.cell.safety import Freshness
from handover_ros.cell.touch import PullDetector
from handover_ros.errors import HandoverError, StaleDataError
from handover_ros.geometry import invert_transform, transform_from_pose
from handover_ros.nodes.convert import numpy_array, pose_message, seconds_from_stamp, transform_from_message
from handover_ros.nodes.convert_belief import fill_choice
from handover_ros.nodes.convert_profile import profile_from_message
from handover_ros.nodes.runtime import LATCHED, SENSOR_CONSUMER, HandoverNode, monotonic
from handover_ros.nodes.streams import Latest
from handover_ros.objects import load_catalogue
from handover_ros.preferences.observed import observed_choice, rehearse_choice
from handover_ros.robot.model import RobotModel
from handover_ros.skeleton.profile import Profile

AT_REST = 0.02  # [rad/s] of an arm that stands still
LATEST = 0.3  # [s] after the moment of taking, of the state it is read from


class ExecutiveView:
    """Keeps what the streams of a cell said last.

    Args:
        node: Owner of the subscriptions.
        robot: The robot.
        pull: Feels for the person's pull.
    """

    def __init__(self, node: HandoverNode, robot: RobotModel, pull: PullDetector) -> None:
        self.node, self.robot, self.pull = node, robot, pull
        self.catalogue = load_catalogue()
        self.robot_state = Freshness("robot/joint_states", limit=1.0)
        self.feeling = ""  # arm at which a pull is felt for
        self.pulled = False
        self.joints: dict[str, tuple[np.ndarray, np.ndarray, float]] = {}  # arm -> positions, velocities, stamp [s]
        self.grippers: dict[str, tuple[float, bool]] = {}  # arm -> opening [m], gripping
        self.objects: dict[str, np.ndarray] = {}  # name -> flat pose
        self.hand_markers: list[int] = []
        self.profile: Profile | None = None
        self.markers: MarkerFrame | None = None
        self.choice: GraspChoice | None = None  # how the person takes what is offered
        self.unread = ""  # why that is not known; empty: it is, or nothing was taken
        self.watching = False
        self.newest_markers = Latest(node, MarkerFrame, "mocap/markers", SENSOR_CONSUMER)
        self.newest_state = Latest(node, SkeletonState, "human/skeleton_state", SENSOR_CONSUMER)
        node.create_subscription(JointState, "robot/joint_states", self.on_joint_state, SENSOR_CONSUMER)
        node.create_subscription(GripperState, "robot/gripper_state", self.on_gripper_state, SENSOR_CONSUMER)
        node.create_subscription(ObjectStates, "objects/states", self.on_objects, SENSOR_CONSUMER)
        node.create_subscription(MarkerSet, "mocap/marker_set", self.on_marker_set, LATCHED)
        node.create_subscription(ActiveProfile, "calibration/active_profile", self.on_profile, LATCHED)

    def on_joint_state(self, message: JointState) -> None:
        """Keep the arms' positions; while the object is offered, feel for a pull."""
        self.robot_state.sample(monotonic())
        index = {name: number for number, name in enumerate(message.name)}
        for arm in self.robot.arm_names:
            try:
                columns = [index[name] for name in self.robot.arm(arm).joint_names]
            except KeyError:
                continue
            positions, velocities = np.array(message.position)[columns], np.array(message.velocity)[columns]
            self.joints[arm] = (positions, velocities, seconds_from_stamp(message.header.stamp))
            if self.feeling == arm:
                self.feel(arm, positions, velocities, np.array(message.effort)[columns])

    def feel(self, arm: str, positions: np.ndarray, velocities: np.ndarray, effort: np.ndarray) -> None:
        """Feel for the person's pull at the offered object, once the arm has come to rest."""
        if not self.pull.settled and np.max(np.abs(velocities)) > AT_REST:
            self.pull.reset()
            return
        felt = self.pull.update(self.robot.external_force(arm, positions, effort))
        self.pulled = felt or (self.pulled and self.pull.pull > 0.5 * self.pull.threshold)

    def begin_feeling(self) -> None:
        """Forget what was felt."""
        self.pulled = False
        self.pull.reset()

    def on_gripper_state(self, message: GripperState) -> None:
        """Keep the grippers' openings."""
        for arm, opening, gripping in zip(message.arms, message.openings, message.gripping, strict=False):
            self.grippers[arm] = (opening, gripping)

    def on_objects(self, message: ObjectStates) -> None:
        """Keep where the objects were seen."""
        try:
            poses = numpy_array(message.poses, len(message.names), 7)
        except HandoverError:
            return
        self.objects = dict(zip(message.names, poses, strict=True))

    def on_profile(self, message: ActiveProfile) -> None:
        """Keep who is tracked; the answers of one whose profile cannot be used are not known."""
        try:
            self.profile = profile_from_message(message)
        except HandoverError:
            self.profile = None
        if self.profile is not None:
            threading.Thread(target=self._load, args=[self.profile], daemon=True, name="load").start()

    def _load(self, profile: Profile) -> None:
        """Load what reads a choice before it is needed: at the first time that takes a second, and the robot moves."""
        with contextlib.suppress(HandoverError):
            rehearse_choice(next(iter(self.catalogue.values())), profile.skeleton)

    def watch_hands(self, watch: bool) -> None:
        """Look at the person's streams only while hands matter: at 240 Hz they would be most of this node's work."""
        if watch and not self.watching:
            self.newest_markers.take()  # what came before does not count
            self.newest_state.take()
        elif not watch:
            self.markers = None
        self.watching = watch

    def look(self) -> None:
        """Take the newest of the person's streams; read how they took something, if that is awaited."""
        if not self.watching:
            return
        if (markers := self.newest_markers.take()) is not None:
            self.markers = markers
        if (state := self.newest_state.take()) is not None and self.unread:
            self.read_choice(state)

    def on_marker_set(self, message: MarkerSet) -> None:
        """Find the markers on the hands."""
        self.hand_markers = [number for number, segment in enumerate(message.segment_names) if "hand" in segment]

    def hand_distance(self, object_name: str) -> float:
        """Return the distance [m] from the object to the nearest hand marker; NaN when either is not seen."""
        pose, markers = self.objects.get(object_name), self.markers
        if pose is None or markers is None or not self.hand_markers:
            return float("nan")
        positions = numpy_array(markers.positions).reshape(-1, 3)
        if len(positions) <= max(self.hand_markers):
            return float("nan")
        distances = np.linalg.norm(positions[self.hand_markers] - pose[:3], axis=1)
        return float(np.nanmin(distances)) if np.isfinite(distances).any() else float("nan")

    def note_taking(self, handover_id: str, plan: HandoverPlan) -> None:
        """Have the choice read from the person's state of this moment, when it comes in: tracking lags a little."""
        choice = GraspChoice(handover_id=handover_id, plan_id=plan.plan_id, object_name=plan.object_name)
        choice.header.stamp = self.node.get_clock().now().to_msg()
        choice.header.frame_id = plan.header.frame_id
        choice.handover_pose, choice.object_from_gripper = plan.handover_pose, plan.object_from_gripper
        choice.arm = plan.arm
        for unknown in (choice.object_from_hand, choice.torso):
            unknown.orientation.w = 0.0
        if self.profile is not None:
            choice.profile_id = self.profile.profile_id
        pose = self.objects.get(plan.object_name)
        if pose is not None and np.isfinite(pose).all():
            choice.handover_pose = pose_message(transform_from_pose(pose))
        self.choice, self.unread = (
            choice,
            "no state of the person came in since" if self.profile else "nobody is active",
        )

    def taken_choice(self, handover_id: str, plan_id: str) -> GraspChoice:
        """Return how the person took the object; what is not known stays empty, and the log says why."""
        choice, self.choice = self.choice, None
        if choice is None or choice.handover_id != handover_id:
            return GraspChoice(handover_id=handover_id, plan_id=plan_id)
        if self.unread:
            self.node.get_logger().info(f"how {choice.object_name} was taken is not known: {self.unread}")
        return choice

    def read_choice(self, state: SkeletonState) -> None:
        """Read the choice that was noted from the first state of that moment or later."""
        choice, profile = self.choice, self.profile
        if choice is None or not self.unread or profile is None:
            return
        late = seconds_from_stamp(state.header.stamp) - seconds_from_stamp(choice.header.stamp)
        if late < 0.0:
            return
        try:
            if late > LATEST:
                raise StaleDataError(f"the person was not tracked for {late:.2f} s")
            self._fill(choice, profile, state)
            self.unread = ""
        except HandoverError as error:
            self.unread = str(error)

    def _fill(self, choice: GraspChoice, profile: Profile, state: SkeletonState) -> None:
        """Fill in hand, region and posture.

        Raises:
            HandoverError: They are not known.
        """
        if not state.valid or state.profile_id != profile.profile_id:
            raise StaleDataError("the person is not tracked with the active profile")
        world_from_torso = transform_from_message(state.torso.pose, "torso")
        world_from_object = transform_from_message(choice.handover_pose, "handover_pose")
        names = profile.skeleton.displacement_names
        values = dict(zip(state.joint_names, state.displacements, strict=False))
        displacements = np.array([values.get(name, np.nan) for name in names])
        covariance = None
        if tuple(state.joint_names) == tuple(names) and len(state.covariance) == len(names) ** 2:
            covariance = numpy_array(state.covariance, len(names), len(names))
        model = self.catalogue[choice.object_name]
        torso_from_object = invert_transform(world_from_torso) @ world_from_object
        seen = observed_choice(model, torso_from_object, profile.skeleton, displacements, covariance)
        fill_choice(choice, seen, world_from_torso)
