"""The loop closed in the real graph: menu, handover, the choice seen through markers, belief."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from cell_graph import HANDOVER, NODES, Cell
from graph import ANSWER, Graph, isolated_graph, wait_for
from handover_msgs.action import ExecuteHandover
from handover_msgs.msg import ActiveProfile, BeliefSummary, SimulationTruth
from handover_msgs.srv import SelectQuery
from profiles import report_of

from handover_ros.errors import ErrorCode
from handover_ros.nodes.convert import seconds_from_stamp
from handover_ros.nodes.convert_profile import active_profile_message
from handover_ros.nodes.runtime import LATCHED, SENSOR_CONSUMER
from handover_ros.sim.person_skeleton import skeleton_of
from handover_ros.sim.person_spec import load_person
from handover_ros.skeleton.profile import Profile

pytestmark = pytest.mark.graph

SKELETON = skeleton_of(load_person("adult"))
OBJECTS = ("mug", "u_lock")
TRIES = 5  # offers whose way may be blocked
NO_WAY = (ErrorCode.NO_PATH, ErrorCode.NOT_REACHABLE, ErrorCode.IN_COLLISION)
WORST = 0.15  # [rad] of a tracked joint
SELECTING = 90.0  # [s] of wall time on a busy machine


class LearningCell(Cell):
    """The graph with a known person and a learner."""

    def __init__(self, graph: Graph, folder: Path) -> None:
        super().__init__(graph, folder)
        self.own["sim_node"] |= {"scene": "learning"}
        self.own["planner_node"] = {"use_sim_time": True, "scene": "learning"}
        self.own["preference_node"] = {
            "use_sim_time": True,
            "profile_directory": str(folder / "profiles"),
            "particles": 500,
        }
        self.beliefs: list[BeliefSummary] = graph.collect(BeliefSummary, "preferences/belief", LATCHED)
        self.every_truth: list[SimulationTruth] = graph.collect(SimulationTruth, "sim/truth", SENSOR_CONSUMER)
        profile = Profile("p", "P", "2026-01-01T00:00:00Z", "simulated", "upper_body", SKELETON, report_of(SKELETON))
        publisher = graph.node.create_publisher(ActiveProfile, "calibration/active_profile", LATCHED)
        publisher.publish(active_profile_message(profile))

    def select(self, menu: list) -> SelectQuery.Response:
        """Return which handover to make."""
        request = SelectQuery.Request(strategy="active", object_names=list(OBJECTS), count=4, menu=menu)
        answer = self.graph.call(SelectQuery, "preferences/select_query", request, SELECTING)
        assert answer.success, answer.message
        return answer

    def make(self, selected: SelectQuery.Response) -> ExecuteHandover.Result:
        """Return the result of making the chosen handover."""
        goal = ExecuteHandover.Goal(object_name=selected.plan.object_name, has_offer=True, offer=selected.plan)
        sent = self.graph.on_executor(self.client.send_goal_async, goal)
        return self.result(wait_for(lambda: sent.done() and sent.result(), ANSWER, "the goal to be accepted"))


@pytest.fixture
def cell(tmp_path: Path) -> Iterator[LearningCell]:
    with isolated_graph() as graph:
        yield LearningCell(graph, tmp_path)


def test_a_handover_of_a_menu_teaches_what_the_person_chose_as_markers_show_it(cell: LearningCell) -> None:
    cell.start(*NODES, "preference_node")
    wait_for(lambda: cell.beliefs and cell.beliefs[-1].profile_id == "p", ANSWER, "a belief about the person")
    assert cell.beliefs[-1].observations == 0
    before = cell.beliefs[-1].entropy
    selected = cell.select([])
    assert {plan.object_name for plan in selected.menu} == set(OBJECTS)
    for _ in range(TRIES):
        result = cell.make(selected)
        if result.success or result.error_code not in map(int, NO_WAY):
            break
        selected = cell.select([plan for plan in selected.menu if plan.plan_id != selected.plan.plan_id])
    assert result.success, result.message
    assert result.taken

    choice, name = result.choice, selected.plan.object_name
    taken = next(event for event in cell.events if event.kind == "taken" and event.object_name == name)
    assert choice.grasp_region, "the region is seen"
    assert choice.grasp_region in taken.message, "and it is the one the simulated person took"
    moment = seconds_from_stamp(choice.header.stamp)
    truth = min(cell.every_truth, key=lambda each: abs(seconds_from_stamp(each.header.stamp) - moment))
    assert truth.holders[list(truth.object_names).index(name)].endswith(f"person:{choice.hand}")
    true = dict(zip(truth.joint_names, truth.displacements))
    tracked = dict(zip(choice.joint_names, choice.displacements))
    assert len(tracked) == 7
    apart = np.array([tracked[joint] - true[f"{choice.hand}_{joint}"] for joint in tracked])
    assert np.abs(apart).max() < WORST

    wait_for(lambda: cell.beliefs[-1].observations == 1, HANDOVER, "the answer to be taken in")
    assert cell.beliefs[-1].entropy < before
