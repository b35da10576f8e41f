"""Other people's programs to measure against: installed on first use in a folder of their own, never in the cell's."""

from __future__ import annotations

import importlib
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType


@dataclass(frozen=True)
class Peer:
    """Another program.

    Attributes:
        module: What is imported of it.
        requirements: What is installed, the program first; nothing else, for the cell has the rest of what they need.
    """

    module: str
    requirements: tuple[str, ...]


PEERS = {  # as in setup.py, extra "bench"; by the folder they install
    "biorbd": Peer("biorbd", ("biorbd==1.12.4",)),
    "eaik": Peer("eaik.IK_HP", ("EAIK==1.2.2",)),
    "ssik": Peer("ssik", ("ssik==8.2.0", "cython==3.3.1")),
}


def peer(name: str) -> ModuleType | None:
    """Return a peer's module, installed if need be; None, with one line, where it cannot be had."""
    folder = Path(sys.prefix).parent / "peers"
    wanted = PEERS[name]
    if not (folder / name).is_dir():
        print(f"installing {' and '.join(wanted.requirements)} into {folder} ...", flush=True)
        options = ["--quiet", "--no-input", "--disable-pip-version-check", "--retries", "1", "--no-deps"]
        command = [sys.executable, "-m", "pip", "install", *options, "--target", str(folder), *wanted.requirements]
        answer = subprocess.run(command, capture_output=True, text=True, check=False)
        if answer.returncode:
            reason = (answer.stderr.strip().splitlines() or ["pip failed"])[-1]
            print(f"without {name}: it cannot be installed here ({reason})", flush=True)
            return None
    if str(folder) not in sys.path:
        sys.path.append(str(folder))
    try:
        return importlib.import_module(wanted.module)
    except ImportError as error:
        print(f"without {name}: it does not load here ({error})", flush=True)
        return None
