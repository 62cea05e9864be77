"""Which kind of tour a folder or file holds, and the plainest kind: images with a table of links."""

from collections.abc import Callable, Collection, Mapping
from pathlib import Path

from dirl.scenes.io.checked import inside
from dirl.scenes.io.texts import read_csv
from dirl.scenes.scene import SceneError
from dirl.sources.tours.images import Equirectangular
from dirl.sources.tours.javascript import SCENES, read_marzipano, read_pannellum
from dirl.sources.tours.krpano import read_krpano
from dirl.sources.tours.tour import MOST_TEXT, Link, Panorama, Tour, check_tour, number, tour_text
from dirl.sources.tours.zind import REACH, read_zind

LINKS, PLACES = "links.csv", "panoramas.csv"

ENDINGS = (".jpg", ".jpeg", ".png", ".webp")
"""Of panoramas in a folder."""

FORMATS: Mapping[str, tuple[str, ...]] = {
    "marzipano": ("data.js", "app-files/data.js"),
    "krpano": ("tour.xml",),
    "zind": ("zind_data.json",),
    "table": (LINKS,),
    "pannellum": ("*.json",),
}
"""Where the description of each kind of tour is in its folder; the first that is there is read."""

PAGES = (".js", ".html", ".htm")
"""Endings of files that may hold a configuration of Pannellum."""

BY_ENDING = {".xml": "krpano", **dict.fromkeys(PAGES, "pannellum")}
"""What a file of another name is taken for."""


def read_table(file: Path) -> Tour:
    """The tour of a folder of equirectangular images with ``links.csv``, and maybe ``panoramas.csv``.

    | table | column | contents |
    |---|---|---|
    | ``links.csv`` | ``image`` | where the link starts: the image's file, relative to the folder |
    | | ``to`` | the image that it leads to |
    | | ``yaw`` | in which direction it lies, degrees clockwise from the middle of the image |
    | ``panoramas.csv`` | ``image`` | one of those images |
    | | ``x``, ``z`` | the place on a map, metres; empty or without a column = unknown |
    | | ``heading`` | where the middle of the image looks, degrees clockwise from +z; likewise |

    Panoramas are the linked images, in the order of their names.
    """
    folder = file.parent
    links: dict[str, list[Link]] = {}
    for where, row in read_csv(file, ("image", "to", "yaw"), most=MOST_TEXT):
        links.setdefault(row["image"], []).append(Link(row["to"], number(row["yaw"], f"{where}: yaw")))
        links.setdefault(row["to"], [])
    places: dict[str, tuple[tuple[float, float] | None, float | None]] = {}
    if (folder / PLACES).is_file():
        for where, row in read_csv(folder / PLACES, ("image",), ("x", "z", "heading"), most=MOST_TEXT):
            told = {key: number(text, f"{where}: {key}") for key, text in row.items() if key != "image" and text}
            x, z, heading = told.get("x"), told.get("z"), told.get("heading")
            places[row["image"]] = (None if x is None or z is None else (x, z), heading)
    panoramas = []
    for name, of_image in sorted(links.items()):
        position, heading = places.get(name, (None, None))
        image = Equirectangular(inside(folder, name, str(file)))
        panoramas.append(Panorama(name, image, tuple(of_image), position, heading))
    lonely = sorted(path.name for path in folder.iterdir() if path.suffix.lower() in ENDINGS and path.name not in links)
    notes = [f"{len(lonely)} images have no link and are left out, the first: {lonely[0]}"] if lonely else []
    return Tour(folder.resolve().name, tuple(panoramas), tuple(notes), str(file))


READERS: Mapping[str, Callable[[Path], Tour]] = {
    "marzipano": read_marzipano,
    "krpano": read_krpano,
    "table": read_table,
    "pannellum": read_pannellum,
}
"""Of all kinds but ``zind``, whose links depend on an option."""


def read_tour(path: str | Path, *, reach: float = REACH, skip: Collection[str] = ()) -> Tour:
    """The tour in a folder, or that a file describes.

    Args:
        path: the folder, or the file itself: ``data.js``, ``tour.xml``, a Pannellum configuration (JSON, or JavaScript
            or a page that holds it), ``links.csv`` or ``zind_data.json``.
        reach: metres between linked panoramas of the Zillow dataset, whose files have no links.
        skip: ids of panoramas that are left out, as those whose files are missing.

    Raises:
        SceneError: there is no tour, or it is invalid; the message names the file and the scene.
    """
    kind, file = _find(Path(path))
    return check_tour(read_zind(file, reach) if kind == "zind" else READERS[kind](file), skip)


def _find(path: Path) -> tuple[str, Path]:
    """Which kind of tour a folder or file holds, and the file that describes it."""
    if path.is_dir():
        found = _in_folder(path)
    elif path.is_file():
        named = (kind for kind, names in FORMATS.items() if any(path.match(Path(name).name) for name in names))
        kind = next(named, BY_ENDING.get(path.suffix.lower()))
        found = None if kind is None else (kind, path)
    else:
        raise SceneError(f"{path}: there is no such file or folder")
    if found is None:
        wanted = ", ".join(name for names in FORMATS.values() for name in names)
        raise SceneError(f"{path}: is no tour; expected one of {wanted}")
    return found


def _in_folder(folder: Path) -> tuple[str, Path] | None:
    for kind, names in [*FORMATS.items(), ("pannellum", tuple(f"*{ending}" for ending in PAGES))]:
        found = sorted(file for name in names for file in folder.glob(name) if kind != "pannellum" or _has_scenes(file))
        if len(found) > 1:
            raise SceneError(
                f"{folder}: holds {len(found)} tours of {kind}, {found[0].name} too; name the file of the one you mean"
            )
        if found:
            return kind, found[0]
    return None


def _has_scenes(file: Path) -> bool:
    try:
        return SCENES.search(tour_text(file)) is not None
    except SceneError:  # too large, or no text: a library or a picture
        return False
