"""The path to a photo by a map of frames, as a strip of pictures."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from dirl.scenes.io.files import atomic_path
from dirl.scenes.palette import BLUE, VERMILION

GAP, LINE = 6, 18
"""Pixels: between pictures, and of a line of text."""

COLUMNS = 6
"""Pictures in a row."""


def draw_strip(pictures: Sequence[tuple[str, NDArray[np.uint8]]], file: Path) -> None:
    """Write RGB pictures, uint8 ``[H, W, 3]``, all of one height, with a line of text above each, as a PNG.

    The first and the last, which are photos, are framed.
    """
    width = max(picture.shape[1] for _, picture in pictures) + GAP
    height = pictures[0][1].shape[0] + LINE + GAP
    rows = -(-len(pictures) // COLUMNS)
    sheet = Image.new("RGB", (min(COLUMNS, len(pictures)) * width + GAP, rows * height + GAP), "white")
    draw = ImageDraw.Draw(sheet)
    for number, (text, picture) in enumerate(pictures):
        x, y = number % COLUMNS * width + GAP, number // COLUMNS * height + GAP
        draw.text((x, y + 2), text, fill="black", font=ImageFont.load_default(12))
        sheet.paste(Image.fromarray(picture), (x, y + LINE))
        if number in (0, len(pictures) - 1):
            corner = x + picture.shape[1], y + LINE + picture.shape[0]
            draw.rectangle((x - 2, y + LINE - 2, *corner), outline=VERMILION if number else BLUE, width=3)
    with atomic_path(file) as temporary:
        sheet.save(temporary, "PNG")
