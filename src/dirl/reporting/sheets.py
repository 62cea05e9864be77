"""Many pictures as one, each with a line of text above it: the path to a photo, and all views of a scene."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from dirl.scenes.io.files import atomic_path
from dirl.scenes.palette import BLUE, VERMILION

GAP, LINE = 6, 18
"""Pixels: between pictures, and of a line of text."""


def draw_sheet(
    pictures: Sequence[tuple[str, NDArray[np.uint8]]], file: Path, *, columns: int = 6, ends: bool = False
) -> None:
    """Write RGB pictures, uint8 ``[H, W, 3]``, all of one height, with a text above each; PNG or JPEG by the name.

    With ``ends`` the first and the last are framed.
    """
    width = max(picture.shape[1] for _, picture in pictures) + GAP
    height = pictures[0][1].shape[0] + LINE + GAP
    rows = -(-len(pictures) // columns)
    sheet = Image.new("RGB", (min(columns, len(pictures)) * width + GAP, rows * height + GAP), "white")
    draw = ImageDraw.Draw(sheet)
    for number, (text, picture) in enumerate(pictures):
        x, y = number % columns * width + GAP, number // columns * height + GAP
        draw.text((x, y + 2), text, fill="black", font=ImageFont.load_default(12))
        sheet.paste(Image.fromarray(picture), (x, y + LINE))
        if ends and number in (0, len(pictures) - 1):
            corner = x + picture.shape[1], y + LINE + picture.shape[0]
            draw.rectangle((x - 2, y + LINE - 2, *corner), outline=VERMILION if number else BLUE, width=3)
    with atomic_path(file) as temporary:
        sheet.save(temporary, quality=85)
