"""Where set-up keeps its things, and which of them are up to date."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

LAYOUT_VERSION = 1  # a change makes every machine set up anew
UNFINISHED = "unfinished"


@dataclass(frozen=True)
class Layout:
    """The folders of one clone.

    Attributes:
        source: The clone.
        state: Everything that set-up makes; safe to delete as a whole.
        way: ``wheels`` (ROS from PyPI) or ``sourced`` (the ROS of the shell that called).
    """

    source: Path
    state: Path
    way: str = "wheels"

    @property
    def root(self) -> Path:
        """Folder of this way's environment; the two ways never share one."""
        return self.state if self.way == "wheels" else self.state / "sourced"

    @property
    def venv(self) -> Path:
        """Virtual environment with ROS (wheels way) and all Python packages."""
        return self.root / "venv"

    @property
    def python(self) -> Path:
        """The environment's Python."""
        return self.venv / "bin" / "python"

    @property
    def build(self) -> Path:
        """What colcon builds in."""
        return self.root / "build"

    @property
    def install(self) -> Path:
        """What colcon installs to; its ``setup.bash`` can be sourced."""
        return self.root / "install"

    @property
    def log(self) -> Path:
        """One log a step."""
        return self.state / "log"

    @property
    def temporary(self) -> Path:
        """Files that live only while set-up runs."""
        return self.state / "tmp"

    @property
    def lock_file(self) -> Path:
        """Held while set-up runs."""
        return self.state / "lock"

    @property
    def requirements(self) -> Path:
        """The pinned packages."""
        return self.source / "requirements.lock"

    def site_packages(self, prefix: Path) -> Path | None:
        """Return the folder of Python packages below an install prefix; None while there is none."""
        return next(iter(sorted(prefix.glob("lib/python3.*/site-packages"))), None)


def choose_state(source: Path) -> Path:
    """Return the folder for what set-up makes.

    It is ``HANDOVER_HOME`` if that is set, else ``.handover`` beside the source, else (source read-only) a folder of
    this clone in the user's cache.
    """
    if own := os.environ.get("HANDOVER_HOME"):
        return Path(own).expanduser().absolute()
    beside = source / ".handover"
    if os.access(beside if beside.exists() else source, os.W_OK):
        return beside
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "handover_ros" / f"setup-{digest([str(source)])[:12]}"


def digest(parts: Iterable[str | bytes]) -> str:
    """Return one hash of several texts; the order and the borders between them count."""
    total = hashlib.sha256()
    for part in parts:
        data = part if isinstance(part, bytes) else part.encode()
        total.update(b"%d:" % len(data))
        total.update(data)
    return total.hexdigest()


class Stamps:
    """What each step last finished with, in one small file that is replaced whole.

    A step that began and did not end is ``unfinished``; what it left behind is not to be trusted.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self.values: dict[str, str] = json.loads(path.read_text())
        except (OSError, ValueError):
            self.values = {}
        if not isinstance(self.values, dict):
            self.values = {}

    def get(self, name: str) -> str:
        """Return the digest a step finished with; empty if it never did."""
        return str(self.values.get(name, ""))

    def set(self, name: str, value: str) -> None:
        """Store a step's digest durably."""
        self.values[name] = value
        self.path.parent.mkdir(parents=True, exist_ok=True)
        temporary = self.path.with_suffix(f".{os.getpid()}")
        with temporary.open("w") as stream:
            json.dump(self.values, stream, indent=1, sort_keys=True)
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(self.path)
