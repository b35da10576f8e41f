"""Files written whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from handover_ros.files import write_whole


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path: Path):
    path = tmp_path / "new" / "f.txt"
    write_whole(path, "first")
    with pytest.raises(UnicodeEncodeError):
        write_whole(path, "second \ud800")
    assert path.read_text() == "first"
    assert list(path.parent.iterdir()) == [path], "nothing is left behind"
