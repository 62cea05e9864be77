"""Which kind of tour a folder or file holds, and the plainest kind: images with a table of links."""

from collections.abc import Collection
from functools import partial
from pathlib import Path

from dirl.scenes.io.files import inside, read_csv, text_of
from dirl.scenes.scene import SceneError
from dirl.scenes.views import SUFFIXES
from dirl.sources.tours.javascript import SCENES, read_marzipano, read_pannellum
from dirl.sources.tours.krpano import read_krpano
from dirl.sources.tours.pixels import Equirectangular
from dirl.sources.tours.tour import MOST_TEXT, Described, Link, Panorama, Tour, make_tour, number

LINKS, PLACES = "links.csv", "panoramas.csv"


def read_table(file: Path) -> Described:
    """Read the tour of a folder of equirectangular images with ``links.csv``, and maybe ``panoramas.csv``.

    A link leads from ``image`` ``to`` another one, files of the folder, in the direction ``yaw``, degrees clockwise
    from the middle of the image. A place is at ``x`` and ``z``, metres, and the middle of its image looks towards
    ``heading``, degrees clockwise from +z; what is empty or has no column is not known. Panoramas are the linked
    images, in the order of their names.
    """
    folder = file.parent
    links: dict[str, list[Link]] = {}
    for where, row in read_csv(file, ("image", "to", "yaw"), most=MOST_TEXT):
        links.setdefault(row["image"], []).append(Link(row["to"], number(row["yaw"], f"{where}: yaw")))
        links.setdefault(row["to"], [])
    places: dict[str, tuple[tuple[float, float] | None, float | None]] = {}
    if (folder / PLACES).is_file():
        for where, row in read_csv(folder / PLACES, ("image",), ("x", "z", "heading"), most=MOST_TEXT):
            numbers = {key: number(text, f"{where}: {key}") for key, text in row.items() if key != "image" and text}
            x, z, heading = numbers.get("x"), numbers.get("z"), numbers.get("heading")
            places[row["image"]] = (None if x is None or z is None else (x, z), heading)

    def panorama(name: str) -> Panorama:
        position, heading = places.get(name, (None, None))
        return Panorama(name, Equirectangular(inside(folder, name, str(file))), tuple(links[name]), position, heading)

    lonely = sorted(
        path.name for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and path.name not in links
    )
    notes = [f"{len(lonely)} images have no link and are left out, the first: {lonely[0]}"] if lonely else []
    return folder.resolve().name, [(name, partial(panorama, name)) for name in sorted(links)], notes


FORMATS = {
    "marzipano": (read_marzipano, ("data.js", "app-files/data.js")),
    "krpano": (read_krpano, ("tour.xml",)),
    "table": (read_table, (LINKS,)),
    "pannellum": (read_pannellum, ("*.json", "*.js", "*.html", "*.htm")),
}
"""What reads each kind of tour, and where its description is in its folder; the first that is there is read."""


def read_tour(path: str | Path, *, skip: Collection[str] = ()) -> Tour:
    """Return the tour in a folder, or that a file describes.

    Args:
        path: the folder, or the file itself: ``data.js``, ``tour.xml``, a Pannellum configuration (JSON, or JavaScript
            or a page that holds it), or ``links.csv``.
        skip: ids of panoramas that are left out, as those whose files are missing.

    Raises:
        SceneError: there is no tour, or it is invalid; the message names the file and the scene.
    """
    path = Path(path)
    if not path.is_dir() and not path.is_file():
        raise SceneError(f"{path}: there is no such file or folder")
    for kind, (read, names) in FORMATS.items():
        if path.is_file():
            tours = [path] if any(path.match(Path(name).name) for name in names) else []
        else:
            tours = sorted(file for name in names for file in path.glob(name))
        if kind == "pannellum" and path.is_dir():  # which files of other kinds may stand beside
            tours = [file for file in tours if _has_scenes(file)]
        if len(tours) > 1:
            raise SceneError(
                f"{path}: holds {len(tours)} tours of {kind}, {tours[0].name} too; name the file of the one you mean"
            )
        if tours or (kind == "krpano" and path.suffix == ".xml"):
            file = tours[0] if tours else path
            return make_tour(read(file), str(file), skip)
    raise SceneError(
        f"{path}: is no tour; expected one of {', '.join(n for _, names in FORMATS.values() for n in names)}"
    )


def _has_scenes(file: Path) -> bool:
    try:
        return SCENES.search(text_of(file, MOST_TEXT)) is not None
    except SceneError:  # too large, or no text: a library or a picture
        return False
