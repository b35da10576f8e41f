"""Who comes first on a busy machine: streams and the control of the robot before plans."""

from __future__ import annotations

import contextlib
import os
import threading
from pathlib import Path

from handover_ros.nodes.parameters import ParameterSpec
from handover_ros.nodes.runtime import WORKER

NICE = -10
PRIORITY = ParameterSpec(
    "realtime_priority",
    10,
    "with the kernel (SCHED_RR) of all but long work, if the user may set it; 0: like any process",
    0,
    99,
)


def come_first(priority: int) -> str:
    """Have the kernel run this process before others, as far as it is allowed to; return how it is run, in words.

    Its worker, which does what takes long, stays behind.

    A frame takes well under a millisecond of work, but waits for several when a plan is computed on every core. The
    right to set it comes from ``rtprio`` or ``nice`` in ``/etc/security/limits.conf``, or ``CAP_SYS_NICE``.

    Args:
        priority: 1 to 99; 0: nothing is changed.
    """
    workers = {thread.native_id for thread in threading.enumerate() if thread.name.endswith(WORKER)}
    threads = [int(task.name) for task in Path("/proc/self/task").glob("*") if int(task.name) not in workers]
    if not priority or not threads:
        return "as any process"
    try:
        for thread in threads:  # those of the middleware too; later ones are like who makes them
            with contextlib.suppress(ProcessLookupError):
                os.sched_setscheduler(thread, os.SCHED_RR, os.sched_param(priority))
        return f"real time, priority {priority}"
    except (OSError, AttributeError):
        pass
    try:
        for thread in threads:
            with contextlib.suppress(ProcessLookupError):
                os.setpriority(os.PRIO_PROCESS, thread, NICE)
        return f"nice {NICE}"
    except OSError:
        return "as any process: the user may not set priorities (see rtprio in limits.conf)"
