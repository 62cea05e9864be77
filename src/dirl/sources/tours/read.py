"""Which kind of tour a folder or file holds."""

from collections.abc import Callable, Collection, Mapping
from functools import partial
from pathlib import Path

from dirl.scenes.scene import SceneError
from dirl.sources.tours.krpano import read_krpano
from dirl.sources.tours.marzipano import read_marzipano
from dirl.sources.tours.pannellum import SCENES, read_pannellum
from dirl.sources.tours.table import LINKS, read_table
from dirl.sources.tours.tour import Tour, tour_text
from dirl.sources.tours.zind import REACH, read_zind

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


def _has_scenes(file: Path) -> bool:
    try:
        return SCENES.search(tour_text(file)) is not None
    except SceneError:  # too large, or no text: a library or a picture
        return False


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
    path = Path(path)
    readers: dict[str, Callable[[Path], Tour]] = {
        "marzipano": partial(read_marzipano, skip=skip),
        "krpano": partial(read_krpano, skip=skip),
        "zind": partial(read_zind, reach=reach, skip=skip),
        "table": partial(read_table, skip=skip),
        "pannellum": partial(read_pannellum, skip=skip),
    }
    if path.is_file():
        fits = [kind for kind, names in FORMATS.items() if any(path.match(Path(name).name) for name in names)]
        kind = fits[0] if fits else BY_ENDING.get(path.suffix.lower(), "")
        if kind:
            return readers[kind](path)
    elif path.is_dir():
        for kind, names in FORMATS.items():
            found = sorted(file for name in names for file in path.glob(name))
            if len(found) > 1:
                raise SceneError(
                    f"{path}: holds {len(found)} files like {found[0].name}; name the one that is the tour"
                )
            if found:
                return readers[kind](found[0])
        pages = sorted(file for file in path.iterdir() if file.suffix.lower() in PAGES and _has_scenes(file))
        if len(pages) > 1:
            raise SceneError(
                f"{path}: {len(pages)} files hold 'scenes', {pages[0].name} too; name the one that is the tour"
            )
        if pages:
            return read_pannellum(pages[0], skip=skip)
    else:
        raise SceneError(f"{path}: there is no such file or folder")
    wanted = ", ".join(name for names in FORMATS.values() for name in names)
    raise SceneError(f"{path}: is no tour; expected one of {wanted}")
