#!/usr/bin/env python3
"""Makes the pictures of the documentation by running the cell: ``docs/make_pictures.py``, from anywhere."""

import json
import shutil
import subprocess
import tempfile
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
PICTURES = REPOSITORY / "docs" / "pictures"


def main() -> None:
    """Hand a glass over and keep the picture of the offer."""
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "demo.json"
        command = [REPOSITORY / "handover", "demo", "--handovers", "1", "--object", "glass", "--seed", "1"]
        subprocess.run([*command, "--out", folder, "--json", result], check=True)
        offer = json.loads(result.read_text())["files"][0]
        PICTURES.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(offer, PICTURES / "cell.png")


if __name__ == "__main__":
    main()
