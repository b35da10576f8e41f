"""Set-up by ./handover: what it decides, what it says, and that it leaves nothing half done."""

import ast
import fcntl
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bootstrap.cmake_paths import mend_cmake_files
from bootstrap.console import SetupError, Step
from bootstrap.environment import cell_environment, joined, without
from bootstrap.failures import explain
from bootstrap.layout import UNFINISHED, Layout, Stamps, choose_state, digest
from bootstrap.needs import Need, combined, disk_need
from bootstrap.prepare import find_setup, setup_lock
from bootstrap.process import run_logged
from bootstrap.requirements import beside_sourced, canonical, complaints
from bootstrap.ros import find_sourced
from bootstrap.shared_memory import find_leftovers, remove

SOURCE = Path(__file__).resolve().parent.parent


def run_handover(arguments, tmp_path, **changes):
    """Run ./handover with an empty set-up folder of its own and no ROS around it."""
    environment = {
        name: value
        for name, value in os.environ.items()
        if name not in ("AMENT_PREFIX_PATH", "PYTHONPATH", "LD_LIBRARY_PATH", "ROS_DISTRO", "HANDOVER_PYTHON")
    }
    environment.update(HANDOVER_HOME=str(tmp_path / "state"), **changes)
    return subprocess.run(
        [sys.executable, str(SOURCE / "handover"), *arguments],
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        cwd=tmp_path,
        check=False,
    )


# The entry script.


def test_entry_script_parses_in_python_3_6():
    """An old Python must get as far as the line that says it is too old."""
    ast.parse((SOURCE / "handover").read_text(), feature_version=(3, 6))


@pytest.mark.parametrize("version", [(3, 6, 15), (3, 9, 18), (3, 15, 0)])
def test_unsupported_python_gets_one_line(version, tmp_path):
    """With no supported Python on PATH: exit status 2 and what to install."""
    script = SOURCE / "handover"
    program = f"import sys; sys.version_info = {version}; sys.argv = ['handover', 'demo']; __file__ = {str(script)!r}; "
    program += "exec(compile(open(__file__).read(), __file__, 'exec'))"
    answer = subprocess.run(
        [sys.executable, "-c", program],
        env={"PATH": str(tmp_path), "HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert answer.returncode == 2
    assert len(answer.stderr.splitlines()) == 1
    assert f"Python 3.{version[1]} is not supported; install Python 3.10 to 3.14" in answer.stderr


def test_bad_handover_python_gets_one_line(tmp_path):
    answer = run_handover(["doctor"], tmp_path, HANDOVER_PYTHON="/no/such/python")
    assert answer.returncode == 2
    assert "HANDOVER_PYTHON is '/no/such/python'" in answer.stderr


def test_missing_compiler_is_said_before_anything_is_made(tmp_path):
    answer = run_handover(["demo"], tmp_path, PATH=str(tmp_path), CC="", CXX="")
    assert answer.returncode == 2
    assert answer.stderr.splitlines() == [
        "handover: cannot set up: no C or C++ compiler, no cmake, no make; apt-get install g++ cmake make"
    ]
    assert not (tmp_path / "state" / "venv").exists()


def test_help_needs_no_set_up(tmp_path):
    answer = run_handover(["--help"], tmp_path)
    assert answer.returncode == 0
    assert "demo" in answer.stdout
    assert not (tmp_path / "state").exists()


def test_doctor_before_set_up_changes_nothing_and_writes_json(tmp_path):
    report = tmp_path / "doctor.json"
    answer = run_handover(["doctor", "--json", str(report)], tmp_path)
    result = json.loads(report.read_text())
    assert answer.returncode == (0 if result["ok"] else 1)
    assert {"command", "ok", "seed", "versions", "metrics", "claims", "files", "checks"} <= set(result)
    assert {"platform", "python", "compiler", "cmake", "disk", "ROS", "set-up"} <= {c["name"] for c in result["checks"]}
    assert all(check["remedy"] for check in result["checks"] if not check["ok"])
    assert not (tmp_path / "state").exists()


def test_doctor_says_what_is_missing_and_fails(tmp_path):
    answer = run_handover(["doctor"], tmp_path, PATH=str(tmp_path), CC="", CXX="")
    assert answer.returncode == 1
    assert "apt-get install g++" in answer.stdout


def test_unknown_ros_choice_is_bad_input(tmp_path):
    answer = run_handover(["doctor"], tmp_path, HANDOVER_ROS="humble")
    assert answer.returncode == 2
    assert "HANDOVER_ROS is 'humble'; use auto, wheels or sourced" in answer.stderr


# Stamps and folders.


@given(st.lists(st.text()), st.lists(st.text()))
def test_digest_tells_different_lists_apart(first, second):
    assert (digest(first) == digest(second)) == (first == second)


def test_stamps_survive_any_damage(tmp_path):
    """A stamp file that cannot be read means that everything is outstanding, never an error."""
    path = tmp_path / "stamps.json"
    Stamps(path).set("venv", "one")
    assert Stamps(path).get("venv") == "one"
    for damage in (b"", b"{", b"[1]", b"\xff\xfe"):
        path.write_bytes(damage)
        assert Stamps(path).get("venv") == ""


def test_unfinished_packages_start_from_an_empty_environment(tmp_path, monkeypatch):
    """pip takes a half-installed package for an installed one, so an interrupted installation is not continued."""
    monkeypatch.setenv("HANDOVER_HOME", str(tmp_path))
    monkeypatch.setenv("HANDOVER_ROS", "wheels")
    setup = find_setup(SOURCE)
    setup.layout.python.parent.mkdir(parents=True)
    setup.layout.python.touch()
    for step in setup.outstanding():
        setup.stamps.set(step.name, step.stamp)
    assert setup.outstanding() == []
    setup.stamps.set("packages", "an older lock")
    assert [step.name for step in setup.outstanding()] == ["packages"]
    setup.stamps.set("packages", UNFINISHED)
    assert [step.name for step in setup.outstanding()] == ["venv", "packages", "messages", "package", "caches"]


def test_moved_clone_is_set_up_anew(tmp_path):
    stamps = set()
    for name in ("here", "there"):
        shutil.copytree(SOURCE / "msg_defs", tmp_path / name / "msg_defs")
        setup = find_setup(SOURCE)
        layout = Layout(tmp_path / name, tmp_path / name / ".handover")
        stamps.add(type(setup)(layout, None).venv_stamp())
    assert len(stamps) == 2


def test_read_only_source_uses_the_cache(tmp_path, monkeypatch):
    monkeypatch.delenv("HANDOVER_HOME", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert choose_state(tmp_path) == tmp_path / ".handover"
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert choose_state(tmp_path).parent == tmp_path / "cache" / "handover_ros"


def test_second_start_waits_with_a_line(tmp_path, capfd):
    """While another process sets up, the lock is held and the second one says so."""
    layout = Layout(SOURCE, tmp_path)
    setup = type(find_setup(SOURCE))(layout, None)
    program = "import fcntl, sys, time; f = open(sys.argv[1], 'w'); fcntl.flock(f, fcntl.LOCK_EX); f.write('4711'); "
    program += "f.flush(); print('held', flush=True); sys.stdin.readline()"
    holder = subprocess.Popen(
        [sys.executable, "-c", program, str(layout.lock_file)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout.readline() == "held\n"
    waiter = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import sys; from pathlib import Path; from bootstrap.layout import Layout; "
            "from bootstrap.prepare import setup_lock; from bootstrap.steps import Setup\n"
            "with setup_lock(Setup(Layout(Path(sys.argv[1]), Path(sys.argv[2])), None)): print('mine')",
            str(SOURCE),
            str(tmp_path),
        ],
        env={**os.environ, "PYTHONPATH": str(SOURCE)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert "process 4711) is setting up; waiting" in waiter.stderr.readline()
    holder.communicate("\n", timeout=30)
    assert waiter.communicate(timeout=30)[0] == "mine\n"
    with setup_lock(setup):
        assert setup.lock >= 0


# Programs that set-up runs.


def test_interrupt_ends_everything_a_step_has_started(tmp_path):
    """Ctrl-C in the middle of a step leaves none of its processes behind."""

    class Interrupting(Step):
        def tick(self):
            raise KeyboardInterrupt

    log = tmp_path / "log" / "step.log"
    command = ["sh", "-c", "sleep 600 & echo $!; sleep 600"]
    with pytest.raises(KeyboardInterrupt), (tmp_path / "lock").open("w") as lock:
        run_logged(command, log, dict(os.environ), Interrupting(1, 1, "step"), tmp_path, lock.fileno())
    grandchild = int(log.read_text())
    deadline = time.monotonic() + 10.0
    while is_running(grandchild) and time.monotonic() < deadline:
        os.sched_yield()
    assert not is_running(grandchild)


def is_running(process):
    """Tell whether a process exists and is more than an entry that nobody has collected."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.parametrize(
    ("log", "words"),
    [
        ("ERROR: Could not install packages: [Errno 28] No space left on device", "the disk is full"),
        ("WARNING: Retrying ... NewConnectionError: Temporary failure in name resolution", "connect to a network"),
        ("ERROR: No matching distribution found for mujoco==4.0.0", "no mujoco==4.0.0 for this Python"),
        ("CMake Error: No CMAKE_CXX_COMPILER could be found.", "apt-get install g++"),
        ("fatal error: Python.h: No such file or directory", "apt-get install python3-dev"),
        ("c++: fatal error: Killed signal terminated program cc1plus", "out of memory"),
        ("CMake Error in CMakeLists.txt:\n  includes a path that does not exist", "a path that does not exist"),
        ("", "it printed nothing"),
    ],
)
def test_failed_step_becomes_one_line_with_its_log(log, words, tmp_path):
    path = tmp_path / "packages.log"
    path.write_text(log)
    line = explain("installing packages", path, 1)
    assert words in line
    assert "\n" not in line
    assert str(path) in line


def test_what_is_missing_becomes_one_command():
    missing = [Need("a", False, "no a", "apt-get install a"), Need("b", False, "no b", "apt-get install b")]
    assert combined(missing) == "no a, no b; apt-get install a b"
    assert not disk_need(Path("/no/such/folder"), 1e9).found


def test_mending_cmake_files_is_complete_and_can_be_repeated(tmp_path):
    folder = tmp_path / "std_msgs" / "cmake"
    folder.mkdir(parents=True)
    text = 'INCLUDE "/opt/python/cp312-cp312/include/python3.12;/opt/python/cp312-cp312/lib/python3.12/site-packages/'
    (folder / "x.cmake").write_text(text + 'numpy/_core/include"')
    assert mend_cmake_files(tmp_path, "/py", "/np") == 1
    assert (folder / "x.cmake").read_text() == 'INCLUDE "/py;/np"'
    assert mend_cmake_files(tmp_path, "/py", "/np") == 0


# The environment of the cell's programs.


@given(st.lists(st.sampled_from(["/a", "/a/b", "/opt/ros/humble/lib", "/c"]), max_size=6))
def test_search_paths_keep_order_and_lose_foreign_folders(parts):
    kept = without(os.pathsep.join(parts), [Path("/opt/ros"), Path("/a")])
    assert kept == os.pathsep.join(part for part in parts if part == "/c")
    assert joined([Path("/z")], os.pathsep.join(parts)).split(os.pathsep) == list(dict.fromkeys(["/z", *parts]))


def test_operator_settings_are_kept_and_the_rest_is_safe(tmp_path, monkeypatch):
    layout = Layout(SOURCE, tmp_path)
    for name in ("ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE", "MUJOCO_GL", "NUMBA_CACHE_DIR"):
        monkeypatch.delenv(name, raising=False)
    environment = cell_environment(layout, None)
    assert environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert Path(environment["FASTRTPS_DEFAULT_PROFILES_FILE"]).is_file()
    assert environment["MUJOCO_GL"] in ("egl", "disabled")  # by whether the machine has EGL
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    environment = cell_environment(layout, None)
    assert environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SUBNET"
    assert environment["MUJOCO_GL"] == "osmesa"


def test_an_edit_of_any_kernel_moves_the_cache_of_all(tmp_path, monkeypatch):
    """Numba would keep a compiled caller when only a kernel of another file was edited."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    rooms = tmp_path / "handover_ros" / "skeleton"
    rooms.mkdir(parents=True)
    (rooms / "inner.py").write_text("import numba\nGAIN = 1.0\n")
    (rooms / "outer.py").write_text("import numba\nfrom inner import GAIN\n")
    (rooms / "other.py").write_text("import math\n")

    def cache() -> str:
        return cell_environment(Layout(tmp_path, tmp_path / "state"), None)["NUMBA_CACHE_DIR"]

    before = cache()
    (rooms / "other.py").write_text("import math, json\n")
    assert cache() == before
    (rooms / "inner.py").write_text("import numba\nGAIN = 2.0\n")
    assert cache() != before


def test_wheels_keep_another_sourced_ros_out(tmp_path, monkeypatch, capsys):
    """With ROS 2 of another distribution sourced, its folders reach none of our programs, and a line says so."""
    other = tmp_path / "opt"
    (other / "share" / "rclpy").mkdir(parents=True)
    (other / "share" / "rclpy" / "package.xml").touch()
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(other))
    monkeypatch.setenv("PYTHONPATH", f"{other}/lib/python3.10/site-packages{os.pathsep}/mine")
    monkeypatch.setenv("LD_LIBRARY_PATH", f"{other}/lib")
    monkeypatch.setenv("ROS_DISTRO", "humble")
    monkeypatch.setenv("HANDOVER_ROS", "auto")
    assert find_sourced(tmp_path / "state") is None
    assert "ROS 2 humble is sourced, this package needs jazzy" in capsys.readouterr().err
    environment = cell_environment(Layout(SOURCE, tmp_path / "state"), None)
    for name in ("AMENT_PREFIX_PATH", "PYTHONPATH", "LD_LIBRARY_PATH"):
        assert str(other) not in environment[name]
    assert "/mine" in environment["PYTHONPATH"]


def test_sourced_was_asked_for_but_is_not_there(tmp_path, monkeypatch):
    monkeypatch.setenv("HANDOVER_ROS", "sourced")
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    with pytest.raises(SetupError, match=r"source /opt/ros/jazzy/setup\.bash"):
        find_sourced(tmp_path)


# Beside a sourced ROS.


def test_beside_a_sourced_ros_numpy_stays_and_ros_is_not_installed_twice(tmp_path):
    lock = tmp_path / "requirements.lock"
    lock.write_text("numpy==2.4.6\nros-rclpy==7.1.6\nrich==15.0.0\nscipy==1.17.1\npin==4.1.0\nmy_lib[x]==1 ; a\n")
    present = {"numpy": "1.26.4", "rich": "13.7.1", "scipy": "1.11.4"}
    assert beside_sourced(lock, ["pin>=3", "rich>=14", "numpy>=2"], present) == [
        "rich==15.0.0",
        "pin==4.1.0",
        "my_lib[x]==1 ; a",
    ]


def test_complaints_of_pip_name_packages_but_never_numpy():
    output = (
        "cmeel-boost 1.90.0 has requirement numpy>=2.0, but you have numpy 1.26.4.\n"
        "hypothesis 6 has requirement sorted_containers<3.0,>=2.1, but you have sorted-containers 1.\n"
        "mujoco 4.0.0 requires PyOpenGL, which is not installed.\n"
    )
    assert complaints(output) == {"sorted-containers", "pyopengl"}
    assert complaints("No broken requirements found.\n") == set()


@given(st.from_regex(r"[A-Za-z0-9]+([-_.]+[A-Za-z0-9]+)*", fullmatch=True))
def test_canonical_names_are_stable(name):
    assert canonical(canonical(name)) == canonical(name)


# Shared memory.


def test_only_segments_without_an_owner_are_deleted(tmp_path):
    for name in ("fastrtps_1", "fastrtps_1_el", "fastrtps_2", "fastrtps_2_el", "other"):
        (tmp_path / name).write_bytes(b"1234")
    with (tmp_path / "fastrtps_2_el").open() as owner:
        fcntl.flock(owner, fcntl.LOCK_EX)
        left = find_leftovers(tmp_path)
        assert left.in_use == 1
        assert {path.name for path in left.abandoned} == {"fastrtps_1", "fastrtps_1_el"}
        assert remove(left) == 2
    assert {path.name for path in tmp_path.iterdir()} == {"fastrtps_2", "fastrtps_2_el", "other"}
