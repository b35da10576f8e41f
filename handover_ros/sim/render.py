"""Pictures of the simulated cell, drawn without a screen."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt
from PIL import Image, ImageOps

from handover_ros.errors import BadModelError, UnknownNameError
from handover_ros.sim.robot_body import DISPLAY_TEXTURE
from handover_ros.sim.scenery import PICTURE_SIZE
from handover_ros.sim.world import World

Picture = npt.NDArray[np.uint8]

# Drawn: scene and objects, robot, person; not the shapes that only collide. Sites: the markers are in group 2.
GEOM_GROUPS = (1, 1, 1, 0, 0, 0)
SITE_GROUPS = (0, 0, 1, 0, 0, 0)
MAXIMUM_GEOMS = 3000
NO_GL = (
    "pictures cannot be drawn: {reason}; install the Debian packages for it "
    "(apt install libegl1 libopengl0 libgl1-mesa-dri), or set MUJOCO_GL=osmesa or glfw"
)


class Renderer:
    """Draws one simulation; use it in the thread that made it.

    Args:
        world: The cell.
        width: Of the pictures [pixels].
        height: Of the pictures [pixels].

    Raises:
        BadModelError: The size is out of range, or there is no OpenGL.
    """

    def __init__(self, world: World, width: int = 1280, height: int = 720) -> None:
        if not (16 <= width <= PICTURE_SIZE[0] and 16 <= height <= PICTURE_SIZE[1]):
            raise BadModelError(
                f"picture size {width} x {height} must be 16 x 16 to {PICTURE_SIZE[0]} x {PICTURE_SIZE[1]}"
            )
        self._world = world
        self._viewport = mujoco.MjrRect(0, 0, width, height)
        self._picture = np.empty((height, width, 3), dtype=np.uint8)
        self._display_changed = False
        with _explained():
            self._context = mujoco.GLContext(width, height)
            self._context.make_current()
            self._drawing = mujoco.MjrContext(world.model, mujoco.mjtFontScale.mjFONTSCALE_150)
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._drawing)
        if self._drawing.currentBuffer != mujoco.mjtFramebuffer.mjFB_OFFSCREEN:
            raise BadModelError(NO_GL.format(reason="OpenGL has no offscreen buffer"))
        self._scene = mujoco.MjvScene(world.model, MAXIMUM_GEOMS)
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = GEOM_GROUPS
        self._option.sitegroup[:] = SITE_GROUPS
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._cameras = [camera.name for camera in world.scene.cameras]

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the scene's cameras."""
        return tuple(self._cameras)

    def render(self, data: mujoco.MjData, camera: str = "") -> Picture:
        """Return a picture (height, width, 3) of the present state.

        Args:
            data: State of the simulation.
            camera: Camera of the scene; empty: the first one.

        Raises:
            UnknownNameError: The scene has no such camera.
        """
        name = camera or self._cameras[0]
        if name not in self._cameras:
            raise UnknownNameError("camera", name, self._cameras)
        model = self._world.model
        self._camera.fixedcamid = model.camera(name).id
        self._context.make_current()
        if self._display_changed:
            mujoco.mjr_uploadTexture(model, self._drawing, model.texture(DISPLAY_TEXTURE).id)
            self._display_changed = False
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(model, data, self._option, None, self._camera, everything, self._scene)
        mujoco.mjr_render(self._viewport, self._scene, self._drawing)
        mujoco.mjr_readPixels(self._picture, None, self._viewport, self._drawing)
        return np.ascontiguousarray(self._picture[::-1])

    def show_on_display(self, picture: Picture) -> None:
        """Put a picture (height, width, 3) on the robot's head display, whole and undistorted on black."""
        model = self._world.model
        index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXTURE, DISPLAY_TEXTURE)
        if index < 0:
            return  # a robot without a display
        width, height = int(model.tex_width[index]), int(model.tex_height[index])
        shown = ImageOps.contain(Image.fromarray(picture), (width, height))
        canvas = Image.new("RGB", (width, height))
        canvas.paste(shown, ((width - shown.width) // 2, (height - shown.height) // 2))
        start = int(model.tex_adr[index])
        model.tex_data[start : start + width * height * 3] = np.asarray(canvas)[::-1].ravel()
        self._display_changed = True

    def close(self) -> None:
        """Give back what the graphics driver holds."""
        self._context.make_current()
        self._drawing.free()
        self._context.free()


def save_picture(picture: Picture, path: Path) -> None:
    """Write a picture (height, width, 3) as PNG, whole or not at all.

    Raises:
        BadModelError: The folder cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(picture).save(temporary, format="PNG")
        temporary.replace(path)
    except OSError as error:
        raise BadModelError(f"{path}: picture cannot be written: {error.strerror or error}") from None


@contextlib.contextmanager
def _explained() -> Iterator[None]:
    """Turn whatever OpenGL raises into one line that says what to install."""
    try:
        yield
    except Exception as error:  # ImportError, AttributeError, RuntimeError, mujoco.FatalError: by platform and driver
        raise BadModelError(NO_GL.format(reason=" ".join(str(error).split()) or type(error).__name__)) from None
