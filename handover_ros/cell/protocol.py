"""The protocol of one handover as a state machine without ROS (Bestick 2017, section 2.2, "Human Subjects Protocol").

Fetch the object while showing "Please wait", present it, show "Ready?", let go when the person has it (or after two
seconds, as in the dissertation), retract. Every phase can be cancelled and every failure has a code and a sentence.

The machine is stepped with what is observed and answers with commands; whoever steps it (the executive node, a test)
carries them out.
"""

from __future__ import annotations

import numpy as np

from handover_ros.cell.protocol_types import (
    Command,
    Follow,
    MoveGripper,
    Observation,
    Outcome,
    Phase,
    Plan,
    ProtocolSettings,
    ReleasePolicy,
    RequestPlan,
    RequestReturn,
    Show,
    Stage,
    Stop,
)
from handover_ros.errors import ErrorCode
from handover_ros.geometry import FloatArray

#: [m] a hand this near to the object holds it, as far as markers on the hand can tell.
HAND_NEAR = 0.30
#: [s] a command may take to reach the robot, in (possibly accelerated) ROS time, on a busy machine too. How far the arm
#: is off its path is judged all the same: a late arm is on it, an arm that something pushes is not.
COMMAND_DELAY = 1.5
#: [m] the gripper counts as open this far from the commanded opening.
OPENING_TOLERANCE = 0.004


class HandoverProtocol:
    """State machine of one handover.

    Args:
        object_name: For the messages.
        settings: Times and limits.
        now: [s] ROS time at the start.
    """

    def __init__(self, object_name: str, settings: ProtocolSettings, now: float) -> None:
        self.object_name = object_name
        self.settings = settings
        self.phase = Phase.PLANNING
        self.phase_start = now
        self.phases: list[tuple[Phase, float]] = []  # (phase, duration [s]) of the finished ones
        self.outcome: Outcome | None = None
        self.plan: Plan | None = None
        self.message = f"planning how to hand over {object_name}"
        self.release_time = float("nan")
        self._pending: list[Command] = [Show("Please wait"), RequestPlan()]
        self._queue: list[Stage] = []
        self._stage: Stage | None = None
        self._stage_start = now
        self._gripper_start: float | None = None
        self._pull_start: float | None = None
        self._holding = False
        self._release_height = float("nan")
        self._failure: Outcome | None = None
        self._felt_pull = False
        self._return_planned = False
        self._last_time = now

    @property
    def finished(self) -> bool:
        """Whether the handover has ended."""
        return self.phase is Phase.DONE

    @property
    def holding(self) -> bool:
        """Whether the robot holds the object, as far as the protocol knows."""
        return self._holding

    # Events from outside

    def plan_ready(self, plan: Plan) -> None:
        """Take the planner's answer."""
        if self.phase is not Phase.PLANNING:
            return
        self.plan = plan
        self._holding = plan.held
        self._enter(Phase.FETCHING, f"fetching {self.object_name} with the {plan.arm} arm")
        self._start_stages(plan.named("approach", "grasp", "lift"))

    def plan_failed(self, code: ErrorCode, message: str) -> None:
        """Take the planner's refusal: of the handover, or of the way back."""
        if self.phase is Phase.PLANNING:
            self._finish(Outcome(False, code, message, taken=False))
        elif self.phase is Phase.RETURNING:
            self._pending.append(Stop())
            failure = self._failure or Outcome(False, code, message, taken=False)
            self._finish(
                Outcome(False, failure.code, f"{failure.message}; and no way back was found: {message}", failure.taken)
            )

    def return_ready(self, stages: tuple[Stage, ...]) -> None:
        """Take the planner's way back."""
        if self.phase is Phase.RETURNING:
            self._return_planned = True
            self._start_stages(stages)

    def cancel(self) -> None:
        """End the handover: before the release the object goes back, after it the arm just retracts."""
        if self.phase in (Phase.RELEASING, Phase.RETRACTING, Phase.RETURNING, Phase.DONE):
            return
        self._fail(ErrorCode.CANCELLED, f"cancelled while {self.phase.value}")

    # Stepping

    def step(self, observation: Observation) -> list[Command]:
        """Advance to ``observation`` and return what to do now."""
        self._last_time = observation.time
        if not self.finished:
            if observation.trouble:
                self._halt(observation.trouble_code, observation.trouble)
            else:
                getattr(self, f"_step_{self.phase.value}")(observation)
        commands, self._pending = self._pending, []
        return commands

    def _step_planning(self, now: Observation) -> None:
        pass  # the planner answers through plan_ready or plan_failed; whoever asks bounds the wait

    def _step_fetching(self, now: Observation) -> None:
        stage = self._stage
        ended = self._advance(now)
        if stage is not None and stage.name == "grasp" and self._stage is not stage:
            if not now.gripping:
                self._fail(
                    ErrorCode.GRASP_FAILED,
                    f"the {self._arm} gripper closed and holds nothing: is {self.object_name} where it was seen?",
                )
                return
            self._holding = True
        elif self._holding and not now.gripping:
            self._lost_object()
        elif ended:
            assert self.plan is not None
            self._enter(Phase.PRESENTING, f"presenting {self.object_name}")
            self._start_stages(self.plan.named("present"))

    def _step_presenting(self, now: Observation) -> None:
        if not now.gripping:
            self._lost_object()
        elif self._advance(now):
            self._enter(Phase.WAITING, f"waiting for the person to take {self.object_name}")
            self._pending.append(Show("Ready?"))

    def _step_waiting(self, now: Observation) -> None:
        settings, waited = self.settings, now.time - self.phase_start
        if not now.gripping:
            # The person pulled it out of the closed fingers: theirs, if it does not fall.
            self._felt_pull = now.pulled or self._felt_pull
            self._release(now)
            return
        if not now.pulled:
            self._pull_start = None
        elif self._pull_start is None:
            self._pull_start = now.time
        felt = self._pull_start is not None and now.time - self._pull_start >= settings.pull_hold
        if felt and settings.release_policy is not ReleasePolicy.TIMER:
            self._felt_pull = True
            self._release(now)
        elif settings.release_policy is not ReleasePolicy.GRASP and waited >= settings.ready_time:
            self._felt_pull = felt
            self._release(now)
        elif waited >= settings.take_limit:
            self._fail(
                ErrorCode.NOT_TAKEN, f"nobody took {self.object_name} within {settings.take_limit:g} s; it went back"
            )

    def _step_releasing(self, now: Observation) -> None:
        if self._fell(now):
            self._dropped("when it was let go")
        elif self._advance(now):
            assert self.plan is not None
            self._holding = False
            self._enter(Phase.RETRACTING, "retracting")
            self._pending.append(Show("Thank you"))
            self._start_stages(self.plan.named("retract", "home"))

    def _step_retracting(self, now: Observation) -> None:
        if self._fell(now) and now.time - self.release_time <= self.settings.confirm_time:
            self._dropped("just after it was let go")
            return
        if self._advance(now) and now.time - self.release_time > self.settings.confirm_time:
            taken = self._felt_pull or now.hand_distance <= HAND_NEAR
            text = (
                f"the person has {self.object_name}"
                if taken
                else f"{self.object_name} was let go; nobody felt to take it"
            )
            self._finish(Outcome(True, ErrorCode.NONE, text, taken))

    def _step_returning(self, now: Observation) -> None:
        if not self._return_planned or not self._advance(now):
            return
        if self._holding:
            # The object is back in its place; now the empty arm goes home.
            self._holding = self._return_planned = False
            self._pending.append(RequestReturn(holding=False))
        else:
            assert self._failure is not None
            self._finish(self._failure)

    # Stages

    @property
    def _arm(self) -> str:
        return self.plan.arm if self.plan else "robot's"

    def _start_stages(self, stages: tuple[Stage, ...]) -> None:
        self._queue = list(stages)
        self._stage = None
        self._next_stage()

    def _next_stage(self) -> None:
        self._gripper_start = None
        self._stage = self._queue.pop(0) if self._queue else None
        self._stage_start = self._last_time
        if self._stage is not None and len(self._stage.times):
            self._pending.append(Follow(self._stage))

    def _advance(self, now: Observation) -> bool:
        """Advance the running stage; return whether all stages have ended."""
        stage = self._stage
        if stage is None:
            return True
        if len(stage.times) and self._gripper_start is None:
            elapsed = now.time - self._stage_start
            if elapsed < stage.duration:
                age = now.time - now.state_time if np.isfinite(now.state_time) else 0.0
                error = tracking_error(stage, elapsed - age, now.positions)
                if error > self.settings.tracking_limit:
                    self._halt(
                        ErrorCode.TRACKING_ERROR,
                        f"the {self._arm} arm is {error:.2f} rad off its trajectory in stage {stage.name}"
                        f" (limit {self.settings.tracking_limit:g}); stopped",
                    )
                return False
            error = float(np.max(np.abs(now.positions - stage.positions[-1])))
            if error > self.settings.goal_tolerance:
                if elapsed > stage.duration + self.settings.settle_time:
                    self._halt(
                        ErrorCode.TRACKING_ERROR,
                        f"the {self._arm} arm ended stage {stage.name} {error:.3f} rad from its goal"
                        f" (tolerance {self.settings.goal_tolerance:g}); stopped",
                    )
                return False
        if np.isfinite(stage.opening):
            if self._gripper_start is None:
                self._gripper_start = now.time
                self._pending.append(MoveGripper(stage.opening))
                return False
            closing = stage.name == "grasp"
            there = now.gripping if closing else now.opening >= stage.opening - OPENING_TOLERANCE
            if not there and now.time - self._gripper_start < self.settings.grip_time:
                return False
        self._next_stage()
        return self._stage is None

    # Transitions

    def _enter(self, phase: Phase, message: str) -> None:
        self.phases.append((self.phase, self._last_time - self.phase_start))
        self.phase, self.phase_start, self.message = phase, self._last_time, message

    def _finish(self, outcome: Outcome) -> None:
        self.outcome = outcome
        self._enter(Phase.DONE, outcome.message)
        if not outcome.success:
            self._pending.append(Show("Sorry"))

    def _release(self, now: Observation) -> None:
        assert self.plan is not None
        self.release_time = now.time
        self._release_height = now.object_height
        self._enter(Phase.RELEASING, f"letting go of {self.object_name}")
        self._start_stages((self.plan.release_stage(),))

    def _fail(self, code: ErrorCode, message: str, taken: bool = False) -> None:
        """End with a failure after the arm has gone back."""
        self._failure = Outcome(False, code, message, taken)
        if self.plan is None:
            self._finish(self._failure)
            return
        self._enter(Phase.RETURNING, f"{message}; going back")
        self._queue, self._stage, self._gripper_start = [], None, None
        self._pending += [Stop(), Show("Please wait")]
        if not self._holding:
            # Closed fingers that hold nothing may still be around something: never move away with them.
            self._pending.append(MoveGripper(self.plan.release_stage().opening))
        self._pending.append(RequestReturn(self._holding))

    def _halt(self, code: ErrorCode, message: str) -> None:
        """End with a failure at once, the robot stopped where it is."""
        self._pending.append(Stop())
        failure = self._failure
        if failure is not None:
            message = f"{failure.message}; then {message}"
            code = failure.code
        self._finish(Outcome(False, code, message, taken=False))

    def _lost_object(self) -> None:
        self._holding = False
        self._fail(ErrorCode.OBJECT_DROPPED, f"{self.object_name} slipped out of the {self._arm} gripper")

    def _dropped(self, when: str) -> None:
        self._holding = False
        self._fail(ErrorCode.OBJECT_DROPPED, f"{self.object_name} fell {when}: the person did not have it")

    def _fell(self, now: Observation) -> bool:
        return self._release_height - now.object_height > self.settings.fall_distance


def tracking_error(stage: Stage, elapsed: float, positions: FloatArray) -> float:
    """Return the largest joint error [rad] against the plan at ``elapsed`` [s] or up to ``COMMAND_DELAY`` before."""
    instants = elapsed - np.linspace(0.0, COMMAND_DELAY, 31)
    planned = np.stack([np.interp(instants, stage.times, column) for column in stage.positions.T], axis=1)
    return float(np.min(np.max(np.abs(positions - planned), axis=1)))
