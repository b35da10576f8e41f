"""The simulated cell in MuJoCo: robot, person, objects and motion-capture cameras.

MuJoCo chooses how to draw when it is imported: without a screen, through EGL, unless the environment says otherwise.
"""

import os

os.environ.setdefault("MUJOCO_GL", "egl")
# Mesa's software renderer takes all cores for each picture, unless told otherwise; the cell's nodes need them.
os.environ.setdefault("LP_NUM_THREADS", "1")
