"""The catalogue: every object can be grasped by Baxter's gripper and by a person, and bad files are named."""

import numpy as np
import pytest
import yaml

from handover_ros.errors import BadModelError, UnknownNameError
from handover_ros.objects.catalogue import load_catalogue, load_object
from handover_ros.resources import config_file

NAMES = ["box", "glass", "handlebars", "mug", "pitcher", "plate", "u_lock"]
FINGERS_OPEN, FINGERS_CLOSED = 0.067, 0.025
BAXTER_PAYLOAD = 2.2


def test_all_objects_of_the_cell_are_there():
    assert sorted(load_catalogue()) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_object_fits_the_gripper(name):
    model = load_object(name)
    assert model.mass <= BAXTER_PAYLOAD
    assert all(FINGERS_CLOSED < grasp.width < FINGERS_OPEN for grasp in model.robot_grasps)
    assert len(model.human_grasps) >= model.hands


@pytest.mark.parametrize("name", NAMES)
def test_object_rests_on_its_origin(name):
    """The lowest point of the shape is at z = 0, within two millimetres."""
    lowest = []
    for primitive in load_object(name).primitives:
        rotation, centre = primitive.object_from_primitive[:3, :3], primitive.object_from_primitive[:3, 3]
        if primitive.type == "box":
            extent = np.abs(rotation[2]) @ np.array(primitive.size) / 2.0
        elif primitive.type == "sphere":
            extent = primitive.size[0]
        else:
            radius, length = primitive.size
            flat = radius * np.hypot(rotation[2, 0], rotation[2, 1]) if primitive.type == "cylinder" else radius
            extent = flat + abs(rotation[2, 2]) * length / 2.0
        lowest.append(centre[2] - extent)
    assert min(lowest) == pytest.approx(0.0, abs=0.002)


def test_mug_has_the_six_regions_of_the_study():
    assert len(load_object("mug").human_grasps) == 6


def test_hand_frames_are_rotations():
    for model in load_catalogue().values():
        for region in (*model.human_grasps, *(grasp.region for grasp in model.robot_grasps)):
            rotation = region.centre()[:3, :3]
            np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
            assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_unknown_object_lists_the_known_ones():
    with pytest.raises(UnknownNameError, match="glass"):
        load_object("unicorn")


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"mass": -1.0}, "mass"),
        ({"masss": 1.0}, "masss"),
        ({"hands": 3}, "hands"),
        ({"primitives": [{"type": "box", "size": [0.1, 0.1]}]}, "primitives.0"),
        ({"human_grasps": [{"name": "a", "hand": {"approach": [1, 0, 0], "across": [1, 0, 0]}}]}, "perpendicular"),
        ({"mass": float("nan")}, "mass"),
    ],
)
def test_bad_file_is_named(tmp_path, change, field):
    content = yaml.safe_load(config_file("objects", "mug").read_text()) | change
    path = tmp_path / "bad.yaml"
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(BadModelError, match=field) as error:
        load_object(str(path))
    assert str(path) in str(error.value)
