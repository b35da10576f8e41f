"""The environment in which the cell's programs run."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path

from bootstrap.layout import Layout, digest
from bootstrap.needs import missing_graphics
from bootstrap.ros import SourcedRos


def cell_environment(layout: Layout, ros: SourcedRos | None) -> dict[str, str]:
    """Return the whole environment for a program of the cell; what the operator has set is kept.

    Args:
        layout: The folders of this clone.
        ros: The sourced ROS, or None for ROS from wheels.
    """
    environment = dict(os.environ)
    prefixes = [layout.install / name for name in ("handover_ros", "handover_msgs")]
    prefixes = [prefix for prefix in prefixes if prefix.is_dir()]
    # The source first, so that an edit shows at once; the linked build folder holds the package's metadata.
    packages = [layout.source, layout.build / "handover_ros"]
    packages += [path for path in map(layout.site_packages, prefixes) if path]
    libraries = [prefix / "lib" for prefix in prefixes]
    if ros is None:
        site_packages = layout.site_packages(layout.venv)
        wheel_libraries = sorted(site_packages.glob("ros_*.libs")) if site_packages else []
        libraries += [layout.venv / "lib", *wheel_libraries]
        prefixes.append(layout.venv)
        # Nothing of another ROS that happens to be sourced may reach ours.
        foreign = foreign_roots(layout)
        ament, python_path, library_path = (
            without(environment.get(name, ""), foreign)
            for name in ("AMENT_PREFIX_PATH", "PYTHONPATH", "LD_LIBRARY_PATH")
        )
        # The wheels would start Python a second time to set LD_LIBRARY_PATH; it is set here already.
        environment["_ROS_WHEELS_BOOTSTRAP_COMPLETE"] = "1"
        environment.pop("CMAKE_PREFIX_PATH", None)
    else:
        ament, python_path = environment.get("AMENT_PREFIX_PATH", ""), environment.get("PYTHONPATH", "")
        library_path = ros.library_path
        # What set-up has installed goes before an older copy in the sourced workspace.
        packages += [path for path in [layout.site_packages(layout.venv)] if path]
        if ros.bootstrapped:
            environment["_ROS_WHEELS_BOOTSTRAP_COMPLETE"] = ros.bootstrapped
    environment["AMENT_PREFIX_PATH"] = joined(prefixes, ament)
    environment["PYTHONPATH"] = joined(packages, python_path)
    environment["LD_LIBRARY_PATH"] = joined(libraries, library_path)
    environment["PATH"] = joined([layout.venv / "bin"], environment.get("PATH", os.defpath))
    environment["VIRTUAL_ENV"] = str(layout.venv)
    environment.pop("PYTHONHOME", None)

    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if "FASTDDS_DEFAULT_PROFILES_FILE" not in environment:
        environment.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(layout.source / "config" / "fastdds.xml"))
    if "MUJOCO_GL" not in environment:
        # Without EGL the cell runs all the same, without pictures.
        environment["MUJOCO_GL"] = "egl" if not missing_graphics() else "disabled"
    kernels = cache_directory(environment) / "numba" / kernels_digest(layout.source)[:16]
    environment.setdefault("NUMBA_CACHE_DIR", str(kernels))
    return environment


def kernels_digest(source: Path) -> str:
    """Return one hash of all modules that numba compiles.

    Numba goes by the calling file alone: a kernel that inlines one of another file would stay as it was when that
    one is edited. With the hash in the cache's path every edit compiles anew, and never leaves a stale kernel.
    """
    texts = ((path, path.read_bytes()) for path in sorted((source / "handover_ros").rglob("*.py")))
    return digest(part for path, text in texts if b"import numba" in text for part in (path.name, text))


def cache_directory(environment: Mapping[str, str]) -> Path:
    """Return the folder of what can be made again, as ``handover_ros.resources`` has it."""
    return Path(environment.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "handover_ros"


def build_environment(layout: Layout, ros: SourcedRos | None) -> dict[str, str]:
    """Return the environment for pip and colcon: the cell's, without what would lead them astray."""
    environment = cell_environment(layout, ros)
    for name in list(environment):
        if name.startswith("COLCON_") or name in ("PIP_TARGET", "PIP_PREFIX", "PIP_USER", "PIP_REQUIRE_VIRTUALENV"):
            del environment[name]
    # Tools must not take the source tree for an installed package.
    environment["PYTHONPATH"] = without(environment["PYTHONPATH"], [layout.source])
    environment["PYTHONNOUSERSITE"] = "1"
    environment["TMPDIR"] = str(layout.temporary)
    environment["COLCON_HOME"] = str(layout.state / "colcon")
    if ros is None:
        environment["CMAKE_PREFIX_PATH"] = str(layout.venv)
    return environment


def foreign_roots(layout: Layout) -> list[Path]:
    """Return the install prefixes of the calling shell that are not this clone's."""
    paths = [Path(part) for part in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if part]
    return [Path("/opt/ros"), *(path for path in paths if not path.is_relative_to(layout.state))]


def without(path_list: str, roots: Iterable[Path]) -> str:
    """Return a search path without the folders below some roots."""
    roots = list(roots)
    parts = [part for part in path_list.split(os.pathsep) if part]
    return os.pathsep.join(part for part in parts if not any(Path(part).is_relative_to(root) for root in roots))


def joined(first: Iterable[Path], rest: str) -> str:
    """Put folders in front of a search path, each folder once."""
    parts = [*map(str, first), *rest.split(os.pathsep)]
    return os.pathsep.join(dict.fromkeys(part for part in parts if part))
