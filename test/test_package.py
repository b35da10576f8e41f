"""The package as others build it: manifests, lock, entry points, launch file, and a plain colcon build."""

import ast
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

from bootstrap.requirements import canonical, declared_requirements, locked_versions
from handover_ros.bags.replay import INPUTS
from handover_ros.cell.processes import EXTRA_NODES, NODES, RECORDER

SOURCE = Path(__file__).resolve().parent.parent
PYTHONS = ("3.10", "3.11", "3.12", "3.13", "3.14")
STANDARD = set(sys.stdlib_module_names)
# Where the name to import is not the name to install.
DISTRIBUTIONS = {
    "pinocchio": "pin",
    "coal": "pin",
    "yaml": "pyyaml",
    "PIL": "pillow",
    "mpl_toolkits": "matplotlib",
    "markdown_it": "markdown-it-py",
}


def python_files(*folders):
    return [path for folder in folders for path in sorted((SOURCE / folder).rglob("*.py"))]


def imported_modules(paths):
    """Return the top-level names that files import, at module level or later."""
    names = set()
    for path in paths:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names.add(node.module.split(".")[0])
    return names


def setup_constant(name):
    """Return a literal that setup.py assigns at module level."""
    for node in ast.parse((SOURCE / "setup.py").read_text()).body:
        if isinstance(node, ast.Assign) and node.targets[0].id == name:
            return ast.literal_eval(node.value)
    raise AssertionError(f"setup.py has no {name}")


def manifest(path):
    return ElementTree.parse(path).getroot()


def locked(name, python):
    """Return the version that the lock gives a package under one Python; None if it is not installed there."""
    environment = {
        "python_version": python,
        "python_full_version": f"{python}.0",
        "sys_platform": "linux",
        "platform_system": "Linux",
        "platform_machine": "x86_64",
        "implementation_name": "cpython",
        "platform_python_implementation": "CPython",
        "os_name": "posix",
        "extra": "",
    }
    requirements = [Requirement(line) for line in locked_versions(SOURCE / "requirements.lock").get(name, [])]
    fitting = [each for each in requirements if each.marker is None or each.marker.evaluate(environment)]
    assert len(fitting) <= 1, f"{name} is locked twice for Python {python}"
    return Version(str(fitting[0].specifier).removeprefix("==")) if fitting else None


# Requirements.


@pytest.mark.parametrize("python", PYTHONS)
def test_lock_has_every_requirement_in_its_range(python):
    """What setup.py and requirements.in ask for is in the lock, for every supported Python."""
    direct = [Requirement(text) for text in declared_requirements(SOURCE / "setup.py")]
    lines = (SOURCE / "requirements.in").read_text().splitlines()
    direct += [Requirement(line) for line in lines if line and not line.startswith("#")]
    for requirement in direct:
        version = locked(canonical(requirement.name), python)
        assert version is not None, f"{requirement} is not locked for Python {python}"
        assert version in requirement.specifier, f"{requirement} is locked at {version} for Python {python}"


def test_lock_pins_exactly_and_names_no_place():
    for line in (SOURCE / "requirements.lock").read_text().splitlines():
        assert re.match(r"\s*#|[A-Za-z0-9._-]+(\[[a-z,]+\])?==[^ ]+( ; .+)?$", line), line
        assert "://" not in line


def test_numpy_of_apt_jazzy_is_allowed():
    """Jazzy's messages are compiled for NumPy 1.26; our ranges must not shut it out."""
    ranges = {
        canonical(Requirement(text).name): Requirement(text) for text in declared_requirements(SOURCE / "setup.py")
    }
    assert "1.26.4" in ranges["numpy"].specifier
    assert "1.11.4" in ranges["scipy"].specifier


def test_every_import_is_declared():
    """A third-party module that the package imports stands in setup.py, a ROS package in package.xml."""
    declared = {canonical(Requirement(text).name) for text in declared_requirements(SOURCE / "setup.py")}
    ros = {element.text for element in manifest(SOURCE / "package.xml") if element.tag.endswith("depend")}
    for module in imported_modules(python_files("handover_ros")) - STANDARD - {"handover_ros"}:
        name = DISTRIBUTIONS.get(module, canonical(module))
        assert name in declared or module in ros, f"{module} is imported, but neither setup.py nor package.xml has it"


def test_bootstrap_needs_only_the_standard_library():
    names = imported_modules([*python_files("bootstrap"), SOURCE / "handover"])
    assert names - STANDARD == {"bootstrap"}


# Manifests.


def test_manifests_agree():
    ours, messages = manifest(SOURCE / "package.xml"), manifest(SOURCE / "msg_defs" / "package.xml")
    assert ours.findtext("name") == "handover_ros"
    assert messages.findtext("name") == "handover_msgs"
    assert ours.findtext("version") == messages.findtext("version")
    assert f'version="{ours.findtext("version")}"' in (SOURCE / "setup.py").read_text()
    for root in (ours, messages):
        assert re.fullmatch(r"[^@\s]+@[^@\s]+\.[a-z]+", root.find("maintainer").get("email"))


def test_message_packages_used_by_messages_are_declared():
    root = manifest(SOURCE / "msg_defs" / "package.xml")
    declared = {element.text for element in root if element.tag.endswith("depend")}
    cmake = (SOURCE / "msg_defs" / "CMakeLists.txt").read_text()
    for path in (SOURCE / "msg_defs").glob("*/*.*"):
        for package in re.findall(r"^([a-z_]+)/[A-Z]\w+", path.read_text(), re.MULTILINE):
            assert package == "handover_msgs" or package in declared, f"{path.name}: {package} not in package.xml"
            assert package == "handover_msgs" or f"find_package({package} " in cmake


def test_every_node_is_an_executable_of_its_own_name():
    for node in setup_constant("NODES"):
        module = importlib.util.find_spec(f"handover_ros.nodes.{node}")
        assert module is not None, f"setup.py names {node}, which is no module"
        body = ast.parse(Path(module.origin).read_text()).body
        names = {getattr(each, "name", "") for each in body}
        assigned = [target for each in body if isinstance(each, ast.Assign) for target in each.targets]
        names |= {target.id for target in assigned if isinstance(target, ast.Name)}
        assert "main" in names


def launch_constant(file, name):
    """Return a constant of a launch file, which cannot be imported where ROS has no ``launch``."""
    tree = ast.parse((SOURCE / "launch" / file).read_text())
    values = [node.value for node in tree.body if isinstance(node, ast.Assign) and node.targets[0].id == name]
    return ast.literal_eval(values[0])


def test_launch_file_starts_every_node():
    assert launch_constant("cell.launch.py", "NODES") == NODES
    assert setup_constant("NODES") == [*NODES, *EXTRA_NODES]
    text = (SOURCE / "launch" / "cell.launch.py").read_text()
    assert f'executable="{RECORDER}"' in text, "it records, as ./handover up does"


def test_launch_file_of_a_replay_starts_what_a_bag_can_drive():
    assert launch_constant("replay.launch.py", "DRIVABLE") == tuple(INPUTS)


def test_parameter_files_belong_to_nodes():
    files = {path.stem for path in (SOURCE / "config").glob("*_node.yaml")}
    assert files == set(setup_constant("NODES"))


@pytest.mark.parametrize(("file", "count"), [("cell", len(NODES) + 1), ("replay", 4), ("hardware", 0)])
def test_launch_description_can_be_made(monkeypatch, file, count):
    """Where ROS brings ``launch`` (apt), the description is built for real."""
    pytest.importorskip("launch_ros", reason="launch_ros is not on PyPI")
    specification = importlib.util.spec_from_file_location(f"{file}_launch", SOURCE / "launch" / f"{file}.launch.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    monkeypatch.setattr(module, "get_package_share_directory", lambda _: str(SOURCE))
    from launch.actions import DeclareLaunchArgument

    from launch import LaunchContext

    context = LaunchContext()
    context.launch_configurations["bag"] = "/a/bag"
    for action in module.generate_launch_description().entities:
        if isinstance(action, DeclareLaunchArgument):
            action.visit(context)
    if count:
        assert len(module.start_nodes(context)) == count


# A plain colcon build.


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Build handover_ros with colcon in a copy of the source, as in anybody's workspace."""
    if importlib.util.find_spec("colcon_core") is None:
        pytest.skip("colcon is not installed")
    folder = tmp_path_factory.mktemp("workspace")
    names = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"], cwd=SOURCE, capture_output=True, text=True, check=False
    ).stdout.split("\n")
    if names == [""]:
        pytest.skip("not a git clone")
    for name in names:
        if (SOURCE / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(SOURCE / name, folder / name)
    command = [sys.executable, "-m", "colcon", "build", "--base-paths", ".", "msg_defs"]
    answer = subprocess.run(
        [*command, "--packages-select", "handover_ros"],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": without_source(os.environ.get("PYTHONPATH", ""))},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert answer.returncode == 0, answer.stdout + answer.stderr
    return folder / "install" / "handover_ros"


def without_source(path):
    """Return a search path without the source and set-up's links to it."""
    return os.pathsep.join(
        part for part in path.split(os.pathsep) if part and not (Path(part) / "handover_ros").is_dir()
    )


def test_colcon_installs_nodes_and_data(installed):
    scripts = {path.name for path in (installed / "lib" / "handover_ros").iterdir()}
    assert scripts == {*setup_constant("NODES"), "handover"}
    share = installed / "share" / "handover_ros"
    assert (installed / "share/ament_index/resource_index/packages/handover_ros").is_file()
    for folder in ("config", "launch"):
        ours = {
            path.relative_to(SOURCE) for path in (SOURCE / folder).rglob("*") if path.suffix in (".yaml", ".py", ".xml")
        }
        assert ours <= {path.relative_to(share) for path in share.rglob("*")}
    packages = next(installed.glob("lib/python3.*/site-packages"))
    assert not list(packages.glob("bootstrap*")), "the bootstrap is no part of the installed package"


def test_installed_node_runs_on_its_own_data(installed):
    """``ros2 run`` starts this very file; it reads the installed configuration and refuses a misspelt parameter."""
    packages = next(installed.glob("lib/python3.*/site-packages"))
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(packages), without_source(os.environ.get("PYTHONPATH", ""))]),
        "AMENT_PREFIX_PATH": os.pathsep.join([str(installed), os.environ.get("AMENT_PREFIX_PATH", "")]),
    }
    where = "from handover_ros.resources import config_directory as c; print(c())"
    command = [sys.executable, "-c", where]
    answer = subprocess.run(command, env=environment, capture_output=True, text=True, cwd="/", timeout=60, check=True)
    assert answer.stdout.strip() == str(installed / "share" / "handover_ros" / "config")
    pytest.importorskip("rclpy", reason="ROS is not there")
    pytest.importorskip("handover_msgs", reason="handover_msgs is not built")
    command = [str(installed / "lib" / "handover_ros" / "mocap_node"), "--ros-args", "-p", "marker_sett:=x"]
    answer = subprocess.run(command, env=environment, capture_output=True, text=True, cwd="/", timeout=120, check=False)
    assert answer.returncode == 2, answer.stderr
    assert "marker_sett" in answer.stderr
    assert "Traceback" not in answer.stderr
