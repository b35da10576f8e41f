"""Where the package's own data files (``config/``) are, in a source tree and installed by colcon."""

from __future__ import annotations

import os
import sysconfig
from functools import cache
from pathlib import Path

from handover_ros.errors import BadModelError, UnknownNameError

PACKAGE = "handover_ros"


@cache
def config_directory() -> Path:
    """Return the folder of the configuration files.

    Looked for in ``HANDOVER_CONFIG`` (an operator's own folder), beside the source, in the ament index and in the
    Python installation, in this order.

    Raises:
        BadModelError: None of them exists.
    """
    candidates = []
    if own := os.environ.get("HANDOVER_CONFIG"):
        candidates.append(Path(own))
    candidates.append(Path(__file__).resolve().parent.parent / "config")
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    candidates += [Path(prefix) / "share" / PACKAGE / "config" for prefix in prefixes if prefix]
    candidates.append(Path(sysconfig.get_path("data")) / "share" / PACKAGE / "config")
    for candidate in candidates:
        if candidate.is_dir():
            return candidate
    raise BadModelError(
        f"no configuration folder; looked in {', '.join(map(str, candidates))}; set HANDOVER_CONFIG to yours"
    )


def config_names(kind: str) -> list[str]:
    """Return the names of the YAML files of one kind (a folder of ``config/``), sorted."""
    return sorted(path.stem for path in (config_directory() / kind).glob("*.yaml"))


def config_file(kind: str, name: str) -> Path:
    """Return the YAML file of a named thing, e.g. ``config_file("objects", "mug")``.

    A path to a YAML file instead of a name is taken as it is.

    Raises:
        UnknownNameError: There is no such file.
    """
    if name.endswith((".yaml", ".yml")) and Path(name).is_file():
        return Path(name)
    names = config_names(kind)
    if name not in names:
        raise UnknownNameError(kind.rstrip("s").replace("_", " "), name, names)
    return config_directory() / kind / f"{name}.yaml"


def cache_directory() -> Path:
    """Return the folder for files that can be made again (converted meshes, compiled kernels); it may not exist."""
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / PACKAGE
