"""What the planner knows of the cell: the newest of each stream, with the wall time at which it came."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from handover_msgs.msg import ActiveProfile, BeliefSummary, GripperState, ObjectStates, SkeletonState
from sensor_msgs.msg import JointState

from handover_ros.ergonomics.arm_costs import Preference
from handover_ros.errors import BadRequestError, ErrorCode, HandoverError, StaleDataError
from handover_ros.geometry import FloatArray, transform_from_pose
from handover_ros.nodes.convert import numpy_array, seconds_from_stamp, transform_from_message
from handover_ros.nodes.convert_belief import preference_from_message
from handover_ros.nodes.convert_profile import profile_from_message
from handover_ros.nodes.runtime import LATCHED, SENSOR_CONSUMER, HandoverNode, monotonic
from handover_ros.nodes.streams import NewestReader
from handover_ros.planning import CellSnapshot, TrackedPerson
from handover_ros.robot import RobotModel
from handover_ros.skeleton.profile import Profile
from handover_ros.skeleton.stillness import Stillness

LOOK_PERIOD = 0.03  # [s] of wall time between two looks at the cell


class CellView:
    """Keeps what the streams of a cell said last.

    Args:
        node: Owner of the subscriptions; its parameters ``joint_state_age``, ``torso_age``, ``object_age``,
            ``body_mass``, ``dominant_hand`` and ``preference`` are used.
        robot: The robot.
        on_person: Called when somebody else is active, or their preference is known better.
    """

    def __init__(self, node: HandoverNode, robot: RobotModel, on_person: Callable[[], None]) -> None:
        self.parameters, self.robot, self.on_person = node.parameters, robot, on_person
        self.joints: dict[str, tuple[float, FloatArray]] = {}
        self.objects: dict[str, tuple[float, FloatArray]] = {}
        self.torso: tuple[float, FloatArray] | None = None
        self.stillness = Stillness()
        self.profile: Profile | None = None
        self.profile_problem = ""
        self.posture: tuple[float, FloatArray] | None = None  # displacements of the profile's skeleton
        self.belief: tuple[str, Preference] | None = None  # whose, and what
        self.gripping: frozenset[str] = frozenset()
        self.last_problem = ""
        reader = NewestReader(node, LOOK_PERIOD)
        reader.newest_of(JointState, "robot/joint_states", self.on_joints, SENSOR_CONSUMER)
        reader.newest_of(GripperState, "robot/gripper_state", self.on_grippers, SENSOR_CONSUMER)
        reader.newest_of(ObjectStates, "objects/states", self.on_objects, SENSOR_CONSUMER)
        reader.newest_of(SkeletonState, "human/skeleton_state", self.on_skeleton, SENSOR_CONSUMER)
        node.create_subscription(ActiveProfile, "calibration/active_profile", self.on_profile, LATCHED)
        node.create_subscription(BeliefSummary, "preferences/belief", self.on_belief, LATCHED)

    def on_joints(self, message: JointState) -> None:
        """Keep the arms' displacements."""
        values = dict(zip(message.name, message.position, strict=False))
        for arm in self.robot.arm_names:
            names = self.robot.arm(arm).joint_names
            if all(name in values for name in names):
                self.joints[arm] = monotonic(), np.array([values[name] for name in names])

    def on_grippers(self, message: GripperState) -> None:
        """Keep which grippers hold something."""
        self.gripping = frozenset(
            arm for arm, gripping in zip(message.arms, message.gripping, strict=False) if gripping
        )

    def on_objects(self, message: ObjectStates) -> None:
        """Keep the poses of the objects that are seen."""
        try:
            poses = numpy_array(message.poses, len(message.names), 7)
            seen = {
                name: (monotonic(), transform_from_pose(pose))
                for name, pose in zip(message.names, poses, strict=True)
                if not np.isnan(pose).any()
            }
        except (BadRequestError, ValueError) as error:
            self.last_problem = f"objects/states: {error}"
            return
        self.objects = {**self.objects, **seen}

    def on_skeleton(self, message: SkeletonState) -> None:
        """Keep the torso when it is valid."""
        if not message.valid:
            return
        try:
            torso = transform_from_message(message.torso.pose, "torso")
            self.torso = monotonic(), torso
            self.stillness.update(seconds_from_stamp(message.header.stamp), torso)
            self.keep_posture(message)
        except BadRequestError as error:
            self.last_problem = f"human/skeleton_state: {error}"

    def keep_posture(self, message: SkeletonState) -> None:
        """Keep where the joints of the active profile's skeleton are, if it is that one that is tracked."""
        if self.profile is None or message.profile_id != self.profile.profile_id:
            return
        names = self.profile.skeleton.displacement_names
        values = dict(zip(message.joint_names, message.displacements, strict=False))
        displacements = np.array([values.get(name, np.nan) for name in names])
        if np.isfinite(displacements).all():
            self.posture = monotonic(), displacements

    def on_profile(self, message: ActiveProfile) -> None:
        """Plan for this person from now on; one whose profile cannot be used is offered things like anybody."""
        self.profile, self.profile_problem, self.posture = None, "", None
        try:
            self.profile = profile_from_message(message)
        except HandoverError as error:
            self.profile_problem = self.last_problem = str(error)
        self.on_person()

    def on_belief(self, message: BeliefSummary) -> None:
        """Plan with what is believed of the person's preference, as soon as there was an answer."""
        self.belief = None
        try:
            if message.observations and self.parameters["preference"] != "none":
                self.belief = message.profile_id, preference_from_message(message, self.parameters["preference"])
        except HandoverError as error:
            self.last_problem = f"preferences/belief: {error}"
        self.on_person()

    @property
    def preference(self) -> Preference | None:
        """What the active person finds comfortable; None: not known."""
        if self.belief is None or self.profile is None or self.belief[0] != self.profile.profile_id:
            return None
        return self.belief[1]

    def person(self, torso: FloatArray, profile: Profile | None, posture: FloatArray | None) -> TrackedPerson:
        """Return what is known of the person."""
        return TrackedPerson(
            torso,
            skeleton=profile.skeleton if profile else None,
            displacements=posture,
            dominant=self.parameters["dominant_hand"] or None,
            body_mass=self.parameters["body_mass"],
            profile=profile.profile_id if profile else "",
            profile_problem=self.profile_problem,
            preference=self.preference if profile is self.profile else None,
        )

    def snapshot(self, needs_person: bool) -> CellSnapshot:
        """Return the cell as it is now.

        Raises:
            StaleDataError: Robot or, if needed, person is not known or too old.
        """
        now = monotonic()
        for arm in self.robot.arm_names:
            limit = self.parameters["joint_state_age"]
            if arm not in self.joints:
                raise StaleDataError(f"no robot/joint_states of the {arm} arm yet: is the robot's driver running?")
            if (age := now - self.joints[arm][0]) > limit:
                raise StaleDataError(f"robot/joint_states are {age:.1f} s old (limit {limit:g} s): did the robot stop?")
        torso, limit = self.torso, self.parameters["torso_age"]
        fresh = torso is not None and now - torso[0] <= limit
        if needs_person and not fresh:
            how = "has not been tracked yet" if torso is None else f"was last tracked {now - torso[0]:.1f} s ago"
            raise StaleDataError(
                f"the person {how} (limit {limit:g} s): step into view of the cameras", ErrorCode.PERSON_NOT_TRACKED
            )
        age_limit = self.parameters["object_age"]
        profile, posture = self.profile, self.posture
        known = posture is not None and profile is not None and now - posture[0] <= limit
        person = None
        if fresh and torso is not None:
            person = self.person(torso[1], profile, posture[1] if known and posture is not None else None)
        return CellSnapshot(
            arms={arm: positions for arm, (_, positions) in self.joints.items()},
            objects={name: pose for name, (seen, pose) in self.objects.items() if now - seen <= age_limit},
            person=person,
            gripping=self.gripping,
        )
