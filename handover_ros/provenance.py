"""Which software made a result."""

from __future__ import annotations

import platform
from importlib import metadata

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
