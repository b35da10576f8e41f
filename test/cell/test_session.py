"""A session's folder: what is in it at the beginning, at the end, and after a crash."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml
from profiles import profile_of
from rich.console import Console

from handover_ros.bags.definitions import Definition
from handover_ros.bags.reading import Bag
from handover_ros.bags.recording import BagWriter
from handover_ros.cell.keeping import keeping
from handover_ros.cell.processes import NodeLaunch
from handover_ros.cell.session import FAILED, OK, Session, keep_people, mend_bag, parameters_of
from handover_ros.cell.store import ProfileStore
from handover_ros.errors import BadRequestError

TEXT = Definition("string data\n", "RIHS01_0")


def launch(tmp_path: Path) -> NodeLaunch:
    file = tmp_path / "planner_node.yaml"
    file.write_text("planner_node:\n  ros__parameters:\n    scheme: relative\n    seed: 1\n")
    return NodeLaunch("planner_node", {"seed": 7, "use_sim_time": True}, file)


def begun(tmp_path: Path) -> Session:
    store = ProfileStore(tmp_path / "profiles")
    store.save(profile_of("anna"))
    store.save(profile_of("bert"))
    store.activate("anna")
    (tmp_path / "profiles" / "beliefs").mkdir(exist_ok=True)
    (tmp_path / "profiles" / "beliefs" / "bert.npz").write_bytes(b"x")
    given = {"handovers": 2, "out": tmp_path / "session", "speed": float("nan")}
    return Session.begin(tmp_path / "session", "demo", given, [launch(tmp_path)], tmp_path / "profiles")


def read(tmp_path: Path) -> dict:
    return json.loads((tmp_path / "session" / "session.json").read_text())


def test_a_session_says_at_once_what_runs(tmp_path: Path) -> None:
    begun(tmp_path)
    content = read(tmp_path)
    assert (content["format"], content["command"], content["outcome"], content["ended"]) == (1, "demo", "running", None)
    assert content["arguments"] == {"handovers": 2, "out": str(tmp_path / "session"), "speed": None}
    assert content["nodes"] == {"planner_node": {"seed": 7, "use_sim_time": True}}
    assert {"handover_ros", "numpy", "python"} <= set(content["versions"])
    given = yaml.safe_load((tmp_path / "session" / "parameters" / "planner_node.yaml").read_text())
    assert given == {"planner_node": {"ros__parameters": {"scheme": "relative", "seed": 7, "use_sim_time": True}}}
    start = ProfileStore(tmp_path / "session" / "start")
    assert start.names() == ("anna", "bert")
    assert start.active_id() == "anna"


def test_the_end_is_written_whatever_happens(tmp_path: Path) -> None:
    def crash() -> None:
        with keeping(begun(tmp_path), Console(quiet=True)) as kept:
            kept.metrics = {"ready_s": 1.5, "nothing": float("nan")}
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        crash()
    content = read(tmp_path)
    assert content["outcome"] == FAILED
    assert content["ended"]
    assert content["metrics"] == {"ready_s": 1.5, "nothing": None}
    assert "It ended, but not as it should." in (tmp_path / "session" / "report.md").read_text()
    assert (tmp_path / "session" / "report.html").is_file()


def test_people_who_were_not_there_are_not_kept(tmp_path: Path) -> None:
    from handover_msgs.msg import ActiveProfile, ProfileInfo
    from rclpy.serialization import serialize_message

    from handover_ros.bags.definitions import Definitions

    session = begun(tmp_path)
    name = "handover_msgs/msg/ActiveProfile"
    writer = BagWriter(tmp_path / "session" / "bag")
    writer.add("/calibration/active_profile", name, Definitions().of(name), [])
    message = ActiveProfile(info=ProfileInfo(profile_id="bert"))
    writer.write("/calibration/active_profile", name, 1, serialize_message(message))
    writer.flush()  # and killed
    with keeping(session, Console(quiet=True)) as kept:
        kept.outcome = OK
    with Bag(tmp_path / "session") as bag:
        assert bag.note == "", "a bag that was not closed is made whole"
        assert bag.messages == 1
    for part in ("start", "end"):
        assert ProfileStore(tmp_path / "session" / part).names() == ("bert",)
        assert (tmp_path / "session" / part / "beliefs" / "bert.npz").is_file()


def test_a_folder_holds_one_session(tmp_path: Path) -> None:
    begun(tmp_path)
    with pytest.raises(BadRequestError, match="holds a session already"):
        begun(tmp_path)


def test_nothing_to_mend_is_left_as_it_is(tmp_path: Path) -> None:
    mend_bag(tmp_path / "none")
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "bag.mcap").write_bytes(b"rubbish")
    mend_bag(tmp_path / "bag")
    assert (tmp_path / "bag" / "bag.mcap").read_bytes() == b"rubbish"
    keep_people(tmp_path / "none", {"anna"})


def test_parameters_of_a_node_without_a_file(tmp_path: Path) -> None:
    assert parameters_of(NodeLaunch("mocap_node", {"pace": 2.0}, tmp_path / "none.yaml")) == {"pace": 2.0}
    assert parameters_of(NodeLaunch("mocap_node")) == {}
