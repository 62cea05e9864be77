"""The description of a room in a TOML file: walls, materials, furniture, the grid of places, the camera.

Lengths are metres, angles degrees; x points right on the plan, y up the plan, z up. See ``descriptions/`` for examples.
"""

import inspect
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, make_dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, get_type_hints

import tomli_w
from annotated_types import Ge, Gt, Le

from dirl.scenes.io.files import check_choice, checked, text_of
from dirl.scenes.scene import SceneError
from dirl.sources.rooms.furniture import FURNITURE
from dirl.sources.rooms.textures import TEXTURES

MOST_TEXT, LONGEST_LINE = 2**20, 2_000
"""Bytes of a description, and characters of one of its lines."""

SIDES = ("north", "south", "east", "west")

LONGEST = 30.0
"""Metres: rooms and furniture larger than this are mistakes."""

Length = Annotated[float, Gt(0), Le(LONGEST)]
NotNegative = Annotated[float, Ge(0)]
Size = tuple[Length, Length, Length]
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
    options: Mapping[str, object] = field(default_factory=lambda: MappingProxyType({}))
    seed: int = 0
    resolution: Annotated[int, Ge(1), Le(2048)] = 512
    size: NotNegative = 1.0
    rough: NotNegative = 0.6
    metal: bool = False
    mirror: bool = False
    emit: NotNegative = 0.0
    glow: NotNegative = 1.6


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
    options: Mapping[str, object] = field(default_factory=lambda: MappingProxyType({}))


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
    text = text_of(Path(path), MOST_TEXT)
    try:
        return parse_description(text)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None


@dataclass
class _Shell:
    """The table ``[room]``."""

    size: Size
    floor: str
    walls: dict[str, object]
    ceiling: str = "ceiling"
    skirting: str | None = None
    rail: str | None = None


@dataclass
class _File:
    """A description as TOML has it; of materials and furniture the kinds are not known yet."""

    name: str
    room: _Shell
    goals: tuple[int, ...] = ()
    grid: Grid = Grid()
    camera: Camera = Camera()
    materials: dict[str, dict[str, object]] = field(default_factory=dict)
    furniture: list[dict[str, object]] = field(default_factory=list)


def parse_description(text: str) -> RoomDescription:
    """Return the room that a TOML text describes; raises `SceneError` as `read_description` does."""
    if len(max(text.splitlines(), key=len, default="")) > LONGEST_LINE:  # the time for a.a.a... is its square
        raise SceneError(f"not TOML of a room: it has a line of more than {LONGEST_LINE} characters")
    try:
        file: _File = checked(tomllib.loads(text), _File)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise SceneError(f"not TOML: {error}") from None
    tables = {
        "walls": _walls(file.room),
        "materials": {name: _material(table, f"[materials] {name}") for name, table in file.materials.items()},
        "furniture": tuple(_piece(table, f"[[furniture]] number {n}") for n, table in enumerate(file.furniture, 1)),
    }
    given = {**vars(file), **vars(file.room), **tables}
    del given["room"]
    return RoomDescription(**given)


def _with_options(
    kind: Any, table: Mapping[str, object], where: str, kinds: Mapping[str, Callable[..., object]]
) -> Any:
    """Return a dataclass of a table; other keys are options of the one of ``kinds`` that the table names."""
    chosen = str(table.get("kind", "plain"))
    check_choice(chosen, kinds, f"{where}: kind")
    values = vars(checked(table, _table(kind, kinds[chosen]), where))
    own = [field.name for field in fields(kind) if field.name != "options"]
    options = {name: values[name] for name in table if name not in own}
    return kind(**{name: values[name] for name in own}, options=options)


@cache
def _table(kind: type, function: Callable[..., object]) -> type:
    """Return a dataclass that has the options of a function, its keyword-only parameters, among its own."""
    hints = get_type_hints(function)
    options = [(name, hints[name], None) for name in inspect.getfullargspec(function).kwonlyargs]
    return make_dataclass(kind.__name__, [*options, ("options", ClassVar[Any])], bases=(kind,), frozen=True)


_Walls = make_dataclass("_Walls", [(side, tuple[Band, ...]) for side in SIDES])


def _walls(room: _Shell) -> dict[str, tuple[Band, ...]]:
    """Return the bands of each side; a side that is one material has one as high as the room."""
    height = room.size[2]
    bands = {side: [[height, given]] if isinstance(given, str) else given for side, given in room.walls.items()}
    walls = vars(checked(bands, _Walls, "[room.walls]"))
    for side, bands_of_side in walls.items():
        tops = [0.0, *(top for top, _ in bands_of_side)]
        if any(low >= high for low, high in pairwise(tops)) or abs(tops[-1] - height) > 1e-6:
            raise SceneError(
                f"[room.walls]: {side}: the upper edges of the bands must rise to the room's height, {height}"
            )
    return walls


def _material(table: Mapping[str, object], where: str) -> Material:
    material: Material = _with_options(Material, table, where, TEXTURES)
    if material.resolution.bit_count() != 1:
        raise SceneError(f"{where}: resolution: must be a power of two, found {material.resolution}")
    return material


def _piece(table: Mapping[str, object], where: str) -> Piece:
    if "kind" not in table:
        raise SceneError(f"{where}: kind: is missing")
    where += f" ({table['kind']})"
    piece: Piece = _with_options(Piece, table, where, FURNITURE)
    if (piece.at is None) == (piece.wall is None) or (piece.wall is None) != (piece.along is None):
        raise SceneError(f"{where}: say where it stands, by 'wall' and 'along', or by 'at'")
    if piece.wall is not None:
        check_choice(piece.wall, SIDES, f"{where}: wall")
    return piece


def description_text(room: RoomDescription) -> str:
    """Return the TOML text of a room; `parse_description` makes an equal room of it."""
    shell = {field.name: value for field in fields(_Shell) if (value := getattr(room, field.name)) is not None}
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


def _changed(item: Material | Piece) -> dict[str, object]:
    """Return what differs from the defaults, options among the rest."""
    defaults = {option.name: option.default for option in fields(item)}
    own = {k: v for k, v in vars(item).items() if k != "options" and (k == "kind" or v != defaults[k])}
    return {**own, **item.options}
