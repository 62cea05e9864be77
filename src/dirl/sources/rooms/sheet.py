"""Contact sheets of rooms: the plan of each, and a few of its views."""

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from dirl.sources.rooms.build import poses
from dirl.sources.rooms.description import RoomDescription
from dirl.sources.rooms.navigation import walk
from dirl.sources.rooms.view import Renderer

VIEW = (120, 160)
"""Height and width of a view on a sheet; a plan is a square of that height."""

CAPTION = 14

CARD = (VIEW[0] + 2 * (VIEW[1] + 4) + 12, VIEW[0] + CAPTION + 8)
"""Width and height of what shows a room."""


def preview(room: RoomDescription) -> Image.Image:
    """A quick look at a room: its name, its plan, and the two views with most to see among some of its states."""
    renderer = Renderer.of(room, fine=False)
    spread = poses(walk(room))
    some = spread[:: len(spread) // 24 | 1]  # an odd step: all headings come in turn
    thumbs = [renderer.view(room.camera, pose, (24, 32)).astype(float) for pose in some]
    detail = [np.abs(np.diff(thumb, axis=0)).mean() + np.abs(np.diff(thumb, axis=1)).mean() for thumb in thumbs]
    chosen: list[int] = []
    for k in np.argsort(detail)[::-1]:
        if all(some[k][2] != some[other][2] for other in chosen):  # not twice in the same direction
            chosen.append(int(k))
    card = Image.new("RGB", CARD, "white")
    ImageDraw.Draw(card).text((2, 0), room.name, fill="black")
    plan = Image.fromarray(renderer.plan(room, VIEW[0]))
    card.paste(plan, ((VIEW[0] - plan.width) // 2, CAPTION + (VIEW[0] - plan.height) // 2))
    for number, k in enumerate(chosen[:2]):
        view = Image.fromarray(renderer.view(room.camera, some[k], VIEW))
        card.paste(view, (VIEW[0] + 4 + number * (VIEW[1] + 4), CAPTION))
    return card


def draw_sheet(cards: list[Image.Image], file: Path) -> None:
    """Draw the cards of rooms side by side; the ending of the file says which format."""
    columns = min(3, len(cards))
    sheet = Image.new("RGB", (columns * CARD[0], -(-len(cards) // columns) * CARD[1]), "white")
    for number, card in enumerate(cards):
        sheet.paste(card, (number % columns * CARD[0], number // columns * CARD[1]))
    sheet.save(file)
