"""``skeleton_node``: marker frames in, the person's torso out."""

from __future__ import annotations

from handover_msgs.msg import MarkerFrame, MarkerSet, SkeletonState
from visualization_msgs.msg import MarkerArray

from handover_ros.errors import BadRequestError, HandoverError
from handover_ros.mocap.marker_sets import load_marker_set
from handover_ros.nodes.convert_human import fill_skeleton_state, human_visual, marker_frame_from_message
from handover_ros.nodes.parameters import ParameterSpec
from handover_ros.nodes.runtime import LATCHED, SENSOR_PUBLISHER, HandoverNode, main_of, monotonic
from handover_ros.nodes.streams import StreamReader
from handover_ros.skeleton.torso import TorsoTracker, TrackingState

SILENT_AFTER = 1.0  # [s] of wall time without frames until the node says so
CLOCK_RESTART = 1.0  # [s] stamps that go back farther than this start a new session

PARAMETERS = (
    ParameterSpec("marker_set", "", "marker set with the torso's definition; empty: the one mocap/marker_set names"),
    ParameterSpec("template_frames", 30, "good frames from which the torso's marker template is learned", 1, 2000),
    ParameterSpec("visual_rate", 20.0, "[Hz] of ROS time, of human/visual", 0.1, 30.0),
)


class SkeletonNode(HandoverNode):
    """Publishes ``human/skeleton_state`` and ``human/visual``."""

    def __init__(self) -> None:
        super().__init__("skeleton_node", PARAMETERS)
        if self.parameters["marker_set"]:
            load_marker_set(self.parameters["marker_set"])
        self.tracker: TorsoTracker | None = None
        self.markers, self.set_version = 0, 0
        self.frames, self.bad_frames, self.last_problem = 0, 0, ""
        self.last_stamp, self.last_visual = float("-inf"), float("-inf")
        self.last_arrival = monotonic()
        self.residual, self.confidence = float("nan"), 0.0
        self.visual_period = 1.0 / self.parameters["visual_rate"]
        self.message = SkeletonState()
        self.state_publisher = self.create_publisher(SkeletonState, "human/skeleton_state", SENSOR_PUBLISHER)
        self.visual_publisher = self.create_publisher(MarkerArray, "human/visual", SENSOR_PUBLISHER)
        # Reliable on both sides: a frame is only lost when the node falls 10 frames behind.
        self.stream = StreamReader(self, MarkerFrame, "mocap/markers", self.on_markers, SENSOR_PUBLISHER)
        self.create_subscription(MarkerSet, "mocap/marker_set", self.on_marker_set, LATCHED)
        self.degraded("waiting for mocap/marker_set")

    def on_stop(self) -> None:
        """End the stream's thread."""
        self.stream.stop()

    def on_marker_set(self, message: MarkerSet) -> None:
        """Prepare the tracker for the markers of the stream."""
        try:
            marker_set = load_marker_set(self.parameters["marker_set"] or message.name)
            names = tuple(message.marker_names)
            tracker = TorsoTracker(marker_set.torso, names, self.parameters["template_frames"])
        except HandoverError as error:
            with self.stream.lock:
                self.tracker = None
            self.last_problem = str(error)
            self.degraded(f"mocap/marker_set: {error}")
            return
        with self.stream.lock:
            self.tracker, self.markers, self.set_version = tracker, len(names), message.version
            self.last_stamp = float("-inf")
        self.ready(f"tracking the torso with marker set {marker_set.name}")

    def on_markers(self, message: MarkerFrame) -> None:
        """Fit the torso to one frame and publish it; frames that cannot be used are counted."""
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
        self.frames += 1
        self.last_stamp = frame.stamp
        estimate = self.tracker.update(frame)
        self.residual, self.confidence = estimate.residual_rms, estimate.confidence
        self.message.header.frame_id = message.header.frame_id
        fill_skeleton_state(self.message, estimate)
        self.state_publisher.publish(self.message)
        if not 0.0 <= frame.stamp - self.last_visual < self.visual_period:
            self.last_visual = frame.stamp
            self.visual_publisher.publish(human_visual(estimate, frame.positions, message.header.frame_id))

    def reject(self, problem: str) -> None:
        """Count a frame that cannot be used."""
        self.bad_frames += 1
        self.last_problem = problem

    def diagnose(self) -> tuple[bool, str, dict[str, object]]:
        """Report what is tracked and how well."""
        tracker, silence = self.tracker, monotonic() - self.last_arrival
        state = tracker.state if tracker else TrackingState.LOST
        values: dict[str, object] = {
            "state": state.value,
            "frames": self.frames,
            "valid_frames": tracker.valid_frames if tracker else 0,
            "bad_frames": self.bad_frames,
            "last_problem": self.last_problem,
            "residual_mm": 1e3 * self.residual,
            "mean_residual_mm": 1e3 * tracker.mean_residual if tracker else float("nan"),
            "confidence": self.confidence,
        }
        if tracker is None or silence > SILENT_AFTER:
            return False, f"no marker frames for {silence:.1f} s", values
        return state is not TrackingState.LOST, f"torso {state.value}", values


main = main_of(SkeletonNode)

if __name__ == "__main__":
    main()
