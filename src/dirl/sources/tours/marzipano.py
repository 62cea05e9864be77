"""Tours of the Marzipano Tool: ``data.js`` and ``tiles/<scene>/<level>/<face>/<row>/<column>.jpg``.

``data.js`` assigns an object to a variable; the object is read as JSON5, no code is run. Angles are radians, clockwise.
"""

import math
import re
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

from dirl.scenes.scene import SceneError
from dirl.sources.tours.images import MOST_LEVELS, Cube, tiled
from dirl.sources.tours.tour import (
    Link,
    Panorama,
    Tour,
    entries,
    entry,
    inside,
    make_tour,
    number,
    read_json,
    tour_text,
)

COMMENT = r"(?:\s|//[^\n]*\n|/\*.*?\*/)*"
ASSIGNMENT = re.compile(
    rf"{COMMENT}(?:['\"]use strict['\"];?{COMMENT})?(?:var|let|const)\s+[A-Za-z_]\w*\s*={COMMENT}(?=\{{)", re.DOTALL
)


def read_marzipano(file: Path, skip: Collection[str] = ()) -> Tour:
    """The tour that a ``data.js`` describes, but for the panoramas in ``skip``.

    Raises:
        SceneError: it is invalid, or a tile is missing.
    """
    text = tour_text(file)
    assigned = ASSIGNMENT.match(text)
    if assigned is None:
        raise SceneError(f"{file}: expected 'var APP_DATA = {{...}};', as the Marzipano Tool writes it")
    data = read_json(text[assigned.end() :], file)
    panoramas = [_panorama(scene, index, file) for index, scene in enumerate(entries(data, "scenes", str(file)))]
    return make_tour(str(data.get("name") or file.resolve().parent.name), panoramas, file, skip=skip)


def _panorama(scene: Mapping[str, Any], index: int, file: Path) -> Panorama:
    name = entry(scene, "id", str, f"{file}: scene {index}")
    where = f"{file}: scene '{name}'"
    hotspots = entries(scene, "linkHotspots", where)
    links = [
        Link(entry(spot, "target", str, where), math.degrees(number(spot.get("yaw"), f"{where}: yaw")))
        for spot in hotspots
    ]
    return Panorama(name, _cube(scene, name, file, where), tuple(links))


def _cube(scene: Mapping[str, Any], name: str, file: Path, where: str) -> Cube:
    """Levels are numbered from the smallest, 0; a first one that is only a preview has no tiles."""
    sizes = []
    for level in entries(scene, "levels", where):
        size, tile = (int(number(level.get(key), f"{where}: {key}", 1, 2**15)) for key in ("size", "tileSize"))
        sizes.append((size, tile, level.get("fallbackOnly") is True))
    if not sizes or len(sizes) > MOST_LEVELS or sizes != sorted(sizes, key=lambda level: level[0]):
        raise SceneError(f"{where}: expected 1 to {MOST_LEVELS} levels, the smallest first")

    def path_at(level: int) -> Callable[[str, int, int], Path]:
        folder = f"tiles/{name}/{level}"
        return lambda face, y, x: inside(file.parent, f"{folder}/{face}/{y}/{x}.jpg", where)

    levels = [
        tiled(size, tile, where, path_at(level)) for level, (size, tile, preview) in enumerate(sizes) if not preview
    ]
    if not levels:
        raise SceneError(f"{where}: has no level with tiles")
    return Cube(tuple(levels))
