"""Scenes from photographs: a folder of images, and a table that says where each was taken.

``states.csv`` has one row for each image, in any order, with the columns of `Row` (docs/howto/make_scenes.md). Further
shots are looks of a place that changes: their other columns but place, heading and position stay empty. Every location
has the same number of headings, a multiple of four, evenly spread: 4 of 90 degrees, 8 of 45, 12 of 30. A right turn is
the next heading clockwise.
"""

import csv
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Le
from PIL import ExifTags, Image, ImageOps

from dirl.scenes.graph import ACTIONS, AHEAD, BACK, MAX_TURNS, IntArray, turns_only
from dirl.scenes.io.files import atomic_path, check_choice, checked, inside, read_csv
from dirl.scenes.scene import LARGEST, Scene, SceneError
from dirl.scenes.views import SUFFIXES, encode, natural_order, open_photo, to_rgb

TABLE = "states.csv"
REQUIRED = ("image", "location", "heading", "x", "z", "ahead")
OPTIONAL = ("back", "goal", "shot")

Number = Annotated[float, Ge(-LARGEST), Le(LARGEST)]

TOLERANCE = 1.0
"""Degrees that a heading may be off."""

PANORAMA_MARK = b"GPano:ProjectionType"
"""What cameras write into the XMP metadata of a panorama."""


@dataclass(frozen=True)
class Row:
    """One row of the table, checked by itself; an empty cell is none, but for those of moves."""

    where: str
    """The table and the line, for errors."""
    image: Path
    location: str
    heading: Number
    """Where the camera looked, degrees clockwise."""
    x: Number
    """Metres, as z; rough values suffice, only pictures use them."""
    z: Number
    ahead: str
    """The location that a move ahead leads to, with the same heading; empty = blocked."""
    back: str | None = None
    """The same for a move back; None where there is no such column: then back undoes ahead."""
    goal: Literal["yes"] | None = None
    shot: Annotated[int, Ge(0), Le(999_999)] = 0
    """0 for the first image of a place and heading; further ones have a number a visit."""


def read_photos(folder: str | Path, *, name: str | None = None) -> tuple[Scene, list[Path]]:
    """Return a scene without views and features from a folder, and the image of each of its states.

    States are numbered by location, in the order of the table, and then by heading. With K further shots of each state
    there are (K + 1) N images, shot by shot. The scene has the folder's name if none is given.

    Raises:
        SceneError: the table is invalid, or describes an invalid scene. The message names the line.
    """
    folder = Path(folder)
    name = name or folder.resolve().name
    file = folder / TABLE
    if not file.is_file():
        raise SceneError(f"{folder}: holds no {TABLE}; it has a row for each image: {','.join(REQUIRED)}")
    table = [_row(values, where, folder) for where, values in read_csv(file, REQUIRED, OPTIONAL)]
    places: dict[str, list[Row]] = {}
    for row in table:
        if not row.shot:
            places.setdefault(row.location, []).append(row)
    if not places:
        raise SceneError(f"{file}: has no rows of first shots; each says where one image was taken")
    count = len(next(iter(places.values())))
    for location, here in places.items():
        here.sort(key=lambda row: row.heading % 360)
        _check_place(location, here, count)
    states = [row for here in places.values() for row in here]
    numbers = {location: range(place * count, (place + 1) * count) for place, location in enumerate(places)}
    scene = Scene(
        name=name,
        graph=_graph(states, numbers),
        positions=np.array([(row.x, row.z) for row in states]),
        headings=np.array([row.heading for row in states]) % 360,
        goals=tuple(state for state, row in enumerate(states) if row.goal),
        source="photos",
        extractor="none",
        origin=str(file),
    )
    return scene, [row.image for row in states] + _further_shots(states, numbers, [row for row in table if row.shot])


def _further_shots(states: Sequence[Row], numbers: Mapping[str, range], rows: Sequence[Row]) -> list[Path]:
    """Return the images of further shots, shot by shot, each in the order of the states; none may be missing."""
    images: dict[tuple[int, int], Path] = {}
    for row in rows:
        state = _state_at(states, numbers.get(row.location, ()), row.heading)
        if state is None or (row.shot, state) in images:
            why = "no first image" if state is None else "two images"
            raise SceneError(f"{row.where}: shot {row.shot}: '{row.location}' has {why} with heading {row.heading:g}")
        images[row.shot, state] = row.image
    shots = sorted({shot for shot, _ in images})
    for shot in shots:
        for state, row in enumerate(states):
            if (shot, state) not in images:
                raise SceneError(
                    f"{row.where}: '{row.location}' has no image of shot {shot} with heading {row.heading:g}; a shot "
                    "is a visit to every place, which sees all headings"
                )
    return [images[shot, state] for shot in shots for state in range(len(states))]


def _state_at(states: Sequence[Row], here: Sequence[int], heading: float) -> int | None:
    """Return which of some states has a heading; None if none does."""
    off = {state: abs((states[state].heading - heading + 180) % 360 - 180) for state in here}
    nearest = min(off, key=off.__getitem__, default=None)
    return nearest if nearest is not None and off[nearest] <= TOLERANCE else None


def encoded_photos(images: Sequence[Path], height: int, width: int) -> Iterator[bytes]:
    """Yield the images as a dump stores them: upright, cropped in the middle to the shape, scaled to it, WebP.

    Raises:
        SceneError: an image cannot be read, or is a panorama.
    """
    for path in images:
        image = open_photo(path, load=False)  # its shape as it is stored
        wide = abs(image.width / image.height - 2) < 0.02 < abs(width / height - 2)  # as no other view is
        if wide or PANORAMA_MARK in path.read_bytes():
            raise SceneError(
                f"{path}: {image.width}x{image.height} pixels are a panorama, which shows all headings at once; cut it "
                "into one image a heading (an ordinary image of that shape: crop it a little)"
            )
        upright = to_rgb(open_photo(path))
        yield encode(np.asarray(ImageOps.fit(upright, (width, height), Image.Resampling.LANCZOS)))


def write_table(folder: Path, rows: Sequence[dict[str, object]]) -> None:
    """Write ``states.csv`` of a folder, completely or not at all."""
    with atomic_path(folder / TABLE) as file, file.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, [*REQUIRED, *(name for name in OPTIONAL if any(name in row for row in rows))])
        writer.writeheader()
        writer.writerows(rows)


COMPASS = {"n": 0.0, "north": 0.0, "e": 90.0, "east": 90.0, "s": 180.0, "south": 180.0, "w": 270.0, "west": 270.0}
"""What the end of a photo's name may say of its heading, besides degrees."""


def draft_table(folder: str | Path, headings: int = 4) -> str:
    """Write a first ``states.csv`` for the photos of a folder; return what was assumed, and what to correct.

    Photos are taken in the order of their EXIF times, or of their names where one has none, and so many in a row are of
    one place. What a name says goes first: ``hall_n.jpg`` or ``hall_90.jpg`` is of the place ``hall``. Headings are
    those of the names, else of the EXIF compass, turned to multiples of a turn, else one turn clockwise from picture to
    picture. Places stand one step apart in a straight row.

    Raises:
        SceneError: there is a table already, there are no photos, one cannot be read, or they do not make whole places.
    """
    folder = Path(folder)
    if headings % 4:
        raise SceneError(f"headings={headings}: a place has a multiple of four, evenly spread")
    if os.path.lexists(folder / TABLE):  # a link to nowhere would be written to
        raise SceneError(f"{folder / TABLE}: is there already; delete it to have it drafted anew")
    photos = [file for file in folder.glob("*") if file.suffix.lower() in SUFFIXES and file.is_file()]
    files = [inside(folder, file.name, f"{folder}: a photo") for file in photos]  # as the table's reader asks
    if not files:
        raise SceneError(f"{folder}: holds no photos (JPEG, PNG or WebP)")
    said = {file: _said_by_exif(file) for file in files}
    timed = all(time for time, _ in said.values())
    files.sort(key=natural_order)
    if timed:
        files.sort(key=lambda file: said[file][0])  # those of one second by their names
    turn = 360 / headings
    counted = [f"place_{number // headings + 1}" for number in range(len(files))]
    clockwise = [turn * (number % headings) for number in range(len(files))]
    drafts = [("the order: one turn clockwise from photo to photo", counted, clockwise)]
    north = [angle for file in files if (angle := said[file][1]) is not None]
    if len(north) == len(files):
        facing = [turn * (round((angle - north[0]) / turn) % headings) for angle in north]
        drafts.insert(0, ("the compass in their EXIF, from the first photo's direction", counted, facing))
    named = [_said_by_name(file) for file in files]
    drafts.insert(0, ("their names", [place for place, _ in named], [heading for _, heading in named]))
    for draft in drafts:  # the first by which each place has one photo for each heading
        how, places, facing = draft
        seen = {(place, round(heading / turn, 2)) for place, heading in zip(places, facing, strict=True)}
        each = {(place, heading) for place in places for heading in range(headings)}
        if all(places) and len(seen) == len(places) and seen == each:
            break
    else:
        raise SceneError(
            f"{folder}: {len(files)} photos are no whole places of {headings} headings each; take what is missing, "
            "move what is too much, or give headings=..."
        )
    order = [*dict.fromkeys(places)]
    rows: list[dict[str, object]] = []
    for file, place, heading in zip(files, places, facing, strict=True):
        at = order.index(place)
        beside = at + 1 if heading == 0 else at - 1 if heading == 180 else -1
        ahead = order[beside] if 0 <= beside < len(order) else ""
        taken = {"image": file.name, "location": place, "heading": f"{heading:g}", "x": 0, "z": at}
        rows.append({**taken, "ahead": ahead, "goal": ""})
    write_table(folder, rows)
    return (
        f"{folder / TABLE}: {len(files)} photos, {headings} at each of {len(order)} places\n"
        f"- order: by {'the times in their EXIF' if timed else 'their names'}\n- headings: by {how}\n"
        "- assumed: the places stand in a straight row, each one step ahead of the one\n"
        "  before (heading 0); correct the column ahead where the way turns, branches or\n"
        "  is blocked, and mark goals by yes in the column goal"
    )


def _said_by_name(file: Path) -> tuple[str, float]:
    """Return place and heading in a name, as ``hall_n`` or ``hall_90``; no place if it says none."""
    place, _, end = file.stem.replace("-", "_").rpartition("_")
    heading = COMPASS.get(end.lower(), float(end) if re.fullmatch(r"\d{1,3}", end) else None)
    return ("", 0.0) if heading is None or heading >= 360 else (place, heading)


def _said_by_exif(file: Path) -> tuple[str, float | None]:
    """Return the time, as text that sorts, and degrees clockwise from north, as far as the camera wrote them."""
    image = open_photo(file, load=False)
    try:
        exif = image.getexif()
        details, place = exif.get_ifd(ExifTags.IFD.Exif), exif.get_ifd(ExifTags.IFD.GPSInfo)
        angle = place.get(ExifTags.GPS.GPSImgDirection)
        north = None if angle is None or not 0 <= angle <= 360 else float(angle)  # NaN where the camera wrote 0 / 0
    except Exception as error:  # as SyntaxError and TypeError
        raise SceneError(f"{file}: its EXIF is damaged ({error})") from None
    time = str(details.get(ExifTags.Base.DateTimeOriginal, ""))
    fraction = str(details.get(ExifTags.Base.SubsecTimeOriginal, ""))
    return time and f"{time}.{fraction}", north


def _row(values: Mapping[str, str], where: str, folder: Path) -> Row:
    given = {column: cell for column, cell in values.items() if cell or column in (ACTIONS[AHEAD], ACTIONS[BACK])}
    row: Row = checked({"where": where, **given}, Row, where, strict=False)
    image = inside(folder, values["image"], f"{where}: image")
    if not image.is_file():
        raise SceneError(f"{where}: image: there is no file '{row.image}' in {folder}")
    for column in ("ahead", "back", "goal"):
        if row.shot and values.get(column):
            raise SceneError(f"{where}: {column}: stands in the row of the first shot; leave it empty here")
    return replace(row, image=image)


def _check_place(location: str, here: Sequence[Row], count: int) -> None:
    """Check the headings, in their order, and the positions of a location; ``count`` is how many the first one has."""
    first = here[0]
    if len(here) > MAX_TURNS:
        raise SceneError(f"{first.where}: location '{location}' has {len(here)} headings; at most {MAX_TURNS}")
    if len(here) != count or count % 4:
        raise SceneError(
            f"{first.where}: location '{location}' has {len(here)} headings; expected the same multiple of four "
            f"everywhere{f' ({count} as the first location)' if len(here) != count else ''}"
        )
    for before, after in pairwise([*here, first]):
        turn = (after.heading - before.heading) % 360
        if abs(turn - 360 / count) > TOLERANCE:
            raise SceneError(
                f"{before.where}: location '{location}': from heading {before.heading:g} to the next, "
                f"{after.heading:g}, are {turn:g} degrees; {count} headings must be {360 / count:g} apart"
            )
    for row in here:
        at, there = (row.x, row.z), (first.x, first.z)
        if at != there:
            raise SceneError(f"{row.where}: location '{location}' is at {at}, but at {there} in {first.where}")


def _graph(states: Sequence[Row], numbers: Mapping[str, range]) -> IntArray:
    """Return next states, int64 ``[N, 4]``: turns by the order of headings, moves as the rows say.

    Where no row says where a move back leads, it is the reverse of a move ahead.
    """
    graph = turns_only(len(numbers), len(states) // len(numbers))
    for state, row in enumerate(states):
        for action, location in ((AHEAD, row.ahead), (BACK, row.back)):
            if not location:
                continue
            where = f"{row.where}: {ACTIONS[action]}"
            check_choice(location, numbers, where, "location")
            if location == row.location:
                raise SceneError(f"{where}: leads to '{location}' itself; leave it empty where the way is blocked")
            there = _state_at(states, numbers[location], row.heading)
            if there is None:
                raise SceneError(f"{where}: '{location}' has no image with heading {row.heading:g}; a move keeps it")
            graph[state, action] = there
    if states[0].back is not None:
        return graph
    for state in np.flatnonzero(graph[:, AHEAD] >= 0).tolist():
        there = int(graph[state, AHEAD])
        if graph[there, BACK] >= 0:
            other = states[int(graph[there, BACK])]
            raise SceneError(
                f"{states[state].where}: ahead: '{states[there].location}' is also ahead of '{other.location}', so "
                "that a move back from there could end in either; add a column back that says where"
            )
        graph[there, BACK] = state
    return graph
