"""Work on many alike things in equal parts, one a core: for kernels that let go of the interpreter's lock."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import TypeVar

import numpy as np

Answer = TypeVar("Answer")


def in_parts(count: int, work: Callable[[int, int], Answer], least: int) -> list[Answer]:
    """Return the answers of ``work`` on equal parts of ``range(count)``, in order.

    Args:
        count: Number of things.
        work: Is given the first place of a part and the one after its last.
        least: Number of things for which another thread pays.
    """
    parts = max(1, min(len(os.sched_getaffinity(0)), count // least))
    bounds = np.linspace(0, count, parts + 1).astype(int)
    pairs = list(zip(bounds[:-1].tolist(), bounds[1:].tolist()))
    if parts == 1:
        return [work(*pairs[0])]
    # The first part is done here: handing it over and waiting would take longer than many a part does.
    others = [_threads().submit(work, *pair) for pair in pairs[1:]]
    return [work(*pairs[0]), *(other.result() for other in others)]


@lru_cache(maxsize=1)
def _threads() -> ThreadPoolExecutor:
    """Return the threads, made once."""
    return ThreadPoolExecutor(max_workers=len(os.sched_getaffinity(0)), thread_name_prefix="parts")
