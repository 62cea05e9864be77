"""The description of a room in a TOML file: walls, materials, furniture, the grid of places, the camera.

Lengths are metres, angles degrees; x points right on the plan, y up the plan, z up. See ``descriptions/`` for examples.
"""

import inspect
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar, get_type_hints

import tomli_w

from dirl.scenes.io.texts import read_text
from dirl.scenes.scene import SceneError
from dirl.sources.rooms.furniture import FURNITURE
from dirl.sources.rooms.options import check_keys, check_value
from dirl.sources.rooms.textures import TEXTURES

T = TypeVar("T")

SIDES = ("north", "south", "east", "west")
SHELL = ("size", "floor", "ceiling", "skirting", "rail")
"""What a room has beside its walls and its furniture."""

LONGEST = 30.0
"""Metres: rooms and furniture larger than this are mistakes."""

Size = tuple[float, float, float]
Band = tuple[float, str]


@dataclass(frozen=True)
class Grid:
    """The places of a room: the points ``origin + step * (i, j)`` where an agent can stand.

    Args:
        origin: of the first place, x and y.
        step: between neighbouring places.
        radius: of the agent, seen from above.
        places: the required number; otherwise building stops. Not checked if left out.
    """

    origin: tuple[float, float] = (0.3, 0.3)
    step: float = 0.5
    radius: float = 0.2
    places: int | None = None


@dataclass(frozen=True)
class Camera:
    """The camera on the agent: its height, how far it looks up (down if negative), its horizontal field of view."""

    height: float = 1.4
    pitch: float = -12.0
    fov: float = 75.0


@dataclass(frozen=True)
class Material:
    """A texture and how it reflects light.

    Args:
        kind: the texture, a name in `dirl.sources.rooms.textures.TEXTURES`.
        options: of that texture.
        seed: another number, another texture of the same kind.
        resolution: of the texture, pixels a side (a power of two).
        size: metres that one repeat covers; 0 for one image over the whole surface.
        rough: 0 is polished, 1 dull; under 0.5 the room is reflected.
        metal: whether the reflection has the material's colour and nothing lies under it.
        mirror: whether it is a mirror.
        emit: radiance; above 0 it lights the room.
        glow: how bright a light looks to the camera; 1 is white.
    """

    kind: str = "plain"
    options: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    seed: int = 0
    resolution: int = 512
    size: float = 1.0
    rough: float = 0.6
    metal: bool = False
    mirror: bool = False
    emit: float = 0.0
    glow: float = 1.6


@dataclass(frozen=True)
class Piece:
    """A piece of furniture, and where it stands: with its back to a ``wall``, or free ``at`` a point.

    Args:
        kind: a name in `dirl.sources.rooms.furniture.FURNITURE`.
        size: width, depth and height.
        wall: north, south, east or west; the piece faces away from it.
        along: where along the wall its middle is: x for north and south, y for east and west.
        off: its distance from the wall.
        at: x and y of its middle; a negative one is measured from the far wall.
        yaw: rotation, anticlockwise; 0 faces south (beside what the wall gives).
        lift: its distance from the floor.
        solid: whether agents cannot pass it; by its kind if left out.
        options: of the kind.
    """

    kind: str
    size: Size
    wall: str | None = None
    along: float | None = None
    off: float = 0.0
    at: tuple[float, float] | None = None
    yaw: float = 0.0
    lift: float = 0.0
    solid: bool | None = None
    options: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))


@dataclass(frozen=True)
class RoomDescription:
    """A furnished room.

    Args:
        name: what the scene is called.
        size: width (x), depth (y) and height.
        floor: its material.
        walls: for each of the four sides, bands from the floor up: (upper edge, material).
        furniture: in any order.
        materials: those that are not in stock, by name.
        ceiling: its material.
        skirting: material of the boards along the floor; none if left out.
        rail: material of a rail at the top of the lowest band of walls with several; none if left out.
        goals: states that agents are sent to, numbered as with turns of 90 degrees: four times the place, plus 0 to 3
            for north, east, south, west.
        grid: the places.
        camera: how they are seen.
    """

    name: str
    size: Size
    floor: str
    walls: Mapping[str, tuple[Band, ...]]
    furniture: tuple[Piece, ...] = ()
    materials: Mapping[str, Material] = field(default_factory=lambda: MappingProxyType({}))
    ceiling: str = "ceiling"
    skirting: str | None = None
    rail: str | None = None
    goals: tuple[int, ...] = ()
    grid: Grid = Grid()
    camera: Camera = Camera()


def read_description(path: str | Path) -> RoomDescription:
    """Read and check a room description.

    Raises:
        SceneError: there is no such file, it is not TOML, or something in it is unknown, missing or out of range. The
            message names the file, the table and the key.
    """
    path = Path(path)
    try:
        return parse_description(read_text(path))
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error})") from None
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None
    except ValueError as error:
        raise SceneError(str(error)) from None


def parse_description(text: str) -> RoomDescription:
    """The room that a TOML text describes; raises `SceneError` as `read_description` does."""
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise SceneError(f"not TOML: {error}") from None
    known = ("name", "goals", "room", "grid", "camera", "materials", "furniture")
    check_keys(tables, known, "the top level", required=("name", "room"))
    room = check_value(tables["room"], dict, "[room]")
    shell = {key: value for key, value in room.items() if key != "walls"}
    check_keys(room, (*SHELL, "walls"), "[room]", required=("size", "floor", "walls"))
    hints = get_type_hints(RoomDescription)
    made = {key: check_value(value, hints[key], f"[room] {key}") for key, value in shell.items()}
    _check_lengths(made["size"], "[room] size")
    return RoomDescription(
        **made,
        name=check_value(tables["name"], str, "name"),
        walls=_walls(room["walls"], made["size"][2]),
        furniture=tuple(
            _piece(table, f"[[furniture]] number {number}")
            for number, table in enumerate(check_value(tables.get("furniture", []), list, "furniture"), 1)
        ),
        materials={
            name: _material(table, f"[materials] {name}")
            for name, table in check_value(tables.get("materials", {}), dict, "[materials]").items()
        },
        goals=check_value(tables.get("goals", []), tuple[int, ...], "goals"),
        grid=_filled(Grid, tables.get("grid", {}), "[grid]"),
        camera=_filled(Camera, tables.get("camera", {}), "[camera]"),
    )


def _filled(kind: Callable[..., T], table: Any, where: str, kinds: Mapping[str, Callable[..., Any]] | None = None) -> T:
    """A dataclass made of a table, its values checked; what it lacks are options of the one of ``kinds`` it names."""
    hints = get_type_hints(kind)
    hints.pop("options", None)
    parameters = fields(kind)  # type: ignore[arg-type]
    required = [option.name for option in parameters if option.default is MISSING and option.default_factory is MISSING]
    table = check_value(table, dict, where)
    given = {key: value for key, value in table.items() if kinds is None or key in hints}
    check_keys(given, hints, where, required=required)
    made = {key: check_value(value, hints[key], f"{where} {key}") for key, value in given.items()}
    if kinds is not None:
        chosen = made.get("kind", "plain")
        check_keys({chosen: 0}, kinds, f"{where} kind")
        options = {key: value for key, value in table.items() if key not in hints}
        check_keys(options, (*inspect.getfullargspec(kinds[chosen]).kwonlyargs, *hints), where)
        types = get_type_hints(kinds[chosen])
        made["options"] = {key: check_value(value, types[key], f"{where} {key}") for key, value in options.items()}
    return kind(**made)


def _check_lengths(size: Size, where: str) -> None:
    if min(size) <= 0 or max(size) > LONGEST:
        raise SceneError(f"{where}: expected lengths above 0 and up to {LONGEST} metres, found {list(size)}")


def _walls(table: Any, height: float) -> dict[str, tuple[Band, ...]]:
    check_keys(check_value(table, dict, "[room.walls]"), SIDES, "[room.walls]", required=SIDES)
    walls = {}
    for side, given in table.items():
        where = f"[room.walls] {side}"
        bands = [[height, given]] if isinstance(given, str) else check_value(given, list, where)
        walls[side] = tuple(check_value(band, tuple[float, str], where) for band in bands)
        tops = [0.0, *(top for top, _ in walls[side])]
        if any(low >= high for low, high in pairwise(tops)) or abs(tops[-1] - height) > 1e-6:
            raise SceneError(f"{where}: the upper edges of the bands must rise to the room's height, {height}")
    return walls


def _material(table: Any, where: str) -> Material:
    material = _filled(Material, table, where, TEXTURES)
    n = material.resolution
    if not (1 <= n <= 2048 and n & (n - 1) == 0):
        raise SceneError(f"{where} resolution: expected a power of two up to 2048, found {n}")
    for key in ("size", "rough", "emit", "glow"):
        if getattr(material, key) < 0:
            raise SceneError(f"{where} {key}: must not be negative")
    return material


def _piece(table: Any, where: str) -> Piece:
    if isinstance(table, dict) and isinstance(table.get("kind"), str):
        where += f" ({table['kind']})"
    piece = _filled(Piece, table, where, FURNITURE)
    _check_lengths(piece.size, f"{where} size")
    if (piece.at is None) == (piece.wall is None) or (piece.wall is None) != (piece.along is None):
        raise SceneError(f"{where}: say where it stands, by 'wall' and 'along', or by 'at'")
    if piece.wall is not None:
        check_keys({piece.wall: 0}, SIDES, f"{where} wall")
    return piece


def description_text(room: RoomDescription) -> str:
    """The TOML text of a room; `parse_description` makes an equal room of it."""
    shell = {key: getattr(room, key) for key in SHELL if getattr(room, key) is not None}
    tables = {
        "name": room.name,
        "goals": room.goals,
        "room": {**shell, "walls": {side: room.walls[side] for side in SIDES}},
        "grid": {key: value for key, value in vars(room.grid).items() if value is not None},
        "camera": vars(room.camera),
        "materials": {name: _changed(material) for name, material in room.materials.items()},
        "furniture": [_changed(piece) for piece in room.furniture],
    }
    return tomli_w.dumps(tables)


def write_description(description: RoomDescription, path: str | Path) -> None:
    """Write a room as TOML.

    Raises:
        SceneError: this file exists already.
    """
    path = Path(path)
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(description_text(description))
    except FileExistsError:
        raise SceneError(f"{path}: this file exists already; it is not overwritten") from None


def _changed(item: Material | Piece) -> dict[str, Any]:
    """What differs from the defaults, options among the rest."""
    defaults = {option.name: option.default for option in fields(item)}
    own = {k: v for k, v in vars(item).items() if k != "options" and (k == "kind" or v != defaults[k])}
    return {**own, **item.options}
