"""Tours that an object of JavaScript describes: those of the Marzipano Tool, and of Pannellum. No code is run.

The Marzipano Tool writes ``data.js``, which assigns the object to a variable, and
``tiles/<scene>/<level>/<face>/<row>/<column>.jpg``; angles are radians. A configuration of Pannellum has ``scenes``,
each an equirectangular image, a cube or a tiled cube; it is a JSON file, or stands in JavaScript or a script of a page;
angles are degrees. They are clockwise from the middle of the image.
"""

import math
import re
from bisect import bisect
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import islice
from pathlib import Path

from dirl.scenes.io.files import LONGEST, inside, text_of
from dirl.scenes.scene import SceneError
from dirl.sources.tours.pixels import FACES, MOST_LEVELS, Cube, Equirectangular, six_images, tiled
from dirl.sources.tours.tour import MOST_TEXT, Described, FlatError, Link, Panorama, entries, entry, number, read_json

COMMENT = r"(?>(?:\s|//[^\n]*\n|/\*.*?\*/)*)"  # atomic: else each comment doubles the time to find no match
ASSIGNMENT = re.compile(
    rf"{COMMENT}(?:['\"]use strict['\"];?{COMMENT})?(?:var|let|const)\s+[A-Za-z_]\w*\s*={COMMENT}(?=\{{)", re.DOTALL
)


def read_marzipano(file: Path) -> Described:
    """Read the tour that a ``data.js`` describes."""
    text = text_of(file, MOST_TEXT)
    assigned = ASSIGNMENT.match(text)
    if assigned is None:
        raise SceneError(f"{file}: expected 'var APP_DATA = {{...}};', as the Marzipano Tool writes it")
    data = read_json(text[assigned.end() :], file)
    scenes = entries(data, "scenes", str(file))
    named = [(entry(scene, "id", str, f"{file}: scene {index}"), scene) for index, scene in enumerate(scenes)]
    readers = [(name, partial(_of_marzipano, name, scene, file)) for name, scene in named]
    return str(data.get("name") or file.resolve().parent.name), readers, []


def _of_marzipano(name: str, scene: Mapping[str, object], file: Path) -> Panorama:
    where = f"{file}: scene '{name}'"
    links = tuple(
        Link(entry(spot, "target", str, where), math.degrees(number(spot.get("yaw"), f"{where}: yaw")))
        for spot in entries(scene, "linkHotspots", where)
    )
    sizes = []  # of levels, numbered from the smallest, 0; a first one that is only a preview has no tiles
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
    return Panorama(name, Cube(tuple(levels)), links)


SCENES = re.compile(r"""(?:"scenes"|'scenes'|\bscenes)\s*:""")
"""What the configuration of a tour has, and little else."""

TOKENS = re.compile(
    r"""["](?:[^"\\\n]|\\.)*+["]?|['](?:[^'\\\n]|\\.)*+[']?|[`](?:[^`\\]|\\.)*+[`]?|//[^\n]*|/\*.*?(?:\*/|\Z)"""
    r"""|(?P<name>(?<=:)\s*+(?!(?:true|false|null|NaN|Infinity)\b)[A-Za-z_$][\w$.]*+(?=\s*+[,}]))"""
    # Up to the brace of the body; no scan passes a colon, where the next one may begin.
    r"""|(?P<function>(?<=:)\s*+(?:function\b[^(){}:]*+\([^(){}:]*+\)|(?:\([^(){}:]*+\)|[\w$]++)\s*+=>)\s*+\{)"""
    r"""|(?P<brace>[{}])""",
    re.DOTALL,
)
"""Texts, comments and braces of JavaScript, and values that are functions, named or written out."""

MOST_OBJECTS = 100
"""Objects that may begin before the scenes in the same text and be no configuration."""

MOST_PARSED = 2**28
"""Characters that are tried in all."""


def read_pannellum(file: Path) -> Described:
    """Read the tour that a configuration describes."""
    text = _without_functions(text_of(file, MOST_TEXT))
    data = read_json(text, file) if text.lstrip().startswith("{") else _within(text, file)
    common = data.get("default")
    common = common if isinstance(common, Mapping) else {}
    scenes = entry(data, "scenes", dict, str(file))
    readers = [(name, partial(_of_pannellum, name, scene, common, file)) for name, scene in scenes.items()]
    return str(common.get("title") or file.resolve().parent.name), readers, []


def _without_functions(text: str) -> str:
    """Return a text with null for each function that is a value, as custom hot spots have them: none is run."""
    kept, copied, depth = [], 0, 0
    for token in TOKENS.finditer(text):
        if depth:  # in the body of a function, whose own functions begin with a brace too
            depth += 1 if token["function"] else {"{": 1, "}": -1}.get(token[0], 0)
            copied = token.end()
        elif token["name"] or token["function"]:
            kept += [text[copied : token.start()], " null"]
            copied, depth = token.end(), int(token["function"] is not None)
    return "".join([*kept, text[copied:]])


def _within(text: str, file: Path) -> dict[str, object]:
    """Return the configuration in a page or a script: the smallest object with scenes."""
    why = SceneError(f"{file}: has no object with 'scenes', as pannellum.viewer(...) takes it")
    for begin in islice(_objects(text), MOST_PARSED // (len(text) + 1)):
        try:
            data = read_json(text[begin:], file)
        except SceneError as error:
            why = error
            continue
        if "scenes" in data:
            return data
    raise why


def _objects(text: str) -> Iterator[int]:
    """Yield where objects begin that may hold scenes, each once, the smallest first."""
    begins, tried = [match.start() for match in re.finditer("{", text)], set[int]()
    for scenes in SCENES.finditer(text):
        last = bisect(begins, scenes.start())
        for begin in reversed(begins[max(0, last - MOST_OBJECTS) : last]):
            if begin not in tried:
                tried.add(begin)
                yield begin


def _of_pannellum(name: str, own: object, common: Mapping[str, object], file: Path) -> Panorama:
    where = f"{file}: scene '{name}'"
    if not isinstance(own, Mapping):
        raise SceneError(f"{where}: expected a JSON object")
    scene = {**common, **own}
    links = [
        Link(entry(spot, "sceneId", str, where), number(spot.get("yaw"), f"{where}: yaw"))
        for spot in entries(scene, "hotSpots", where)
        if spot.get("type") == "scene"
    ]
    north = scene.get("northOffset")
    heading = None if north is None else number(north, f"{where}: northOffset")
    return Panorama(name, _image(scene, file, where), tuple(links), heading=heading)


def _image(scene: Mapping[str, object], file: Path, where: str) -> Equirectangular | Cube:
    kind, base = scene.get("type", "equirectangular"), scene.get("basePath", "")
    folder = inside(file.parent, base, where) if base else file.parent
    for key, whole in (("haov", 360), ("vaov", 180)):
        if number(scene.get(key, whole), f"{where}: {key}") != whole:
            raise FlatError(f"{where}: {key}={scene[key]}: only whole panoramas can be cut into views")
    if kind == "equirectangular":
        return Equirectangular(inside(folder, scene.get("panorama"), where))
    if kind == "cubemap":
        names = entry(scene, "cubeMap", list, where)
        if len(names) != len(FACES):
            raise SceneError(f"{where}: cubeMap has {len(names)} images, not six (front, right, back, left, up, down)")
        return six_images(lambda face: inside(folder, names[FACES.index(face)], where))
    if kind == "multires":
        return _tiles(entry(scene, "multiRes", dict, where), folder, where)
    raise SceneError(f"{where}: type '{str(kind)[:50]}' is none of equirectangular, cubemap and multires")


def _tiles(given: Mapping[str, object], folder: Path, where: str) -> Cube:
    """Return levels 1 to ``maxLevel``, each half as large as the next, rounded down as by Pannellum's generate.py."""
    if given.get("basePath"):
        folder = inside(folder, given["basePath"], where)
    most, size, tile = (
        int(number(given.get(key), f"{where}: {key}", 1, high))
        for key, high in (("maxLevel", MOST_LEVELS), ("cubeResolution", 2**15), ("tileResolution", 2**15))
    )
    pattern, ending = entry(given, "path", str, where), str(given.get("extension") or "")

    def path_at(level: int) -> Callable[[str, int, int], Path]:
        def path(face: str, y: int, x: int) -> Path:
            name = pattern if len(pattern) <= LONGEST else ""
            for sign, value in {"%s": face, "%l": level, "%y": y, "%x": x}.items():
                name = name.replace(sign, str(value))
            return inside(folder, name.lstrip("/") + (f".{ending}" if ending else ""), where)

        return path

    sides = {level: max(size // 2 ** (most - level), 1) for level in range(1, most + 1)}
    return Cube(tuple(tiled(side, tile, where, path_at(level)) for level, side in sides.items()))
