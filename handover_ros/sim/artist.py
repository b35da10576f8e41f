"""Draws pictures in a thread of its own from snapshots, so that the simulation goes on meanwhile."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor

import mujoco

from handover_ros.sim.render import Picture, Renderer
from handover_ros.sim.world import World

Size = tuple[int, int]


class Artist:
    """Owns the renderers of one cell, one for each size, made on first use.

    Args:
        world: The cell.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._renderers: dict[Size, Renderer] = {}
        self._shown: Picture | None = None
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="artist")

    def draw(self, snapshot: mujoco.MjData, camera: str, size: Size) -> Future[Picture]:
        """Return the picture to come of a snapshot; its errors are those of ``Renderer``.

        Args:
            snapshot: A copy of the simulation's data that nobody else uses.
            camera: Camera of the scene.
            size: Width and height [pixels].
        """
        return self._thread.submit(self._draw, snapshot, camera, size)

    def show_on_display(self, picture: Picture) -> None:
        """Put a picture (height, width, 3) on the robot's head display from the next drawing on."""
        self._thread.submit(self._show, picture)

    def prepare(self, size: Size) -> None:
        """Make the renderer of a size ahead of its first picture; without OpenGL the first picture will say so."""
        self._thread.submit(self._renderer, size)

    def close(self) -> None:
        """Finish what was begun and free the graphics memory."""
        self._thread.submit(self._close)
        self._thread.shutdown(wait=True, cancel_futures=False)

    def _draw(self, snapshot: mujoco.MjData, camera: str, size: Size) -> Picture:
        return self._renderer(size).render(snapshot, camera)

    def _renderer(self, size: Size) -> Renderer:
        if size not in self._renderers:
            renderer = Renderer(self._world, *size)
            if self._shown is not None:
                renderer.show_on_display(self._shown)
            self._renderers[size] = renderer
        return self._renderers[size]

    def _show(self, picture: Picture) -> None:
        self._shown = picture
        for renderer in self._renderers.values():
            renderer.show_on_display(picture)

    def _close(self) -> None:
        for renderer in self._renderers.values():
            renderer.close()
        self._renderers.clear()
