"""Which kind of tour a folder or file holds."""

from collections.abc import Callable, Mapping
from pathlib import Path

from dirl.scenes.scene import SceneError
from dirl.tours.krpano import read_krpano
from dirl.tours.marzipano import read_marzipano
from dirl.tours.pannellum import read_pannellum
from dirl.tours.table import LINKS, read_table
from dirl.tours.tour import Tour
from dirl.tours.zind import REACH, read_zind

FORMATS: Mapping[str, tuple[str, ...]] = {
    "marzipano": ("data.js", "app-files/data.js"),
    "krpano": ("tour.xml",),
    "zind": ("zind_data.json",),
    "table": (LINKS,),
    "pannellum": ("*.json",),
}
"""Where the description of each kind of tour is in its folder; the first that is there is read."""


def read_tour(path: str | Path, *, reach: float = REACH) -> Tour:
    """The tour in a folder, or that a file describes.

    Args:
        path: the folder, or the file itself: ``data.js``, ``tour.xml``, a Pannellum configuration, ``links.csv`` or
            ``zind_data.json``.
        reach: metres between linked panoramas of the Zillow dataset, whose files have no links.

    Raises:
        SceneError: there is no tour, or it is invalid; the message names the file and the scene.
    """
    path = Path(path)
    readers: dict[str, Callable[[Path], Tour]] = {
        "marzipano": read_marzipano,
        "krpano": read_krpano,
        "zind": lambda file: read_zind(file, reach),
        "table": read_table,
        "pannellum": read_pannellum,
    }
    if path.is_file():
        fits = [kind for kind, names in FORMATS.items() if any(path.match(Path(name).name) for name in names)]
        kind = fits[0] if fits else "krpano" if path.suffix == ".xml" else ""
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
    else:
        raise SceneError(f"{path}: there is no such file or folder")
    wanted = ", ".join(name for names in FORMATS.values() for name in names)
    raise SceneError(f"{path}: is no tour; expected one of {wanted}")
