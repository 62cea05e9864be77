"""A tour: panoramas, and links that say in which direction another one stands.

The functions that look into its files raise `SceneError` where these are not as expected.
"""

import math
import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import pyjson5

from dirl.scenes.io.files import check_choice
from dirl.scenes.scene import SceneError
from dirl.sources.tours.pixels import Cube, Equirectangular

MOST_PANORAMAS = 2_000
"""Panoramas of a tour at most; headings and layout are solved for all of them together."""

MOST_FILES = 1_000_000
"""Files of a tour at most: a hundred panoramas of 8,192 pixels a face have 200,000 tiles."""

MOST_SKIPPED = 20
"""Panoramas that cannot be read, and that an error names."""

MOST_DEPTH = 100
"""Depth of objects in objects at most."""

MOST_TEXT = 16 * 2**20
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
        """Return the yaw of each link, degrees, by the places of its two panoramas in the tour."""
        number = {panorama.id: index for index, panorama in enumerate(self.panoramas)}
        links = ((index, link) for index, panorama in enumerate(self.panoramas) for link in panorama.links)
        return {(index, number[link.target]): link.yaw for index, link in links}


class FlatError(SceneError):
    """A picture of a tour that shows a part of what is around it: nothing is wrong with it, but it is no panorama."""


Described = tuple[str, Sequence[tuple[str, Callable[[], Panorama]]], list[str]]
"""What a file says of a tour: its name; the id of each panorama and what reads it, which may fail; and notes."""


def make_tour(described: Described, origin: str, skip: Collection[str]) -> Tour:
    """Return a tour without some panoramas; `SceneError` names those that cannot be read, or whose files are missing.

    Flat pictures, and links that lead nowhere, to where they start, or twice to one place are left out, and noted.
    """
    name, scenes, notes = described
    every = [id_ for id_, _ in scenes]
    for unknown in sorted(set(skip) - set(every)):
        check_choice(unknown, every, f"{origin}: skip", "panorama")
    wanted = [(id_, read) for id_, read in scenes if id_ not in skip]
    if len(wanted) > MOST_PANORAMAS:
        raise SceneError(f"{origin}: {len(wanted)} panoramas; at most {MOST_PANORAMAS} are read")
    ids = {id_ for id_, _ in wanted}
    if len(ids) < len(wanted):
        twice = next(id_ for id_ in every if every.count(id_) > 1)
        raise SceneError(f"{origin}: two panoramas have the id '{twice}'")
    panoramas: list[Panorama] = []
    flat: list[str] = []
    problems: dict[str, str] = {}
    files = 0
    for id_, read in wanted:
        try:
            panorama = read()
        except FlatError:
            flat.append(id_)
            continue
        except SceneError as error:
            problems[id_] = str(error)
            continue
        files += panorama.image.count
        if files > MOST_FILES:
            raise SceneError(f"{origin}: its images are more than {MOST_FILES} files, which are not read")
        panoramas.append(panorama)
    if not panoramas and not problems:
        raise SceneError(f"{origin}: names no panoramas" + (" but those to skip, or flat ones" if every else ""))
    problems |= {panorama.id: why for panorama in panoramas if (why := _why_unreadable(panorama, origin))}
    if problems:
        more = f" ({len(problems)} of {len(ids) - len(flat)} panoramas cannot be read)" if len(problems) > 1 else ""
        few = len(problems) <= MOST_SKIPPED and len(problems) < len(ids) - len(flat)
        skipping = f"; without these panoramas: 'skip=[{','.join(problems)}]'" if few else ""
        raise SceneError(f"{next(iter(problems.values()))}{more}{skipping}")
    ids -= set(flat)
    dropped: dict[str, list[str]] = {}
    kept = tuple(replace(panorama, links=tuple(_kept(panorama, ids, dropped))) for panorama in panoramas)
    lines = (f"{len(all_)} links {why} are left out, the first: {all_[0]}" for why, all_ in dropped.items())
    of_flat = [f"{len(flat)} flat pictures are left out, the first: {flat[0]}"] if flat else []
    return Tour(name, kept, (*notes, *of_flat, *lines), origin)


def _why_unreadable(panorama: Panorama, origin: str) -> str:
    """Return which file of a panorama is missing, or why its name cannot be one; empty if all are there."""
    try:
        missing = next((file for file in panorama.image.files() if not os.path.isfile(file)), None)
    except SceneError as error:
        return str(error)
    return f"{origin}: panorama '{panorama.id}': there is no file {missing}" if missing else ""


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


def read_json(text: str, where: Path) -> dict[str, object]:
    """Return the object at the start of a text: JSON, or a JavaScript literal with comments, bare keys, extra commas.

    No code is run: a literal that calls a function or names a variable is refused. What follows the object is ignored.
    """
    try:
        data = pyjson5.decode(text, MOST_DEPTH, True)
    except pyjson5.Json5Exception as error:
        raise SceneError(f"{where}: is no JSON, and no object of JavaScript without code ({error.args[0]})") from None
    if not isinstance(data, dict):
        raise SceneError(f"{where}: expected an object, {{...}}")
    return data


Kind = TypeVar("Kind")


def entry(values: object, key: str, kind: type[Kind], where: str) -> Kind:
    """Return a required value of a JSON object."""
    if not isinstance(values, Mapping) or not isinstance(values.get(key), kind):
        raise SceneError(f"{where}: expected '{key}' ({kind.__name__})")
    return values[key]


def entries(values: object, key: str, where: str) -> list[Mapping[str, object]]:
    """Return a list of JSON objects, empty if it is missing."""
    items = values.get(key, []) if isinstance(values, Mapping) else None
    if not isinstance(items, list) or not all(isinstance(item, Mapping) for item in items):
        raise SceneError(f"{where}: expected '{key}' (list of objects)")
    return items


def number(value: object, where: str, low: float = -1e6, high: float = 1e6) -> float:
    """Return a number of a tour, as a number or as its text."""
    try:
        parsed = math.nan if isinstance(value, bool) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        parsed = math.nan
    if not low <= parsed <= high:
        shown = str(value)[:50]
        raise SceneError(f"{where}: expected a number from {low:g} to {high:g}, found '{shown}'")
    return parsed
