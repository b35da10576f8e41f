"""Pictures: something is to be seen, the display shows what it is given, and no OpenGL is a clear message."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from cell import empty_cell, staffed_cell
from PIL import Image

from handover_ros.errors import BadModelError, UnknownNameError
from handover_ros.sim.artist import Artist
from handover_ros.sim.render import Renderer, save_picture

SIZE = (320, 240)
LIMIT = 120.0


@pytest.fixture(scope="module")
def renderer():
    try:
        renderer = Renderer(staffed_cell().world, *SIZE)
    except BadModelError as error:
        pytest.skip(str(error))
    yield renderer
    renderer.close()


@pytest.mark.rendering
def test_picture_shows_the_red_robot(renderer):
    picture = renderer.render(staffed_cell().data).astype(int)
    assert picture.shape == (SIZE[1], SIZE[0], 3)
    red = (picture[..., 0] > 90) & (picture[..., 1] < 50) & (picture[..., 2] < 50)
    assert red.mean() > 0.005
    assert picture.std() > 20


@pytest.mark.rendering
def test_every_camera_of_the_scene_sees_something_else(renderer):
    pictures = [renderer.render(staffed_cell().data, camera) for camera in renderer.cameras]
    for index, picture in enumerate(pictures):
        assert picture.std() > 10
        assert all(np.abs(picture.astype(int) - other).mean() > 5 for other in pictures[:index])
    with pytest.raises(UnknownNameError, match="overview"):
        renderer.render(staffed_cell().data, "backstage")


@pytest.mark.rendering
def test_display_shows_its_picture(renderer):
    green = np.zeros((60, 100, 3), dtype=np.uint8)
    green[..., 1] = 255

    def green_pixels():
        picture = renderer.render(staffed_cell().data).astype(int)
        return int(((picture[..., 1] > 120) & (picture[..., 0] < 60) & (picture[..., 2] < 60)).sum())

    before = green_pixels()
    renderer.show_on_display(green)
    assert green_pixels() > before + 30


@pytest.mark.rendering
def test_artist_draws_snapshots_in_another_thread():
    artist = Artist(empty_cell().world)
    try:
        artist.show_on_display(np.full((60, 100, 3), 255, dtype=np.uint8))
        drawings = [artist.draw(empty_cell().snapshot(), "overview", SIZE) for _ in range(2)]
        first, second = (drawing.result(LIMIT) for drawing in drawings)
    except BadModelError as error:
        pytest.skip(str(error))
    finally:
        artist.close()
    np.testing.assert_array_equal(first, second)


def test_picture_file_is_written_whole(tmp_path):
    picture = np.random.default_rng(0).integers(0, 255, (20, 30, 3), dtype=np.uint8)
    save_picture(picture, tmp_path / "new" / "picture.png")
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "new" / "picture.png")), picture)
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["picture.png"]
    (tmp_path / "file").write_text("")
    with pytest.raises(BadModelError, match="cannot be written"):
        save_picture(picture, tmp_path / "file" / "picture.png")


@pytest.mark.parametrize("size", [(4, 100), (100, 5000)])
def test_size_out_of_range_is_refused(size):
    with pytest.raises(BadModelError, match="picture size"):
        Renderer(empty_cell().world, *size)


def test_missing_opengl_is_explained():
    """A driver that cannot start: one line that names the packages."""
    program = (
        "from handover_ros.objects.scene import load_scene\n"
        "from handover_ros.sim.options import SimulationOptions\n"
        "from handover_ros.sim.simulation import Simulation\n"
        "from handover_ros.sim.render import Renderer\n"
        "from handover_ros.errors import BadModelError\n"
        "world = Simulation(load_scene('lab'), 1, SimulationOptions(person='none')).world\n"
        "try:\n"
        "    Renderer(world, 64, 64)\n"
        "except BadModelError as error:\n"
        "    print('EXPLAINED', error)\n"
    )
    environment = dict(os.environ, MUJOCO_GL="glfw")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        environment.pop(name, None)
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=environment,
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        timeout=LIMIT,
        check=False,
    )
    assert "libegl1" in done.stdout, done.stdout + done.stderr
    assert "libgl1-mesa-dri" in done.stdout
