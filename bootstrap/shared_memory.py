"""Shared-memory segments that killed ROS processes have left behind."""

from __future__ import annotations

import contextlib
import fcntl
from dataclasses import dataclass
from pathlib import Path

SHARED_MEMORY = Path("/dev/shm")
LOCK_SUFFIX = "_el"  # Fast DDS: the owner of a segment holds a lock on the file of this name beside it


@dataclass(frozen=True)
class Leftovers:
    """Segments of Fast DDS, by whether a process still owns them.

    Attributes:
        in_use: How many are owned by a running process.
        abandoned: Files whose owner is gone, with their lock files.
        size: Bytes in the abandoned ones.
    """

    in_use: int
    abandoned: tuple[Path, ...]
    size: int


def find_leftovers(folder: Path = SHARED_MEMORY) -> Leftovers:
    """Look for segments that nobody owns any more; nothing is changed."""
    in_use, size = 0, 0
    abandoned: list[Path] = []
    for lock_file in sorted(folder.glob(f"fastrtps_*{LOCK_SUFFIX}")):
        segment = lock_file.with_name(lock_file.name[: -len(LOCK_SUFFIX)])
        if _is_locked(lock_file):
            in_use += 1
            continue
        abandoned += [path for path in (segment, lock_file) if path.exists()]
        with contextlib.suppress(OSError):
            size += segment.stat().st_size
    return Leftovers(in_use, tuple(abandoned), size)


def remove(leftovers: Leftovers) -> int:
    """Delete abandoned segments; return how many files could be."""
    removed = 0
    for path in leftovers.abandoned:
        with contextlib.suppress(OSError):
            path.unlink()
            removed += 1
    return removed


def _is_locked(path: Path) -> bool:
    """Tell whether a process holds the lock; an unreadable file counts as held, so that it is left alone."""
    try:
        with path.open("rb") as stream:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return True
    return False
