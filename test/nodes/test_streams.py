"""Streams beside the executor, the newest of a stream, the worker, and who comes first."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator

import pytest
from graph import ANSWER, Graph, isolated_graph, wait_for
from std_msgs.msg import Int64

from handover_ros.nodes import scheduling
from handover_ros.nodes.runtime import RECORDER, WORKER, Worker
from handover_ros.nodes.scheduling import come_first
from handover_ros.nodes.streams import NewestReader, StreamReader

MANY = 400


@pytest.fixture
def graph() -> Iterator[Graph]:
    with isolated_graph() as made:
        yield made


@pytest.mark.graph
def test_a_stream_is_read_whole_and_its_newest_only_now_and_then(graph: Graph) -> None:
    every: list[int] = []
    newest: list[int] = []
    stream = StreamReader(graph.node, Int64, "numbers", lambda message: every.append(message.data), RECORDER)
    reader = NewestReader(graph.node, 0.05)
    reader.newest_of(Int64, "numbers", lambda message: newest.append(message.data), RECORDER)
    publisher = graph.node.create_publisher(Int64, "numbers", RECORDER)
    wait_for(lambda: publisher.get_subscription_count() == 2, ANSWER, "both subscriptions")
    for number in range(MANY):
        publisher.publish(Int64(data=number))
    wait_for(lambda: len(every) == MANY and newest and newest[-1] == MANY - 1, ANSWER, "all messages")
    assert every == list(range(MANY))
    assert newest == sorted(set(newest))
    assert len(newest) < MANY / 4
    report = stream.latencies.report(1.0)
    assert 0.0 < report["latency_median_ms"] <= report["latency_max_ms"]
    stream.stop()


@pytest.mark.graph
def test_jobs_are_done_one_after_the_other_in_one_thread(graph: Graph) -> None:
    worker = Worker(graph.node)
    futures = [worker.submit(lambda value: (value, threading.get_ident()), number) for number in range(20)]
    failing = worker.submit(int, "x")
    wait_for(failing.done, ANSWER, "the jobs")
    assert [future.result()[0] for future in futures] == list(range(20))
    assert len({future.result()[1] for future in futures}) == 1
    assert isinstance(failing.exception(), ValueError)


def test_who_may_not_come_first_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, int]] = []

    def refuse(*_: object) -> None:
        raise PermissionError

    assert come_first(0) == "as any process"
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr(os, "setpriority", lambda which, who, value: asked.append((which, value)))
    assert come_first(10) == f"nice {scheduling.NICE}"
    assert set(asked) == {(os.PRIO_PROCESS, scheduling.NICE)}
    monkeypatch.setattr(os, "setpriority", refuse)
    assert "may not set priorities" in come_first(10)


def test_workers_stay_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    stop = threading.Event()
    threads = [threading.Thread(target=stop.wait, name=name) for name in ("stream", f"node{WORKER}")]
    for thread in threads:
        thread.start()
    try:
        monkeypatch.setattr(os, "sched_setscheduler", lambda thread, policy, parameter: asked.append(thread))
        assert come_first(7) == "real time, priority 7"
    finally:
        stop.set()
    assert threads[0].native_id in asked
    assert threads[1].native_id not in asked
