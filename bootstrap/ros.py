"""Which ROS 2 is used: the one the calling shell has sourced, or the one from PyPI wheels."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from dataclasses import asdict, dataclass
from pathlib import Path

from bootstrap.console import SetupError, say
from bootstrap.layout import digest

DISTRO = "jazzy"
CHOICE = "HANDOVER_ROS"  # auto | wheels | sourced

# Run by a candidate Python: answers in JSON, or fails if it cannot import rclpy.
PROBE = """
import json, os, site, sys, sysconfig
import rclpy
try:
    import numpy
    numpy_version = numpy.__version__
except ImportError:
    numpy_version = ""
print("PROBE" + json.dumps({
    "python": sys.executable,
    "version": list(sys.version_info[:2]),
    "in_venv": sys.prefix != sys.base_prefix,
    "site_packages": sysconfig.get_path("purelib"),
    "rclpy": os.path.dirname(rclpy.__file__),
    "numpy": numpy_version,
    "library_path": os.environ.get("LD_LIBRARY_PATH", ""),
    "bootstrapped": os.environ.get("_ROS_WHEELS_BOOTSTRAP_COMPLETE", ""),
}))
"""


@dataclass(frozen=True)
class SourcedRos:
    """A ROS 2 that the calling shell has sourced.

    Attributes:
        python: Python that imports its rclpy.
        version: Major and minor version of that Python.
        in_venv: Whether that Python lives in a venv, whose packages a further venv does not see by itself.
        site_packages: Folder of that Python's packages.
        rclpy: Folder of the rclpy package.
        numpy: NumPy's version there; the compiled messages need this major version.
        library_path: ``LD_LIBRARY_PATH`` with which rclpy loads.
        bootstrapped: Value of ``_ROS_WHEELS_BOOTSTRAP_COMPLETE`` with which rclpy loads; empty for apt's ROS.
    """

    python: str
    version: tuple[int, int]
    in_venv: bool
    site_packages: str
    rclpy: str
    numpy: str
    library_path: str
    bootstrapped: str


def sourced_prefixes(state: Path) -> list[str]:
    """Return the prefixes of ``AMENT_PREFIX_PATH`` that are not set-up's own."""
    prefixes = [prefix for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    return [prefix for prefix in prefixes if not Path(prefix).is_relative_to(state)]


def find_sourced(state: Path) -> SourcedRos | None:
    """Return the ROS 2 Jazzy of the calling shell, or None where the wheels are to be used.

    The answer for one shell environment is kept in a file, since asking takes half a second.

    Raises:
        SetupError: ``HANDOVER_ROS`` has another value than auto, wheels, sourced; or it says ``sourced`` and no
            usable ROS is sourced.
    """
    choice = os.environ.get(CHOICE, "auto") or "auto"
    if choice not in ("auto", "wheels", "sourced"):
        raise SetupError(f"{CHOICE} is {choice!r}; use auto, wheels or sourced")
    if choice == "wheels":
        return None
    prefixes = sourced_prefixes(state)
    has_rclpy = any((Path(prefix) / "share" / "rclpy" / "package.xml").is_file() for prefix in prefixes)
    distro = os.environ.get("ROS_DISTRO", "")
    if not has_rclpy or (distro != DISTRO and choice == "auto"):
        if has_rclpy and distro:
            say(f"handover: ROS 2 {distro} is sourced, this package needs {DISTRO}: using ROS from PyPI wheels")
        if choice == "sourced":
            raise SetupError(f"{CHOICE}=sourced, but no ROS 2 with rclpy is: source /opt/ros/{DISTRO}/setup.bash first")
        return None
    found = _remembered(state)
    if found is None and choice == "sourced":
        raise SetupError("no python3 on PATH can import the sourced rclpy; leave other virtual environments first")
    if found is None:
        say("handover: ROS 2 is sourced, but no python3 on PATH imports its rclpy: using ROS from PyPI wheels")
    return found


def _remembered(state: Path) -> SourcedRos | None:
    names = ("AMENT_PREFIX_PATH", "PYTHONPATH", "LD_LIBRARY_PATH", "ROS_DISTRO", "PATH")
    key = digest(os.environ.get(name, "") for name in names)
    memory = state / "sourced.json"
    try:
        stored = json.loads(memory.read_text())
        if stored["key"] == key and Path(stored["ros"]["python"]).exists() and Path(stored["ros"]["rclpy"]).exists():
            return SourcedRos(**{**stored["ros"], "version": tuple(stored["ros"]["version"])})
    except (OSError, ValueError, KeyError, TypeError):
        pass
    found = _probe_candidates()
    if found is not None:
        try:
            memory.parent.mkdir(parents=True, exist_ok=True)
            temporary = memory.with_suffix(f".{os.getpid()}")
            temporary.write_text(json.dumps({"key": key, "ros": asdict(found)}, indent=1))
            temporary.replace(memory)
        except OSError:
            pass  # asked again next time
    return found


def _probe_candidates() -> SourcedRos | None:
    names = ("python3", "/usr/bin/python3", "python3.12")
    for candidate in dict.fromkeys(path for path in map(shutil.which, names) if path):
        try:
            answer = subprocess.run(
                [candidate, "-c", PROBE], capture_output=True, text=True, timeout=60, cwd="/", check=False
            )
        except (OSError, subprocess.TimeoutExpired):
            continue
        for line in answer.stdout.splitlines():
            if answer.returncode == 0 and line.startswith("PROBE"):
                values = json.loads(line[len("PROBE") :])
                return SourcedRos(**{**values, "version": tuple(values["version"])})
    return None
