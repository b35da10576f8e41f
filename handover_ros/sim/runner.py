"""Runs a simulation in a thread of its own, at a pace, and does what others ask of it between two steps."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

from handover_ros.errors import StaleDataError
from handover_ros.sim.simulation import Simulation

Result = TypeVar("Result")

SLICE = 0.004  # [s] simulated between two looks at the clock and the requests
LARGEST_LAG = 0.25  # [s] of wall time behind the pace that is caught up; more is forgiven
FACTOR_PERIOD = 1.0  # [s] of wall time over which the realtime factor is measured
JOIN_TIMEOUT = 5.0  # [s]


class SimulationRunner:
    """Owns a simulation: after ``start`` only the runner's thread may touch it.

    Args:
        simulation: What to run.
        realtime_factor: Simulated seconds per second of wall time; 0: as fast as possible.
        after_slice: Called in the runner's thread after every few milliseconds of simulated time.

    Attributes:
        pace: The wanted realtime factor; may be changed at any time.
        realtime_factor: The measured one, over the last second.
        longest_slice: Longest time that a slice took [s] of wall time, since somebody set it to 0.
        error: What ended the simulation, None while it is well.
    """

    def __init__(
        self, simulation: Simulation, realtime_factor: float, after_slice: Callable[[Simulation], None]
    ) -> None:
        self._simulation = simulation
        self._after_slice = after_slice
        self._requests: queue.SimpleQueue[tuple[Callable[[Simulation], Any], Future[Any]]] = queue.SimpleQueue()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="simulation", daemon=True)
        self._steps_per_slice = max(1, round(SLICE / simulation.timestep))
        self.pace = realtime_factor
        self.realtime_factor = 0.0
        self.longest_slice = 0.0
        self.error: BaseException | None = None

    def start(self) -> None:
        """Start to run."""
        self._thread.start()

    def stop(self) -> None:
        """Stop after the present slice; requests not yet done fail."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(JOIN_TIMEOUT)
        self._refuse_requests()

    def submit(self, function: Callable[[Simulation], Result]) -> Future[Result]:
        """Let the runner's thread call ``function`` between two slices; return its result to come."""
        future: Future[Result] = Future()
        self._requests.put((function, future))
        if self._stopping.is_set():
            self._refuse_requests()
        return future

    def call(self, function: Callable[[Simulation], Result], timeout: float) -> Result:
        """Return what ``function`` returns, called as by ``submit``; for threads that may wait [s].

        Raises:
            StaleDataError: It was not done in time, or the simulation stopped.
        """
        try:
            return self.submit(function).result(timeout)
        except TimeoutError:
            raise StaleDataError(f"the simulation did not answer within {timeout:g} s") from None

    def _run(self) -> None:
        try:
            self._loop()
        except BaseException as error:
            self.error = error
        finally:
            self._stopping.set()
            self._refuse_requests()

    def _loop(self) -> None:
        simulation = self._simulation
        due = measured_at = time.perf_counter()
        measured_time = simulation.time
        while not self._stopping.is_set():
            now = time.perf_counter()
            self._serve_requests()
            before = simulation.time
            for _ in range(self._steps_per_slice):
                simulation.step()
            self._after_slice(simulation)
            began, now = now, time.perf_counter()
            self.longest_slice = max(self.longest_slice, now - began)
            if now - measured_at >= FACTOR_PERIOD:
                self.realtime_factor = (simulation.time - measured_time) / (now - measured_at)
                measured_at, measured_time = now, simulation.time
            if self.pace <= 0.0:
                due = now  # no pause: MuJoCo leaves the interpreter to other threads in every step
                continue
            due = max(due + (simulation.time - before) / self.pace, now - LARGEST_LAG)
            if due > now:
                time.sleep(due - now)

    def _serve_requests(self) -> None:
        while True:
            try:
                function, future = self._requests.get_nowait()
            except queue.Empty:
                return
            if not future.set_running_or_notify_cancel():
                continue
            try:
                future.set_result(function(self._simulation))
            except Exception as error:
                future.set_exception(error)

    def _refuse_requests(self) -> None:
        while True:
            try:
                _, future = self._requests.get_nowait()
            except queue.Empty:
                return
            if future.set_running_or_notify_cancel():
                future.set_exception(StaleDataError("the simulation has stopped"))
