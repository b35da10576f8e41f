"""``skeleton_node``: marker frames in, the person out: the whole skeleton of the active profile, else the torso."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from handover_msgs.msg import ActiveProfile, MarkerFrame, MarkerSet, SkeletonState
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from handover_ros.errors import BadRequestError, HandoverError
from handover_ros.mocap import frames
from handover_ros.mocap.marker_sets import load_marker_set
from handover_ros.nodes.convert import seconds_from_stamp
from handover_ros.nodes.convert_human import (
    Looks,
    fill_joint_state,
    fill_person_state,
    fill_skeleton_state,
    human_visual,
    marker_frame_from_message,
)
from handover_ros.nodes.convert_profile import profile_from_message
from handover_ros.nodes.parameters import ParameterSpec
from handover_ros.nodes.runtime import (
    LATCHED,
    RECORDER,
    SENSOR_PUBLISHER,
    STREAM_PUBLISHER,
    HandoverNode,
    Worker,
    main_of,
    monotonic,
)
from handover_ros.nodes.scheduling import PRIORITY, come_first
from handover_ros.nodes.streams import StreamReader
from handover_ros.skeleton.profile import Profile, read_profile
from handover_ros.skeleton.torso import TorsoTracker, TrackingState
from handover_ros.skeleton.tracking import SkeletonTracker, TrackingSettings
from handover_ros.skeleton.urdf import skeleton_urdf
from handover_ros.skeleton.warm_up import warm_up_tracking

SILENT_AFTER = 1.0  # [s] of wall time without frames until the node says so
CLOCK_RESTART = 1.0  # [s] stamps that go back farther than this start a new session
SWITCH_DELAY = 0.5  # [s] of the markers' time from the activation of a profile to the first frame tracked with it
PREPARATION_LIMIT = 5.0  # [s] of wall time that frames wait for a profile which is due
TORSO = "torso"
DEFAULTS = TrackingSettings()

PARAMETERS = (
    ParameterSpec("marker_set", "", "marker set with the torso's definition; empty: the one mocap/marker_set names"),
    ParameterSpec("template_frames", 30, "good frames from which the torso's marker template is learned", 1, 2000),
    ParameterSpec("visual_rate", 20.0, "[Hz] of ROS time, of human/visual", 0.1, 30.0),
    ParameterSpec("profile_file", "", "profile to track with; empty: the one on calibration/active_profile"),
    ParameterSpec("marker_noise", DEFAULTS.marker_noise, "[m] of a marker about the skeleton, one axis", 1e-5, 0.05),
    ParameterSpec("limits", DEFAULTS.limits, "whether the profile's joint limits bound the estimate"),
    PRIORITY,
)


@dataclass(frozen=True, eq=False)
class Person:
    """A profile being tracked, and how it is shown."""

    profile: Profile
    tracker: SkeletonTracker
    looks: Looks
    description: str

    @property
    def has_torso(self) -> bool:
        """Whether the skeleton's root is the torso."""
        return self.profile.skeleton.root == TORSO


@dataclass(eq=False)
class Change:
    """A change of who is tracked. It is made at a frame that the stamps tell: what is replayed is tracked alike.

    Attributes:
        at: Stamp [s] of the first frame that is tracked so.
        prepared: Set when ``person`` and ``problem`` are there.
        person: Who is tracked; None: the torso only.
        problem: Why a profile cannot be tracked.
        patience: How long frames wait [s] for it.
    """

    at: float
    prepared: threading.Event = field(default_factory=threading.Event)
    person: Person | None = None
    problem: str = ""
    patience: float = PREPARATION_LIMIT

    def is_due(self, stamp: float) -> bool:
        """Return whether a frame is to be tracked so: it is late enough, or of another clock."""
        return not self.at - 2.0 * SWITCH_DELAY <= stamp < self.at


class SkeletonNode(HandoverNode):
    """Publishes ``human/skeleton_state``, ``human/joint_states``, ``human/visual``, ``human/robot_description``."""

    def __init__(self) -> None:
        super().__init__("skeleton_node", PARAMETERS)
        if self.parameters["marker_set"]:
            load_marker_set(self.parameters["marker_set"])
        file = self.parameters["profile_file"]
        self.profile: Profile | None = read_profile(Path(file)) if file else None
        self.profile_at = float("-inf")
        self.settings = TrackingSettings(marker_noise=self.parameters["marker_noise"], limits=self.parameters["limits"])
        warm_up_tracking()
        self.tracker: TorsoTracker | None = None
        self.person: Person | None = None
        self.names: tuple[str, ...] = ()
        self.markers, self.set_version, self.set_name = 0, 0, ""
        self.change: Change | None = None  # the newest; older ones are not wanted any more
        self.frames, self.bad_frames, self.last_problem, self.profile_problem = 0, 0, "", ""
        self.last_stamp, self.last_visual, self.clear_visual = float("-inf"), float("-inf"), False
        self.last_arrival = monotonic()
        self.residual, self.confidence = float("nan"), 0.0
        self.visual_period = 1.0 / self.parameters["visual_rate"]
        self.message, self.joint_message = SkeletonState(), JointState()
        self.worker = Worker(self)
        self.state_publisher = self.create_publisher(SkeletonState, "human/skeleton_state", STREAM_PUBLISHER)
        self.joint_publisher = self.create_publisher(JointState, "human/joint_states", STREAM_PUBLISHER)
        self.visual_publisher = self.create_publisher(MarkerArray, "human/visual", SENSOR_PUBLISHER)
        self.description_publisher = self.create_publisher(String, "human/robot_description", LATCHED)
        self.description_publisher.publish(String())
        # Deep: to find a lost posture again takes the time of some frames, which are caught up with then.
        self.stream = StreamReader(self, MarkerFrame, "mocap/markers", self.on_markers, RECORDER, timed=False)
        self.create_subscription(MarkerSet, "mocap/marker_set", self.on_marker_set, LATCHED)
        if not file:
            self.create_subscription(ActiveProfile, "calibration/active_profile", self.on_profile, LATCHED)
        self.degraded("waiting for mocap/marker_set")
        self.scheduling = come_first(self.parameters["realtime_priority"])

    def on_stop(self) -> None:
        """End the stream's thread."""
        self.stream.stop()

    # Who is tracked, and by which markers

    def on_marker_set(self, message: MarkerSet) -> None:
        """Prepare the trackers for the markers of the stream."""
        self.names = tuple(message.marker_names)
        try:
            marker_set = load_marker_set(self.parameters["marker_set"] or message.name)
            tracker = TorsoTracker(marker_set.torso, self.names, self.parameters["template_frames"])
        except HandoverError as error:
            self.names = ()
            with self.stream.lock:
                self.tracker, self.change = None, None
                self.swap(None)
            self.last_problem = str(error)
            self.degraded(f"mocap/marker_set: {error}")
            return
        with self.stream.lock:
            self.swap(None)
            self.change = None
            self.tracker, self.markers, self.set_version = tracker, len(self.names), message.version
            self.last_stamp = float("-inf")
        self.set_name = marker_set.name
        self.prepare()

    def on_profile(self, message: ActiveProfile) -> None:
        """Track another person from now on, or nobody in particular."""
        try:
            self.profile, self.profile_problem = profile_from_message(message), ""
        except HandoverError as error:
            self.profile, self.profile_problem = None, str(error)
        activated = seconds_from_stamp(message.header.stamp)
        self.profile_at = activated + SWITCH_DELAY if activated > 0.0 else float("-inf")
        self.prepare()

    def prepare(self) -> None:
        """Make the tracker of the profile, beside the stream, which goes on meanwhile."""
        if not self.names:
            return  # the names of the markers come later
        change = Change(self.profile_at, problem=self.profile_problem)
        if self.profile is None:
            change.prepared.set()
            self.change = change
            self.announce(change)
            return
        self.change = change
        future = self.worker.submit(self.work_on_change, change, self.profile, self.names)
        future.add_done_callback(lambda done: self.on_prepared(change, done))

    def work_on_change(self, change: Change, profile: Profile, names: tuple[str, ...]) -> None:
        """Prepare a person, or say why that is not possible; runs in the worker thread."""
        try:
            change.person = prepared_person(profile, names, self.settings)
        except HandoverError as error:
            change.problem = str(error)
        change.prepared.set()

    def on_prepared(self, change: Change, done: Future) -> None:
        """Tell of a change, unless another profile or other markers came meanwhile."""
        if (error := done.exception()) is not None:
            raise error
        if change is self.change or (self.change is None and change.person is self.person):
            self.announce(change)

    def announce(self, change: Change) -> None:
        """Say who is tracked, or why nobody in particular is."""
        person, self.profile_problem = change.person, change.problem
        self.description_publisher.publish(String(data=person.description if person else ""))
        if change.problem:
            self.degraded(f"tracking the torso only: {change.problem}")
        elif person is not None:
            names = person.profile.skeleton.displacement_names
            self.ready(f"tracking {person.profile.person} with {len(names)} displacements")
        else:
            self.ready(f"tracking the torso with marker set {self.set_name}")

    def make_change(self, change: Change) -> None:
        """Track with what is due from this frame on; the frames behind it wait until it is prepared."""
        if change.prepared.wait(change.patience):
            self.swap(change.person)
            if self.change is change:
                self.change = None
        else:
            change.patience = 0.0

    def swap(self, person: Person | None) -> None:
        """Change what the next frame is tracked with; under the stream's lock."""
        self.person, self.clear_visual = person, True
        names = list(person.profile.skeleton.displacement_names) if person else []
        self.message, self.joint_message = SkeletonState(joint_names=names), JointState(name=names)
        if person is not None:
            self.message.profile_id = person.profile.profile_id

    # Frames

    def on_markers(self, message: MarkerFrame) -> None:
        """Track one frame and publish it; frames that cannot be used are counted."""
        self.last_arrival = monotonic()
        if self.tracker is None:
            return  # the names have not come yet, or hold no torso; the heartbeat says so
        if message.set_version != self.set_version:
            self.reject(f"set_version {message.set_version} is not that of mocap/marker_set ({self.set_version})")
            return
        try:
            frame = marker_frame_from_message(message, self.markers)
        except BadRequestError as error:
            self.reject(str(error))
            return
        if self.last_stamp - CLOCK_RESTART < frame.stamp <= self.last_stamp:
            self.reject(f"stamp {frame.stamp:.6f} is not later than the one before, {self.last_stamp:.6f}")
            return
        if (change := self.change) is not None and change.is_due(frame.stamp):
            self.make_change(change)
        self.frames += 1
        self.last_stamp = frame.stamp
        self.message.header.frame_id = message.header.frame_id
        show = not 0.0 <= frame.stamp - self.last_visual < self.visual_period
        if self.person is None:
            self.track_torso(frame, show)
        else:
            self.track_person(self.person, frame, show)

    def track_torso(self, frame: frames.MarkerFrame, show: bool) -> None:
        """Track and publish the torso only."""
        assert self.tracker is not None
        estimate = self.tracker.update(frame)
        self.residual, self.confidence = estimate.residual_rms, estimate.confidence
        fill_skeleton_state(self.message, estimate)
        self.state_publisher.publish(self.message)
        self.stream.note_latency()
        if show:
            self.show(frame, estimate.world_from_torso if estimate.valid else None)

    def track_person(self, person: Person, frame: frames.MarkerFrame, show: bool) -> None:
        """Track and publish the whole person."""
        estimate = person.tracker.update(frame)
        torso = None
        if not person.has_torso:
            assert self.tracker is not None
            torso = self.tracker.update(frame)
        self.residual, self.confidence = estimate.residual_rms, estimate.confidence
        fill_person_state(self.message, estimate, torso)
        self.state_publisher.publish(self.message)
        self.stream.note_latency()
        if estimate.valid:
            self.joint_message.header.frame_id = self.message.header.frame_id
            fill_joint_state(self.joint_message, estimate)
            self.joint_publisher.publish(self.joint_message)
        if show:
            pose = estimate if torso is None else torso
            self.show(frame, pose.world_from_torso if pose.valid else None, (person.looks, estimate))

    def show(self, frame: frames.MarkerFrame, torso: np.ndarray | None, person: tuple | None = None) -> None:
        """Publish what is seen, at the visual rate."""
        self.last_visual = frame.stamp
        frame_id, clear = self.message.header.frame_id, self.clear_visual
        self.visual_publisher.publish(human_visual(frame.stamp, torso, frame.positions, frame_id, person, clear))
        self.clear_visual = False

    def reject(self, problem: str) -> None:
        """Count a frame that cannot be used."""
        self.bad_frames += 1
        self.last_problem = problem

    def diagnose(self) -> tuple[bool, str, dict[str, object]]:
        """Report what is tracked and how well."""
        person, silence = self.person, monotonic() - self.last_arrival
        tracker = person.tracker if person else self.tracker
        state = tracker.state if tracker else TrackingState.LOST
        values: dict[str, object] = {
            "profile": person.profile.profile_id if person else "",
            "state": state.value,
            "frames": self.frames,
            "valid_frames": tracker.valid_frames if tracker else 0,
            "bad_frames": self.bad_frames,
            "last_problem": self.profile_problem or self.last_problem,
            "residual_mm": 1e3 * self.residual,
            "mean_residual_mm": 1e3 * tracker.mean_residual if tracker else float("nan"),
            "confidence": self.confidence,
            "scheduling": self.scheduling,
            **self.stream.latencies.report(monotonic()),
        }
        if person is not None:
            values |= {
                "gated": person.tracker.gated,
                "relabelled": person.tracker.relabelled,
                "reacquired": person.tracker.reacquired,
            }
        if tracker is None or silence > SILENT_AFTER:
            return False, f"no marker frames for {silence:.1f} s", values
        what = person.profile.person if person else "torso"
        return state is not TrackingState.LOST and not self.profile_problem, f"{what} {state.value}", values


def prepared_person(profile: Profile, names: tuple[str, ...], settings: TrackingSettings) -> Person:
    """Return a profile ready to be tracked.

    Raises:
        BadModelError: The stream lacks markers without which the profile cannot be tracked.
    """
    skeleton = profile.skeleton
    tracker = SkeletonTracker(skeleton, names, settings)
    return Person(profile, tracker, Looks.of(skeleton), skeleton_urdf(skeleton, name=profile.profile_id))


main = main_of(SkeletonNode)

if __name__ == "__main__":
    main()
