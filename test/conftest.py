"""Makes the helper modules of the tests importable and ROS strict about message fields; a second try for graph tests.

Hypothesis draws the same examples in every run, so that a change is judged and not the luck of the draw;
``--hypothesis-profile=explore`` draws new ones.

Graph tests wait for real processes with bounds of wall time, so a machine that stalls can fail them. Such a test is run
once more, and the first failure is shown at the end: a test that needs its second try often has a real fault.
"""

import os
import sys
import tempfile
from pathlib import Path

from _pytest.runner import runtestprotocol
from hypothesis import settings

os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
os.environ.setdefault("MUJOCO_GL", "egl")
# Never the user's own profiles; the folder is made only by a test that stores one.
os.environ["HANDOVER_PROFILES"] = str(Path(tempfile.gettempdir()) / f"handover_profiles_{os.getpid()}")
for folder in ("bags", "mocap", "nodes", "preferences", "skeleton", "studies"):
    sys.path.insert(0, str(Path(__file__).parent / folder))

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.register_profile("explore", deadline=None)
settings.load_profile("repeatable")

FIRST_FAILURES: list = []


def pytest_runtest_protocol(item, nextitem):
    """Run a graph test a second time when it failed, and report the second result."""
    if item.get_closest_marker("graph") is None:
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    reports = runtestprotocol(item, nextitem=nextitem, log=False)
    failed = [report for report in reports if report.failed]
    if failed:
        FIRST_FAILURES.extend(failed)
        reports = runtestprotocol(item, nextitem=nextitem, log=False)
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def pytest_terminal_summary(terminalreporter):
    """Show the failures that a second try followed."""
    for report in FIRST_FAILURES:
        terminalreporter.section(f"tried again after: {report.nodeid} ({report.when})")
        terminalreporter.write_line(report.longreprtext[-3000:])
