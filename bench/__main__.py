"""``./handover bench``: our numbers and those of the peers, measured in the same run."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from bench import calibration, inverse_kinematics, learning_loop, planning, preferences, soak, tracking
from bench.bench_simulation import factor
from bench.peers import peer
from handover_ros.cell.report import output_folder, write_json
from handover_ros.errors import HandoverError
from handover_ros.sim.options import SimulationOptions

PARTS = ("tracking", "calibration", "simulation", "ik", "planning", "preferences", "learning", "soak")
# What the design asks for: metric, relation, value.
REACH = {
    "ukf_speed_over_biorbd": (">=", 1.0),
    "ukf_speed_over_filterpy": (">=", 10.0),
    "ukf_robust_diverged": ("<=", 0.0),
    "calibration_s": ("<=", 2.0),
    "calibration_linear_exponent": ("<=", 1.1),
    "calibration_stalls": ("<=", 0.0),
    "calibration_speed_over_scipy": (">=", 10.0),
    **{f"calibration_{kind}_centre_max_mm": ("<=", 5.0) for kind in calibration.KINDS},
    **{f"calibration_{kind}_axis_max_deg": ("<=", 1.5) for kind in calibration.KINDS},
    **{f"calibration_{kind}_limit_max_deg": ("<=", 3.0) for kind in calibration.KINDS},
    "sim_realtime_factor": (">=", 5.0),
    "plan_median_ms": ("<=", 100.0),
    "plan_cost_over_exhaustive_max": ("<=", 1.0),
    "ik_speed_over_eaik32": (">=", 20.0),
    "ik_poses_missed": ("<=", 0.0),
    "ik_cost_over_best_peer": ("<=", 1.0 + 1e-9),
    "ik_fk_error": ("<=", 1e-9),
    "belief_update_ms": ("<=", 10.0),
    "query_select_ms": ("<=", 100.0),
    "learning_active_value_cost_over_truth": ("<=", 1.10),
    "learning_active_value_cost_over_truth_of_all": ("<=", 1.10),
    "mutual_information_speedup": (">=", 1000.0),
    "soak_handovers": (">=", 100.0),
    "frames_lost": ("<=", 0.0),
    "latency_p99_ms": ("<=", 5.0),
    "soak_growth_max_mb_per_h": ("<=", 5.0),
}
AGAINST_PEER = {"ukf_rmse_deg": "biorbd_rmse_deg", "ukf_rmse_deg_missing10": "biorbd_rmse_deg_missing10"}
EXIT_BAD_INPUT = 2


def verdict(name: str, metrics: dict[str, float]) -> tuple[str, str]:
    """Return what to reach, as text, and whether it is reached: yes, no or nothing."""
    relation, target = REACH.get(name, ("", 0.0))
    value, peers = metrics[name], metrics.get(AGAINST_PEER.get(name, ""))
    if peers is not None and math.isfinite(peers):
        relation, target = "<=", peers
    if not relation:
        return "", ""
    if math.isnan(value):
        return f"{relation} {target:.4g}", ""
    reached = value >= target if relation == ">=" else value <= target
    return f"{relation} {target:.4g}", "[green]yes[/green]" if reached else "[red]no[/red]"


def bench(
    part: Annotated[str, typer.Argument(help=f"One of {', '.join(PARTS)}, or all (but soak).")] = "all",
    quick: Annotated[bool, typer.Option("--quick", help="Fewer frames, people and rounds.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of people, motions and noise.")] = 1,
    json_file: Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write the result as JSON.")] = None,
    out: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Folder for bench.json.")] = None,
) -> None:
    """Measure tracking, calibration, simulation, planning, preferences and learning, with the peers in the same run."""
    if part not in (*PARTS, "all"):
        raise typer.BadParameter(f"unknown part {part!r}; known: {', '.join(PARTS)}, all")
    console = Console()
    metrics: dict[str, float] = {}
    if part in ("tracking", "all"):
        console.print("tracking ...")
        metrics |= tracking.measure(seed, quick, peer("biorbd"))
    if part in ("calibration", "all"):
        console.print("calibration ...")
        metrics |= calibration.measure(seed, quick)
    if part in ("simulation", "all"):
        console.print("simulation ...")
        metrics["sim_realtime_factor"] = factor(5.0 if quick else 20.0, "calibrate", SimulationOptions())
    if part in ("planning", "all"):
        console.print("planning ...")
        metrics |= planning.measure(seed, quick)
    if part in ("ik", "all"):
        console.print("inverse kinematics of the arm ...")
        metrics |= inverse_kinematics.measure(seed, quick, peer("eaik"), peer("ssik"))
    if part in ("preferences", "all"):
        console.print("preferences ...")
        metrics |= preferences.measure(seed, quick)
    if part in ("learning", "all"):
        console.print("learning from tracking ...")
        metrics |= learning_loop.measure(seed, quick)
    if part == "soak":  # half an hour: only when it is asked for
        console.print("handovers one after the other, in the whole graph ...")
        folder = output_folder(out, "soak")
        metrics |= soak.soak(2.0 if quick else 30.0, 5 if quick else 100, seed, folder, console)
        console.print(f"everything is in {folder}", highlight=False, soft_wrap=True)
    table = Table(box=None, padding=(0, 2, 0, 0))
    for heading in ("metric", "value", "to reach", "reached"):
        table.add_column(heading, justify="right" if heading == "value" else "left")
    for name, value in metrics.items():
        table.add_row(name, "-" if math.isnan(value) else f"{value:.4g}", *verdict(name, metrics))
    console.print(table)
    for target in filter(None, (out / "bench.json" if out else None, json_file)):
        write_json(target, "bench", True, seed, metrics)


def main() -> int:
    """Run the command; what the user can mend becomes one line and status 2."""
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command()(bench)
    try:
        app(standalone_mode=False, prog_name="./handover bench")
    except (HandoverError, typer.BadParameter.__base__) as error:  # type: ignore[misc]
        message = error.format_message() if hasattr(error, "format_message") else str(error)
        print(f"error: {' '.join(message.split())}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except (typer.Abort, KeyboardInterrupt):
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
