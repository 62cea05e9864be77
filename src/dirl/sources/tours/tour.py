"""A tour: panoramas, and links that say in which direction another one stands.

The functions that look into its files raise `SceneError` where these are not as expected.
"""

import math
import os
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

import pyjson5

from dirl.scenes.io.checked import check_choice
from dirl.scenes.io.texts import read_text
from dirl.scenes.scene import SceneError
from dirl.sources.tours.images import Cube, Equirectangular

MOST_PANORAMAS = 2_000
"""Of a tour; headings and layout are solved for all of them together."""

MOST_SKIPPED = 20
"""Panoramas without files that an error names."""

MOST_DEPTH = 100
"""Of objects in objects."""

MOST_TEXT = 32 * 2**20
"""Bytes of the file that describes a tour."""


@dataclass(frozen=True)
class Link:
    """An arrow to another panorama.

    Args:
        target: its id.
        yaw: where the arrow is, degrees clockwise from the middle of the image.
    """

    target: str
    yaw: float


@dataclass(frozen=True)
class Panorama:
    """One place of a tour.

    Args:
        id: unique in the tour.
        image: where its pixels are.
        links: at most one to each other panorama.
        position: x and z in metres; None if the tour does not say.
        heading: where the middle of the image looks, degrees clockwise from +z (or from north); None if the tour does
            not say.
    """

    id: str
    image: Equirectangular | Cube
    links: tuple[Link, ...]
    position: tuple[float, float] | None = None
    heading: float | None = None


@dataclass(frozen=True)
class Tour:
    """What a reader found.

    Args:
        name: of the tour.
        panoramas: in the order of the file.
        notes: what was left out and why, a line each.
        origin: the file, named in errors.
    """

    name: str
    panoramas: tuple[Panorama, ...]
    notes: tuple[str, ...]
    origin: str

    def yaws(self) -> dict[tuple[int, int], float]:
        """The yaw of each link, degrees, by the places of its two panoramas in the tour."""
        number = {panorama.id: index for index, panorama in enumerate(self.panoramas)}
        links = ((index, link) for index, panorama in enumerate(self.panoramas) for link in panorama.links)
        return {(index, number[link.target]): link.yaw for index, link in links}


def check_tour(tour: Tour, skip: Collection[str]) -> Tour:
    """A tour without some panoramas, if its files exist and its ids differ.

    Links that lead nowhere, to where they start, or twice to one place are left out, and noted.
    """
    every = [panorama.id for panorama in tour.panoramas]
    found = [panorama for panorama in tour.panoramas if panorama.id not in skip]
    for unknown in sorted(set(skip) - set(every)):
        check_choice(unknown, every, f"{tour.origin}: skip", "panorama")
    if not found:
        raise SceneError(f"{tour.origin}: names no panoramas" + (" but those to skip" if every else ""))
    if len(found) > MOST_PANORAMAS:
        raise SceneError(f"{tour.origin}: {len(found)} panoramas; at most {MOST_PANORAMAS} are read")
    ids: set[str] = set()
    for panorama in found:
        if panorama.id in ids:
            raise SceneError(f"{tour.origin}: two panoramas have the id '{panorama.id}'")
        ids.add(panorama.id)
    missing = [(panorama.id, file) for panorama in found for file in panorama.image.files() if not os.path.isfile(file)]
    if missing:
        more = f" ({len(missing)} files are missing in all)" if len(missing) > 1 else ""
        without = list(dict.fromkeys(one for one, _ in missing))
        skipping = f"; without these panoramas: 'skip=[{','.join(without)}]'" if len(without) <= MOST_SKIPPED else ""
        raise SceneError(f"{tour.origin}: panorama '{missing[0][0]}': there is no file {missing[0][1]}{more}{skipping}")
    dropped: dict[str, list[str]] = {}
    kept = tuple(replace(panorama, links=tuple(_kept(panorama, ids, dropped))) for panorama in found)
    lines = (f"{len(all_)} links {why} are left out, the first: {all_[0]}" for why, all_ in dropped.items())
    return replace(tour, panoramas=kept, notes=(*tour.notes, *lines))


def _kept(panorama: Panorama, ids: set[str], dropped: dict[str, list[str]]) -> Iterator[Link]:
    seen: set[str] = set()
    for link in panorama.links:
        if link.target not in ids:
            why = "to panoramas that the tour does not have"
        elif link.target == panorama.id:
            why = "from a panorama to itself"
        elif link.target in seen:
            why = "beside another one to the same panorama"
        else:
            seen.add(link.target)
            yield link
            continue
        dropped.setdefault(why, []).append(f"'{panorama.id}' to '{link.target}'")


def read_json(text: str, where: Path) -> dict[str, Any]:
    """The object that a text begins with: JSON, or a JavaScript literal with comments, bare keys and trailing commas.

    No code is run: a literal that calls a function or names a variable is refused. What follows the object is ignored.
    """
    try:
        found = pyjson5.decode(text, MOST_DEPTH, True)
    except pyjson5.Json5Exception as error:
        raise SceneError(f"{where}: is no JSON, and no object of JavaScript without code ({error.args[0]})") from None
    if not isinstance(found, dict):
        raise SceneError(f"{where}: expected an object, {{...}}")
    return found


def tour_text(file: Path) -> str:
    """The text of a file that describes a tour."""
    try:
        return read_text(file, MOST_TEXT, encoding="utf-8-sig")
    except OSError as error:
        raise SceneError(f"{file}: cannot be read ({error.strerror})") from None
    except ValueError as error:
        raise SceneError(str(error)) from None


def entry(values: Any, key: str, kind: type, where: str) -> Any:
    """A required value of a JSON object."""
    if not isinstance(values, Mapping) or not isinstance(values.get(key), kind):
        raise SceneError(f"{where}: expected '{key}' ({kind.__name__})")
    return values[key]


def entries(values: Any, key: str, where: str) -> list[Mapping[str, Any]]:
    """A list of JSON objects, empty if it is missing."""
    found = values.get(key, []) if isinstance(values, Mapping) else None
    if not isinstance(found, list) or not all(isinstance(one, Mapping) for one in found):
        raise SceneError(f"{where}: expected '{key}' (list of objects)")
    return found


def number(value: Any, where: str, low: float = -1e6, high: float = 1e6) -> float:
    """A number of a tour, as a number or as its text."""
    try:
        found = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        found = math.nan
    if not low <= found <= high:
        shown = str(value)[:50]
        raise SceneError(f"{where}: expected a number from {low:g} to {high:g}, found '{shown}'")
    return found


def inside(folder: Path, name: Any, where: str) -> Path:
    """The path of a file of a tour, which lies in the tour's folder."""
    if not isinstance(name, str) or not name.strip() or not name.isprintable():
        raise SceneError(f"{where}: expected the name of a file, found {str(name)[:50]!r}")
    text = name.replace("\\", "/")
    if "://" in text or text.startswith("//"):
        raise SceneError(f"{where}: '{name[:100]}' is on the web; nothing is downloaded, fetch the tour's files first")
    path = PurePosixPath(text)
    if not path.parts:
        raise SceneError(f"{where}: expected the name of a file, found {name[:50]!r}")
    if path.is_absolute() or ".." in path.parts or ":" in path.parts[0]:
        raise SceneError(f"{where}: '{name[:100]}' lies outside the tour's folder")
    return folder / path
