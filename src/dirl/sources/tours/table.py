"""A folder of equirectangular images with ``links.csv``, and maybe ``panoramas.csv``.

| table | column | contents |
|---|---|---|
| ``links.csv`` | ``image`` | where the link starts: the image's file, relative to the folder |
| | ``to`` | the image that it leads to |
| | ``yaw`` | in which direction it lies, degrees clockwise from the middle of the image |
| ``panoramas.csv`` | ``image`` | one of those images |
| | ``x``, ``z`` | the place on a map, metres; empty = unknown |
| | ``heading`` | where the middle of the image looks, degrees clockwise from +z; empty = unknown |
"""

from pathlib import Path

from dirl.scenes.io.texts import read_csv
from dirl.sources.tours.images import Equirectangular
from dirl.sources.tours.tour import MOST_TEXT, Link, Panorama, Tour, inside, number

LINKS, PLACES = "links.csv", "panoramas.csv"

ENDINGS = (".jpg", ".jpeg", ".png", ".webp")


def read_table(file: Path) -> Tour:
    """The tour of a folder with ``links.csv``: its linked images, in the order of their names."""
    folder = file.parent
    links: dict[str, list[Link]] = {}
    for where, row in read_csv(file, ("image", "to", "yaw"), most=MOST_TEXT):
        links.setdefault(row["image"], []).append(Link(row["to"], number(row["yaw"], f"{where}: yaw")))
        links.setdefault(row["to"], [])
    places: dict[str, tuple[tuple[float, float] | None, float | None]] = {}
    if (folder / PLACES).is_file():
        for where, row in read_csv(folder / PLACES, ("image", "x", "z", "heading"), most=MOST_TEXT):
            x, z, heading = (number(row[key], f"{where}: {key}") if row[key] else None for key in ("x", "z", "heading"))
            places[row["image"]] = (None if x is None or z is None else (x, z), heading)
    panoramas = []
    for name, of_image in sorted(links.items()):
        position, heading = places.get(name, (None, None))
        image = Equirectangular(inside(folder, name, str(file)))
        panoramas.append(Panorama(name, image, tuple(of_image), position, heading))
    lonely = sorted(path.name for path in folder.iterdir() if path.suffix.lower() in ENDINGS and path.name not in links)
    notes = [f"{len(lonely)} images have no link and are left out, the first: {lonely[0]}"] if lonely else []
    return Tour(folder.resolve().name, tuple(panoramas), tuple(notes), str(file))
