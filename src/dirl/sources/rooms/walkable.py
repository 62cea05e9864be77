"""Places and moves of an agent: a disc on a grid, among the footprints of the furniture."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from dirl.scenes.graph import AHEAD, BACK, IntArray, turns_only
from dirl.scenes.live import turns_by_angle
from dirl.scenes.scene import SceneError
from dirl.sources.rooms.description import Piece, RoomDescription
from dirl.sources.rooms.furniture import NOT_SOLID
from dirl.sources.rooms.layout import place_of
from dirl.sources.rooms.mesh import Array

TOUCH = 1e-9
"""Metres: an agent that just touches a wall or a piece is not stopped by it."""


@dataclass(frozen=True)
class Walk:
    """Places, and the graph of states over them.

    Args:
        places: metres, float64 ``[P, 2]``, in the order of x, then y.
        headings: degrees clockwise from the y axis, float64 ``[K]``.
        graph: next states, int64 ``[P * K, 4]`` in the order of `dirl.scenes.ACTIONS`, -1 = blocked. State
            ``K * place + k`` has heading k.
    """

    places: Array
    headings: Array
    graph: IntArray


def footprints(room: RoomDescription) -> Array:
    """Return rectangles that agents cannot enter: middle x and y, half width and depth, turn in radians, ``[n, 5]``."""
    solid = [
        footprint(piece, room)
        for piece in room.furniture
        if (piece.kind not in NOT_SOLID if piece.solid is None else piece.solid)
    ]
    return np.array(solid).reshape(-1, 5)


def footprint(piece: Piece, room: RoomDescription) -> tuple[float, ...]:
    """Return the rectangle of a piece on the floor plan, see `footprints`."""
    x, y, yaw = place_of(piece, room.size)
    return x, y, piece.size[0] / 2, piece.size[1] / 2, float(np.radians(yaw))


def clearance(a: Array, b: Array, rectangles: Array) -> Array:
    """Return the exact distance of segments from a to b, ``[n, 2]`` each, to the nearest of the `footprints`.

    Metres; 0 where they meet, infinite if there are no rectangles.
    """
    if not len(rectangles):
        return np.full(len(a), np.inf)
    x, y, half_width, half_depth, turn = rectangles.T
    half = np.stack([half_width, half_depth], -1)

    def inside(points: Array) -> Array:
        """Return points in each rectangle's own coordinates, ``[n, m, 2]``."""
        dx, dy = points[:, None, 0] - x, points[:, None, 1] - y
        return np.stack([dx * np.cos(turn) + dy * np.sin(turn), dy * np.cos(turn) - dx * np.sin(turn)], -1)

    start, end = inside(a), inside(b)
    along = end - start
    # The segment meets the rectangle if some part of it lies in both slabs.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        to_low, to_high = (-half - start) / along, (half - start) / along
    parallel, within = along == 0, np.abs(start) <= half
    enter = np.where(parallel, np.where(within, 0, np.inf), np.minimum(to_low, to_high)).max(-1)
    leave = np.where(parallel, np.where(within, 1, -np.inf), np.maximum(to_low, to_high)).min(-1)
    meets = np.maximum(enter, 0) <= np.minimum(leave, 1)
    # Otherwise the nearest point is an end of the segment or a corner of the rectangle.
    ends = np.minimum(*(np.hypot(*np.moveaxis(np.maximum(np.abs(p) - half, 0), -1, 0)) for p in (start, end)))
    length = np.maximum((along**2).sum(-1), 1e-300)
    corner = half * np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)])[:, None, None]
    share = np.clip(((corner - start) * along).sum(-1) / length, 0, 1)
    corners = np.hypot(*np.moveaxis(start + share[..., None] * along - corner, -1, 0)).min(0)
    return np.where(meets, 0, np.minimum(ends, corners)).min(1)


def walk(room: RoomDescription, turn: float = 90) -> Walk:
    """Return the places of a room and how they are linked.

    Places are the points of the grid where the agent's disc is clear of the walls and of every solid piece, and that
    can be reached from most others by steps along the axes. A move is possible if it leads to a place and the disc
    stays clear all the way: with turns of 90 degrees along the axes only, with 45 along the diagonals too. Other
    headings, such as those of 30 degrees, point at no neighbouring place, and moves ahead and back are blocked.

    Raises:
        SceneError: the turn, degrees, does not divide 90, there is no place, or their number is not that of the
            description.
    """
    turns = turns_by_angle(turn)
    cells, points = _places(room)
    headings = np.arange(turns) * turn
    graph = turns_only(len(cells), turns)
    for k, heading in enumerate(np.radians(headings)):
        if round(np.degrees(heading)) % 45 == 0:
            step = np.round([1.2 * np.sin(heading), 1.2 * np.cos(heading)]).astype(int)
            for action, way in ((AHEAD, step), (BACK, -step)):
                here, there = _steps(cells, points, way, room)
                graph[turns * here + k, action] = turns * there + k
    return Walk(points, headings, graph)


def free_points(room: RoomDescription) -> tuple[IntArray, Array]:
    """Return the grid cells, int64 ``[F, 2]``, and points, metres, ``[F, 2]``, where the agent can stand."""
    grid = room.grid
    if grid.step <= 0 or max(room.size[:2]) / grid.step > 1000:
        raise SceneError(f"[grid] step: expected at least a thousandth of the room's length, found {grid.step:g}")
    counts = [
        max(0, int((length - start) / grid.step) + 1) for length, start in zip(room.size[:2], grid.origin, strict=True)
    ]
    cells = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), -1).reshape(-1, 2)
    points = cells * grid.step + grid.origin
    free = _free(points, points, room)
    return cells[free], points[free]


def _places(room: RoomDescription) -> tuple[IntArray, Array]:
    """Return the grid cells ``[P, 2]`` and points ``[P, 2]`` of the largest connected group of free points."""
    grid, (cells, points) = room.grid, free_points(room)
    if not len(cells):
        raise SceneError("there is no place where the agent can stand; see [grid] and the furniture")
    a, b = np.concatenate([_steps(cells, points, np.array(way), room) for way in ((1, 0), (0, 1))], 1)
    _, group = connected_components(coo_array((np.ones(len(a)), (a, b)), (len(cells), len(cells))), directed=False)
    largest = group == np.bincount(group).argmax()
    if grid.places is not None and largest.sum() != grid.places:
        raise SceneError(f"[grid] places: the room has {largest.sum()} places, not {grid.places}")
    return cells[largest], points[largest]


def _steps(cells: IntArray, points: Array, way: IntArray, room: RoomDescription) -> tuple[IntArray, IntArray]:
    """Return from which places a step of so many cells is possible, and to which it leads."""
    number = {tuple(cell): place for place, cell in enumerate(cells.tolist())}
    there = np.array([number.get(tuple(cell), -1) for cell in (cells + way).tolist()])
    here = np.flatnonzero(there >= 0)
    here = here[_free(points[here], points[there[here]], room)]
    return here, there[here]


def _free(a: Array, b: Array, room: RoomDescription) -> Array:
    """Return True where the agent's disc stays clear from point a to point b, bool ``[n]``."""
    radius, extent = room.grid.radius, np.array(room.size[:2])
    both = np.concatenate([a, b], 1).reshape(-1, 2, 2)
    indoors = ((both >= radius - TOUCH) & (both <= extent - radius + TOUCH)).all((1, 2))
    return indoors & (clearance(a, b, footprints(room)) >= radius - TOUCH)
