"""From the log of a program that failed to one line that says what to do."""

from __future__ import annotations

import re
from pathlib import Path

NETWORK = re.compile(
    r"name resolution|NewConnectionError|ConnectionError|Network is unreachable|No route to host|ConnectTimeout"
    r"|ReadTimeout|Read timed out|Connection (refused|reset|aborted)|ProxyError|Tunnel connection failed|Max retries"
    r"|Could not fetch URL|IncompleteRead|RemoteDisconnected|SSLError|CERTIFICATE_VERIFY",
    re.IGNORECASE,
)
DISK = re.compile(r"No space left on device|Disk quota exceeded|ENOSPC", re.IGNORECASE)
READ_ONLY = re.compile(r"Read-only file system|Permission denied", re.IGNORECASE)
MISSING = re.compile(r"No matching distribution found for (?P<name>\S+)")
NO_COMPILER = re.compile(r"No CMAKE_(C|CXX)_COMPILER could be found|is not able to compile a simple test program")
NO_HEADERS = re.compile(r"Python\.h: No such file|Could NOT find Python3[^\n]*Development", re.IGNORECASE)
MEMORY = re.compile(r"Killed signal terminated program|cannot allocate memory|MemoryError", re.IGNORECASE)


def explain(what: str, log: Path, status: int) -> str:
    """Return one line for a failed step: the cause if it is a known one, the remedy, and where the log is.

    Args:
        what: The step, for people.
        log: Everything the program printed.
        status: Its exit status.
    """
    try:
        text = log.read_text(errors="replace")
    except OSError:
        text = ""
    see = f"(log: {log})"
    if DISK.search(text):
        return f"{what}: the disk is full; free 3 GB, or set HANDOVER_HOME to a folder on another disk {see}"
    if NETWORK.search(text):
        remedy = "connect to a network (behind a proxy: set HTTPS_PROXY, PIP_INDEX_URL, PIP_CERT) and run this again"
        return f"{what}: the package index cannot be reached; {remedy} {see}"
    if missing := MISSING.search(text):
        remedy = "use Python 3.12 (HANDOVER_PYTHON=python3.12) or check PIP_INDEX_URL"
        return f"{what}: the package index has no {missing['name']} for this Python; {remedy} {see}"
    if NO_COMPILER.search(text):
        return f"{what}: the C++ compiler does not work; apt-get install g++ {see}"
    if NO_HEADERS.search(text):
        return f"{what}: the C headers of Python are missing; apt-get install python3-dev {see}"
    if MEMORY.search(text) or status in (-9, 137):
        return f"{what}: the machine ran out of memory; free 2 GB and run this again {see}"
    if READ_ONLY.search(text):
        return f"{what}: a folder cannot be written; set HANDOVER_HOME to one that can {see}"
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    places = [number for number, line in enumerate(lines) if re.search(r"\berror\b", line, re.IGNORECASE)]
    start = places[0] if places else max(0, len(lines) - 1)
    cause = " ".join(lines[start : start + 2 if lines[start : start + 1] and lines[start].endswith(":") else start + 1])
    return f"{what} failed with exit status {status}: {cause[:200] or 'it printed nothing'} {see}"
