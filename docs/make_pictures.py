#!/usr/bin/env python3
"""Makes the pictures of the documentation by running the cell: ``docs/make_pictures.py [--soak]``, from anywhere.

With ``--soak`` only the one of half an hour of operation, which takes that long.
"""

import json
import shutil
import subprocess
import sys
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


def timeline() -> None:
    """Run a session with a calibration and two handovers, and keep its timeline."""
    with tempfile.TemporaryDirectory() as folder:
        run(folder, "demo", "--handovers", "2", "--calibrate", "--no-pictures", "--seed", "1")
        with tempfile.TemporaryDirectory() as drawn:
            files = run(drawn, "bag", "info", folder)
            shutil.copyfile(next(file for file in files if file.suffix == ".png"), PICTURES / "timeline.png")


def soak() -> None:
    """Run the cell for half an hour and keep the plot of what it cost."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([REPOSITORY / "handover", "bench", "soak", "--out", folder], check=True)
        shutil.copyfile(Path(folder) / "soak.png", PICTURES / "soak.png")


def main() -> None:
    """Hand a glass over and keep the picture of the offer; draw a plan of the mug, its grasps, and a session."""
    if "--soak" in sys.argv[1:]:
        soak()
        return
    commands = {
        "cell.png": ("demo", "--handovers", "1", "--object", "glass", "--seed", "1"),
        "plan.png": ("plan", "mug"),
        "mug.png": ("objects", "mug"),
    }
    PICTURES.mkdir(parents=True, exist_ok=True)
    for name, command in commands.items():
        with tempfile.TemporaryDirectory() as folder:
            shutil.copyfile(run(folder, *command)[0], PICTURES / name)
    timeline()


if __name__ == "__main__":
    main()
