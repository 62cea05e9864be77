"""A tour of a building: panoramas some metres apart, the ways between them, and their images in a folder."""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order

from dirl.scenes.scene import SceneError
from dirl.sources.rooms.building import Building, building_renderer, furniture, walls
from dirl.sources.rooms.mesh import Array
from dirl.sources.rooms.navigation import TOUCH, clearance

ROOM_FOR_TRIPOD = 0.3
"""Metres around a panorama that are free."""

FINE = 0.25
"""Metres between the points of which panoramas are chosen."""


@dataclass(frozen=True)
class Panoramas:
    """Where panoramas stand, and from which to which there are links.

    Args:
        places: metres, float64 ``[P, 2]``; those of doorways first.
        links: pairs of them, int64 ``[L, 2]``, each way.
    """

    places: Array
    links: Array


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
    renderer = building_renderer(building)
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
