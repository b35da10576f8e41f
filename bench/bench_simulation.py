"""How fast the simulated cell runs: person, robot, objects and 24 markers at 240 Hz, without drawing.

    python bench/bench_simulation.py [--seconds 20] [--json FILE]

Prints simulated seconds per second of wall time, where the time goes, and how long a picture takes.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

from handover_ros.errors import HandoverError
from handover_ros.objects.scene import load_scene
from handover_ros.sim.options import SimulationOptions
from handover_ros.sim.render import Renderer
from handover_ros.sim.simulation import Simulation

WARM_UP = 0.5  # [s] simulated


def factor(seconds: float, behaviour: str, options: SimulationOptions, with_mocap: bool = True) -> float:
    """Return simulated seconds per second of wall time."""
    simulation = Simulation(load_scene("lab"), seed=1, options=options)
    if simulation.person is not None:
        simulation.set_behaviour(behaviour)
    if not with_mocap:
        simulation.mocap = None
    simulation.run(WARM_UP)
    start = time.perf_counter()
    simulation.run(seconds)
    elapsed = time.perf_counter() - start
    simulation.frames()
    return seconds / elapsed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0, help="simulated time of each run [s]")
    parser.add_argument("--json", type=Path, help="write the numbers to this file")
    arguments = parser.parse_args()

    start = time.perf_counter()
    simulation = Simulation(load_scene("lab"), seed=1)
    metrics = {"sim_build_s": time.perf_counter() - start}
    seconds = arguments.seconds
    metrics["sim_realtime_factor"] = factor(seconds, "calibrate", SimulationOptions())
    metrics["sim_realtime_factor_standing"] = factor(seconds, "stand", SimulationOptions())
    metrics["sim_realtime_factor_no_mocap"] = factor(seconds, "stand", SimulationOptions(), with_mocap=False)
    metrics["sim_realtime_factor_no_person"] = factor(seconds, "", SimulationOptions(person="none"))
    try:
        renderer = Renderer(simulation.world)
        renderer.render(simulation.data)
        start = time.perf_counter()
        renderer.render(simulation.data)
        metrics["picture_s"] = time.perf_counter() - start
        renderer.close()
    except HandoverError as error:
        print(f"no pictures: {error}")

    labels = {
        "sim_build_s": "building the cell [s]",
        "sim_realtime_factor": "times real time, person in calibration motions, 240 Hz motion capture",
        "sim_realtime_factor_standing": "times real time, person standing, 240 Hz motion capture",
        "sim_realtime_factor_no_mocap": "times real time, without motion capture",
        "sim_realtime_factor_no_person": "times real time, without a person",
        "picture_s": "one picture of 1280 x 720 [s]",
    }
    for name, value in metrics.items():
        print(f"{value:8.2f}  {labels[name]}")
    if arguments.json:
        arguments.json.write_text(json.dumps({"metrics": metrics}, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
