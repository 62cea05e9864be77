"""Several random rooms joined by doorways: what stands in them, where an agent can go, how they look."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dirl.scenes.scene import SceneError
from dirl.sources.rooms.description import Material, RoomDescription
from dirl.sources.rooms.layout import Opening, assemble, materials_of
from dirl.sources.rooms.mesh import Array, Mesh, Part
from dirl.sources.rooms.navigation import clearance, footprint, footprints
from dirl.sources.rooms.sampling import KINDS, sample_room
from dirl.sources.rooms.view import Renderer

WALL = 0.12
"""Metres: how thick the walls between rooms are."""

DOORWAY = (0.9, 2.05)
"""Width and height, metres."""

APPROACH = 0.75
"""Metres to both sides of a doorway that are cleared of furniture."""

OVERHEAD = ("rug", "ceiling_lamp")
"""Kinds of furniture that may stay in front of a doorway."""


@dataclass(frozen=True)
class Door:
    """A doorway between two rooms, which are given by their numbers.

    Args:
        first: the western or southern room.
        second: the eastern or northern room.
        axis: 0 if the second room lies east of the first, 1 if it lies north of it.
        at: where the middle of the doorway is along the wall, metres.
    """

    first: int
    second: int
    axis: int
    at: float


@dataclass(frozen=True)
class Building:
    """Rooms in one row, or in two rows on both sides of a wall, with doorways between them.

    The rooms of a row lie from west to east, with a doorway from each to the next. Those of the first row have their
    south walls in line. A second row lies south of it, with its north walls in line.

    Args:
        name: what the scene is called.
        rooms: two or more, first row first; what stood in the way of doorways is not in them any more.
        doors: where the middle of each doorway within a row is, y in metres.
        south: how many of the rooms, the last ones, are the second row; 0 if there is none.
        across: where the middle of each doorway between the rows is, x in metres.
    """

    name: str
    rooms: tuple[RoomDescription, ...]
    doors: tuple[float, ...]
    south: int = 0
    across: tuple[float, ...] = ()

    @property
    def corners(self) -> Array:
        """The south-west corners of the rooms, metres, float64 ``[R, 2]``."""
        first, second = self.rooms[: len(self.rooms) - self.south], self.rooms[len(self.rooms) - self.south :]
        line = max((room.size[1] for room in second), default=0.0)
        lows = [line + WALL if second else 0.0] * len(first) + [line - room.size[1] for room in second]
        starts = [
            sum(room.size[0] + WALL for room in row[:index]) for row in (first, second) for index in range(len(row))
        ]
        return np.array([starts, lows]).T

    @property
    def size(self) -> tuple[float, float, float]:
        """Width, depth and height of all rooms together."""
        width, depth = (self.corners + [room.size[:2] for room in self.rooms]).max(0)
        return float(width), float(depth), max(room.size[2] for room in self.rooms)

    @property
    def passages(self) -> list[Door]:
        """All doorways, those between the rows last."""
        found = [Door(*pair, 0, y) for pair, y in zip(self._neighbours, self.doors, strict=True)]
        for x in self.across:
            spans = zip(self.corners[:, 0].tolist(), self.rooms, strict=True)
            north, south = (i for i, (start, room) in enumerate(spans) if start < x < start + room.size[0])
            found.append(Door(south, north, 1, x))
        return found

    @property
    def _neighbours(self) -> list[tuple[int, int]]:
        """The pairs of rooms that lie side by side in a row."""
        last = len(self.rooms) - self.south - 1  # of the first row
        return [(room, room + 1) for room in range(len(self.rooms) - 1) if room != last]

    @property
    def doorways(self) -> Array:
        """The middles of `passages`, x and y, float64 ``[D, 2]``."""
        corners, middles = self.corners, []
        for door in self.passages:
            through = corners[door.second, door.axis] - WALL / 2
            middles.append((door.at, through) if door.axis else (through, door.at))
        return np.array(middles).reshape(-1, 2)


def sample_building(kinds: Sequence[str], seed: int) -> Building:
    """Random rooms of these kinds, joined; kinds and seed determine them.

    Up to four rooms lie in a row. More lie in two rows, with a doorway between the rows in the west, and another one
    in the east.

    Args:
        kinds: of the rooms from west to east, first row first, see `dirl.sources.rooms.KINDS`; two to eight.
        seed: of the first room; of the others the numbers that follow it.

    Raises:
        SceneError: another number of rooms, or `sample_room` cannot draw one.
    """
    if not 2 <= len(kinds) <= 8 or not set(kinds) <= set(KINDS):
        raise SceneError(f"kinds={list(kinds)}: expected two to eight of {', '.join(KINDS)}")
    rooms = [sample_room(kind, seed + index, look=False) for index, kind in enumerate(kinds)]
    south = len(rooms) // 2 if len(rooms) > 4 else 0
    building = Building(f"building_{seed}", tuple(rooms), (), south)
    corners, first = building.corners, len(rooms) - south
    doors = [_join(rooms, corners, pair, 0) for pair in building._neighbours]
    facing = [(b, a) for b in range(first, len(rooms)) for a in range(first) if _spots(rooms, corners, (b, a), 1)]
    facing.sort(key=lambda pair: float(corners[list(pair), 0].max()))
    across = [_join(rooms, corners, pair, 1) for pair in dict.fromkeys([*facing[:1], *facing[-1:]])]
    return replace(building, rooms=tuple(rooms), doors=tuple(doors), across=tuple(across))


def _spots(rooms: Sequence[RoomDescription], corners: Array, pair: tuple[int, int], axis: int) -> list[float]:
    """Return where the middle of a doorway between two rooms may be along their wall, see `Door`."""
    low = max(corners[index, 1 - axis] for index in pair)
    high = min(corners[index, 1 - axis] + rooms[index].size[1 - axis] for index in pair)
    spots = np.arange(low + (DOORWAY[0] / 2 + 0.2), high - DOORWAY[0] / 2 - 0.2, 0.1)
    return [float(at) for at in spots.round(2)]


def _join(rooms: list[RoomDescription], corners: Array, pair: tuple[int, int], axis: int) -> float:
    """Where the doorway between two rooms is, before which least furniture stands; the rooms lose that furniture."""
    first, second = pair
    spots = _spots(rooms, corners, pair, axis)
    cleared = [
        (
            _cleared(rooms[first], rooms[first].size[axis], at - corners[first, 1 - axis], axis),
            _cleared(rooms[second], 0, at - corners[second, 1 - axis], axis),
        )
        for at in spots
    ]
    best = int(np.argmax([sum(len(room.furniture) for room in both) for both in cleared]))
    rooms[first], rooms[second] = cleared[best]
    return spots[best]


def _cleared(room: RoomDescription, end: float, at: float, axis: int = 0) -> RoomDescription:
    """Return a room without the furniture in front of a doorway, and without what stood on it.

    The doorway is in the wall at ``end`` of the room, x with axis 0 or y with axis 1, and its middle at ``at``.
    """
    ends = ((end - APPROACH, at), (end + APPROACH, at))
    start, stop = (np.array([point[::-1] if axis else point]) for point in ends)
    boxes = np.array([footprint(piece, room) for piece in room.furniture]).reshape(-1, 5)
    standing = np.array([piece.kind not in OVERHEAD for piece in room.furniture], bool)
    near = np.array([clearance(start, stop, box[None])[0] < DOORWAY[0] / 2 for box in boxes], bool)
    on_top = clearance(boxes[:, :2], boxes[:, :2], boxes[standing & near]) == 0
    gone = standing & (near | on_top)
    return replace(room, furniture=tuple(piece for piece, out in zip(room.furniture, gone, strict=True) if not out))


def walls(building: Building) -> Array:
    """Return the walls of a building and what lies outside them, as `footprints` gives them, ``[n, 5]``."""
    width, depth, _ = building.size
    far, half = max(width, depth) + 2, DOORWAY[0] / 2
    first = len(building.rooms) - building.south
    line = building.corners[0, 1]  # where the first row's south walls are
    found = [(-1.0, 0.0, 1.0, far)]
    cuts = [-far, *(x + side * half for x in sorted(building.across) for side in (-1, 1)), far]
    thick, outside = (WALL, far) if building.south else (2.0, 2.0)
    for low, high in zip(cuts[::2], cuts[1::2], strict=True):
        found.append(((low + high) / 2, line - thick / 2, (high - low) / 2, thick / 2))
    for outwards, row in ((1, range(first)), (-1, range(first, len(building.rooms)))):
        for index in row:
            (x, y), room = building.corners[index], building.rooms[index]
            outer = y + room.size[1] if outwards > 0 else y
            found.append((x + room.size[0] / 2, outer + outwards * far / 2, room.size[0] / 2 + WALL, far / 2))
            if index == row[-1]:
                found.append((x + room.size[0] + outside / 2, line + outwards * far / 2, outside / 2, far / 2))
    for door, (x, y) in zip(building.passages, building.doorways, strict=True):
        if door.axis == 0:
            to_line = abs(y - line) - half if building.south else far
            low, high = (to_line, far) if door.first < first else (far, to_line)
            found += [(x, y - (half + low / 2), WALL / 2, low / 2), (x, y + (half + high / 2), WALL / 2, high / 2)]
    return np.pad(np.array(found), ((0, 0), (0, 1)))


def furniture(building: Building) -> Array:
    """Return what stands in a building, as `footprints` gives them, ``[n, 5]``."""
    rooms = zip(building.rooms, building.corners, strict=True)
    return np.concatenate([footprints(room) + np.array([*corner, 0, 0, 0]) for room, corner in rooms])


WALLS = (("east", "west"), ("north", "south"))
"""In which walls of its two rooms a doorway is, by its axis."""


def assemble_building(building: Building) -> tuple[list[Part], dict[str, Material]]:
    """Return all triangles of a building, and its materials; those of different rooms have different names."""
    parts: list[Part] = []
    materials: dict[str, Material] = {}
    for index, (room, corner) in enumerate(zip(building.rooms, building.corners, strict=True)):
        openings = []
        for door in building.passages:
            if index in (door.first, door.second):
                at = float(door.at - corner[1 - door.axis])
                wall = WALLS[door.axis][index == door.second]
                openings.append(Opening(wall, at - DOORWAY[0] / 2, at + DOORWAY[0] / 2, DOORWAY[1]))
        own = {name: f"{index}.{name}" for name in materials_of(room)}
        materials |= {own[name]: material for name, material in materials_of(room).items()}
        for part in assemble(room, openings):
            moved = part.moved((float(corner[0]), float(corner[1]), 0), 0, 1.0)
            parts.append(replace(moved, material=own[part.material]))
    for door, (x, y) in zip(building.passages, building.doorways, strict=True):
        jambs = _jambs(x, y) if door.axis == 0 else [part.moved((x, y, 0), 90, 1.0) for part in _jambs(0, 0)]
        parts += [replace(part, material=f"0.{part.material}") for part in jambs]
    return parts, materials


def _jambs(x: float, y: float) -> list[Part]:
    """Return the inside of a doorway from west to east: threshold, sides and top."""
    (left, right), (low, high) = (x - WALL / 2, x + WALL / 2), (y - DOORWAY[0] / 2, y + DOORWAY[0] / 2)
    top, paint = DOORWAY[1], "white_paint"
    mesh = Mesh().quad([(left, low, 0), (right, low, 0), (right, high, 0), (left, high, 0)], paint)
    mesh.quad([(left, low, top), (left, high, top), (right, high, top), (right, low, top)], paint)
    mesh.quad([(left, low, 0), (left, low, top), (right, low, top), (right, low, 0)], paint)
    mesh.quad([(left, high, 0), (right, high, 0), (right, high, top), (left, high, top)], paint)
    return [part.moved((0, 0, 0), 0, 1.0) for part in mesh.parts]


def building_renderer(building: Building) -> Renderer:
    """Return a building in coarse light, seen from anywhere in it."""
    return Renderer.lit(*assemble_building(building), building.size, 1.4, fine=False)
