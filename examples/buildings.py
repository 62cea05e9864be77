"""Random rooms in a row, joined by doorways, and a tour of them: panoramas some metres apart, and links.

    python examples/buildings.py "kinds=[bedroom,bathroom,kitchen]" seed=10001 out=flat
    python recipes/scenes.py tour path=flat out=flat.h5

Without furniture in front of the doorways, and rendered as the built-in rooms are: synthetic. With ``walk=true`` it is
the frames of a camera that is carried from the first room to the last, and two photos beside the way.
"""

import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, dijkstra

from dirl.cli.start import run, start
from dirl.config.schemas import option
from dirl.scenes.scene import SceneError
from dirl.sources.rooms.description import Camera, Material, RoomDescription
from dirl.sources.rooms.layout import Opening, assemble, materials_of
from dirl.sources.rooms.mesh import Array, Mesh, Part
from dirl.sources.rooms.sampling import KINDS, sample_room
from dirl.sources.rooms.view import Pose, Renderer
from dirl.sources.rooms.walkable import TOUCH, clearance, footprint, footprints

WALL = 0.12
"""Metres: how thick the walls between rooms are."""

DOORWAY = (0.9, 2.05)
"""Width and height, metres."""

APPROACH = 0.75
"""Metres to both sides of a doorway that are cleared of furniture."""

OVERHEAD = ("rug", "ceiling_lamp")
"""Kinds of furniture that may stay in front of a doorway."""

OUTSIDE = 2.0
"""Metres of what lies around a building and stops an agent."""

ROOM_FOR_TRIPOD = 0.3
"""Metres around a panorama that are free."""

FINE = 0.25
"""Metres between the points of which panoramas are chosen."""


@dataclass
class Options:
    """What the command line may say."""

    kinds: list[str] = option("of the rooms from west to east: two to four of bathroom, bedroom, kitchen, living_room")
    out: str = option("the folder of the panoramas and their tables, made if there is none")
    seed: int = option("of the first room; of the others the numbers that follow", 0)
    height: int = option("of a panorama, pixels; it is twice as wide", 128)
    walk: bool = option("frames of a walk in place of panoramas, 320x180 pixels", False)


@dataclass(frozen=True)
class Building:
    """Rooms in a row from west to east, their south walls in line, with a doorway from each to the next.

    Args:
        name: what the scene is called.
        rooms: two or more; what stood in the way of doorways is not in them any more.
        doors: where the middle of each doorway is, y in metres.
    """

    name: str
    rooms: tuple[RoomDescription, ...]
    doors: tuple[float, ...]

    @property
    def starts(self) -> Array:
        """Where the west wall of each room is, x in metres, float64 ``[R]``."""
        return np.cumsum([0.0, *(room.size[0] + WALL for room in self.rooms[:-1])])

    @property
    def size(self) -> tuple[float, float, float]:
        """Width, depth and height of all rooms together."""
        depth, height = (max(room.size[axis] for room in self.rooms) for axis in (1, 2))
        return float(self.starts[-1] + self.rooms[-1].size[0]), depth, height

    @property
    def doorways(self) -> Array:
        """The middles of the doorways, x and y, float64 ``[R - 1, 2]``."""
        return np.stack([self.starts[1:] - WALL / 2, self.doors], 1)


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
    for west in range(len(rooms) - 1):
        # The doorway is where least furniture stands in front of it; the rooms lose that furniture.
        high = min(room.size[1] for room in rooms[west : west + 2])
        spots = np.arange(DOORWAY[0] / 2 + 0.2, high - DOORWAY[0] / 2 - 0.2, 0.1).round(2).tolist()
        cleared = [(_cleared(rooms[west], rooms[west].size[0], at), _cleared(rooms[west + 1], 0, at)) for at in spots]
        best = int(np.argmax([sum(len(room.furniture) for room in both) for both in cleared]))
        rooms[west : west + 2] = cleared[best]
        doors.append(spots[best])
    return Building(f"building_{seed}", tuple(rooms), tuple(doors))


def _cleared(room: RoomDescription, end: float, at: float) -> RoomDescription:
    """Return a room without the furniture in front of a doorway, and without what stood on it.

    The doorway is in the wall at x = ``end`` of the room, and its middle at y = ``at``.
    """
    start, stop = np.array([[end - APPROACH, at]]), np.array([[end + APPROACH, at]])
    boxes = np.array([footprint(piece, room) for piece in room.furniture]).reshape(-1, 5)
    standing = np.array([piece.kind not in OVERHEAD for piece in room.furniture], bool)
    near = np.array([clearance(start, stop, box[None])[0] < DOORWAY[0] / 2 for box in boxes], bool)
    on_top = clearance(boxes[:, :2], boxes[:, :2], boxes[standing & near]) == 0
    gone = standing & (near | on_top)
    return replace(room, furniture=tuple(piece for piece, out in zip(room.furniture, gone, strict=True) if not out))


def walls(building: Building) -> Array:
    """Return the walls of a building and what lies outside them, as `footprints` gives them, ``[n, 5]``."""
    width, depth, _ = building.size
    far = max(width, depth) + OUTSIDE
    half = OUTSIDE / 2
    found = [(-half, 0.0, half, far), (0.0, -half, far, half), (width + half, far / 2, half, far / 2)]
    for x, room in zip(building.starts, building.rooms, strict=True):
        found.append((x + room.size[0] / 2, room.size[1] + far / 2, room.size[0] / 2 + WALL, far / 2))
    for x, y in building.doorways:
        beside = (DOORWAY[0] + far) / 2
        found += [(x, y - beside, WALL / 2, far / 2), (x, y + beside, WALL / 2, far / 2)]
    return np.pad(np.array(found), ((0, 0), (0, 1)))


def furniture(building: Building) -> Array:
    """Return what stands in a building, as `footprints` gives them, ``[n, 5]``."""
    rooms = zip(building.rooms, building.starts, strict=True)
    return np.concatenate([footprints(room) + np.array([x, 0, 0, 0, 0]) for room, x in rooms])


def assemble_building(building: Building) -> tuple[list[Part], dict[str, Material]]:
    """Return all triangles of a building, and its materials; those of different rooms have different names."""
    parts: list[Part] = []
    materials: dict[str, Material] = {}
    for index, (room, x) in enumerate(zip(building.rooms, building.starts.tolist(), strict=True)):
        openings = [
            Opening(wall, building.doors[door] - DOORWAY[0] / 2, building.doors[door] + DOORWAY[0] / 2, DOORWAY[1])
            for wall, door in (("west", index - 1), ("east", index))
            if 0 <= door < len(building.doors)
        ]
        own = {name: f"{index}.{name}" for name in materials_of(room)}
        materials |= {own[name]: material for name, material in materials_of(room).items()}
        for part in assemble(room, openings):
            parts.append(replace(part.moved((x, 0, 0), 0, 1.0), material=own[part.material]))
    for x, y in building.doorways:
        parts += [replace(part, material=f"0.{part.material}") for part in _jambs(x, y)]
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


STRIDE = 0.5, 15.0
"""Metres and degrees between the frames of a walk."""


class Panoramas(NamedTuple):
    """Where panoramas stand, and from which to which there are links."""

    places: Array
    """Metres, float64 ``[P, 2]``; those of doorways first."""
    links: Array
    """Pairs of them, int64 ``[L, 2]``, each way."""


def choose_panoramas(building: Building, apart: float = 2.0) -> Panoramas:
    """Panoramas in the doorways, and in the rooms as many as can stand so far from all others.

    Two are linked if no wall is between them, and no third one is nearer to both. As the arrows of real tours, links
    lead over furniture.

    Args:
        building: where.
        apart: metres.

    Raises:
        SceneError: not all doorways can be reached by links.
    """
    solid = np.concatenate([walls(building), furniture(building)])
    steps = [np.arange(FINE, length, FINE) for length in building.size[:2]]
    points = np.stack(np.meshgrid(*steps, indexing="ij"), -1).reshape(-1, 2)
    points = points[clearance(points, points, solid) >= ROOM_FOR_TRIPOD]
    chosen = [*building.doorways]
    while True:
        distance = np.linalg.norm(points[:, None] - np.array(chosen), axis=-1).min(1)
        if distance.max() < apart:
            break
        chosen.append(points[distance.argmax()])
    places = np.array(chosen)
    links = _links(places, walls(building))
    graph = coo_array((np.ones(len(links)), links.T), (len(places), len(places))).tocsr()
    reached = np.isin(np.arange(len(places)), breadth_first_order(graph, 0, return_predecessors=False))
    if not reached[: len(building.doorways)].all():
        raise SceneError(f"{building.name}: not all doorways can be reached by links")
    number = np.cumsum(reached) - 1
    return Panoramas(places[reached], number[links[reached[links].all(1)]])


def _links(places: Array, solid: Array) -> Array:
    between = np.linalg.norm(places[:, None] - places, axis=-1)
    count = len(places)
    free = clearance(np.repeat(places, count, 0), np.tile(places, (count, 1)), solid).reshape(count, count) > TOUCH
    np.fill_diagonal(free, False)
    seen = np.where(free, between, np.inf)
    nearer = np.maximum(seen[:, None], seen).min(-1) < between - TOUCH
    return np.argwhere(free & ~nearer)


def write_building_tour(
    building: Building, folder: Path, *, apart: float = 2.0, size: tuple[int, int] = (128, 256), seed: int = 0
) -> Panoramas:
    """Render the panoramas of a building into a folder that `scenes.py tour` reads.

    The middle of each image looks in a random direction, as in real tours; positions are written, headings are not.

    Args:
        building: what is shown.
        folder: made if there is none.
        apart: see `choose_panoramas`.
        size: height and width of the images, pixels.
        seed: of the directions.

    Raises:
        SceneError: see `choose_panoramas`.
    """
    found = choose_panoramas(building, apart)
    folder.mkdir(parents=True, exist_ok=True)
    renderer = Renderer.lit(*assemble_building(building), building.size, 1.4, fine=False)
    middles = np.random.default_rng(seed).uniform(0, 360, len(found.places))
    names = [f"{index:03d}.png" for index in range(len(found.places))]
    for name, (x, y), middle in zip(names, found.places, middles, strict=True):
        Image.fromarray(renderer.panorama(1.4, (x, y, middle), size)).save(folder / name)
    along = found.places[found.links[:, 1]] - found.places[found.links[:, 0]]
    yaws = (np.degrees(np.arctan2(*along.T)) - middles[found.links[:, 0]] + 180) % 360 - 180
    links = [(names[a], names[b], f"{yaw:.2f}") for (a, b), yaw in zip(found.links, yaws, strict=True)]
    places = [(name, f"{x:.3f}", f"{y:.3f}", "") for name, (x, y) in zip(names, found.places, strict=True)]
    tables: dict[str, list[tuple[str, ...]]] = {
        "links": [("image", "to", "yaw"), *links],
        "panoramas": [("image", "x", "z", "heading"), *places],
    }
    for name, rows in tables.items():
        with (folder / f"{name}.csv").open("w", newline="") as stream:
            csv.writer(stream).writerows(rows)
    return found


def walk_poses(building: Building) -> list[Pose]:
    """Return where a camera is on a walk from the first room to the last, a pose every `STRIDE`."""
    places, links = choose_panoramas(building)
    length = np.linalg.norm(places[links[:, 0]] - places[links[:, 1]], axis=1)
    graph = coo_array((length, links.T), (len(places), len(places))).tocsr()
    before = dijkstra(graph, indices=int(places[:, 0].argmin()), return_predecessors=True)[1]
    path = [int(places[:, 0].argmax())]
    while before[path[-1]] >= 0:
        path.append(int(before[path[-1]]))
    poses: list[Pose] = []
    for here, there in pairwise(places[path[::-1]]):
        ahead = float(np.degrees(np.arctan2(*(there - here))))
        turn = (ahead - poses[-1][2] + 180) % 360 - 180 if poses else 0.0
        left = np.linspace(turn, 0, int(abs(turn) // STRIDE[1]) + 1, endpoint=False)[1:]
        steps = np.linspace(here, there, int(np.linalg.norm(there - here) // STRIDE[0]) + 1, endpoint=False)
        poses += [(*here, ahead - part) for part in left] + [(*step, ahead) for step in steps]
    return poses


def write_walk(building: Building, folder: Path) -> int:
    """Render what a camera of 65 degrees sees on a walk into the folder's ``frames``; return how many there are.

    Photos near both ends of the walk, ``start.png`` and ``goal.png``, are taken 14 cm and 7 degrees aside of it.
    """
    poses = walk_poses(building)
    shots = {f"frames/{number}": pose for number, pose in enumerate(poses)}
    for name, (x, y, heading) in {"start": poses[2], "goal": poses[-2]}.items():
        shots[name] = (x + 0.1, y + 0.1, heading + 7)
    (folder / "frames").mkdir(parents=True, exist_ok=True)
    renderer = Renderer.lit(*assemble_building(building), building.size, 1.4, fine=False)
    for name, pose in shots.items():
        Image.fromarray(renderer.view(Camera(fov=65.0), pose, (180, 320))).save(folder / f"{name}.png")
    return len(poses)


def main(kinds: list[str], out: str, seed: int, height: int, walk: bool) -> None:
    """Draw a building, and the tour of it or a walk through it."""
    if walk:
        print(f"{out}: {write_walk(sample_building(kinds, seed), Path(out))} frames")
        return
    found = write_building_tour(sample_building(kinds, seed), Path(out), size=(height, 2 * height), seed=seed)
    print(f"{out}: {len(found.places)} panoramas, {len(found.links)} links")


if __name__ == "__main__":
    options = start(__doc__, Options)
    run(lambda: main(**vars(options)))
