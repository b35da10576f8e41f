"""The Python packages: pinned by requirements.lock for the wheels way, by the sourced ROS's own where there is one."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from bootstrap.console import SetupError

# Needed to build where ROS is sourced; found already installed where colcon is.
BUILD_TOOLS = ("colcon-common-extensions>=0.3", "setuptools<80")

# Tried after installing beside a sourced ROS, whose NumPy these did not choose.
COMPILED = ("numpy", "scipy", "numba", "mujoco", "pinocchio", "coal", "ezc3d", "matplotlib.pyplot")

# Run by the new venv's Python: prints the requirements that what it already sees does not meet.
UNMET = """
import importlib.metadata, json, sys
from pip._vendor.packaging.requirements import Requirement
def version(name):
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None
unmet = []
for text in json.loads(sys.argv[1]):
    requirement = Requirement(text)
    present = version(requirement.name)
    if present is None or not requirement.specifier.contains(present, prereleases=True):
        unmet.append(text)
present = {d.metadata["Name"].lower().replace("_", "-"): d.version for d in importlib.metadata.distributions()}
print(json.dumps({"unmet": unmet, "present": present}))
"""


def declared_requirements(setup_file: Path) -> list[str]:
    """Return what setup.py declares in ``install_requires`` and in the extra ``test``, without running it.

    Raises:
        SetupError: The file has no such literal lists.
    """
    tree = ast.parse(setup_file.read_text())
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    for call in calls:
        keywords = {keyword.arg: keyword.value for keyword in call.keywords}
        if "install_requires" in keywords:
            runtime = ast.literal_eval(keywords["install_requires"])
            test = ast.literal_eval(keywords["extras_require"]).get("test", [])
            return [*runtime, *test]
    raise SetupError(f"{setup_file} declares no install_requires; restore it with: git checkout {setup_file.name}")


def locked_versions(lock_file: Path) -> dict[str, list[str]]:
    """Return the lines of a lock file by package name; a package may have one line for each range of Pythons."""
    lines: dict[str, list[str]] = {}
    for line in lock_file.read_text().splitlines():
        if match := re.match(r"([A-Za-z0-9][A-Za-z0-9._-]*)(\[[^]]*\])?==", line):
            lines.setdefault(canonical(match[1]), []).append(line)
    return lines


def ros_part(lock_file: Path) -> str:
    """Return the lines of the lock on which compiled messages depend."""
    versions = locked_versions(lock_file)
    names = sorted(name for name in versions if name.startswith("ros-") or name in ("numpy", "empy", "setuptools"))
    return "\n".join(line for name in names for line in versions[name])


def beside_sourced(lock_file: Path, unmet: Iterable[str], present: Mapping[str, str]) -> list[str]:
    """Return the lines of the lock to install beside a sourced ROS, without resolving anything anew.

    What is there stays as it is, unless the package asks for a newer one; what is missing comes from the lock. NumPy
    always stays, since the messages are compiled for its major version: some wheels ask for NumPy 2 and run with the
    1.26 of Jazzy all the same, which pip would refuse.

    Args:
        lock_file: The lock.
        unmet: Requirements that what is there does not meet.
        present: Versions of what is there, by canonical name.
    """
    wanted = {canonical(re.split(r"[<>=!~\[ ;]", text, maxsplit=1)[0]) for text in unmet}
    return [
        line
        for name, versions in locked_versions(lock_file).items()
        if not name.startswith("ros-") and (name not in present or (name in wanted and name != "numpy"))
        for line in versions
    ]


def complaints(check_output: str) -> set[str]:
    """Return the packages that ``pip check`` finds missing or of a wrong version; NumPy is never among them."""
    missing = re.findall(r"requires ([A-Za-z0-9._-]+), which is not installed", check_output)
    wrong = re.findall(r"has requirement ([A-Za-z0-9._-]+).*, but you have", check_output)
    return {canonical(name) for name in missing + wrong} - {"numpy"}


def canonical(name: str) -> str:
    """Return a package's name as PyPI compares names."""
    return re.sub(r"[-_.]+", "-", name).lower()
