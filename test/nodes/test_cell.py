"""The whole graph as real processes on an isolated domain: handovers, lost nodes, bad requests."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from cell_graph import HANDOVER, NODES, Cell
from graph import ANSWER, isolated_graph, wait_for
from handover_msgs.srv import PlanHandover, ResetSimulation, SetPersonBehaviour, SetSimulationFault

from handover_ros.errors import ErrorCode

pytestmark = pytest.mark.graph

REPORT = 2.0  # [s] within which a lost node must be reported
SLACK = 1.5  # [s] for the result to travel and this process to look, on a busy machine


@pytest.fixture
def cell(tmp_path: Path) -> Iterator[Cell]:
    with isolated_graph() as graph:
        yield Cell(graph, tmp_path)


def test_two_objects_end_in_the_persons_hand_and_bad_requests_leave_the_nodes_up(cell: Cell) -> None:
    cell.start(*NODES)
    for name in ("mug", "u_lock"):
        result = cell.result(cell.send(name))
        assert result.success, result.message
        assert result.taken
        assert cell.saw("taken", name)
        wait_for(lambda name=name: cell.saw("placed", name), HANDOVER, f"the {name} to be put down")
        assert list(result.phases) == ["planning", "fetching", "presenting", "waiting", "releasing", "retracting"]
        assert min(result.phase_durations) >= 0.0
        put_back = ResetSimulation.Request(seed=-1, objects_only=True)
        assert cell.graph.call(ResetSimulation, "sim/reset", put_back).success
    assert [event.message for event in cell.events if event.kind == "dropped"] == []
    truth = cell.truths[-1]
    assert (truth.joint_limit_violations, truth.velocity_limit_violations) == (0, 0)

    unknown = cell.result(cell.send("brick"))
    assert unknown.error_code == ErrorCode.UNKNOWN_NAME
    assert "mug" in unknown.message, "the message lists what there is"
    for request, code, words in (
        (PlanHandover.Request(object_name="mug", scheme="telepathy"), ErrorCode.UNKNOWN_NAME, "relative"),
        (PlanHandover.Request(object_name="mug", arm="third"), ErrorCode.UNKNOWN_NAME, "left"),
        (PlanHandover.Request(object_name="mug", time_budget=float("nan")), ErrorCode.BAD_REQUEST, "time_budget"),
    ):
        answer = cell.graph.call(PlanHandover, "planner/plan_handover", request)
        assert (answer.success, answer.error_code) == (False, code), answer.message
        assert words in answer.message
    for service, name, request in (
        (SetSimulationFault, "sim/set_fault", SetSimulationFault.Request(kind="earthquake")),
        (SetSimulationFault, "sim/set_fault", SetSimulationFault.Request(kind="occlusion", magnitude=float("nan"))),
        (SetPersonBehaviour, "sim/set_person", SetPersonBehaviour.Request(behaviour="juggle")),
    ):
        answer = cell.graph.call(service, name, request)
        assert not answer.success
        assert answer.message
    answer = cell.graph.call(ResetSimulation, "sim/reset", ResetSimulation.Request(seed=2, objects_only=False))
    assert answer.success, answer.message
    assert all(process.process.poll() is None for process in cell.processes.values())


def test_nobody_takes_it_then_somebody_drops_it(cell: Cell) -> None:
    cell.start(*NODES)
    call = cell.graph.call
    assert call(SetPersonBehaviour, "sim/set_person", SetPersonBehaviour.Request(behaviour="ignore")).success
    result = cell.result(cell.send("mug"))
    assert result.error_code == ErrorCode.NOT_TAKEN, result.message
    assert not cell.saw("dropped", "mug")
    assert call(SetPersonBehaviour, "sim/set_person", SetPersonBehaviour.Request(behaviour="drop")).success
    result = cell.result(cell.send("mug"))
    assert result.error_code == ErrorCode.OBJECT_DROPPED, result.message
    wait_for(lambda: cell.saw("dropped", "mug"), ANSWER, "the simulator to say that the mug fell")


@pytest.mark.parametrize(
    ("victim", "phase"),
    [
        ("mocap_node", "fetching"),
        ("skeleton_node", "presenting"),
        ("planner_node", "waiting"),
        ("sim_node", "presenting"),
        ("executive_node", "fetching"),
    ],
)
def test_a_killed_node_is_reported_the_robot_stops_and_after_a_restart_the_next_handover_succeeds(
    cell: Cell, victim: str, phase: str
) -> None:
    cell.start(*NODES)
    call = cell.graph.call
    assert call(SetPersonBehaviour, "sim/set_person", SetPersonBehaviour.Request(behaviour="ignore")).success
    handle = cell.send("mug")
    cell.reached(handle, phase)
    killed = cell.kill(victim)
    if victim != "executive_node":
        result = cell.result(handle, REPORT + SLACK)
        assert time.monotonic() - killed < REPORT + SLACK
        assert result.error_code in (ErrorCode.NODE_LOST, ErrorCode.STALE_DATA), result.message
    if victim != "sim_node":
        wait_for(cell.robot_stands_still, REPORT + SLACK, "the robot to stop")
    cell.start(victim)
    ignore = SetPersonBehaviour.Request(behaviour="ignore")
    assert call(SetPersonBehaviour, "sim/set_person", ignore).success
    handle = cell.send("mug")
    # The robot may hold the mug still, in reach: the person shall take it when it is presented, not before.
    cell.reached(handle, "waiting")
    assert call(SetPersonBehaviour, "sim/set_person", SetPersonBehaviour.Request(behaviour="take")).success
    result = cell.result(handle)
    assert result.success, result.message
    assert result.taken
    assert not cell.saw("dropped", "mug")
