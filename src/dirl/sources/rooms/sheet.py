"""Contact sheets of rooms: the plan of each, and a few of its views."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from dirl.sources.rooms.build import poses
from dirl.sources.rooms.description import RoomDescription
from dirl.sources.rooms.mesh import Array
from dirl.sources.rooms.navigation import walk
from dirl.sources.rooms.view import Renderer

VIEW = (120, 160)
"""Height and width of a view on a sheet; a plan is a square of that height."""

CAPTION = 14


@dataclass(frozen=True)
class Preview:
    """What a sheet shows of a room: its plan, ``[h, w, 3]``, and views, each ``[*VIEW, 3]``, all uint8."""

    name: str
    plan: Array
    views: list[Array]


def preview(room: RoomDescription) -> Preview:
    """A quick look at a room: its plan, and the views with most to see among some spread over its states."""
    renderer = Renderer.of(room, fine=False)
    spread = poses(walk(room))
    some = spread[:: len(spread) // 24 | 1]  # an odd step: all headings come in turn
    thumbs = [renderer.view(room.camera, pose, (24, 32)).astype(float) for pose in some]
    detail = [np.abs(np.diff(thumb, axis=0)).mean() + np.abs(np.diff(thumb, axis=1)).mean() for thumb in thumbs]
    chosen: list[int] = []
    for k in np.argsort(detail)[::-1]:
        if all(some[k][2] != some[other][2] for other in chosen):  # not twice in the same direction
            chosen.append(int(k))
    large = [renderer.view(room.camera, some[k], VIEW) for k in chosen[:2]]
    return Preview(room.name, renderer.plan(room, VIEW[0]), large)


def draw_sheet(previews: list[Preview], file: Path) -> None:
    """Draw rooms side by side, each with its name; the ending of the file says which format."""
    count, columns = max(len(one.views) for one in previews), min(3, len(previews))
    width, height = VIEW[0] + count * (VIEW[1] + 4) + 12, VIEW[0] + CAPTION + 8
    rows = -(-len(previews) // columns)
    sheet = Image.new("RGB", (columns * width, rows * height), "white")
    draw = ImageDraw.Draw(sheet)
    for number, one in enumerate(previews):
        x, y = (number % columns) * width, (number // columns) * height
        draw.text((x + 2, y), one.name, fill="black")
        plan = Image.fromarray(one.plan)
        sheet.paste(plan, (x + (VIEW[0] - plan.width) // 2, y + CAPTION + (VIEW[0] - plan.height) // 2))
        for k, view in enumerate(one.views):
            sheet.paste(Image.fromarray(view), (x + VIEW[0] + 4 + k * (VIEW[1] + 4), y + CAPTION))
    sheet.save(file)
