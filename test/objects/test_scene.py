"""The scene: objects rest on something, goals are in reach of the person, bad files are named."""

import numpy as np
import pytest
import yaml

from handover_ros.errors import BadModelError
from handover_ros.objects.scene import load_scene
from handover_ros.resources import config_file, config_names


def supported(scene, pose, surface_names):
    x, y, z = pose[:3, 3]
    for name in surface_names:
        box = scene.box(name)
        inside = np.all(np.abs([x, y] - box.world_from_box[:2, 3]) <= np.array(box.size[:2]) / 2)
        if inside and abs(z - (box.world_from_box[2, 3] + box.size[2] / 2)) < 0.02:
            return True
    return False


def test_lab_places_every_object_on_a_supply_table():
    scene = load_scene("lab")
    assert sorted(scene.placements) == config_names("objects")
    assert all(supported(scene, pose, ["left_table", "right_table"]) for pose in scene.placements.values())


def test_lab_goals_lie_on_the_goal_surface():
    scene = load_scene("lab")
    assert sorted(scene.goals) == sorted(scene.placements)
    assert all(supported(scene, pose, [scene.default_goal_surface]) for pose in scene.goals.values())


def test_objects_start_apart():
    origins = [pose[:2, 3] for pose in load_scene("lab").placements.values()]
    assert min(np.linalg.norm(a - b) for i, a in enumerate(origins) for b in origins[:i]) > 0.1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"objects": {"unicorn": {"xyz": [0, 0, 0]}}}, "unicorn"),
        ({"goal_surface": "moon"}, "goal_surface"),
        ({"cameras": {}}, "cameras"),
        ({"tables": {"t": {"centre": [0, 0], "size": [1, -1], "height": 1}}}, "size"),
    ],
)
def test_bad_scene_is_named(tmp_path, change, message):
    path = tmp_path / "bad.yaml"
    path.write_text(yaml.safe_dump(yaml.safe_load(config_file("scenes", "lab").read_text()) | change))
    with pytest.raises(BadModelError, match=message) as error:
        load_scene(str(path))
    assert str(path) in str(error.value)


def test_unknown_box_lists_the_known_ones():
    with pytest.raises(BadModelError, match="goal_table"):
        load_scene("lab").box("moon")
