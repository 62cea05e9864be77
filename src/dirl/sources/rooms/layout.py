"""From a description to triangles: the shell of the room, and every piece of furniture in its place."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from dirl.scenes.scene import SceneError
from dirl.sources.rooms.description import Material, Piece, RoomDescription, Size
from dirl.sources.rooms.furniture import FURNITURE
from dirl.sources.rooms.materials import STOCK
from dirl.sources.rooms.mesh import Array, Mesh, Part

Corner = tuple[float, float]

YAW = {"north": 0.0, "west": 90.0, "south": 180.0, "east": -90.0}
"""How far a piece with its back to a wall is turned."""


@dataclass(frozen=True)
class Opening:
    """A doorway in a wall, from the floor to its ``top``, between two places along the wall: x or y, metres."""

    wall: str
    low: float
    high: float
    top: float


def place_of(piece: Piece, size: Size) -> tuple[float, float, float]:
    """Return x and y, metres, of a piece's middle in a room of this size, and how far it is turned, degrees."""
    width, depth, _ = size
    if piece.wall is None:
        x, y = piece.at or (0.0, 0.0)
        return x + width * (x < 0), y + depth * (y < 0), piece.yaw
    along, back = piece.along or 0.0, piece.size[1] / 2 + piece.off
    x, y = {
        "south": (along, back),
        "north": (along, depth - back),
        "west": (back, along),
        "east": (width - back, along),
    }[piece.wall]
    return x, y, YAW[piece.wall] + piece.yaw


def materials_of(room: RoomDescription) -> dict[str, Material]:
    """Return the materials that a room may use: its own, and those in stock."""
    return {**STOCK, **room.materials}


def assemble(room: RoomDescription, openings: Sequence[Opening] = ()) -> list[Part]:
    """Return a room's triangles, in metres; `SceneError` names a piece that cannot be made or has no such material."""
    return [part for _, parts in assemble_pieces(room, openings) for part in parts]


def assemble_pieces(room: RoomDescription, openings: Sequence[Opening] = ()) -> list[tuple[str, list[Part]]]:
    """Return the shell of a room and each of its pieces, with its name in messages; raises as `assemble` does."""
    materials = materials_of(room)
    assembled = [("[room]", _placed(_shell(room, openings), (0, 0, 0), 0, materials, "[room]"))]
    for number, piece in enumerate(room.furniture, 1):
        where = f"[[furniture]] number {number} ({piece.kind})"
        x, y, yaw = place_of(piece, room.size)
        z = room.size[2] if piece.kind == "ceiling_lamp" else piece.lift
        try:
            mesh = FURNITURE[piece.kind](*piece.size, **piece.options)
        except ValueError as error:
            raise SceneError(f"{where}: {error}") from None
        assembled.append((where, _placed(mesh, (x, y, z), yaw, materials, where)))
    return assembled


def _placed(
    mesh: Mesh, at: tuple[float, float, float], yaw: float, materials: dict[str, Material], where: str
) -> list[Part]:
    for part in mesh.parts:
        if part.material not in materials:
            raise SceneError(f"{where}: there is no material '{part.material}'; describe it under [materials]")
    return [
        part.moved(at, yaw, materials[part.material].size, grained=materials[part.material].kind == "wood")
        for part in mesh.parts
    ]


def _shell(room: RoomDescription, openings: Sequence[Opening]) -> Mesh:
    """Build floor, ceiling, walls with their bands, skirting and rail."""
    w, d, h = room.size
    mesh = Mesh().quad([(0, 0, 0), (w, 0, 0), (w, d, 0), (0, d, 0)], room.floor)
    mesh.quad([(0, 0, h), (0, d, h), (w, d, h), (w, 0, h)], room.ceiling)
    ends: dict[str, tuple[Corner, Corner]] = {
        "south": ((w, 0), (0, 0)),
        "north": ((0, d), (w, d)),
        "west": ((0, 0), (0, d)),
        "east": ((w, d), (w, 0)),
    }
    for side, (first, last) in ends.items():
        for a, b, foot in _stretches(first, last, [opening for opening in openings if opening.wall == side]):
            low = 0.0
            for top, material in room.walls[side]:
                if top > foot:
                    mesh.quad([(*a, max(low, foot)), (*b, max(low, foot)), (*b, top), (*a, top)], material)
                low = top
            edge = room.walls[side][0][0]
            if room.rail and len(room.walls[side]) > 1 and edge > foot:
                _board(mesh, a, b, (edge - 0.025, edge + 0.025), 0.02, room.rail)
            if room.skirting and not foot:
                _board(mesh, a, b, (0, 0.09), 0.015, room.skirting)
    return mesh


def _stretches(first: Corner, last: Corner, openings: Sequence[Opening]) -> Iterator[tuple[Corner, Corner, float]]:
    """Yield a wall's stretches between and above its openings: from where to where, and from which height up."""
    axis = 0 if first[1] == last[1] else 1
    start, end = sorted((first[axis], last[axis]))
    cuts = [(start, end, 0.0)]
    for opening in sorted(openings, key=lambda opening: opening.low):
        before = cuts.pop()
        cuts += [(before[0], opening.low, 0.0), (opening.low, opening.high, opening.top), (opening.high, end, 0.0)]
    for low, high, foot in cuts:
        a, b = (low, high) if first[axis] < last[axis] else (high, low)
        yield ((a, first[1]), (b, first[1]), foot) if axis == 0 else ((first[0], a), (first[0], b), foot)


def _board(mesh: Mesh, a: Corner, b: Corner, z: tuple[float, float], thick: float, material: str) -> None:
    """Add a board along the foot of a wall from a to b, which has the room on its right."""
    start, end = np.array(a), np.array(b)
    along = (end - start) / np.linalg.norm(end - start)
    inwards: Array = np.array([along[1], -along[0]]) * thick
    corners = np.stack([start, end, start + inwards, end + inwards])
    low, high = corners.min(0), corners.max(0)
    mesh.box(low[0], low[1], z[0], high[0], high[1], z[1], material, 0.005)
