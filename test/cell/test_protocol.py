"""The protocol, stepped against a robot and a person made of a few lines."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.cell.protocol import HandoverProtocol
from handover_ros.cell.protocol_types import (
    Follow,
    MoveGripper,
    Observation,
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

STEP = 0.02  # [s]
OPEN, CLOSED = 0.06, 0.03  # [m]


def move(name: str, start: float, end: float, opening: float = float("nan")) -> Stage:
    times = np.linspace(0.0, 1.0, 11)
    positions = np.linspace(start, end, 11)[:, None] * np.ones((1, 7))
    return Stage(name, times, positions, np.zeros_like(positions), opening)


def gripper(name: str, opening: float) -> Stage:
    return Stage(name, np.empty(0), np.empty((0, 0)), np.empty((0, 0)), opening)


PLAN = Plan(
    "left",
    tuple(f"j{n}" for n in range(7)),
    (
        move("approach", 0.0, 0.5, OPEN),
        gripper("grasp", 0.0),
        move("lift", 0.5, 0.6),
        move("present", 0.6, 1.0),
        move("retract", 1.0, 0.0),
    ),
)


@dataclass
class Cell:
    """A robot that follows perfectly, an object, a person who may take it."""

    protocol: HandoverProtocol
    time: float = 0.0
    trajectory: Stage | None = None
    trajectory_start: float = 0.0
    position: float = 0.0
    opening: float = CLOSED
    object_there: bool = True
    held: bool = False
    person_takes_after: float = 1.0
    in_hand: bool = False
    height: float = 0.8
    shown: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)
    stopped: int = 0
    trouble: str = ""
    lag: float = 0.0

    def observation(self) -> Observation:
        waiting = self.protocol.phase is Phase.WAITING
        pulled = waiting and self.time - self.protocol.phase_start > self.person_takes_after
        if self.protocol.phase in (Phase.WAITING, Phase.RELEASING) and pulled:
            self.in_hand = True
        if self.trajectory is not None:
            elapsed = self.time - self.trajectory_start - self.lag
            self.position = float(np.interp(elapsed, self.trajectory.times, self.trajectory.positions[:, 0]))
        return Observation(
            time=self.time,
            positions=np.full(7, self.position),
            velocities=np.zeros(7),
            gripping=self.held,
            opening=self.opening,
            pulled=pulled,
            object_height=self.height,
            trouble=self.trouble,
            trouble_code=ErrorCode.NODE_LOST if self.trouble else ErrorCode.NONE,
        )

    def run(self, until: float = 60.0, cancel_in: Phase | None = None) -> None:
        while not self.protocol.finished and self.time < until:
            if cancel_in is self.protocol.phase:
                self.protocol.cancel()
            for command in self.protocol.step(self.observation()):
                self.carry_out(command)
            self.time += STEP
            if not self.held and not self.in_hand and self.protocol.release_time > 0:
                self.height = max(0.0, self.height - 2.0 * STEP)

    def carry_out(self, command: object) -> None:
        match command:
            case RequestPlan():
                self.requests.append("plan")
                self.protocol.plan_ready(PLAN)
            case RequestReturn(holding):
                self.requests.append("put_back" if holding else "home")
                opening = OPEN if holding else float("nan")
                self.protocol.return_ready((move("return", self.position, 0.0, opening),))
            case Follow(stage):
                self.trajectory, self.trajectory_start = stage, self.time
            case MoveGripper(opening):
                self.opening = opening
                self.held = opening < CLOSED and self.object_there
            case Show(text):
                self.shown.append(text)
            case Stop():
                self.stopped += 1
                self.trajectory = None


def make(object_name: str = "mug", **arguments: object) -> Cell:
    chosen = {key: arguments.pop(key) for key in list(arguments) if key in ProtocolSettings.__annotations__}
    return Cell(HandoverProtocol(object_name, replace(ProtocolSettings(), **chosen), 0.0), **arguments)


def names(cell: Cell) -> list[str]:
    return [phase.value for phase, _ in cell.protocol.phases]


def test_a_handover_goes_through_all_phases_in_order_and_shows_the_texts():
    cell = make()
    cell.run()
    assert cell.protocol.outcome is not None
    assert cell.protocol.outcome.success
    assert cell.protocol.outcome.taken
    assert names(cell) == ["planning", "fetching", "presenting", "waiting", "releasing", "retracting"]
    assert cell.shown == ["Please wait", "Ready?", "Thank you"]
    durations = [duration for _, duration in cell.protocol.phases]
    assert sum(durations) == pytest.approx(cell.time - STEP, abs=2 * STEP)
    assert not cell.held


def test_the_object_is_held_until_the_pull_lasted_long_enough():
    cell = make(person_takes_after=2.0, pull_hold=0.3)
    cell.run()
    waiting = dict(cell.protocol.phases)[Phase.WAITING]
    assert 2.3 - STEP <= waiting <= 2.3 + 3 * STEP


def test_timer_policy_lets_go_after_two_seconds_as_in_the_dissertation():
    cell = make(release_policy=ReleasePolicy.TIMER, person_takes_after=0.5)
    cell.run()
    assert cell.protocol.outcome.success
    assert dict(cell.protocol.phases)[Phase.WAITING] == pytest.approx(2.0, abs=2 * STEP)


def test_timer_policy_reports_a_drop_when_nobody_holds_the_object():
    cell = make(release_policy=ReleasePolicy.TIMER, person_takes_after=1e9)
    cell.run()
    assert cell.protocol.outcome.code is ErrorCode.OBJECT_DROPPED
    assert not cell.protocol.outcome.taken
    assert cell.requests[-1] == "home"


def test_nobody_takes_it_so_it_goes_back_and_the_arm_goes_home():
    cell = make(person_takes_after=1e9, take_limit=3.0)
    cell.run()
    assert cell.protocol.outcome.code is ErrorCode.NOT_TAKEN
    assert "mug" in cell.protocol.outcome.message
    assert cell.requests == ["plan", "put_back", "home"]
    assert not cell.held


def test_closing_on_nothing_fails_and_returns_home():
    cell = make(object_there=False)
    cell.run()
    assert cell.protocol.outcome.code is ErrorCode.GRASP_FAILED
    assert cell.requests == ["plan", "home"]


@pytest.mark.parametrize("phase", [Phase.PLANNING, Phase.FETCHING, Phase.PRESENTING, Phase.WAITING])
def test_cancel_before_the_release_ends_cancelled_with_nothing_in_the_gripper(phase):
    cell = make(person_takes_after=1e9)
    if phase is Phase.PLANNING:
        cell.protocol.cancel()
        cell.run()
    else:
        cell.run(cancel_in=phase)
    assert cell.protocol.outcome.code is ErrorCode.CANCELLED
    assert not cell.held


@pytest.mark.parametrize("phase", [Phase.RELEASING, Phase.RETRACTING])
def test_cancel_after_the_release_lets_the_arm_retract(phase):
    cell = make()
    cell.run(cancel_in=phase)
    assert cell.protocol.outcome.success
    assert cell.protocol.outcome.taken


@given(at=st.floats(0.0, 8.0))
@settings(max_examples=60, deadline=None)
def test_trouble_at_any_time_stops_the_robot_and_ends_at_once(at):
    cell = make()
    cell.run(until=at)
    if cell.protocol.finished:
        return
    cell.trouble = "lost planner_node"
    before = cell.stopped
    cell.run(until=at + 10 * STEP)
    assert cell.protocol.finished
    assert cell.protocol.outcome.code is ErrorCode.NODE_LOST
    assert cell.stopped == before + 1


def test_a_robot_that_does_not_follow_is_stopped():
    cell = make(lag=5.0)
    cell.run()
    assert cell.protocol.outcome.code is ErrorCode.TRACKING_ERROR
    assert "approach" in cell.protocol.outcome.message
    assert cell.stopped


def test_a_planner_that_refuses_ends_the_handover_with_its_words():
    protocol = HandoverProtocol("mug", ProtocolSettings(), 0.0)
    protocol.step(Observation(time=0.0))
    protocol.plan_failed(ErrorCode.NOT_REACHABLE, "mug: 12 of 12 poses out of reach")
    assert protocol.finished
    assert protocol.outcome.message == "mug: 12 of 12 poses out of reach"


def test_a_plan_for_a_held_object_skips_the_fetching():
    protocol = HandoverProtocol("mug", ProtocolSettings(), 0.0)
    protocol.step(Observation(time=0.0))
    protocol.plan_ready(replace(PLAN, stages=(move("present", 0.0, 1.0), move("retract", 1.0, 0.0)), held=True))
    protocol.step(Observation(time=0.0, positions=np.zeros(7), velocities=np.zeros(7), gripping=True))
    assert protocol.phase is Phase.PRESENTING
    assert protocol.holding
