"""``./handover doctor``: what is installed, what is missing, what to type.

It works before anything is set up, changes nothing (but for ``--clean``) and needs no network (but for ``--network``).
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from bootstrap.console import SetupError
from bootstrap.environment import cell_environment
from bootstrap.needs import (
    DISK_NEEDED,
    DISK_NEEDED_BUILD,
    Need,
    build_tool_needs,
    compiler_need,
    disk_need,
    headers_need,
    missing_graphics,
    platform_need,
    python_need,
)
from bootstrap.prepare import describe, find_setup
from bootstrap.shared_memory import SHARED_MEMORY, find_leftovers, remove
from bootstrap.steps import Setup

SHARED_MEMORY_NEEDED = 0.03  # [GB]; a process of the graph takes 0.6 MB, pictures pass through it
GL_PACKAGES = "apt-get install libegl1 libopengl0 libgl1-mesa-dri"

# Run by the prepared Python: what the cell cannot do without, each with its version.
IMPORTS = """
import importlib, json
answer = {}
for name in ("rclpy", "handover_msgs.msg", "handover_msgs.srv", "handover_msgs.action", "numpy", "scipy", "numba",
             "mujoco", "pinocchio", "pydantic", "rosbags", "handover_ros"):
    try:
        module = importlib.import_module(name)
        answer[name] = [True, str(getattr(module, "__version__", ""))]
    except Exception as error:
        answer[name] = [False, f"{type(error).__name__}: {error}"]
print("IMPORTS" + json.dumps(answer))
"""
FIRST = "import os; os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(10))"
RENDER = "import mujoco; context = mujoco.GLContext(64, 64); context.make_current(); context.free(); print('drawn')"


def doctor(arguments: list[str], source: Path) -> int:
    """Print the table; return 0 if the cell can run (or can be set up and then run), 1 if not, 2 on bad input."""
    parser = argparse.ArgumentParser(prog="./handover doctor", description=__doc__.splitlines()[0])
    parser.add_argument("--json", metavar="FILE", type=Path, help="write the result as JSON")
    parser.add_argument("--network", action="store_true", help="also try to reach the package index")
    parser.add_argument("--clean", action="store_true", help="delete shared memory that killed processes have left")
    options = parser.parse_args(arguments)
    setup = find_setup(source)
    checks = examine(setup, network=options.network, clean=options.clean)
    required = [check for check, is_required in checks if is_required]
    well = all(check.found for check in required)
    _print_table(checks)
    outstanding = [step.title for step in setup.outstanding()]
    if not well:
        verdict = "The cell cannot run; do what stands at the right of MISSING, then ask again."
    elif outstanding:
        verdict = "Nothing is missing; the next ./handover command sets up first."
    else:
        verdict = "The cell can run: ./handover demo"
    print(verdict)
    if options.json:
        result = {
            "command": "doctor",
            "ok": well,
            "seed": None,
            "versions": {"python": platform.python_version(), "ros": describe(setup.ros)},
            "metrics": {
                "missing": sum(not check.found for check in required),
                "warnings": sum(not check.found for check, is_required in checks if not is_required),
                "steps_outstanding": len(outstanding),
            },
            "claims": [],
            "files": [],
            "checks": [
                {
                    "name": check.name,
                    "ok": check.found,
                    "required": is_required,
                    "detail": check.detail,
                    "remedy": check.remedy,
                }
                for check, is_required in checks
            ],
        }
        try:
            options.json.write_text(json.dumps(result, indent=2) + "\n")
        except OSError as error:
            raise SetupError(f"--json {options.json}: {error.strerror}; name a file that can be written") from error
    return 0 if well else 1


def examine(setup: Setup, network: bool = False, clean: bool = False) -> list[tuple[Need, bool]]:
    """Return every check with whether the cell needs it."""
    layout = setup.layout
    outstanding = {step.name for step in setup.outstanding()}
    building = "messages" in outstanding
    checks = [(platform_need(), True), (python_need(), "venv" in outstanding)]
    checks += [(need, building) for need in (headers_need(), compiler_need(), *build_tool_needs())]
    needed = DISK_NEEDED if outstanding & {"venv", "packages"} else DISK_NEEDED_BUILD if outstanding else 0.05
    checks.append((disk_need(layout.state, needed), True))
    checks.append((Need("ROS", True, describe(setup.ros)), True))
    checks.append((_state(setup, outstanding), False))
    if not outstanding & {"venv", "packages"}:
        checks += [(need, need.name != "imports handover_msgs" or not building) for need in _imports(setup)]
    checks += [(_rendering(setup, outstanding), False), (_shared_memory(clean), True), (_leftovers(), False)]
    checks += [(_middleware(), False), (_priorities(), False), (_recordings(layout.source), False)]
    if network:
        checks.append((_network(), bool(outstanding & {"venv", "packages"})))
    return checks


def _state(setup: Setup, outstanding: set[str]) -> Need:
    folder = setup.layout.root
    if not outstanding:
        return Need("set-up", True, f"complete in {folder}")
    if not setup.stamps.values:
        return Need("set-up", False, f"not done yet (goes to {folder})", "./handover setup")
    return Need("set-up", False, f"outstanding: {', '.join(sorted(outstanding))}", "./handover setup")


def _imports(setup: Setup) -> list[Need]:
    answer = _ask(setup, IMPORTS)
    lines = [line for line in answer.stdout.splitlines() if line.startswith("IMPORTS")]
    remedy = f"rm -r {setup.layout.root}; ./handover setup"
    if not lines:
        detail = (answer.stderr.strip().splitlines() or [f"exit status {answer.returncode}"])[-1]
        return [Need("python packages", False, detail[:120], remedy)]
    found = json.loads(lines[0][len("IMPORTS") :])
    messages = {name: found.pop(name) for name in list(found) if name.startswith("handover_msgs")}
    bad = {name: text for name, (works, text) in found.items() if not works}
    bad_messages = [text for works, text in messages.values() if not works]
    versions = ", ".join(f"{name} {text}".strip() for name, (works, text) in found.items() if works)
    detail = "; ".join(f"{name}: {text}" for name, text in bad.items()) if bad else versions
    message_detail = bad_messages[0] if bad_messages else "messages, services, actions"
    return [
        Need("imports python", not bad, detail, remedy),
        Need("imports handover_msgs", not bad_messages, message_detail, remedy),
    ]


def _rendering(setup: Setup, outstanding: set[str]) -> Need:
    """Pictures are drawn without a screen; the graph runs without them."""
    if missing := missing_graphics():
        return Need("rendering", False, f"no {missing}; the cell runs without pictures", GL_PACKAGES)
    if outstanding & {"venv", "packages"}:
        return Need("rendering", True, "EGL and OpenGL are there; not tried yet")
    answer = _ask(setup, RENDER)
    if "drawn" in answer.stdout:
        return Need("rendering", True, f"MuJoCo draws with MUJOCO_GL={os.environ.get('MUJOCO_GL', 'egl')}")
    detail = (answer.stderr.strip().splitlines() or [f"exit status {answer.returncode}"])[-1]
    return Need("rendering", False, detail[:120], GL_PACKAGES)


def _shared_memory(clean: bool) -> Need:
    if clean:
        count = remove(find_leftovers())
        print(f"deleted {count} files of abandoned shared memory")
    if not os.access(SHARED_MEMORY, os.W_OK):
        return Need("shared memory", False, f"{SHARED_MEMORY} cannot be written", "mount -t tmpfs tmpfs /dev/shm")
    free = shutil.disk_usage(SHARED_MEMORY).free / 1e9
    remedy = "./handover doctor --clean, or a bigger one (docker run --shm-size=256m)"
    enough = free >= SHARED_MEMORY_NEEDED
    return Need("shared memory", enough, f"{free:.2f} GB free in {SHARED_MEMORY}", "" if enough else remedy)


def _leftovers() -> Need:
    left = find_leftovers()
    if not left.abandoned:
        return Need("left behind", True, f"nothing ({left.in_use} segments in use)")
    detail = f"{len(left.abandoned)} files of killed processes, {left.size / 1e6:.1f} MB ({left.in_use} in use)"
    return Need("left behind", False, detail, "./handover doctor --clean")


def _middleware() -> Need:
    names = ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "RMW_IMPLEMENTATION", "FASTRTPS_DEFAULT_PROFILES_FILE")
    own = ", ".join(f"{name}={os.environ[name]}" for name in names if name in os.environ)
    profile = os.environ.get("FASTRTPS_DEFAULT_PROFILES_FILE", "")
    if profile and not Path(profile).is_file():
        return Need("middleware", False, f"no file {profile}", "unset FASTRTPS_DEFAULT_PROFILES_FILE")
    return Need("middleware", True, own or "domain 0, this machine only, config/fastdds.xml")


def _priorities() -> Need:
    """Streams may come first on a busy machine; the graph runs without that."""
    answer = subprocess.run([sys.executable, "-c", FIRST], capture_output=True, check=False, timeout=60)
    if answer.returncode == 0:
        return Need("priorities", True, "streams may come first (SCHED_RR)")
    user = os.environ.get("USER", "USER")
    remedy = f"a line '{user} - rtprio 20' in /etc/security/limits.conf, then log in again"
    return Need("priorities", False, "streams may not come first; states are later on a busy machine", remedy)


def _recordings(source: Path) -> Need:
    own = os.environ.get("HANDOVER_RECORDINGS", "")
    folder = Path(own) if own else source.parent / "shared" / "data"
    if folder.is_dir():
        return Need("recordings", True, str(folder))
    return Need("recordings", False, f"no {folder}; their tests are skipped", "set HANDOVER_RECORDINGS to your folder")


def _network() -> Need:
    with tempfile.TemporaryDirectory() as folder:
        command = [
            sys.executable,
            "-m",
            "pip",
            "download",
            "--no-deps",
            "--no-cache-dir",
            "--no-input",
            "--retries",
            "1",
        ]
        try:
            answer = subprocess.run(
                [*command, "--timeout", "10", "-d", folder, "iniconfig==2.3.1"],
                capture_output=True,
                text=True,
                timeout=60,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return Need("network", False, "no answer in 60 s", "connect to a network, or set HTTPS_PROXY")
    if answer.returncode == 0:
        return Need("network", True, "the package index answers")
    detail = (answer.stderr.strip().splitlines() or ["no answer"])[-1]
    return Need("network", False, detail[:120], "connect to a network, or set HTTPS_PROXY, PIP_INDEX_URL, PIP_CERT")


def _ask(setup: Setup, program: str) -> subprocess.CompletedProcess[str]:
    environment = cell_environment(setup.layout, setup.ros)
    command = [str(setup.layout.python), "-c", program]
    try:
        return subprocess.run(
            command, capture_output=True, text=True, env=environment, cwd="/", timeout=120, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return subprocess.CompletedProcess(command, 1, "", str(error))


def _print_table(checks: list[tuple[Need, bool]]) -> None:
    width = max(len(check.name) for check, _ in checks)
    for check, is_required in checks:
        mark = "ok     " if check.found else "MISSING" if is_required else "note   "
        remedy = f"  ->  {check.remedy}" if check.remedy and not check.found else ""
        print(f"{mark}  {check.name:<{width}}  {check.detail}{remedy}")
