"""Robot descriptions: every mistake in the file is named with file and field."""

import pytest
import yaml

from handover_ros.errors import BadModelError, UnknownNameError
from handover_ros.resources import config_file
from handover_ros.robot.description import read_description, share_directory


@pytest.fixture
def content():
    return yaml.safe_load(config_file("robots", "baxter").read_text())


def read(content, folder):
    path = folder / "robot.yaml"
    path.write_text(yaml.safe_dump(content))
    return read_description(str(path))


def test_share_holds_the_urdf():
    """The URDF of the shipped robot is found."""
    description, urdf = read_description("baxter")
    assert urdf.is_file()
    assert share_directory() in urdf.parents
    assert set(description.arms) == {"left", "right"}


def test_own_share_folder_wins(tmp_path, monkeypatch):
    """HANDOVER_ROBOT_DATA is looked at before the installation."""
    (tmp_path / "example-robot-data" / "robots").mkdir(parents=True)
    monkeypatch.setenv("HANDOVER_ROBOT_DATA", str(tmp_path))
    assert share_directory() == tmp_path


def test_unknown_robot_lists_the_known():
    with pytest.raises(UnknownNameError, match="baxter"):
        read_description("hal")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c.update(urdf="nowhere.urdf"), "urdf"),
        (lambda c: c["arms"]["left"]["acceleration"].pop(), "arms.left.acceleration"),
        (lambda c: c["arms"]["left"]["postures"].pop("home"), "home"),
        (lambda c: c["arms"]["left"]["postures"].update(rest=[0.0]), "arms.left.postures.rest"),
        (lambda c: c["arms"]["left"].update(opening=[0.05, 0.02]), "arms.left.opening"),
        (lambda c: c.update(velocity_scale=1.5), "velocity_scale"),
        (lambda c: c.update(velocty_scale=0.5), "velocty_scale"),
        (lambda c: c["collision"].update(margin=float("nan")), "collision.margin"),
    ],
)
def test_a_mistake_names_file_and_field(content, tmp_path, change, words):
    change(content)
    with pytest.raises(BadModelError, match=r"robot\.yaml") as caught:
        read(content, tmp_path)
    assert words in str(caught.value)
