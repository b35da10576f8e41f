"""The simulated cell in MuJoCo: robot, person, objects and motion-capture cameras.

MuJoCo chooses how to draw when it is imported: without a screen, through EGL, unless the environment says otherwise.
Told to use EGL on a machine without it, it cannot be imported at all; there the cell runs without pictures.
"""

import ctypes
import os


def _loads(*names: str) -> bool:
    """Tell whether one of some libraries can be loaded."""
    for name in names:
        try:
            ctypes.CDLL(name)
        except OSError:
            continue
        return True
    return False


if "MUJOCO_GL" not in os.environ:
    has_egl = _loads("libEGL.so.1") and _loads("libOpenGL.so.0", "libGL.so.1")
    os.environ["MUJOCO_GL"] = "egl" if has_egl else "disabled"
# Mesa's software renderer takes all cores for each picture, unless told otherwise; the cell's nodes need them.
os.environ.setdefault("LP_NUM_THREADS", "1")
