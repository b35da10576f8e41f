"""The runner does what is asked of it between two steps, and ends in order."""

import threading

import pytest
from cell import empty_cell

from handover_ros.errors import BadRequestError, StaleDataError
from handover_ros.sim.runner import SimulationRunner

LIMIT = 20.0


@pytest.fixture
def runner():
    simulation = empty_cell()
    simulation.reset(seed=1)
    slices = []
    runner = SimulationRunner(simulation, 0.0, lambda cell: slices.append(cell.time))
    runner.slices = slices
    runner.start()
    yield runner
    runner.stop()


def test_requests_run_in_the_simulations_thread_in_order(runner):
    names = [runner.submit(lambda _: threading.current_thread().name) for _ in range(3)]
    assert {name.result(LIMIT) for name in names} == {"simulation"}
    times = [runner.call(lambda cell: cell.time, LIMIT) for _ in range(3)]
    assert times == sorted(times)


def test_an_error_goes_to_who_asked_and_the_cell_runs_on(runner):
    with pytest.raises(BadRequestError):
        runner.call(lambda cell: cell.set_behaviour("take"), LIMIT)
    before = runner.call(lambda cell: cell.time, LIMIT)
    reached = threading.Event()

    def look(cell):
        if cell.time > before + 0.1:
            reached.set()

    for _ in range(10_000):
        runner.call(look, LIMIT)
        if reached.is_set():
            break
    assert reached.is_set()
    assert runner.error is None
    assert runner.slices == sorted(runner.slices)


def test_a_stopped_runner_refuses(runner):
    runner.stop()
    with pytest.raises(StaleDataError, match="stopped"):
        runner.call(lambda cell: cell.time, LIMIT)


def test_a_failure_of_the_simulation_itself_is_kept():
    def fail(_):
        raise ZeroDivisionError

    runner = SimulationRunner(empty_cell(), 0.0, fail)

    def ask_until_refused():
        while True:
            runner.call(lambda cell: cell.time, LIMIT)

    runner.start()
    with pytest.raises(StaleDataError):
        ask_until_refused()
    runner.stop()
    assert isinstance(runner.error, ZeroDivisionError)
