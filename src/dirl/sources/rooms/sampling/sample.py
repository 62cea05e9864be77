"""Draw random rooms until one passes every check."""

import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dirl.scenes.io.files import check_choice
from dirl.scenes.scene import SceneError
from dirl.sources.rooms.checks import check_room
from dirl.sources.rooms.description import Grid, RoomDescription
from dirl.sources.rooms.dump import View, poses, take_views, view_problems
from dirl.sources.rooms.layout import assemble
from dirl.sources.rooms.sampling import furnishing
from dirl.sources.rooms.sampling.draft import Draft, rounded
from dirl.sources.rooms.sampling.splits import repertoire_of
from dirl.sources.rooms.sampling.styles import Style
from dirl.sources.rooms.view import Renderer
from dirl.sources.rooms.walkable import walk

ATTEMPTS = 60
"""Rooms that are sampled before giving up. About one in three passes."""

LOOK = (48, 64)
"""Height and width of the views that are checked, pixels."""

GOALS = 5


@dataclass(frozen=True)
class Kind:
    """A kind of room: how it is furnished, how wide and deep it may be in metres, the fewest places, what it needs.

    ``per_lamp`` is square metres; ``wet`` rooms have tiles and towels.
    """

    furnish: Callable[[Draft, str], None]
    extent: tuple[float, float]
    places: int
    needs: tuple[str, ...]
    per_lamp: float
    wet: bool = False


KINDS = {
    "bathroom": Kind(furnishing.bathroom, (3.6, 5.0), 20, ("toilet", "vanity"), 7, wet=True),
    "bedroom": Kind(furnishing.bedroom, (4.4, 6.8), 30, ("bed",), 11),
    "kitchen": Kind(furnishing.kitchen, (4.6, 7.4), 35, ("counter", "table"), 14, wet=True),
    "living_room": Kind(furnishing.living_room, (5.0, 7.4), 40, ("sofa", "tv"), 13),
}


def sample_room(kind: str, seed: int, *, look: bool = True) -> RoomDescription:
    """Return a random room that passes `check_room` and, in small views, `check_views`; kind and seed determine it.

    A kind is bathroom, bedroom, kitchen or living_room, and every seed from 0 on gives another room. To ``look`` at the
    views takes some ten seconds an attempt; else only the furniture and the places are checked.

    Raises:
        SceneError: there is no such kind, the seed is negative, or no attempt passed; the message says why the last
            one did not.
    """
    return sample_views(kind, seed, look=look)[0]


def sample_views(
    kind: str, seed: int, *, look: bool = True, threads: int | None = None
) -> tuple[RoomDescription, list[View]]:
    """Return the room that `sample_room` returns, and the views of its check: of `LOOK` pixels, in coarse light.

    They are those that `build_room` takes with that ``size`` and without ``fine``; none without ``look``.
    """
    check_choice(kind, KINDS, "kind")
    if seed < 0:
        raise SceneError(f"seed={seed}: must not be negative")
    for attempt in range(ATTEMPTS):
        room = draw_room(kind, seed, attempt)
        problems = problems_of(room, KINDS[kind])
        views = look_around(room, threads) if look and not problems else []
        if views:
            problems = view_problems(views, walk(room))
        if not problems:
            return room, views
    raise SceneError(f"kind={kind} seed={seed}: none of {ATTEMPTS} rooms passed the checks; the last: {problems[0]}")


def draw_room(kind: str, seed: int, attempt: int = 0) -> RoomDescription:
    """Return a random room, unchecked."""
    rng = np.random.default_rng([zlib.crc32(kind.encode()), seed, attempt])
    room_kind = KINDS[kind]
    width, depth = (round(float(rng.uniform(*room_kind.extent)), 1) for _ in range(2))
    size = (width, depth, round(float(rng.uniform(2.5, 2.9)), 2))
    style = Style(rng, wet=room_kind.wet, repertoire=repertoire_of(seed))
    walls, floor = style.walls(size[2]), style.floor()
    skirting = "white_paint" if rng.random() < 0.6 else style.wood()
    draft = Draft(size, style, rng)
    room_kind.furnish(draft, draft.door())
    draft.lamps(room_kind.per_lamp)
    draft.dress_walls()
    room = RoomDescription(
        name=f"{kind}_{seed}",
        size=size,
        floor=floor,
        walls=walls,
        furniture=tuple(placed.piece for placed in draft.placed),
        materials=style.materials,
        skirting=skirting,
        rail=skirting,
        grid=Grid(rounded(tuple(0.25 + (length - 0.5) % 0.5 / 2 for length in size[:2]))),
    )
    used = {part.material for part in assemble(room)}
    room = replace(room, materials={name: style.materials[name] for name in style.materials if name in used})
    try:
        places = len(walk(room).places)
    except SceneError:  # no place at all: what the checks will say
        return room
    chosen = rng.choice(places, min(GOALS, places), replace=False)
    goals = tuple(sorted(int(4 * place + rng.integers(4)) for place in chosen))
    return replace(room, goals=goals, grid=replace(room.grid, places=places))


def problems_of(room: RoomDescription, kind: Kind) -> list[str]:
    """Return the problems of a room's furniture and places, one line each."""
    try:
        way = walk(room)
    except SceneError as error:
        return [str(error)]
    if len(way.places) < kind.places:
        return [f"only {len(way.places)} places; at least {kind.places} are wanted"]
    kinds = {piece.kind for piece in room.furniture} | {"table" for piece in room.furniture if "table" in piece.kind}
    return [f"there was no room for a {need}" for need in kind.needs if need not in kinds] + check_room(room)


def look_around(room: RoomDescription, threads: int | None = None) -> list[View]:
    """Return the views of all states, of `LOOK` pixels, in coarse light."""
    renderer = Renderer.of(room, fine=False)
    return list(take_views(renderer, room.camera, poses(walk(room)), LOOK, threads=threads))
