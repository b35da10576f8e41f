"""Makes the helper modules of the tests importable and ROS strict about message fields."""

import os
import sys
from pathlib import Path

os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
os.environ.setdefault("MUJOCO_GL", "egl")
sys.path.insert(0, str(Path(__file__).parent / "nodes"))
