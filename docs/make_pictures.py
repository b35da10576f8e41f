#!/usr/bin/env python3
"""Makes the pictures of the documentation by running the cell: ``docs/make_pictures.py``, from anywhere."""

import json
import shutil
import subprocess
import tempfile
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
PICTURES = REPOSITORY / "docs" / "pictures"


def run(folder: str, *arguments: str) -> list[Path]:
    """Run a command of the cell with its output in a folder and return the files it wrote."""
    result = Path(folder) / "result.json"
    command = [REPOSITORY / "handover", *arguments, "--out", folder, "--json", result]
    subprocess.run(command, check=True)
    return [Path(file) for file in json.loads(result.read_text())["files"]]


def main() -> None:
    """Hand a glass over and keep the picture of the offer; draw a plan of the mug and its grasps."""
    commands = {
        "cell.png": ("demo", "--handovers", "1", "--object", "glass", "--seed", "1"),
        "plan.png": ("plan", "mug"),
        "mug.png": ("objects", "mug"),
    }
    PICTURES.mkdir(parents=True, exist_ok=True)
    for name, command in commands.items():
        with tempfile.TemporaryDirectory() as folder:
            shutil.copyfile(run(folder, *command)[0], PICTURES / name)


if __name__ == "__main__":
    main()
