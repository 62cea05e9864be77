"""Tours of a room that is known exactly, written as each of the five kinds of tour that dirl reads."""

import json
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from closet import closet
from PIL import Image

from dirl.scenes.graph import AHEAD
from dirl.sources.rooms.description import Camera
from dirl.sources.rooms.view import Renderer
from dirl.sources.rooms.walkable import walk
from dirl.sources.tours.alignment import wrap
from dirl.sources.tours.pixels import Equirectangular
from dirl.sources.tours.tour import Link, Panorama, Tour

HEADINGS = 8
CUBE = {"f": (0, 0), "r": (90, 0), "b": (180, 0), "l": (270, 0), "u": (0, 90), "d": (0, -90)}
"""Where the faces of a cube look: degrees clockwise from the front, degrees up."""

EYES = 1.4
"""Metres of the camera above the floor."""


@dataclass(frozen=True)
class Truth:
    """A tour as it should be read: P panoramas.

    Args:
        places: metres, ``[P, 2]``.
        middles: where the middle of each panorama looks, degrees clockwise, ``[P]``.
        links: pairs of panoramas and where the link is on the map, degrees clockwise.
    """

    places: np.ndarray
    middles: np.ndarray
    links: list[tuple[int, int, float]]

    @property
    def names(self):
        return [f"place_{index}" for index in range(len(self.places))]

    def yaw(self, link):
        """Where a link is in its image, degrees, -180 to 180."""
        return (link[2] - self.middles[link[0]] + 180) % 360 - 180

    def spots(self, index):
        """Where the links of a panorama are in its image, degrees, and the names of the panoramas they lead to."""
        return [(self.yaw(link), self.names[link[1]]) for link in self.links if link[0] == index]


def room_truth():
    """The tour of the closet: each of its places, and a link for each free way to a neighbour, diagonals too."""
    way = walk(closet(), 360 / HEADINGS)
    ahead = way.graph[:, AHEAD]
    states = np.flatnonzero(ahead >= 0)
    links = [(int(s // HEADINGS), int(ahead[s] // HEADINGS), float(s % HEADINGS * 45)) for s in states]
    return Truth(way.places, np.zeros(len(way.places)), links)


def grid_truth(width, depth, middles=None):
    """The tour of an empty hall with places on a grid, 2 m apart, linked along the axes."""
    places = np.array([(2.0 * x, 2.0 * z) for x in range(width) for z in range(depth)])
    offsets = places[None] - places[:, None]
    near = np.argwhere(np.isclose(np.hypot(*np.moveaxis(offsets, -1, 0)), 2))
    links = [(int(i), int(j), float(np.degrees(np.arctan2(*offsets[i, j])) % 360)) for i, j in near]
    return Truth(places, np.zeros(len(places)) if middles is None else np.asarray(middles), links)


class Camera360:
    """Takes the pictures of a tour in a room, each once; without a room all are grey."""

    def __init__(self, room=None):
        self.renderer = None if room is None else Renderer.of(room, fine=False)
        self._once = cache(self._take)

    def panorama(self, truth, index, width):
        """Equirectangular, ``[width / 2, width, 3]``."""
        return self._once("panorama", (*truth.places[index], truth.middles[index]), (width // 2, width))

    def face(self, truth, index, face, side):
        """A face of the cube, ``[side, side, 3]``."""
        turn, pitch = CUBE[face]
        return self._once("view", (*truth.places[index], truth.middles[index] + turn), (side, side), 90.0, pitch)

    def view(self, place, heading, size, fov):
        """What an agent would see there."""
        return self._once("view", (*place, heading), size, fov, 0.0)

    def _take(self, kind, pose, size, fov=0.0, pitch=0.0):
        if self.renderer is None:
            return np.full((*size, 3), 128, np.uint8)
        look = EYES if kind == "panorama" else Camera(EYES, pitch, fov)
        return getattr(self.renderer, kind)(look, pose, size)


def write_marzipano(folder, truth, camera, side=48):
    """``data.js`` with a preview level, one of half the size in one tile, and one in tiles of 3/4 of a side."""
    levels = [{"tileSize": side // 4, "size": side // 4, "fallbackOnly": True}]
    levels += [{"tileSize": side // 2, "size": side // 2}, {"tileSize": side * 3 // 4, "size": side}]
    scenes = []
    for index, name in enumerate(truth.names):
        for face in CUBE:
            pixels = camera.face(truth, index, face, side)
            for level, about in enumerate(levels[1:], 1):
                pattern = f"tiles/{name}/{level}/{face}/{{y}}/{{x}}.jpg"
                save_tiles(pixels, about["size"], about["tileSize"], folder, pattern)
        spots = [
            {"yaw": np.radians(yaw), "pitch": 0.2, "rotation": 0, "target": target}
            for yaw, target in truth.spots(index)
        ]
        scenes.append(
            {"id": name, "name": name, "levels": levels, "faceSize": side, "linkHotspots": spots, "infoHotspots": []}
        )
    text = json.dumps({"scenes": scenes, "name": "closet", "settings": {}}, indent=1)
    (folder / "data.js").write_text(f"var APP_DATA = {text};\n")
    return folder


def write_krpano(folder, truth, camera, side=48, *, image="cube"):
    """``tour.xml`` with six images a panorama (cube), tiles at two sizes (multires, level), or a sphere."""
    lines = ['<krpano version="1.20" title="closet">', '<include url="skin/vtourskin.xml" />']
    for index, name in enumerate(truth.names):
        if image == "sphere":
            save(camera.panorama(truth, index, 4 * side), folder / "panos" / f"{name}.jpg")
        for face in CUBE if image != "sphere" else ():
            pixels = camera.face(truth, index, face, side)
            if image == "cube":
                save(pixels, folder / "panos" / f"{name}_{face}.jpg")
                continue
            for level, size in enumerate((side // 2, side), 1):
                pattern = f"panos/{name}.tiles/{face}/l{level}/{{y1:02d}}/l{level}_{face}_{{y1:02d}}_{{x1:02d}}.jpg"
                save_tiles(pixels, size, side // 2, folder, pattern)
        lines += [f'<scene name="{name}" title="{name}" heading="">', '<view hlookat="0.0" fov="120" />']
        lines += [_krpano_image(name, side, image)]
        for number, (yaw, target) in enumerate(truth.spots(index)):
            lines.append(f'<hotspot name="spot{number}" ath="{yaw:.4f}" atv="5" linkedscene="{target}" />')
        lines.append("</scene>")
    (folder / "tour.xml").write_text("\n".join([*lines, "</krpano>"]))
    return folder


def _krpano_image(name, side, image):
    """The ``<image>`` of a scene as krpano's tools of several ages write it."""
    if image == "sphere":
        return f'<image><sphere url="panos/{name}.jpg" /></image>'
    if image == "cube":
        return f'<image><cube url="panos/{name}_%s.jpg" /></image>'
    if image == "multires":
        url = f"panos/{name}.tiles/%s/l%l/%0v/l%l_%s_%0v_%0h.jpg"
        return f'<image><cube url="{url}" multires="{side // 2},{side // 2},{side}" /></image>'
    levels = "".join(
        f'<level tiledimagewidth="{size}" tiledimageheight="{size}">'
        f'<cube url="panos/{name}.tiles/%s/l{level}/%0v/l{level}_%s_%0v_%0h.jpg" /></level>'
        for level, size in ((2, side), (1, side // 2))
    )
    return f'<image type="CUBE" multires="true" tilesize="{side // 2}" prealign="0|0.0|0">{levels}</image>'


def write_pannellum(folder, truth, camera, side=48, *, image="equirectangular"):
    """``tour.json`` with equirectangular images, with cubes, or with the tiles of Pannellum's generate.py."""
    scenes = {}
    for index, name in enumerate(truth.names):
        if image == "equirectangular":
            save(camera.panorama(truth, index, 4 * side), folder / f"{name}.jpg")
            about = {"type": image, "panorama": f"{name}.jpg"}
        elif image == "cubemap":
            names = [f"{name}_{face}.png" for face in CUBE]
            for face, file in zip(CUBE, names, strict=True):
                save(camera.face(truth, index, face, side), folder / file)
            about = {"type": image, "cubeMap": names}
        else:
            about = {"type": image, "basePath": name, "multiRes": _tiled(folder / name, truth, camera, index, side)}
        spots = [{"type": "info", "yaw": 3, "pitch": 0, "text": "a stool"}]
        spots += [{"type": "scene", "yaw": yaw, "pitch": 0, "sceneId": target} for yaw, target in truth.spots(index)]
        scenes[name] = {"title": name, **about, "hotSpots": spots}
    (folder / "tour.json").write_text(json.dumps({"default": {"firstScene": truth.names[0]}, "scenes": scenes}))
    return folder


def _tiled(folder, truth, camera, index, side):
    """Tiles at three sizes, an odd one among them, and the ``multiRes`` that names them."""
    full, tile = side + 2, side // 2
    for face in CUBE:
        pixels = camera.face(truth, index, face, full)
        for level, size in ((3, full), (2, full // 2), (1, full // 4)):
            save_tiles(pixels, size, tile, folder, f"{level}/{face}{{y}}_{{x}}.jpg")
    sizes = {"tileResolution": tile, "maxLevel": 3, "cubeResolution": full}
    return {"path": "/%l/%s%y_%x", "fallbackPath": "/fallback/%s", "extension": "jpg", **sizes}


def write_table(folder, truth, camera, side=48):
    """Images with ``links.csv`` and ``panoramas.csv``."""
    for index, name in enumerate(truth.names):
        save(camera.panorama(truth, index, 4 * side), folder / f"{name}.jpg")
    links = [f"{truth.names[link[0]]}.jpg,{truth.names[link[1]]}.jpg,{truth.yaw(link)}" for link in truth.links]
    (folder / "links.csv").write_text("\n".join(["image,to,yaw", *links, ""]))
    places = [f"{name}.jpg,{x},{z}," for name, (x, z) in zip(truth.names, truth.places, strict=True)]
    (folder / "panoramas.csv").write_text("\n".join(["image,x,z,heading", *places, ""]))
    return folder


WRITERS = {"marzipano": write_marzipano, "krpano": write_krpano, "pannellum": write_pannellum, "table": write_table}


def written(kind, folder):
    """A small tour of grey pictures, of four places."""
    return WRITERS[kind](folder, grid_truth(2, 2), Camera360(), 8)


def save(pixels, file):
    """An image file, as good as its format lets it be."""
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(file, quality=97, subsampling=0)


def save_tiles(pixels, size, tile, folder, pattern):
    """Tiles of an image of this size, numbered from 0 (x, y) or 1 (x1, y1); the last ones may be smaller."""
    scaled = np.asarray(Image.fromarray(pixels).resize((size, size), Image.Resampling.BOX))
    for y, top in enumerate(range(0, size, tile)):
        for x, left in enumerate(range(0, size, tile)):
            name = pattern.format(x=x, y=y, x1=x + 1, y1=y + 1)
            save(scaled[top : top + tile, left : left + tile], folder / name)


def turned(truth, share, seed=0):
    """The same tour with a share of its panoramas turned at random."""
    rng = np.random.default_rng(seed)
    chosen = rng.permutation(len(truth.places))[: round(share * len(truth.places))]
    middles = truth.middles.astype(float).copy()
    middles[chosen] = rng.uniform(0, 360, len(chosen))
    return replace(truth, middles=middles)


def heading_errors(found, truly):
    """How far off headings are, degrees, up to the zero that they share."""
    off = np.radians(found - truly)
    return np.abs(wrap(np.degrees(off - np.angle(np.exp(1j * off).mean()))))


def tour_of(truth, off=None, dropped=()):
    """The tour as a reader gives it; ``off`` degrees are added to the yaw of each link."""
    off = np.zeros(len(truth.links)) if off is None else off
    links = {index: [] for index in range(len(truth.places))}
    for number, link in enumerate(truth.links):
        if link[:2] not in dropped:
            links[link[0]].append(Link(truth.names[link[1]], truth.yaw(link) + off[number]))
    image = Equirectangular("nowhere.jpg")
    made = [Panorama(name, image, tuple(links[index])) for index, name in enumerate(truth.names)]
    return Tour("grid", tuple(made), (), "a test")
