"""What all figures share: panels, axes, markers, the room below a map, and how they are saved."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Rectangle
from matplotlib.ticker import MultipleLocator
from PIL import Image

from dirl.scenes import Scene
from dirl.scenes.io.files import atomic_path
from dirl.scenes.palette import WALL_COLOR

LAID_OUT = "tour, laid out"
"""The source of a scene whose positions are known only by its links."""


def plain(axes: Axes) -> None:
    """Draw a pale grid behind what is drawn, and no frame above and at the right."""
    axes.grid(color="0.9")
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def marker(shape: str, size: float, color: str, edge: str, label: str) -> Line2D:
    """Return a marker for a legend."""
    return Line2D([], [], linestyle="", marker=shape, markersize=size, color=color, markeredgecolor=edge, label=label)


def draw_room(axes: Axes, scene: Scene, side: float) -> None:
    """Draw white squares where an agent can be, on the grey of walls and furniture; discs for a tour.

    The axes get the limits and labels of the room. ``side`` is that of a square, metres, see `Scene.step_length`.
    """
    cells = np.unique(scene.positions.round(3), axis=0)
    places: list[Patch]
    if not scene.source.startswith("tour"):  # of a tour it is not known what lies between places
        places = [Rectangle((x - side / 2, z - side / 2), side, side) for x, z in cells]
        axes.set_facecolor(WALL_COLOR)
        edge, order = "0.9", 1.0
    else:
        places = [Circle((x, z), 0.25 * side) for x, z in cells]
        edge, order = "0.6", 1.6
    axes.add_collection(PatchCollection(places, facecolor="white", edgecolor=edge, linewidth=0.5, zorder=order))
    low, high = cells.min(0) - side, cells.max(0) + side
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", anchor="N", xlabel="x (m)", ylabel="z (m)")
    if scene.source == LAID_OUT:
        axes.set(xlabel="layout of links: distances mean nothing", ylabel="", xticklabels=[], yticklabels=[])
    axes.xaxis.set_major_locator(MultipleLocator(1))
    axes.yaxis.set_major_locator(MultipleLocator(1))


def write_figure(figure: Figure, file: Path, dpi: int = 120) -> None:
    """Write a figure in the format that the file's name ends with, PNG or SVG, completely or not at all."""
    canvas = FigureCanvasAgg(figure)
    with atomic_path(file) as temporary:
        if file.suffix == ".png":
            # Matplotlib's own function goes through the figure twice, keeps an opaque alpha channel, and compresses at
            # Pillow's level 6, which takes twice the time and saves 8% of the size.
            figure.set_dpi(dpi)
            canvas.draw()
            Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB").save(temporary, compress_level=3)
        else:
            canvas.print_figure(temporary, dpi=dpi)


def panels(count: int, size: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    """Make a figure of so many panels side by side, ``size`` in inches."""
    figure = Figure(figsize=size, layout="constrained")
    grid = list(figure.subplots(1, count, sharey=True, squeeze=False)[0])
    for axes in grid:
        plain(axes)
    return figure, grid


def save_figure(figure: Figure, out: Path, name: str) -> None:
    """Write a figure as PNG and SVG."""
    out.mkdir(parents=True, exist_ok=True)
    write_figure(figure, out / f"{name}.png")
    write_figure(figure, out / f"{name}.svg", dpi=100)
