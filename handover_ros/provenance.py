"""Which software made a result."""

from __future__ import annotations

import platform
import subprocess
from importlib import metadata
from pathlib import Path

import handover_ros

VERSIONED = ("numpy", "scipy", "pin", "mujoco", "filterpy", "numba", "rclpy")


def versions() -> dict[str, str]:
    """Return the versions that a result depends on."""
    found = {"handover_ros": handover_ros.__version__, "python": platform.python_version()}
    for name in VERSIONED:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def commit() -> str:
    """Return the commit of the source tree, with ``+`` when files in it are changed; empty: it is no clone."""
    try:
        done = subprocess.run(
            ["git", "describe", "--always", "--dirty=+", "--abbrev=12"],
            cwd=Path(__file__).resolve().parent,
            capture_output=True,
            text=True,
            timeout=10.0,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()
