"""The handovers of a bag, put together from what the executive said of the cell's state."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from handover_ros.bags.timeline_types import Event, HandoverSpan, PhaseSpan

IDLE, DONE = "idle", "done"


@dataclass
class _Phase:
    """A phase and when it began: in the bag [s], by its stamp [s]."""

    name: str
    begin: float
    stamp: float


@dataclass
class _Run:
    """A handover under way."""

    handover_id: str
    object_name: str
    begin: float
    finished: int  # handovers that the executive had finished before
    taken_before: int
    message: str = ""
    phases: list[_Phase] = field(default_factory=list)
    plan: Any = None
    plan_id: str = ""


class Handovers:
    """Takes in the cell's states and gives the handovers.

    Args:
        most: How many handovers are kept.

    Attributes:
        left_out: How many are not.
    """

    def __init__(self, most: int) -> None:
        self.left_out = 0
        self._most = most
        self._run: _Run | None = None
        self._spans: list[HandoverSpan] = []
        self._plans: dict[str, Any] = {}  # by plan_id, the newest few
        self._last_plan: Any = None

    def take_state(self, seconds: float, state: Any) -> None:
        """Take in a state of the cell at a time [s]."""
        stamp = state.header.stamp.sec + state.header.stamp.nanosec * 1e-9
        run = self._run
        if run is not None and state.handover_id != run.handover_id:
            self._close(run, seconds, stamp, state)
            run = self._run = None
        if state.phase == IDLE or not state.handover_id:
            return
        if run is None:
            run = self._run = _Run(
                state.handover_id, state.object_name, seconds, int(state.handovers), int(state.taken)
            )
        run.message = state.message
        if not run.phases or run.phases[-1].name != state.phase:
            run.phases.append(_Phase(state.phase, seconds, stamp))

    def take_plan(self, seconds: float, plan: Any) -> None:
        """Take in a plan; it belongs to the handover of its object that is being planned."""
        del seconds
        told = _Plan(plan.plan_id, plan.object_name, plan.scheme, plan.arm, float(plan.planning_time))
        self._plans[told.plan_id] = self._last_plan = told
        if len(self._plans) > 16:
            self._plans.pop(next(iter(self._plans)))
        run = self._run
        if run is not None and run.object_name == told.object_name and len(run.phases) <= 2 and run.plan is None:
            run.plan = told

    def take_answer(self, choice: Any) -> None:
        """Take in how an object was taken, which names the plan."""
        plan = self._plans.get(choice.plan_id)
        if plan is None:
            return
        if self._run is not None and self._run.handover_id == choice.handover_id:
            self._run.plan = plan
        for number in range(len(self._spans) - 1, max(-1, len(self._spans) - 4), -1):
            if self._spans[number].handover_id == choice.handover_id:
                self._spans[number] = _with_plan(self._spans[number], plan)

    def closed(self, duration: float, events: Sequence[Event] | None) -> tuple[HandoverSpan, ...]:
        """Return all handovers.

        Args:
            duration: Of the bag [s]; a handover under way ends there.
            events: Of the simulation, in order, or None: they were not recorded.
        """
        if self._run is not None:
            self._close(self._run, duration, math.nan, None)
            self._run = None
        if events is None:
            return tuple(self._spans)
        limits = [*(span.begin for span in self._spans), math.inf]
        places = [bisect_left(events, limit, key=lambda event: event.time) for limit in limits]
        return tuple(
            _judged(span, events[first:last])
            for span, first, last in zip(self._spans, places, places[1:], strict=False)
        )

    def _close(self, run: _Run, seconds: float, stamp: float, state: Any) -> None:
        """Note a handover; ``state``: that after it, None when the bag ends."""
        if len(self._spans) >= self._most:
            self.left_out += 1
            return
        done = run.phases[-1] if run.phases[-1].name == DONE else None
        ends = [*run.phases[1:], _Phase(IDLE, seconds, stamp)]
        phases = tuple(_span(begin, end) for begin, end in zip(run.phases, ends) if begin.name != DONE)
        message, taken = run.message, None
        if state is not None:
            counted = int(state.handovers) > run.finished
            taken = int(state.taken) > run.taken_before if counted else None
            message = run.message if counted else "broken off: the executive was started again"
        span = HandoverSpan(
            number=len(self._spans) + self.left_out + 1,
            handover_id=run.handover_id,
            object_name=run.object_name,
            begin=run.begin,
            end=done.begin if done else seconds,
            phases=phases,
            ended=state is not None or done is not None,
            taken=taken,
            placed=None,
            dropped=False,
            message=message,
        )
        self._spans.append(span if run.plan is None else _with_plan(span, run.plan))


@dataclass(frozen=True)
class _Plan:
    """What counts of a plan."""

    plan_id: str
    object_name: str
    scheme: str
    arm: str
    planning_time: float


def _with_plan(span: HandoverSpan, plan: _Plan) -> HandoverSpan:
    return replace(span, scheme=plan.scheme, arm=plan.arm, planning_time=plan.planning_time)


def _span(begin: _Phase, end: _Phase) -> PhaseSpan:
    """Return a phase; a stamp of zero is none."""
    stamped = begin.stamp > 0.0 and end.stamp >= begin.stamp
    return PhaseSpan(
        begin.name, begin.begin, end.begin, end.stamp - begin.stamp if stamped else end.begin - begin.begin
    )


def _judged(span: HandoverSpan, events: Sequence[Event]) -> HandoverSpan:
    """Return a handover with what the simulation says of its object, from its begin to that of the next one."""
    kinds = {event.kind for event in events if event.object_name == span.object_name}
    return replace(span, placed="placed" in kinds, dropped="dropped" in kinds)
