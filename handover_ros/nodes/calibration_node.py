"""``calibration_node``: records calibration motions, fits a person's skeleton, keeps the profiles."""

from __future__ import annotations

import threading
from pathlib import Path

from handover_msgs.msg import ActiveProfile, CalibrationProgress, MarkerFrame, MarkerSet
from handover_msgs.srv import (
    ActivateProfile,
    DeleteProfile,
    DiscardRecording,
    FitSkeleton,
    ListProfiles,
    StartRecording,
    StopRecording,
)
from rclpy.callback_groups import ReentrantCallbackGroup

from handover_ros.cell.calibration_session import (
    CalibrationSession,
    RecordedMotion,
    chosen_template,
    fit_profile,
    require_usable,
)
from handover_ros.cell.store import ProfileStore
from handover_ros.errors import BadRequestError, ErrorCode, HandoverError, StaleDataError
from handover_ros.mocap.frames import check_rate
from handover_ros.mocap.marker_sets import load_marker_set
from handover_ros.nodes.convert_profile import active_profile_message, profile_info, stored_profile_info
from handover_ros.nodes.parameters import ParameterSpec
from handover_ros.nodes.runtime import (
    LATCHED,
    POLL_PERIOD,
    RECORDER,
    SENSOR_PUBLISHER,
    HandoverNode,
    Worker,
    main_of,
    monotonic,
)
from handover_ros.nodes.streams import StreamReader
from handover_ros.skeleton.calibration import CalibrationSettings
from handover_ros.skeleton.calibration_report import CalibrationReport
from handover_ros.skeleton.profile import Profile, safe_profile_id
from handover_ros.skeleton.prompts import FINISHED, prompt_of
from handover_ros.skeleton.templates import load_template
from handover_ros.skeleton.warm_up import warm_up_calibration

IDLE, RECORDING, FITTING, DONE, FAILED = "idle", "recording", "fitting", "done", "failed"
PROGRESS_PERIOD = 0.2  # [s] of wall time
FIRST_DATA = 3.0  # [s] of wall time the names of the markers may take to come in
FIRST_FRAME = 5.0  # [s] of wall time until a recording has its first frame; discovery takes up to 3 s
SILENT_AFTER = 1.0  # [s] of wall time without frames until a recording says so
NAN = float("nan")
DEFAULTS = CalibrationSettings()

PARAMETERS = (
    ParameterSpec("profile_directory", "", "folder of profiles; empty: $HANDOVER_PROFILES, or the user's data folder"),
    ParameterSpec("marker_set", "", "marker set with the torso's definition; empty: the one mocap/marker_set names"),
    ParameterSpec("template", "", "skeleton in config/skeletons for requests that name none; empty: the one that fits"),
    ParameterSpec("motion_time", 13.0, "[s] each motion is prompted when all are recorded in order", 1.0, 600.0),
    ParameterSpec("record_limit", 1200.0, "[s] longest recording of one profile, all motions together", 10.0, 7200.0),
    ParameterSpec("max_frames", DEFAULTS.max_frames, "frames that enter the fit, spread evenly", 100, 20000),
    ParameterSpec("holdout", DEFAULTS.holdout, "share of the time left out of the fit to measure its error", 0.0, 0.5),
    ParameterSpec("seed", DEFAULTS.seed, "of the fit's random starts", 0, 2**31 - 1),
)


class CalibrationNode(HandoverNode):
    """Serves ``calibration/...``; publishes ``calibration/progress`` and ``calibration/active_profile``."""

    niceness = 10

    def __init__(self) -> None:
        super().__init__("calibration_node", PARAMETERS)
        if self.parameters["marker_set"]:
            load_marker_set(self.parameters["marker_set"])
        if self.parameters["template"]:
            load_template(self.parameters["template"])
        directory = self.parameters["profile_directory"]
        self.store = ProfileStore(Path(directory).expanduser() if directory else None)
        self.settings = CalibrationSettings(
            max_frames=self.parameters["max_frames"], holdout=self.parameters["holdout"], seed=self.parameters["seed"]
        )
        self.motion_time = self.parameters["motion_time"]
        self.marker_set: MarkerSet | None = None
        self.session: CalibrationSession | None = None
        self.stream: StreamReader | None = None
        self.phase, self.sentence = IDLE, ""
        self.fit_progress = (0.0, NAN)
        self.cancelled = threading.Event()
        self.last_frame = monotonic()
        self.fits, self.active_id = 0, ""

        warm_up_calibration()
        self.worker = Worker(self)
        self.progress_publisher = self.create_publisher(CalibrationProgress, "calibration/progress", SENSOR_PUBLISHER)
        self.active_publisher = self.create_publisher(ActiveProfile, "calibration/active_profile", LATCHED)
        self.create_subscription(MarkerSet, "mocap/marker_set", self.on_marker_set, LATCHED)
        self.create_timer(PROGRESS_PERIOD, self.on_timer, clock=self.steady_clock)
        # Reentrant: a request that waits (for frames, for the fit) holds up no other.
        group = ReentrantCallbackGroup()
        for service, name, work in (
            (StartRecording, "start_recording", self.start_recording),
            (StopRecording, "stop_recording", self.stop_recording),
            (DiscardRecording, "discard_recording", self.discard_recording),
            (FitSkeleton, "fit", self.fit),
            (ListProfiles, "list_profiles", self.list_profiles),
            (ActivateProfile, "activate_profile", self.activate_profile),
            (DeleteProfile, "delete_profile", self.delete_profile),
        ):
            self.serve(service, f"calibration/{name}", work, group)
        self.publish_active()
        self.ready(f"{len(self.known_names())} profiles in {self.store.directory}")

    def known_names(self) -> tuple[str, ...]:
        """Return the names of the stored profiles; none where the store cannot be read, which a request would tell."""
        try:
            return self.store.names()
        except HandoverError as error:
            self.last_problem = str(error)
            return ()

    def on_stop(self) -> None:
        """End what runs."""
        self.cancelled.set()
        self.end_stream()

    # Marker frames

    def on_marker_set(self, message: MarkerSet) -> None:
        """Keep the names of the stream; other names end a recording."""
        before, self.marker_set = self.marker_set, message
        changed = before is not None and list(before.marker_names) != list(message.marker_names)
        if self.phase == RECORDING and changed:
            self.end_recording()
            self.say(FAILED, "mocap/marker_set names other markers now, so the recording ended")

    def on_markers(self, message: MarkerFrame) -> None:
        """Record one frame; runs in the stream's thread."""
        session = self.session
        if session is not None and self.marker_set is not None and message.set_version == self.marker_set.version:
            session.add(message.positions, message.status, message.device_frame)
            self.last_frame = monotonic()

    def end_stream(self) -> None:
        """Receive no more frames."""
        stream, self.stream = self.stream, None
        if stream is not None:
            stream.stop()

    # Recording

    async def start_recording(self, request: StartRecording.Request, response: StartRecording.Response) -> None:
        """Start to record, or change the prompt of a recording; answer when the first frame has come."""
        safe_profile_id(request.profile_id)
        await self.until_marker_set()
        self.refuse_while_fitting()
        session = self.session
        if self.phase == RECORDING:
            assert session is not None
            if request.profile_id != session.profile_id:
                raise HandoverError(
                    f"profile {session.profile_id!r} is being recorded; call calibration/stop_recording first",
                    ErrorCode.BUSY,
                )
            if not session.current_frames:
                raise HandoverError("the recording is just starting; call again in a moment", ErrorCode.BUSY)
            session.prompt_next(request.motion)
        else:
            session = self.session_for(request)
            session.begin(request.motion)
            self.session = session
            self.say(RECORDING, "")
            await self.first_frame(session)
        prompt = session.prompt(self.motion_time)
        response.prompt = prompt.text if prompt else FINISHED
        response.success, response.message = True, f"recording {request.motion or 'all motions in order'}"
        self.publish_progress()

    async def until_marker_set(self) -> None:
        """Give a node that just started a moment to hear of the markers."""
        for _ in range(round(FIRST_DATA / POLL_PERIOD)):
            if self.marker_set is not None:
                return
            await self.pause(POLL_PERIOD)

    def session_for(self, request: StartRecording.Request) -> CalibrationSession:
        """Return the session of a request: the present one, which the recording adds to, or a new one."""
        if request.motion:
            prompt_of(request.motion)
        stream = self.marker_set
        if stream is None:
            raise StaleDataError("mocap/marker_set has not come yet: is mocap_node running?")
        names, segments = tuple(stream.marker_names), tuple(stream.segment_names)
        present = self.session
        if present is not None and present.frames:
            if present.profile_id != request.profile_id:
                raise HandoverError(
                    f"{present.frames} frames of profile {present.profile_id!r} are not fitted yet; call "
                    "calibration/fit or calibration/discard_recording first",
                    ErrorCode.BUSY,
                )
            if present.names != names:
                raise BadRequestError(
                    f"the markers are others than in the recordings of {present.profile_id!r}; call "
                    "calibration/discard_recording and begin anew"
                )
            if request.skeleton_template not in ("", present.template.name):
                raise BadRequestError(
                    f"skeleton_template: {present.profile_id!r} is being recorded for {present.template.name!r}; call "
                    "calibration/discard_recording to change it"
                )
            if present.full:
                raise BadRequestError(
                    f"{present.frames} frames of {present.profile_id!r} are recorded, which is the limit; call "
                    "calibration/fit or calibration/discard_recording"
                )
            present.person = request.person or present.person
            return present
        return CalibrationSession(
            request.profile_id,
            request.person,
            chosen_template(request.skeleton_template or self.parameters["template"], segments),
            self.parameters["marker_set"] or stream.name,
            names,
            segments,
            check_rate(Path("mocap/marker_set"), "rate", stream.rate),
            self.parameters["record_limit"],
        )

    async def first_frame(self, session: CalibrationSession) -> None:
        """Receive marker frames and wait for the first one.

        Raises:
            StaleDataError: None came.
        """
        load_marker_set(session.marker_set)
        self.last_frame = monotonic()
        self.stream = StreamReader(self, MarkerFrame, "mocap/markers", self.on_markers, RECORDER)
        for _ in range(round(FIRST_FRAME / POLL_PERIOD)):
            if self.phase != RECORDING:
                raise HandoverError("the recording was ended before it began", ErrorCode.CANCELLED)
            if session.current_frames:
                return
            await self.pause(POLL_PERIOD)
        self.end_stream()
        self.session = session if session.frames else None
        problem = f"no usable frames on mocap/markers within {FIRST_FRAME:g} s: is mocap_node running?"
        self.say(FAILED, problem)
        raise StaleDataError(problem)

    async def stop_recording(self, _: StopRecording.Request, response: StopRecording.Response) -> None:
        """End the recording and say what it holds."""
        if self.phase != RECORDING or self.session is None:
            raise BadRequestError("nothing is being recorded; call calibration/start_recording first")
        recorded = self.end_recording()
        response.frames, response.total_frames = recorded.frames, self.session.frames
        response.lost_frames = min(recorded.lost_frames, 2**32 - 1)
        response.missing_fraction = recorded.missing_fraction
        response.success = True
        response.message = (
            f"{recorded.frames} frames of {recorded.motion or 'all motions'}, "
            f"{100.0 * recorded.missing_fraction:.1f} % of the marker samples missing"
        )
        self.say(IDLE, response.message)

    def end_recording(self) -> RecordedMotion:
        """Receive no more frames and keep what was recorded."""
        assert self.session is not None
        self.end_stream()
        return self.session.end()

    async def discard_recording(self, request: DiscardRecording.Request, response: DiscardRecording.Response) -> None:
        """Throw away what is not fitted; end a running recording or fit."""
        session = self.session
        if request.profile_id:
            safe_profile_id(request.profile_id)
        if session is None or request.profile_id not in ("", session.profile_id):
            raise BadRequestError(f"nothing is recorded for profile {request.profile_id!r}")
        response.frames = session.frames
        self.end_stream()
        if self.phase == FITTING:
            self.cancelled.set()  # the fit's own request answers and changes the phase
        else:
            self.say(IDLE, "")
        self.session = None
        response.success, response.message = True, f"{response.frames} frames of {session.profile_id!r} thrown away"

    # Fitting

    async def fit(self, request: FitSkeleton.Request, response: FitSkeleton.Response) -> None:
        """Fit in the worker thread; store the profile when the fit may be used."""
        response.fit_rms = response.heldout_mean = NAN
        response.profile.fit_rms = response.profile.heldout_mean = NAN
        if request.profile_id:
            safe_profile_id(request.profile_id)
        self.refuse_while_fitting()
        if self.phase == RECORDING:
            raise HandoverError("still recording; call calibration/stop_recording first", ErrorCode.BUSY)
        session = self.session
        if session is None or request.profile_id not in ("", session.profile_id):
            raise HandoverError(
                f"nothing was recorded for profile {request.profile_id!r}; call calibration/start_recording first",
                ErrorCode.NOT_ENOUGH_DATA,
            )
        self.cancelled.clear()
        self.fit_progress = (0.0, NAN)
        self.say(FITTING, "")
        try:
            profile, report = await self.worker.submit(self.work_on_fit, session)
            fill_report(response, report)
            self.fit_progress = (1.0, report.fit_rms)
            if self.cancelled.is_set():
                raise HandoverError("the fit was cancelled", ErrorCode.CANCELLED)
            require_usable(report)
            self.store.save(profile)
            self.fits, self.session = self.fits + 1, None
            if request.activate:
                self.store.activate(profile.profile_id)
        except Exception as error:
            self.say(FAILED, str(error))
            raise
        finally:
            self.publish_active()
        response.profile = profile_info(profile, self.active_id == profile.profile_id)
        response.success = True
        response.message = f"fitted to {1e3 * report.fit_rms:.1f} mm rms; stored as {profile.profile_id!r}"
        self.say(DONE, response.message)

    def work_on_fit(self, session: CalibrationSession) -> tuple[Profile, CalibrationReport]:
        """Return the profile fitted to a session; runs in the worker thread."""
        return fit_profile(
            session.recording(),
            session.template,
            load_marker_set(session.marker_set),
            session.profile_id,
            session.person,
            session.source,
            self.settings,
            self.on_fit_progress,
        )

    def on_fit_progress(self, fraction: float, rms: float) -> None:
        """Keep how far the fit is; end it when it is not wanted any more. Runs in the worker thread."""
        if self.cancelled.is_set():
            raise HandoverError("the fit was cancelled", ErrorCode.CANCELLED)
        self.fit_progress = (float(fraction), float(rms))

    def refuse_while_fitting(self) -> None:
        """Raise while a fit runs."""
        if self.phase == FITTING:
            raise HandoverError(
                "a fit is running; wait for it, or end it with calibration/discard_recording", ErrorCode.BUSY
            )

    # Stored profiles

    async def list_profiles(self, _: ListProfiles.Request, response: ListProfiles.Response) -> None:
        """List the stored profiles."""
        stored = self.store.list()
        response.profiles = [stored_profile_info(each) for each in stored]
        damaged = sum(each.profile is None for each in stored)
        response.success = True
        response.message = f"{len(stored)} profiles" + (f", {damaged} of them damaged" if damaged else "")

    async def activate_profile(self, request: ActivateProfile.Request, response: ActivateProfile.Response) -> None:
        """Make a stored profile the active one, or none."""
        response.profile.fit_rms = response.profile.heldout_mean = NAN
        if request.profile_id:
            response.profile = profile_info(self.store.activate(request.profile_id), True)
        else:
            self.store.deactivate()
        self.publish_active()
        response.success = True
        response.message = f"profile {request.profile_id!r} is active" if request.profile_id else "no profile is active"

    async def delete_profile(self, request: DeleteProfile.Request, response: DeleteProfile.Response) -> None:
        """Delete a stored profile."""
        self.store.delete(request.profile_id)
        self.publish_active()
        response.success, response.message = True, f"profile {request.profile_id!r} is deleted"

    def publish_active(self) -> None:
        """Tell everybody which profile is active; a damaged one counts as none."""
        try:
            profile = self.store.active()
        except HandoverError as error:
            profile, self.last_problem = None, str(error)
        message = active_profile_message(profile)
        message.header.stamp = self.get_clock().now().to_msg()
        self.active_publisher.publish(message)
        self.active_id = profile.profile_id if profile else ""

    # What it is doing

    def say(self, phase: str, sentence: str) -> None:
        """Change the phase and tell it."""
        self.phase, self.sentence = phase, sentence
        if phase == FAILED:
            self.last_problem = sentence
        self.publish_progress()

    def on_timer(self) -> None:
        """Tell the progress; end a recording that reached its limit."""
        session = self.session
        if self.phase == RECORDING and session is not None and session.full:
            self.end_recording()
            self.say(FAILED, f"the recording ended at its limit of {session.frames} frames; call calibration/fit")
        elif self.phase in (RECORDING, FITTING):
            self.publish_progress()

    def publish_progress(self) -> None:
        """Publish phase, prompt and progress."""
        session = self.session
        message = CalibrationProgress(phase=self.phase, prompt=self.sentence, rms=NAN)
        message.header.stamp = self.get_clock().now().to_msg()
        if session is not None:
            message.profile_id, message.frames = session.profile_id, session.frames
        if self.phase == RECORDING and session is not None:
            prompt = session.prompt(self.motion_time)
            message.motion, message.prompt = (prompt.name, prompt.text) if prompt else ("", FINISHED)
            message.fraction = session.fraction(self.motion_time)
        elif self.phase == FITTING:
            message.fraction, message.rms = self.fit_progress
        elif self.phase in (DONE, FAILED):
            message.fraction = 1.0
            message.rms = self.fit_progress[1]
        self.progress_publisher.publish(message)

    def diagnose(self) -> tuple[bool, str, dict[str, object]]:
        """Report what is recorded, stored and active."""
        session, silence = self.session, monotonic() - self.last_frame
        values: dict[str, object] = {
            "phase": self.phase,
            "profile": session.profile_id if session else "",
            "frames": session.frames if session else 0,
            "bad_frames": session.bad_frames if session else 0,
            "active": self.active_id,
            "fits": self.fits,
            "last_problem": self.last_problem,
        }
        if self.phase == RECORDING and silence > SILENT_AFTER:
            return False, f"recording, but no marker frames for {silence:.1f} s", values
        return True, self.phase, values


def fill_report(response: FitSkeleton.Response, report: CalibrationReport) -> None:
    """Write a report's figures and sentences into the answer."""
    response.frames = report.frames
    response.fit_rms, response.heldout_mean = float(report.fit_rms), float(report.heldout_mean)
    response.seconds = float(report.seconds)
    response.problems, response.advice = list(report.problems), list(report.advice)


main = main_of(CalibrationNode)

if __name__ == "__main__":
    main()
