"""The real recordings, where they are; and small files written for a test."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from handover_ros.mocap.frames import MarkerFrame, Recording
from handover_ros.mocap.marker_sets import load_marker_set
from handover_ros.mocap.recordings import load_recording

FOLDER = Path(os.environ.get("HANDOVER_RECORDINGS", Path(__file__).resolve().parents[2] / ".." / "shared" / "data"))
C3D = "pyomeca/markers_analogs.c3d"
CSV = "UE_ADLdatabase/ADL006/ADL006DR1.csv"
CSV_TRIALS = (CSV, "UE_ADLdatabase/ADL006/ADL006CL1.csv", "UE_ADLdatabase/ADL009/ADL009AR1.csv")


def recorded(name: str) -> Path:
    """Return a real recording's path; skip the test where there is none."""
    path = FOLDER / name
    if not path.is_file():
        pytest.skip(f"no real recording {path}")
    return path


def real_recording(name: str) -> Recording:
    """Return a real recording with its marker set."""
    return load_recording(recorded(name), load_marker_set("ue_adl" if name.endswith(".csv") else "pyomeca_daphnee"))


def frame_of(positions: np.ndarray, index: int, rate: float = 100.0, start: float = 10.0) -> MarkerFrame:
    """Return frame number ``index`` of a stream, before repair."""
    stamp = start + index / rate
    return MarkerFrame(stamp, index, stamp, positions, np.zeros(len(positions), dtype=np.uint8))


def vicon_csv(labels: list[str], positions: np.ndarray, rate: str = "100", units: str = "mm") -> str:
    """Return the text of a Vicon CSV file; ``positions`` (frames, markers, 3), NaN as an empty cell."""
    lines = ["\ufeffTrajectories", rate, ",," + ",,,".join(labels) + ",,,"]
    lines.append("Frame,Sub Frame" + ",X,Y,Z" * len(labels))
    lines.append("," + f",{units}" * (3 * len(labels)))
    for number, frame in enumerate(positions, start=1):
        cells = ["" if np.isnan(value) else f"{value:.6f}" for value in frame.ravel()]
        lines.append(f"{number},0," + ",".join(cells))
    return "\n".join([*lines, ""])


def trc(labels: list[str], positions: np.ndarray, rate: float = 100.0, units: str = "mm") -> str:
    """Return the text of a TRC file."""
    frames, n = positions.shape[:2]
    lines = ["PathFileType\t4\t(X/Y/Z)\ttest.trc"]
    lines.append("DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames")
    lines.append(f"{rate}\t{rate}\t{frames}\t{n}\t{units}\t{rate}\t1\t{frames}")
    lines.append("Frame#\tTime\t" + "\t\t\t".join(labels) + "\t\t")
    lines.append("\t\t" + "\t".join(f"{axis}{number}" for number in range(1, n + 1) for axis in "XYZ"))
    lines.append("")
    for number, frame in enumerate(positions, start=1):
        cells = ["" if np.isnan(value) else f"{value:.6f}" for value in frame.ravel()]
        lines.append(f"{number}\t{(number - 1) / rate:.5f}\t" + "\t".join(cells))
    return "\n".join([*lines, ""])


def marker_set_text(labels: list[str], extra: str = "") -> str:
    """Return a marker-set file for a few labels."""
    markers = "".join(f"  - {{name: {label}, segment: torso}}\n" for label in labels)
    weights = ", ".join(f"{label}: 1.0" for label in labels)
    template = ", ".join(f"{label}: [{0.1 * i}, {0.05 * i * i}, 0.0]" for i, label in enumerate(labels))
    return f"markers:\n{markers}torso:\n  weights: {{{weights}}}\n  template: {{{template}}}\n{extra}"
