"""calibration_node alone: records, fits, stores; stays responsive; loses nothing; survives bad requests."""

from __future__ import annotations

import itertools
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from graph import ANSWER, FIRST_CONTACT, REPOSITORY, Graph, NodeProcess, isolated_graph, wait_for
from handover_msgs.msg import ActiveProfile, CalibrationProgress, Heartbeat
from handover_msgs.srv import (
    ActivateProfile,
    DeleteProfile,
    DiscardRecording,
    FitSkeleton,
    ListProfiles,
    StartRecording,
    StopRecording,
)
from marker_player import MarkerPlayer
from people import NAMES, SEGMENTS, calibration_motion, random_person
from profiles import profile_of
from rclpy.qos import QoSProfile

from handover_ros.cell.store import ProfileStore
from handover_ros.errors import ErrorCode
from handover_ros.nodes import calibration_node
from handover_ros.nodes.convert_profile import profile_from_message
from handover_ros.nodes.runtime import LATCHED, SENSOR_PUBLISHER
from handover_ros.skeleton.prompts import MOTION_NAMES

pytestmark = pytest.mark.graph

RATE, FRAMES = 100.0, 1600
FIT = 120.0  # [s] a fit on a busy machine, kernels not compiled yet


class Bench:
    """The node, its store and a marker stream."""

    def __init__(self, graph: Graph, directory: Path) -> None:
        self.graph = graph
        self.store = ProfileStore(directory)
        self.progress = graph.collect(CalibrationProgress, "calibration/progress", SENSOR_PUBLISHER)
        self.active = graph.collect(ActiveProfile, "calibration/active_profile", LATCHED)
        self.beats: list[float] = []
        graph.node.create_subscription(Heartbeat, "cell/heartbeat", self.on_beat, QoSProfile(depth=50))
        self.motion = calibration_motion(random_person(5), frames=FRAMES, rate=RATE)
        self.player = MarkerPlayer(graph, NAMES, SEGMENTS, self.motion.measured, RATE, speed=4.0)
        self.node = self.start()

    def start(self) -> NodeProcess:
        file = REPOSITORY / "config" / "calibration_node.yaml"
        self.node = self.graph.start("calibration_node", file, profile_directory=str(self.store.directory))
        return self.node

    def on_beat(self, _: Heartbeat) -> None:
        self.beats.append(time.monotonic())

    def call(self, service, request=None, timeout: float = ANSWER, **fields):
        name = {
            StartRecording: "start_recording",
            StopRecording: "stop_recording",
            DiscardRecording: "discard_recording",
            FitSkeleton: "fit",
            ListProfiles: "list_profiles",
            ActivateProfile: "activate_profile",
            DeleteProfile: "delete_profile",
        }[service]
        return self.graph.call(service, f"calibration/{name}", service.Request(**fields), timeout)

    def record(self, profile_id: str = "anna", frames: int = FRAMES + 40, **fields) -> StopRecording.Response:
        """Record until so many frames came; the person moves unless asked to stand still."""
        answer = self.call(StartRecording, profile_id=profile_id, **fields)
        assert answer.success, answer.message
        if fields.get("motion") != "still":
            self.player.moving.set()
        before = self.player.sent
        wait_for(lambda: self.player.sent >= before + frames, 60.0, "frames to be sent")
        answer = self.call(StopRecording)
        assert answer.success, answer.message
        return answer

    def active_id(self) -> str | None:
        return self.active[-1].info.profile_id if self.active else None


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with isolated_graph() as graph:
        bench = Bench(graph, tmp_path / "profiles")
        yield bench
        bench.player.stop()


def test_recordings_add_up_no_frame_is_lost_the_fit_is_stored_and_activated_while_the_node_keeps_serving(bench: Bench):
    bench.player.start()
    first = bench.record(motion="still", person="Anna", frames=60)
    assert first.total_frames == first.frames
    rest = bench.record()
    assert rest.total_frames == first.frames + rest.frames
    assert (first.lost_frames, rest.lost_frames) == (0, 0)
    assert rest.frames >= FRAMES
    assert rest.missing_fraction == pytest.approx(0.1, abs=0.02)

    future_client = bench.graph.node.create_client(FitSkeleton, "calibration/fit")
    wait_for(future_client.service_is_ready, FIRST_CONTACT, "calibration/fit")
    began = time.monotonic()
    future = future_client.call_async(FitSkeleton.Request(profile_id="anna", activate=True))
    wait_for(lambda: any(message.phase == "fitting" for message in bench.progress), ANSWER, "the fit to begin")
    answered, slowest = 0, 0.0
    while not future.done():
        asked = time.monotonic()
        assert bench.call(ListProfiles).success
        slowest = max(slowest, time.monotonic() - asked)
        answered += 1
        busy = bench.call(StartRecording, profile_id="bert")
        assert future.done() or busy.error_code == ErrorCode.BUSY, busy.message
        assert time.monotonic() - began < FIT
    ended = time.monotonic()
    answer = future.result()
    assert answer.success, answer.message
    assert answer.fit_rms < 0.004
    assert answer.heldout_mean < 0.005
    assert answer.profile.active
    assert len(answer.profile.joint_names) == 14
    during = [beat for beat in bench.beats if began <= beat <= ended]
    gaps = [later - earlier for earlier, later in itertools.pairwise(during)]
    assert max(gaps, default=0.0) < 1.5, "the node stays alive for the executive while it fits"
    assert answered > 0
    assert slowest < 1.5
    wait_for(lambda: bench.active_id() == "anna", ANSWER, "the profile to be active")
    profile = profile_from_message(bench.active[-1])
    assert profile.person == "Anna"
    assert profile.report.frames == answer.frames
    assert bench.store.active().created == profile.created
    phases = list(dict.fromkeys(message.phase for message in bench.progress))
    assert [phase for phase in phases if phase != "idle"] == ["recording", "fitting", "done"]
    fractions = [message.fraction for message in bench.progress if message.phase == "fitting"]
    assert fractions == sorted(fractions)
    prompted = [message.motion for message in bench.progress if message.phase == "recording"]
    assert prompted[0] == MOTION_NAMES[0]


def test_bad_requests_and_bad_frames_are_answered_and_the_node_goes_on(bench: Bench):
    early = bench.call(StartRecording, profile_id="anna") if not bench.player.sent else None
    assert early is None or not early.success, "no frames are played yet"
    for service, fields, code, words in (
        (StopRecording, {}, ErrorCode.BAD_REQUEST, "start_recording"),
        (FitSkeleton, {"profile_id": "anna"}, ErrorCode.NOT_ENOUGH_DATA, "start_recording"),
        (FitSkeleton, {"profile_id": "a/b"}, ErrorCode.BAD_REQUEST, "profile_id"),
        (StartRecording, {"profile_id": ""}, ErrorCode.BAD_REQUEST, "profile_id"),
        (StartRecording, {"profile_id": "../x"}, ErrorCode.BAD_REQUEST, "profile_id"),
        (StartRecording, {"profile_id": "a", "motion": "somersault"}, ErrorCode.UNKNOWN_NAME, "elbow_flexion"),
        (StartRecording, {"profile_id": "a", "skeleton_template": "octopus"}, ErrorCode.UNKNOWN_NAME, "upper_body"),
        (
            StartRecording,
            {"profile_id": "a", "skeleton_template": "right_arm_on_shoulder"},
            ErrorCode.NOT_ENOUGH_DATA,
            "right_shoulder",
        ),
        (ActivateProfile, {"profile_id": "nobody"}, ErrorCode.UNKNOWN_NAME, "nobody"),
        (ActivateProfile, {"profile_id": "/etc/passwd"}, ErrorCode.BAD_REQUEST, "profile_id"),
        (DeleteProfile, {"profile_id": ""}, ErrorCode.BAD_REQUEST, "profile_id"),
        (DeleteProfile, {"profile_id": "nobody"}, ErrorCode.UNKNOWN_NAME, "nobody"),
        (DiscardRecording, {}, ErrorCode.BAD_REQUEST, "nothing"),
    ):
        answer = bench.call(service, **fields)
        assert (answer.success, answer.error_code) == (False, code), (service, fields, answer.message)
        assert words in answer.message
        assert len(answer.message.splitlines()) == 1

    bench.player.speed = 0.2
    bench.player.start()
    bench.record(frames=10)
    other = bench.call(StartRecording, profile_id="bert")
    assert other.error_code == ErrorCode.BUSY
    assert "anna" in other.message
    short = bench.call(FitSkeleton, profile_id="anna", activate=True)
    assert not short.success
    assert short.error_code in (ErrorCode.NOT_ENOUGH_DATA, ErrorCode.FIT_FAILED), short.message
    assert bench.store.list() == ()
    wait_for(lambda: bench.progress[-1].phase == "failed", ANSWER, "the failure to be told")
    gone = bench.call(DiscardRecording)
    assert gone.success
    assert gone.frames > 0
    assert bench.call(StartRecording, profile_id="bert").success
    bench.player.version = 2
    bench.player.announce(NAMES[:-1])
    wait_for(lambda: bench.progress[-1].phase == "failed", ANSWER, "other markers to end the recording")
    assert not bench.call(StopRecording).success
    assert bench.node.process.poll() is None


def test_a_fit_with_problems_stores_nothing_and_says_what_to_do(bench: Bench):
    swapped = bench.motion.measured.copy()
    right, left = [NAMES.index(f"RARM{i}") for i in range(1, 9)], [NAMES.index(f"LARM{i}") for i in range(1, 9)]
    swapped[:, right + left] = swapped[:, left + right]
    bench.player.positions = swapped
    bench.player.start()
    bench.record()
    answer = bench.call(FitSkeleton, profile_id="anna", activate=True, timeout=FIT)
    assert (answer.success, answer.error_code) == (False, ErrorCode.FIT_FAILED), answer.message
    assert any("swapped" in problem for problem in answer.problems)
    assert "swapped" in answer.message
    assert answer.profile.profile_id == ""
    assert bench.store.list() == ()
    assert bench.active_id() == ""


def test_killed_between_recording_and_fit_it_loses_no_stored_profile(bench: Bench):
    for name in ("anna", "bert"):
        bench.store.save(profile_of(name))
    assert bench.call(ActivateProfile, profile_id="bert").success
    bench.player.start()
    bench.record("carl", frames=100)
    bench.node.signal(signal.SIGKILL)
    bench.node.wait(5.0)
    bench.active.clear()
    bench.start()
    wait_for(lambda: bench.active_id() == "bert", FIRST_CONTACT, "the active profile to be told again")
    listed = bench.call(ListProfiles)
    assert [(info.profile_id, info.active) for info in listed.profiles] == [("anna", False), ("bert", True)]
    assert bench.call(FitSkeleton, profile_id="carl").error_code == ErrorCode.NOT_ENOUGH_DATA


def test_profiles_are_listed_activated_and_deleted_damaged_ones_too(bench: Bench):
    for name in ("anna", "bert"):
        bench.store.save(profile_of(name))
    (bench.store.directory / "bert.json").write_text("{")
    listed = {info.profile_id: info for info in bench.call(ListProfiles).profiles}
    assert listed["anna"].problem == ""
    assert "bert.json" in listed["bert"].problem
    assert bench.call(ActivateProfile, profile_id="bert").error_code == ErrorCode.BAD_MODEL
    answer = bench.call(ActivateProfile, profile_id="anna")
    assert answer.success
    assert answer.profile.person == "Anna Åström"
    assert answer.profile.lower_limits[2] == float("-inf")
    wait_for(lambda: bench.active_id() == "anna", ANSWER, "anna to be active")
    assert bench.call(DeleteProfile, profile_id="bert").success
    assert bench.call(DeleteProfile, profile_id="anna").success
    wait_for(lambda: bench.active_id() == "", ANSWER, "nobody to be active")
    assert not bench.active[-1].document
    bench.store.save(profile_of("anna"))
    assert bench.call(ActivateProfile, profile_id="anna").success
    assert bench.call(ActivateProfile, profile_id="").success
    wait_for(lambda: bench.active_id() == "", ANSWER, "nobody to be active")


def test_a_fit_can_be_cancelled_and_prompts_follow_calls(bench: Bench):
    bench.player.start()
    started = bench.call(StartRecording, profile_id="anna", motion="still")
    assert "still" in started.prompt
    for motion in ("elbow_flexion", "wrist_flexion"):
        answer = bench.call(StartRecording, profile_id="anna", motion=motion)
        assert answer.success, answer.message
        wait_for(lambda motion=motion: bench.progress[-1].motion == motion, ANSWER, f"prompt of {motion}")
    assert bench.call(FitSkeleton, profile_id="anna").error_code == ErrorCode.BUSY
    bench.player.moving.set()
    wait_for(lambda: bench.progress[-1].frames > FRAMES, 60.0, "frames")
    assert bench.call(StopRecording).success
    client = bench.graph.node.create_client(FitSkeleton, "calibration/fit")
    wait_for(client.service_is_ready, FIRST_CONTACT, "calibration/fit")
    future = client.call_async(FitSkeleton.Request(profile_id="anna"))
    wait_for(lambda: bench.progress[-1].phase == "fitting", ANSWER, "the fit to begin")
    assert bench.call(DiscardRecording).success
    wait_for(future.done, FIT, "the fit to end")
    assert future.result().error_code == ErrorCode.CANCELLED, future.result().message
    assert bench.store.list() == ()


def test_the_parameter_file_names_every_parameter_with_its_default():
    written = yaml.safe_load((REPOSITORY / "config" / "calibration_node.yaml").read_text())
    declared = {spec.name: spec.default for spec in calibration_node.PARAMETERS}
    assert written == {"calibration_node": {"ros__parameters": declared}}
    assert all(spec.description for spec in calibration_node.PARAMETERS)
