"""Pictures of a scene: its map, and all its views; and many pictures as one, each with a line of text above it."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from dirl.reporting.style import draw_room, marker, write_figure
from dirl.scenes import Scene
from dirl.scenes.graph import AHEAD, IntArray, places, turns_per_circle
from dirl.scenes.io.files import atomic_path
from dirl.scenes.palette import BLUE, COLORS, GOAL_COLOR, VERMILION, WALL_COLOR

MAX_THUMBNAILS = 720
THUMBNAIL = 96
"""Pixels: the width of a view on the contact sheet."""

MAP_SIZE = 6.0
"""Inches, the longer side."""

BACKGROUND = {"facecolor": "white", "edgecolor": "none", "pad": 0.8}
"""Of the numbers on the map."""

GAP, LINE = 6, 18
"""Pixels: between the pictures of a sheet, and of a line of text."""


def draw_scene_map(scene: Scene, parts: IntArray, file: Path) -> None:
    """Draw walls, free cells, moves and goals, as a PNG; parts other than the largest are coloured.

    ``parts`` is `dirl.perception.recognition.diagnostics.Inspection.parts`.
    """
    side, place = scene.step_length, places(scene.graph)
    spans = np.ptp(scene.positions, axis=0) + 2 * side
    width, height = spans * MAP_SIZE / spans.max()
    figure = Figure((max(width, 3.5) + 1, height + 1.4), layout="constrained")
    axes = figure.subplots()
    draw_room(axes, scene, side)
    figure.suptitle(f"{scene.name} ({scene.source}): {len(scene)} states at {place.max() + 1} places", fontsize=11)
    # Numbers too small to read are left out.
    size = 72 * 0.28 * side * min(width / spans[0], height / spans[1])
    for first in np.unique(place, return_index=True)[1]:
        x, z = scene.positions[first]
        if parts[first] > 0:
            color = COLORS[(parts[first] - 1) % len(COLORS)]
            axes.plot(x, z, "s", color=color, alpha=0.35, markersize=2.4 * size, zorder=2)
        if size > 3.5:
            centred = axes.text(
                x, z, str(first), ha="center", va="center", fontsize=min(size, 9), color="0.25", zorder=4
            )
            centred.set_bbox(BACKGROUND)
    for state in np.flatnonzero(scene.graph[:, AHEAD] >= 0):
        ends = scene.positions[[state, scene.graph[state, AHEAD]]]
        axes.plot(*ends.T, color="0.7", linewidth=0.8, zorder=1.5)
    ahead = np.nan_to_num(scene.directions)
    arrow = {"arrowstyle": "-|>", "color": "black", "shrinkA": 0, "shrinkB": 0}
    for goal in scene.goals:
        at = scene.positions[goal]
        axes.annotate("", xytext=at, xy=at + 0.8 * side * ahead[goal], arrowprops=arrow, zorder=5)
        axes.plot(*at, "*", color=GOAL_COLOR, markeredgecolor="black", markersize=14, zorder=6)
    handles: list[Patch | Line2D] = (
        [Patch(color=WALL_COLOR, label="walls, furniture")] if not scene.source.startswith("tour") else []
    )
    handles.append(Line2D([], [], color="0.7", linewidth=0.8, label="moves ahead"))
    if len(scene.goals):
        handles.append(marker("*", 12, GOAL_COLOR, "black", "goals, and the way they face"))
    if parts.max() > 0:
        handles.append(Patch(color=COLORS[0], alpha=0.35, label="not connected with the rest"))
    figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    write_figure(figure, file)


def draw_contact_sheet(scene: Scene, file: Path) -> None:
    """Draw all views small, place by place, each place with its first state's number, as a JPEG.

    Of a scene with more than `MAX_THUMBNAILS` views, places evenly spread over it are drawn.

    Raises:
        ValueError: a view cannot be decoded.
    """
    assert scene.views is not None
    turns = turns_per_circle(scene.graph)
    place = places(scene.graph)
    groups = [np.flatnonzero(place == number) for number in range(place.max() + 1)]
    most = max(1, MAX_THUMBNAILS // turns)
    if len(groups) > most:
        groups = [groups[number] for number in np.linspace(0, len(groups) - 1, most).round().astype(int)]
    rows, columns, _ = scene.views[0].shape
    height = max(1, round(THUMBNAIL * rows / columns))
    # The headings of a place are side by side; the sheet is about as wide as high.
    across = max(1, round(math.sqrt(len(groups) * (height + LINE) / (turns * THUMBNAIL))))
    pictures = []
    for states in groups:
        views = (Image.fromarray(scene.views[int(state)]) for state in states)
        small = [np.asarray(view.resize((THUMBNAIL, height), Image.Resampling.BOX)) for view in views]
        apart = [np.pad(view, ((0, 0), (0, 1), (0, 0)), constant_values=255) for view in small]
        pictures.append((f"{states[0]}", np.concatenate(apart, 1)))
    draw_sheet(pictures, file, columns=across)


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
