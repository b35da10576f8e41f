"""``mocap_node``: a source of marker samples in, clean stamped marker frames out."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from handover_msgs.msg import MarkerFrame, MarkerSet

from handover_ros.errors import BadModelError, BadRecordingError, BadRequestError
from handover_ros.mocap.frames import positions_from_flat
from handover_ros.mocap.marker_sets import load_marker_set, match_labels
from handover_ros.mocap.pipeline import MarkerPipeline
from handover_ros.mocap.placement import PLACEMENTS, move_recording, place_person, planar_transform
from handover_ros.mocap.recordings import load_recording
from handover_ros.mocap.repair_types import RepairSettings
from handover_ros.mocap.sources import MarkerSample, RecordingSource
from handover_ros.nodes.convert import numpy_array, seconds_from_stamp
from handover_ros.nodes.convert_human import fill_marker_frame, marker_set_message
from handover_ros.nodes.parameters import ParameterSpec
from handover_ros.nodes.runtime import LATCHED, RECORDER, STREAM_PUBLISHER, HandoverNode, main_of, monotonic
from handover_ros.nodes.scheduling import PRIORITY, come_first
from handover_ros.nodes.streams import StreamReader
from handover_ros.objects.scene import load_scene
from handover_ros.skeleton.torso import track_recording

SILENT_AFTER = 1.0  # [s] of wall time without frames until the node says so
MAX_CATCH_UP = 64  # frames published in one go after a pause
LISTENER_WAIT = 3.0  # [s] of wall time a recording waits for somebody to listen
LOOKED_AT = 1000  # frames of a recording whose torso is looked at before it is played

PARAMETERS = (
    ParameterSpec("source", "simulator", "where the samples come from", choices=("simulator", "recording")),
    ParameterSpec("recording", "", "file to play when source is recording: .c3d, .trc or Vicon .csv"),
    ParameterSpec("marker_set", "upper_body_24", "marker set, as in config/marker_sets, or a YAML file"),
    ParameterSpec("frame_id", "world", "frame of the positions"),
    ParameterSpec("pace", 1.0, "recorded seconds per second of ROS time", 0.05, 50.0),
    ParameterSpec("loop", False, "play the recording again and again"),
    ParameterSpec("loop_style", "ping_pong", "how it is repeated", choices=("ping_pong", "restart")),
    ParameterSpec("start_delay", 0.0, "[s] of ROS time before the first frame", 0.0, 600.0),
    ParameterSpec(
        "placement",
        "none",
        "where a recording is put: as recorded (none), at placement_pose (explicit), its person at the person's place "
        "of the scene (auto)",
        choices=PLACEMENTS,
    ),
    ParameterSpec("placement_pose", [0.0, 0.0, 0.0], "x [m], y [m], yaw [rad] of the recording's origin in the world"),
    ParameterSpec("scene", "lab", "scene whose person's place is used by placement auto"),
    ParameterSpec("max_gap", 0.2, "[s] longest gap that is bridged", 0.0, 2.0),
    ParameterSpec("gate", 0.025, "[m] distance from the prediction that needs no excuse", 0.001, 0.5),
    ParameterSpec("max_acceleration", 50.0, "[m/s^2] greatest acceleration of a marker", 1.0, 1000.0),
    ParameterSpec("max_speed", 4.0, "[m/s] greatest speed of a marker", 0.1, 50.0),
    ParameterSpec("confirm_frames", 4, "frames until a marker is believed at a new place", 1, 1000),
    PRIORITY,
)


class MocapNode(HandoverNode):
    """Publishes ``mocap/markers`` and the latched ``mocap/marker_set``."""

    def __init__(self) -> None:
        super().__init__("mocap_node", PARAMETERS)
        parameters = self.parameters
        self.marker_set = load_marker_set(parameters["marker_set"])
        settings = RepairSettings(
            max_gap=parameters["max_gap"],
            gate=parameters["gate"],
            max_acceleration=parameters["max_acceleration"],
            max_speed=parameters["max_speed"],
            confirm_frames=parameters["confirm_frames"],
        )
        self.pipeline = MarkerPipeline(self.marker_set.segments, settings)
        self.set_version = 1
        self.frames_read, self.bad_frames, self.last_problem = 0, 0, ""
        self.last_published = monotonic()
        self.counted_frames, self.counted_at = 0, monotonic()
        self.message = MarkerFrame(set_version=self.set_version)
        self.message.header.frame_id = parameters["frame_id"]
        self.marker_publisher = self.create_publisher(MarkerFrame, "mocap/markers", STREAM_PUBLISHER)
        self.set_publisher = self.create_publisher(MarkerSet, "mocap/marker_set", LATCHED)
        self.columns: np.ndarray | None = None  # where the set's markers stand in the source's samples; -1: nowhere
        self.absent = np.zeros(0, dtype=int)
        self.source_markers = 0
        self.source_version: int | None = None
        self.source: RecordingSource | None = None
        self.stream: StreamReader | None = None
        self.torso_residual = math.nan
        if parameters["source"] == "recording":
            self.open_recording()
        else:
            # Reliable on both sides and deep: a machine that is busy for a moment costs no frame.
            self.stream = StreamReader(self, MarkerFrame, "sim/markers", self.on_source_frame, RECORDER)
            self.create_subscription(MarkerSet, "sim/marker_set", self.on_source_set, LATCHED)
            self.degraded("waiting for sim/marker_set")
        self.scheduling = come_first(parameters["realtime_priority"])

    def on_stop(self) -> None:
        """End the stream's thread."""
        if self.stream is not None:
            self.stream.stop()

    # Recording -------------------------------------------------------------------------------------------------

    def open_recording(self) -> None:
        """Read the recording, put it in its place and start playing.

        Raises:
            BadRecordingError: The file cannot be used.
            BadRequestError: No file was named.
        """
        parameters = self.parameters
        if not parameters["recording"]:
            raise BadRequestError("mocap_node: parameter recording: name a .c3d, .trc or .csv file to play")
        recording = load_recording(Path(parameters["recording"]).expanduser(), self.marker_set)
        torso = [t for t in track_recording(self.marker_set.torso, recording, LOOKED_AT) if t.valid]
        if torso:
            self.torso_residual = math.sqrt(sum(t.residual_rms**2 for t in torso) / len(torso))
        if parameters["placement"] == "explicit":
            pose = parameters["placement_pose"]
            if len(pose) != 3:
                raise BadRequestError(f"mocap_node: parameter placement_pose: needs x, y, yaw, got {len(pose)} numbers")
            recording = move_recording(recording, planar_transform(*pose))
        elif parameters["placement"] == "auto":
            if not torso:
                raise BadRecordingError(
                    f"{recording.path}: the torso is not seen in its first {LOOKED_AT} frames, so it cannot be placed; "
                    "use placement none or explicit"
                )
            place = load_scene(parameters["scene"]).person_pose
            recording = move_recording(recording, place_person(torso[0].world_from_torso, place))
        self.recording = recording
        self.announce(recording.rate * parameters["pace"])
        self.started_at: float | None = None
        self.opened_at = monotonic()
        self.create_timer(1.0 / (recording.rate * parameters["pace"]), self.play)
        self.ready(f"playing {recording.path.name}: {recording.frames} frames at {recording.rate:g} Hz")

    def play(self) -> None:
        """Publish what is due; the node's clock paces, simulated or not."""
        now = self.seconds_now()
        if now <= 0.0:
            return  # nobody publishes /clock yet
        unheard = self.source is None and not self.marker_publisher.get_subscription_count()
        if unheard and monotonic() - self.opened_at < LISTENER_WAIT:
            return
        if self.source is None or self.started_at is None or now < self.started_at - self.parameters["start_delay"]:
            self.started_at = now + self.parameters["start_delay"]
            loop = self.parameters["loop_style"] if self.parameters["loop"] else "none"
            self.source = RecordingSource(self.recording, self.parameters["pace"], self.started_at, loop)
            self.pipeline.restart()
        for _ in range(MAX_CATCH_UP):
            sample = self.source.poll(now)
            if sample is None:
                break
            self.take(sample)
            if self.source.finished:
                self.finish()

    def finish(self) -> None:
        """Say what was read, once, after the last frame."""
        counters = self.pipeline.repair.counters
        self.ready(
            f"played {self.recording.path.name}: {self.frames_read} frames read, {counters.missing} samples missing "
            f"({100.0 * counters.missing_fraction:.2f} %), {counters.bridged} bridged, "
            f"{counters.jumps + counters.ghosts} jumps and {counters.swaps} swaps repaired, "
            f"torso residual {1e3 * self.torso_residual:.1f} mm"
        )

    # Simulator or another live system on the same topics ---------------------------------------------------------

    def on_source_set(self, message: MarkerSet) -> None:
        """Find the set's markers among those of the source."""
        names = tuple(message.marker_names)
        try:
            columns = match_labels(self.marker_set, names)
        except BadModelError as error:
            self.columns = None
            self.last_problem = str(error)
            self.degraded(f"sim/marker_set: {error}")
            return
        with self.stream.lock:
            self.columns = np.array([-1 if column is None else column for column in columns])
            self.absent = np.flatnonzero(self.columns < 0)
            self.source_markers, self.source_version = len(names), message.version
            self.pipeline.restart()
        self.announce(message.rate)
        self.ready(f"{len(columns)} markers of {self.marker_set.name} at {message.rate:g} Hz")

    def on_source_frame(self, message: MarkerFrame) -> None:
        """Clean and publish one frame; what cannot be used is counted."""
        if self.columns is None:
            return  # the names have not come yet, or do not fit; the heartbeat says so
        if message.set_version != self.source_version:
            self.reject(f"set_version {message.set_version} is not that of sim/marker_set ({self.source_version})")
            return
        try:
            positions = positions_from_flat(numpy_array(message.positions), self.source_markers)
        except BadRequestError as error:
            self.reject(str(error))
            return
        if not math.isfinite(message.device_time):
            self.reject(f"device_time: {message.device_time} is not finite")
            return
        ordered = positions[self.columns]
        if self.absent.size:
            ordered[self.absent] = np.nan
        stamp = seconds_from_stamp(message.header.stamp)
        reference = stamp if stamp > 0.0 else self.seconds_now()
        self.take(MarkerSample(message.device_frame, message.device_time, reference, ordered))

    # Both ---------------------------------------------------------------------------------------------------------

    def take(self, sample: MarkerSample) -> None:
        """Clean and publish one sample."""
        self.frames_read += 1
        frame = self.pipeline.process(sample)
        if frame is not None:
            self.last_published = monotonic()
            fill_marker_frame(self.message, frame)
            self.marker_publisher.publish(self.message)

    def reject(self, problem: str) -> None:
        """Count a sample that cannot be used."""
        self.bad_frames += 1
        self.last_problem = problem

    def announce(self, rate: float) -> None:
        """Publish the names of the markers."""
        marker_set = self.marker_set
        self.set_publisher.publish(
            marker_set_message(
                marker_set.name,
                marker_set.names,
                marker_set.segments,
                rate,
                self.parameters["frame_id"],
                self.set_version,
            )
        )

    def diagnose(self) -> tuple[bool, str, dict[str, object]]:
        """Report rates, gaps and repairs."""
        now = monotonic()
        rate = (self.frames_read - self.counted_frames) / max(now - self.counted_at, 1e-3)
        self.counted_frames, self.counted_at = self.frames_read, now
        counters = self.pipeline.report()
        finished = self.source is not None and self.source.finished
        silence = now - self.last_published
        values: dict[str, object] = {
            "source": self.parameters["source"],
            "marker_set": self.marker_set.name,
            "frames_read": self.frames_read,
            "rate_hz": rate,
            "missing_fraction": counters["missing_fraction"],
            "missing_samples": counters["missing"],
            "bridged_samples": counters["bridged"],
            "repaired_jumps": counters["jumps"] + counters["ghosts"],
            "repaired_swaps": counters["swaps"],
            "relabelled_samples": counters["relabelled"],
            "dropped_samples": counters["dropped"],
            "ghosts": counters["ghosts"],
            "relocations": counters["relocations"],
            "clock_jumps": counters["clock_jumps"],
            "clock_drift_ppm": float(counters["clock_drift_ppm"]),
            "duplicates": counters["duplicates"],
            "out_of_order": counters["out_of_order"],
            "lost_frames": counters["lost_frames"],
            "restarts": counters["restarts"],
            "bad_frames": self.bad_frames,
            "last_problem": self.last_problem,
            "finished": finished,
            "torso_residual_mm": 1e3 * self.torso_residual,
            "scheduling": self.scheduling,
        }
        if self.stream is not None:
            values |= {**self.stream.latencies.report(now), "rate_hz": rate}
        if finished:
            return True, "recording played to its end", values
        if silence > SILENT_AFTER:
            return False, f"no usable marker frames for {silence:.1f} s", values
        return True, f"{rate:.0f} frames/s, {100.0 * float(counters['missing_fraction']):.1f} % missing", values


main = main_of(MocapNode)

if __name__ == "__main__":
    main()
