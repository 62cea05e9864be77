"""Tours of krpano: ``tour.xml`` with a ``<scene>`` for each panorama; spheres, cube faces or tiles at several sizes.

Angles are degrees, clockwise from the middle of the front face. Scripts in the file are not run, includes not followed.
Names of scenes are not case-sensitive: MakeVTour itself writes ``name="scene_Hall"`` and ``linkedscene="scene_hall"``.
"""

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from functools import partial
from pathlib import Path

from dirl.scenes.io.files import LONGEST, inside, text_of
from dirl.scenes.scene import SceneError
from dirl.sources.tours.pixels import MOST_LEVELS, Cube, CubeLevel, Equirectangular, six_images, tiled
from dirl.sources.tours.tour import MOST_TEXT, Described, FlatError, Link, Panorama, number


def read_krpano(file: Path) -> Described:
    """Read the tour that a ``tour.xml`` describes."""
    text = text_of(file, MOST_TEXT)
    if "<!DOCTYPE" in text:  # it can declare entities; refused before anything is expanded
        raise SceneError(f"{file}: has a document type (DOCTYPE), which no tour needs")
    try:
        root = ET.fromstring(text)
    except (ET.ParseError, ValueError, RecursionError) as error:
        raise SceneError(f"{file}: is not XML ({error})") from None
    if root.tag == "encrypted":
        raise SceneError(f"{file}: is encrypted; make the tour again with encrypt=false, or ask its author for the XML")
    scenes = list(root.iter("scene"))
    spots = [spot for scene in scenes for spot in scene.iter("hotspot")]
    unlinked = sum("loadscene" in spot.get("onclick", "") and not spot.get("linkedscene") for spot in spots)
    note = f"{unlinked} hotspots call loadscene() in a script instead of naming a linkedscene: left out"
    names: dict[str, str] = {}
    for scene in scenes:
        name = scene.get("name", "")
        if not name:
            raise SceneError(f"{file}: scene {len(names)} has no name")
        if name.lower() in names:
            raise SceneError(f"{file}: two scenes have the name '{name}', in which case does not count")
        names[name.lower()] = name
    if not any(scene.get("heading", "").strip("0.") for scene in scenes):
        for scene in scenes:  # MakeVTour writes 0.0 where nothing is known
            scene.set("heading", "")
    readers = [(scene.get("name", ""), partial(_panorama, scene, file, names)) for scene in scenes]
    return file.resolve().parent.name, readers, [note] if unlinked else []


def _panorama(scene: ET.Element, file: Path, names: Mapping[str, str]) -> Panorama:
    name = scene.get("name", "")
    where = f"{file}: scene '{name}'"
    links = tuple(
        Link(names.get(target.lower(), target), number(spot.get("ath"), f"{where}: ath"))
        for spot in scene.iter("hotspot")
        if (target := spot.get("linkedscene"))
    )
    heading = number(scene.get("heading"), f"{where}: heading") if scene.get("heading") else None
    return Panorama(name, _image(scene, file, where), links, heading=heading)


def _image(scene: ET.Element, file: Path, where: str) -> Equirectangular | Cube:
    image = scene.find("image")
    if image is None:
        raise SceneError(f"{where}: has no image")
    # Part of a panorama is no panorama, and krpano may turn one before it is shown.
    for key in ("hfov", "vfov"):
        if image.get(key) not in (None, "", "360", "360.0", "180", "180.0"):
            raise FlatError(f"{where}: {key}={image.get(key)}: only whole panoramas can be cut into views")
    turned = image.get("prealign") or ""
    if any(part.strip().strip("+-0.") for part in turned.split("|")):
        raise SceneError(f"{where}: prealign={turned[:50]}: turns the panorama; export the tour without it")
    sphere = image.find("sphere")
    if sphere is not None:
        return Equirectangular(inside(file.parent, _name(sphere.get("url", ""), {}), where))

    def level_of(url: str, size: int, tile: int, level: int) -> CubeLevel:
        return tiled(size, tile, where, lambda face, y, x: _file(url, face, level, y + 1, x + 1, file, where))

    of_levels = [(level, cube) for level in image.iter("level") if (cube := level.find("cube")) is not None]
    if of_levels:
        levels = []
        for level, cube in of_levels:
            size = int(number(level.get("tiledimagewidth"), f"{where}: tiledimagewidth", 1, 2**15))
            tile = int(number(image.get("tilesize"), f"{where}: tilesize", 1, 2**15))
            levels.append(level_of(cube.get("url", ""), size, tile, 0))
        if len(levels) > MOST_LEVELS:
            raise SceneError(f"{where}: has {len(levels)} levels; at most {MOST_LEVELS}")
        return Cube(tuple(sorted(levels, key=lambda level: level.size or 0)))
    cube = image.find("cube")
    if cube is None:
        raise SceneError(f"{where}: its image is none of sphere, cube and levels of cubes")
    url, sizes = cube.get("url", ""), cube.get("multires")
    if sizes is None:
        return six_images(lambda face: _file(url, face, 0, 1, 1, file, where))
    tile, *sides = (int(number(side, f"{where}: multires", 1, 2**15)) for side in sizes.split(","))
    if not 0 < len(sides) <= MOST_LEVELS or sides != sorted(sides):
        raise SceneError(f"{where}: multires={sizes[:50]}: expected the size of tiles, then sizes of the cube, growing")
    return Cube(tuple(level_of(url, side, tile, level) for level, side in enumerate(sides, 1)))


def _file(url: str, face: str, level: int, row: int, column: int, file: Path, where: str) -> Path:
    values: dict[str, str | int] = {"s": face, "l": level, "v": row, "y": row, "h": column, "x": column, "u": column}
    return inside(file.parent, _name(url, values), where)


def _name(url: str, values: dict[str, str | int]) -> str:
    """Return the URL with ``%s``, ``%l``, ``%v``, ``%h`` replaced; zeros before the letter pad a number."""
    if len(url) > LONGEST:  # before it is repeated for each tile
        return ""

    def put(match: re.Match[str]) -> str:
        zeros, letter = match.groups()
        return str(values[letter]).rjust(len(zeros) + 1, "0") if letter in values else match.group()

    return re.sub(r"%(0{0,9})([a-z])", put, re.sub("%(FIRSTXML|CURRENTXML|SWFPATH)%/", "", url))
