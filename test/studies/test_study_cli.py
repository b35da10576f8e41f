"""``./handover study`` as typed."""

import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["chapter5"], "chapter4"),
        (["chapter4", "--jobs", "0"], "jobs"),
        (["chapter4", "--seed", "-1"], "seed"),
        (["chapter4", "--out", "/proc/nowhere"], "cannot be made"),
    ],
)
def test_bad_input_is_one_line_and_status_two(arguments, told):
    command = [sys.executable, "-m", "handover_ros.cli", "study", *arguments]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert answer.returncode == 2, answer.stderr
    assert told in answer.stderr
    assert len(answer.stderr.strip().splitlines()) == 1
    assert "Traceback" not in answer.stderr
