from __future__ import annotations

from pathlib import Path

import pytest

from handover_ros.errors import BadModelError, UnknownNameError
from handover_ros.resources import config_directory, config_file
from handover_ros.yaml_file import Schema, Vector3, read_yaml


class Box(Schema):
    name: str
    size: Vector3


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name: a", "size: Field required"),
        ("name: a\nsize: [1, 2]", "size"),
        ("name: a\nsize: [1, 2, .nan]", "size.2"),
        ("name: a\nsize: [1, 2, 3]\nsise: 4", "sise"),
        ("name: [a\n", "not valid YAML"),
        ("- a\n- b\n", "mapping"),
        ("", "mapping"),
    ],
)
def test_a_bad_file_is_one_line_naming_file_and_field(tmp_path: Path, text: str, words: str):
    path = tmp_path / "box.yaml"
    path.write_text(text)
    with pytest.raises(BadModelError) as caught:
        read_yaml(path, Box)
    assert str(path) in str(caught.value)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_or_binary_file_is_one_line(tmp_path: Path):
    with pytest.raises(BadModelError, match="cannot be read"):
        read_yaml(tmp_path / "none.yaml", Box)
    (tmp_path / "binary.yaml").write_bytes(bytes(range(128, 256)))
    with pytest.raises(BadModelError, match="not valid YAML"):
        read_yaml(tmp_path / "binary.yaml", Box)


def test_values_are_frozen(tmp_path: Path):
    path = tmp_path / "box.yaml"
    path.write_text("name: a\nsize: [1, 2, 3]")
    box = read_yaml(path, Box)
    with pytest.raises(ValueError, match="frozen"):
        box.name = "b"


def test_an_unknown_name_lists_the_known_ones():
    with pytest.raises(UnknownNameError, match=r"unknown object 'brick'.*mug"):
        config_file("objects", "brick")


def test_an_operators_own_configuration_folder_comes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("HANDOVER_CONFIG", str(tmp_path))
    config_directory.cache_clear()
    try:
        assert config_directory() == tmp_path
    finally:
        config_directory.cache_clear()
