"""The house style, as far as tools can hold it."""

import importlib.util
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

NUMPY_CHECKED_WITH = "2.4."  # every NumPy hints its arrays a little otherwise; this is the one for Python 3.11
SOURCE = Path(__file__).resolve().parent.parent


@pytest.mark.parametrize(
    ("tool", "arguments"),
    [
        ("ruff", ["check", "--no-cache", "."]),
        ("ruff", ["format", "--check", "--no-cache", ".", "handover"]),
        ("mypy", ["--no-error-summary", "handover_ros", "bootstrap"]),
    ],
    ids=["ruff check", "ruff format", "mypy"],
)
def test_tool_finds_nothing(tool, arguments):
    if importlib.util.find_spec(tool) is None:
        pytest.skip(f"{tool} is not installed")
    if tool == "mypy" and not version("numpy").startswith(NUMPY_CHECKED_WITH):
        pytest.skip(f"NumPy {version('numpy')} hints its arrays otherwise")
    command = [sys.executable, "-m", tool, *arguments]
    answer = subprocess.run(command, cwd=SOURCE, capture_output=True, text=True, timeout=600, check=False)
    assert answer.returncode == 0, answer.stdout + answer.stderr
