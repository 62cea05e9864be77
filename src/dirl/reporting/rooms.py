"""The map of a room that pictures are drawn on, and its colours."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.patches import Circle, Patch, Rectangle
from matplotlib.ticker import MultipleLocator

from dirl.scenes import Scene
from dirl.scenes.palette import GOAL_COLOR, WALL_COLOR

__all__ = ["GOAL_COLOR", "WALL_COLOR", "draw_room", "has_walls"]


LAID_OUT = "tour, laid out"
"""The source of a scene whose positions are known only by its links."""


def has_walls(scene: Scene) -> bool:
    """Whether what lies between places is a wall or furniture; of a tour it is not known."""
    return not scene.source.startswith("tour")


def draw_room(axes: Axes, scene: Scene, side: float) -> None:
    """Draw white squares where an agent can be, on the grey of walls and furniture; discs for a tour.

    Args:
        axes: drawn on; get the limits and labels of the room.
        scene: the room.
        side: of a square, metres, see `dirl.scenes.geometry.step_length`.
    """
    cells = np.unique(scene.positions.round(3), axis=0)
    places: list[Patch]
    if has_walls(scene):
        places = [Rectangle((x - side / 2, z - side / 2), side, side) for x, z in cells]
        axes.set_facecolor(WALL_COLOR)
    else:
        places = [Circle((x, z), 0.25 * side) for x, z in cells]
    edge = "0.9" if has_walls(scene) else "0.6"
    axes.add_collection(
        PatchCollection(places, facecolor="white", edgecolor=edge, linewidth=0.5, zorder=1 if has_walls(scene) else 1.6)
    )
    low, high = cells.min(0) - side, cells.max(0) + side
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", anchor="N", xlabel="x (m)", ylabel="z (m)")
    if scene.source == LAID_OUT:
        axes.set(xlabel="layout of links: distances mean nothing", ylabel="", xticklabels=[], yticklabels=[])
    axes.xaxis.set_major_locator(MultipleLocator(1))
    axes.yaxis.set_major_locator(MultipleLocator(1))
