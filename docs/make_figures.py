#!/usr/bin/env python3
"""Makes the gallery of the studies' figures: runs every study quickly, shrinks its figures, writes ``docs/figures.md``.

From anywhere: ``.handover/venv/bin/python docs/make_figures.py`` (some minutes); ``--page`` writes the page only, from
the captions as they are now and the pictures that are there.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
for place in (REPOSITORY, REPOSITORY / "docs"):
    if str(place) not in sys.path:
        sys.path.insert(0, str(place))

from make_reference import plain  # noqa: E402

from handover_ros.studies import beyond_study, chapter2_study, chapter3_study, chapter4_study  # noqa: E402
from handover_ros.studies.registry import STUDIES  # noqa: E402

PAGE = REPOSITORY / "docs" / "figures.md"
PICTURES = REPOSITORY / "docs" / "pictures" / "studies"
COMMAND = ".handover/venv/bin/python docs/make_figures.py"
WIDTH = 800  # [pixels] of a figure on the page
COLOURS = 48
CAPTIONS = {
    "chapter2": chapter2_study.CAPTIONS,
    "chapter3": chapter3_study.CAPTIONS,
    "chapter4": chapter4_study.CAPTIONS,
    "beyond": beyond_study.CAPTIONS,
}
INTRODUCTION = f"""# Figures

<!-- Written by docs/make_figures.py from the captions of the studies: do not edit. -->

Every figure of the studies, with the number of the dissertation's figure that it answers; `B` are those of the study
`beyond`. The pictures are of `--quick` runs with seed 1, made by `{COMMAND}`; a study
without `--quick` has more people and narrower intervals. Numbers and verdicts are in each study's `report.html`.
"""
CELL = """
## The cell

`./handover demo --handovers 1 --object glass --seed 1` draws a picture at each offer:

![Baxter hands a glass to the simulated person](pictures/cell.png)

`./handover plan mug` draws three schemes for the same mug:

![The mug offered by three schemes: likely arms, and what each grasp costs](pictures/plan.png)

`./handover objects mug` draws where a hand and the gripper can take it:

![The mug with the grasps of each region](pictures/mug.png)
"""


def word(number: str) -> str:
    """Return a figure's number as files have it."""
    return number.replace(".", "_").lower()


def picture(study: str, number: str) -> Path:
    """Return where a figure's picture lies."""
    return PICTURES / f"{study}_{word(number)}.png"


def page() -> str:
    """Return the page, with the pictures that are there."""
    text = INTRODUCTION + CELL
    for name, captions in CAPTIONS.items():
        text += f"\n## {STUDIES[name].title}\n\n`./handover study {name} --quick`\n"
        for number, caption in captions.items():
            text += f"\n### Figure {number}\n\n{plain(caption)}\n"
            if picture(name, number).is_file():
                text += f"\n![Figure {number}](pictures/studies/{picture(name, number).name})\n"
            else:
                text += "\nNot drawn here: run the command.\n"
    return text


def shrink(source: Path, target: Path) -> None:
    """Write a picture smaller, with few colours."""
    from PIL import Image

    with Image.open(source) as opened:
        image = opened.convert("RGB")
    if image.width > WIDTH:
        image = image.resize((WIDTH, round(image.height * WIDTH / image.width)), Image.Resampling.LANCZOS)
    target.parent.mkdir(parents=True, exist_ok=True)
    image.quantize(COLOURS).save(target, optimize=True)


def make_pictures(name: str, folder: Path) -> bool:
    """Run a study into a folder and keep its figures; return whether it went well."""
    command = [str(REPOSITORY / "handover"), "study", name, "--quick", "--seed", "1", "--out", str(folder)]
    done = subprocess.run(command, check=False)
    keep_pictures(name, folder)
    return done.returncode == 0


def keep_pictures(name: str, folder: Path) -> None:
    """Keep the figures of a study that was run."""
    for number in CAPTIONS[name]:
        for found in sorted(folder.glob(f"figure_{word(number)}_*.png"))[:1]:
            shrink(found, picture(name, number))


def main(arguments: Sequence[str]) -> int:
    """Make the pictures, unless only the page is wanted, and write the page."""
    if list(arguments) not in ([], ["--page"]):
        print(f"usage: {COMMAND} [--page]", file=sys.stderr)
        return 2
    failed = []
    for name in CAPTIONS if not arguments else ():
        with tempfile.TemporaryDirectory() as folder:
            if not make_pictures(name, Path(folder)):
                failed.append(name)
    PAGE.write_text(page(), encoding="utf-8")
    if failed:
        print(f"these studies failed, their pictures are as before: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
