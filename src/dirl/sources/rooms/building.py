"""Several random rooms joined by doorways: what stands in them, where an agent can go, how they look."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dirl.scenes.scene import SceneError
from dirl.sources.rooms.description import Material, RoomDescription
from dirl.sources.rooms.layout import Opening, assemble, materials_of
from dirl.sources.rooms.light import bake
from dirl.sources.rooms.mesh import Array, Mesh, Part
from dirl.sources.rooms.navigation import clearance, footprint, footprints
from dirl.sources.rooms.sampling import KINDS, sample_room
from dirl.sources.rooms.scenery import Scenery
from dirl.sources.rooms.view import Renderer, exposure

WALL = 0.12
"""Metres: how thick the walls between rooms are."""

DOORWAY = (0.9, 2.05)
"""Width and height, metres."""

APPROACH = 0.75
"""Metres to both sides of a doorway that are cleared of furniture."""

OVERHEAD = ("rug", "ceiling_lamp")
"""Kinds of furniture that may stay in front of a doorway."""


@dataclass(frozen=True)
class Building:
    """Rooms in a row from west to east, their south walls in line, with a doorway from each to the next.

    Args:
        name: what the scene is called.
        rooms: two or more; what stood in the way of doorways is not in them any more.
        doors: where the middle of each doorway is, y in metres; one less than rooms.
    """

    name: str
    rooms: tuple[RoomDescription, ...]
    doors: tuple[float, ...]

    @property
    def starts(self) -> list[float]:
        """Where each room begins, x in metres."""
        widths = [room.size[0] + WALL for room in self.rooms]
        return [float(sum(widths[:index])) for index in range(len(widths))]

    @property
    def size(self) -> tuple[float, float, float]:
        """Width, depth and height of all rooms together."""
        depth, height = (max(room.size[axis] for room in self.rooms) for axis in (1, 2))
        return self.starts[-1] + self.rooms[-1].size[0], depth, height

    @property
    def doorways(self) -> Array:
        """The middles of the doorways, x and y, float64 ``[R - 1, 2]``."""
        return np.array([(x - WALL / 2, y) for x, y in zip(self.starts[1:], self.doors, strict=True)]).reshape(-1, 2)


def sample_building(kinds: Sequence[str], seed: int) -> Building:
    """Random rooms of these kinds, joined; kinds and seed determine them.

    Args:
        kinds: of the rooms from west to east, see `dirl.sources.rooms.KINDS`; two to four.
        seed: of the first room; of the others the numbers that follow it.

    Raises:
        SceneError: another number of rooms, or `sample_room` cannot draw one.
    """
    if not 2 <= len(kinds) <= 4 or not set(kinds) <= set(KINDS):
        raise SceneError(f"kinds={list(kinds)}: expected two to four of {', '.join(KINDS)}")
    rooms = [sample_room(kind, seed + index, look=False) for index, kind in enumerate(kinds)]
    doors = []
    for index in range(len(rooms) - 1):
        pair = rooms[index : index + 2]
        last = min(room.size[1] for room in pair) - DOORWAY[0] / 2 - 0.2
        heights = np.arange(DOORWAY[0] / 2 + 0.2, last, 0.1).round(2).tolist()
        cleared = [[_cleared(room, x, y) for room, x in zip(pair, (pair[0].size[0], 0), strict=True)] for y in heights]
        removed = [sum(len(room.furniture) for room in pair) - sum(len(r.furniture) for r in both) for both in cleared]
        best = int(np.argmin(removed))
        doors.append(heights[best])
        rooms[index : index + 2] = cleared[best]
    return Building(f"building_{seed}", tuple(rooms), tuple(doors))


def _cleared(room: RoomDescription, x: float, y: float) -> RoomDescription:
    """A room without the furniture in front of a doorway at a point of its wall, and without what stood on it."""
    reach = np.array([[x - APPROACH, y, x + APPROACH, y]])
    pieces = [piece for piece in room.furniture if piece.kind not in OVERHEAD]
    boxes = np.array([footprint(piece, room) for piece in pieces]).reshape(-1, 5)
    near = [clearance(reach[:, :2], reach[:, 2:], box[None])[0] < DOORWAY[0] / 2 for box in boxes]
    middles, in_the_way = boxes[:, :2], boxes[np.array(near, bool)]
    on_top = clearance(middles, middles, in_the_way) == 0
    gone = {id(piece) for piece, near_it, above in zip(pieces, near, on_top, strict=True) if near_it or above}
    return replace(room, furniture=tuple(piece for piece in room.furniture if id(piece) not in gone))


def walls(building: Building) -> Array:
    """The walls of a building and what lies outside them, as `footprints` gives them, ``[n, 5]``."""
    width, depth, _ = building.size
    far, half = max(width, depth) + 2, DOORWAY[0] / 2
    found = [(-1.0, 0.0, 1.0, far), (width + 1, 0.0, 1.0, far), (0.0, -1.0, far, 1.0)]
    for room, start in zip(building.rooms, building.starts, strict=True):
        found.append((start + room.size[0] / 2, room.size[1] + far / 2, room.size[0] / 2 + WALL, far / 2))
    for x, y in building.doorways:
        found += [(x, y + side * (half + far / 2), WALL / 2, far / 2) for side in (-1, 1)]
    return np.pad(np.array(found), ((0, 0), (0, 1)))


def furniture(building: Building) -> Array:
    """What stands in a building, as `footprints` gives them, ``[n, 5]``."""
    starts = [np.array([start, 0, 0, 0, 0]) for start in building.starts]
    return np.concatenate([footprints(room) + start for room, start in zip(building.rooms, starts, strict=True)])


def assemble_building(building: Building) -> tuple[list[Part], dict[str, Material]]:
    """All triangles of a building, and its materials; those of different rooms have different names."""
    parts: list[Part] = []
    materials: dict[str, Material] = {}
    for index, (room, start) in enumerate(zip(building.rooms, building.starts, strict=True)):
        openings = [
            Opening(wall, y - DOORWAY[0] / 2, y + DOORWAY[0] / 2, DOORWAY[1])
            for wall, doors in (
                ("west", building.doors[index - 1 : index] if index else ()),
                ("east", building.doors[index : index + 1]),
            )
            for y in doors
        ]
        own = {name: f"{index}.{name}" for name in materials_of(room)}
        materials |= {own[name]: material for name, material in materials_of(room).items()}
        for part in assemble(room, openings):
            moved = part.moved((start, 0, 0), 0, 1.0)
            parts.append(replace(moved, material=own[part.material]))
    for x, y in building.doorways:
        parts += [replace(part, material=f"0.{part.material}") for part in _jambs(x, y)]
    return parts, materials


def _jambs(x: float, y: float) -> list[Part]:
    """The inside of a doorway: threshold, sides and top."""
    (left, right), (low, high) = (x - WALL / 2, x + WALL / 2), (y - DOORWAY[0] / 2, y + DOORWAY[0] / 2)
    top, paint = DOORWAY[1], "white_paint"
    mesh = Mesh().quad([(left, low, 0), (right, low, 0), (right, high, 0), (left, high, 0)], paint)
    mesh.quad([(left, low, top), (left, high, top), (right, high, top), (right, low, top)], paint)
    mesh.quad([(left, low, 0), (left, low, top), (right, low, top), (right, low, 0)], paint)
    mesh.quad([(left, high, 0), (right, high, 0), (right, high, top), (left, high, top)], paint)
    return [part.moved((0, 0, 0), 0, 1.0) for part in mesh.parts]


def building_renderer(building: Building) -> Renderer:
    """A building in coarse light, seen from anywhere in it."""
    scenery = Scenery(*assemble_building(building), edge=0.25, texture_limit=128)
    light = bake(scenery, direct=9, indirect=36, bounces=3, rng=np.random.default_rng(0))
    renderer = Renderer(scenery, light)
    renderer.exposure = exposure(renderer, building.size, 1.4)
    return renderer
