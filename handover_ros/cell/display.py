"""Pictures for the robot's head display."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

WIDTH, HEIGHT = 1024, 600  # [pixel] of Baxter's head display

BACKGROUNDS = {
    "Please wait": (32, 64, 110),
    "Ready?": (24, 120, 72),
    "Thank you": (58, 58, 72),
    "Sorry": (140, 52, 40),
}
DEFAULT_BACKGROUND = (30, 30, 36)


def text_picture(text: str, width: int = WIDTH, height: int = HEIGHT) -> npt.NDArray[np.uint8]:
    """Return an RGB picture (height, width, 3) with ``text`` large in its middle."""
    picture = Image.new("RGB", (width, height), BACKGROUNDS.get(text, DEFAULT_BACKGROUND))
    draw = ImageDraw.Draw(picture)
    size = height // 4
    font = ImageFont.load_default(size)
    while size > 8 and draw.textlength(text, font=font) > 0.9 * width:
        size = int(size * 0.9)
        font = ImageFont.load_default(size)
    draw.text((width / 2, height / 2), text, fill=(255, 255, 255), font=font, anchor="mm")
    return np.asarray(picture, dtype=np.uint8)
