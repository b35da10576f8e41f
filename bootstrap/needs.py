"""What a machine must have before set-up starts, and which one line to say when it has not."""

from __future__ import annotations

import ctypes
import importlib.util
import os
import platform
import shutil
import sysconfig
from dataclasses import dataclass
from pathlib import Path

DISK_NEEDED = 3.0  # [GB] the wheels way takes 2.0 GB, plus what pip unpacks on the way
DISK_NEEDED_SOURCED = 1.5  # [GB]
DISK_NEEDED_BUILD = 0.2  # [GB] messages and package only
OLDEST_GLIBC = (2, 28)  # the wheels are manylinux_2_28


@dataclass(frozen=True)
class Need:
    """One thing a machine must have.

    Attributes:
        name: What it is.
        found: Whether it is there.
        detail: What was found, or what is wrong.
        remedy: What to type; empty if nothing needs doing.
    """

    name: str
    found: bool
    detail: str
    remedy: str = ""


def platform_need() -> Need:
    """Linux on x86-64 with a glibc for which there are wheels."""
    library, version = platform.libc_ver()
    detail = f"{platform.system()} {platform.machine()}, {library or 'unknown C library'} {version}".strip()
    numbers = tuple(int(part) for part in version.split(".") if part.isdigit())
    fits = platform.system() == "Linux" and platform.machine() == "x86_64"
    fits = fits and library == "glibc" and numbers >= OLDEST_GLIBC
    remedy = "" if fits else "use x86-64 Linux with glibc 2.28 or newer (Debian 10, Ubuntu 20.04, RHEL 8 or newer)"
    return Need("platform", fits, detail, remedy)


def python_need() -> Need:
    """A Python with venv, pip and its C headers."""
    version = platform.python_version()
    short = ".".join(version.split(".")[:2])
    if not importlib.util.find_spec("venv") or not importlib.util.find_spec("ensurepip"):
        return Need("python", False, f"Python {version} has no venv", f"apt-get install python{short}-venv")
    return Need("python", True, version)


def headers_need() -> Need:
    """The C headers of the running Python, against which the messages are compiled."""
    header = Path(sysconfig.get_path("include")) / "Python.h"
    if header.is_file():
        return Need("python headers", True, str(header.parent))
    short = ".".join(platform.python_version().split(".")[:2])
    return Need("python headers", False, f"no {header}", f"apt-get install python{short}-dev")


def compiler_need() -> Need:
    """A C and a C++ compiler, which CMake finds by itself."""
    compilers = {"C": ("CC", "cc", "gcc", "clang"), "C++": ("CXX", "c++", "g++", "clang++")}
    found = {}
    for language, (variable, *names) in compilers.items():
        own = os.environ.get(variable, "").split()
        found[language] = next((path for path in map(shutil.which, [*own[:1], *names]) if path), "")
    missing = [language for language, path in found.items() if not path]
    if missing:
        return Need("compiler", False, f"no {' or '.join(missing)} compiler", "apt-get install g++")
    return Need("compiler", True, found["C++"])


def build_tool_needs() -> list[Need]:
    """CMake and make."""
    return [
        Need(name, True, path)
        if (path := shutil.which(name))
        else Need(name, False, f"no {name}", f"apt-get install {name}")
        for name in ("cmake", "make")
    ]


def missing_graphics() -> str:
    """Return what keeps pictures from being drawn without a screen; empty if nothing does.

    MuJoCo, told to use EGL, cannot even be imported without these libraries.
    """
    missing = []
    for names in (("libEGL.so.1",), ("libOpenGL.so.0", "libGL.so.1")):
        if not any(_loads(name) for name in names):
            missing.append(" or ".join(names))
    return " and ".join(missing)


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def disk_need(folder: Path, needed: float) -> Need:
    """Room on the disk of a folder that may not exist yet [GB]."""
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    free = shutil.disk_usage(existing).free / 1e9
    detail = f"{free:.1f} GB free for {folder}"
    if free >= needed:
        return Need("disk", True, detail)
    remedy = f"free {needed - free:.1f} GB more, or set HANDOVER_HOME to a folder on another disk"
    return Need("disk", False, f"{detail}, {needed:.1f} GB needed", remedy)


def combined(missing: list[Need]) -> str:
    """Return one line for everything that is missing; packages to install become one command."""
    install = "apt-get install "
    packages = [need.remedy[len(install) :] for need in missing if need.remedy.startswith(install)]
    remedies = [install + " ".join(packages)] if packages else []
    remedies += [need.remedy for need in missing if not need.remedy.startswith(install)]
    return f"{', '.join(need.detail for need in missing)}; {'; '.join(remedies)}"
