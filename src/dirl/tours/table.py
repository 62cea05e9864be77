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

import csv
from collections.abc import Collection
from pathlib import Path

from dirl.scenes.scene import SceneError
from dirl.tours.images import Equirectangular
from dirl.tours.tour import Link, Panorama, Tour, inside, make_tour, number, tour_text

LINKS, PLACES = "links.csv", "panoramas.csv"

ENDINGS = (".jpg", ".jpeg", ".png", ".webp")


def read_table(file: Path, skip: Collection[str] = ()) -> Tour:
    """The tour of a folder with ``links.csv``: its linked images, in the order of their names.

    Raises:
        SceneError: a table is invalid, or an image is missing.
    """
    folder = file.parent
    links: dict[str, list[Link]] = {}
    for where, row in _rows(file, ("image", "to", "yaw")):
        links.setdefault(row["image"], []).append(Link(row["to"], number(row["yaw"], f"{where}: yaw")))
        links.setdefault(row["to"], [])
    places: dict[str, tuple[tuple[float, float] | None, float | None]] = {}
    if (folder / PLACES).is_file():
        for where, row in _rows(folder / PLACES, ("image", "x", "z", "heading")):
            x, z, heading = (number(row[key], f"{where}: {key}") if row[key] else None for key in ("x", "z", "heading"))
            places[row["image"]] = (None if x is None or z is None else (x, z), heading)
    panoramas = []
    for name, of_image in sorted(links.items()):
        position, heading = places.get(name, (None, None))
        image = Equirectangular(inside(folder, name, str(file)))
        panoramas.append(Panorama(name, image, tuple(of_image), position, heading))
    lonely = sorted(path.name for path in folder.iterdir() if path.suffix.lower() in ENDINGS and path.name not in links)
    notes = [f"{len(lonely)} images have no link and are left out, the first: {lonely[0]}"] if lonely else []
    return make_tour(folder.resolve().name, panoramas, file, notes, skip)


def _rows(file: Path, columns: tuple[str, ...]) -> list[tuple[str, dict[str, str]]]:
    """The rows of a table by column, each with the line that it stands in."""
    reader = csv.reader(tour_text(file).splitlines())
    rows = []
    try:
        names = [name.strip() for name in next(reader, [])]
        if sorted(names) != sorted(columns):
            raise SceneError(f"{file}: line 1: expected the columns {','.join(columns)}, found {','.join(names)[:100]}")
        for cells in reader:
            where = f"{file}: line {reader.line_num}"
            if len(cells) not in (0, len(names)):
                raise SceneError(f"{where}: {len(cells)} cells for {len(names)} columns")
            if cells:
                rows.append((where, dict(zip(names, (cell.strip() for cell in cells), strict=True))))
    except csv.Error as error:
        raise SceneError(f"{file}: line {reader.line_num}: is no line of a table ({error})") from None
    return rows
