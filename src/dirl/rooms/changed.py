"""A room some time later: lamps off, another daylight, chairs elsewhere, small things gone."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from dirl.rooms.checks import check_room
from dirl.rooms.description import Material, Piece, RoomDescription
from dirl.rooms.materials import STOCK
from dirl.rooms.navigation import walk

LAMPS = ("lamp", "lampshade")
"""Materials that glow in a lamp that is on."""

DARK = 0.35
"""How bright a lamp that is off looks to the camera, where 1 is white."""

MOVABLE = ("chair", "stool", "basket", "plant", "round_table")
THINGS = ("bottles", "bowl", "vase", "basket", "plant", "picture")

ATTEMPTS = 8
"""To move a piece of furniture, each half as far as the one before."""


def changed_room(
    room: RoomDescription, rng: np.random.Generator, *, lamps: float, daylight: float, furniture: float, objects: float
) -> RoomDescription:
    """The room at a later visit, with the same places to stand at.

    Args:
        room: as it is.
        rng: draws the changes.
        lamps: probability that the lamps of one kind, on the ceiling or with shades, are off.
        daylight: standard deviation of the logarithm of the light through each window: cloud, and sun on another side.
        furniture: standard deviation of how far a chair, stool, basket, plant or small round table is moved along each
            axis, metres, and of its turn, in units of 45 degrees a metre. What would stand in the way stays.
        objects: probability that a small thing, such as a vase or a picture, is gone.
    """
    kept = [piece for piece in room.furniture if piece.kind not in THINGS or rng.random() >= objects]
    grid = replace(room.grid, places=None)  # where a thing is gone there may be more
    changed = replace(room, furniture=tuple(kept), materials=_relit(room, rng, lamps, daylight), grid=grid)
    if furniture:
        places = _places(room)
        for number, piece in enumerate(kept):
            if piece.kind in MOVABLE and not piece.lift:
                changed = _moved(changed, number, rng.normal(0, furniture, 3), places)
    return changed


def _relit(room: RoomDescription, rng: np.random.Generator, lamps: float, daylight: float) -> Mapping[str, Material]:
    known = {**STOCK, **room.materials}
    outlooks = {str(piece.options.get("outlook", "outdoors")) for piece in room.furniture if piece.kind == "window"}
    made = dict(room.materials)
    for name in sorted(outlooks):
        factor = float(np.exp(rng.normal(0, 1) * daylight))
        if daylight:
            made[name] = replace(known[name], emit=known[name].emit * factor, glow=known[name].glow * min(1.0, factor))
    for name in LAMPS:
        off = rng.random() < lamps
        if off and outlooks:  # a room without a window keeps its only light
            made[name] = replace(known[name], emit=0.0, options={**known[name].options, "color": _grey(DARK)})
    return made


def _grey(value: float) -> str:
    return "#" + f"{round(255 * value):02x}" * 3


def _moved(room: RoomDescription, number: int, errors: np.ndarray, places: set[tuple[float, ...]]) -> RoomDescription:
    """The room with one piece moved and turned, as far as it leaves the places free and touches nothing anew."""
    problems = set(check_room(room))
    for attempt in range(ATTEMPTS):
        pieces = list(room.furniture)
        pieces[number] = _shifted(pieces[number], errors / 2**attempt)
        moved = replace(room, furniture=tuple(pieces))
        if places <= _places(moved) and set(check_room(moved)) <= problems:
            return moved
    return room


def _places(room: RoomDescription) -> set[tuple[float, ...]]:
    return {tuple(place) for place in walk(room).places.tolist()}


def _shifted(piece: Piece, errors: np.ndarray) -> Piece:
    along, across, turn = (float(error) for error in errors)
    yaw = piece.yaw + 45 * turn
    if piece.at is not None:
        # A negative coordinate is measured from the far wall.
        x, y = (
            max(0.0, v + e) if v >= 0 else min(-1e-3, v + e) for v, e in zip(piece.at, (along, across), strict=True)
        )
        return replace(piece, at=(x, y), yaw=yaw)
    assert piece.along is not None
    return replace(piece, along=piece.along + along, off=max(0.0, piece.off + across), yaw=yaw)


def _beside(coordinate: float, error: float) -> float:
    """A coordinate with an error, and of the same sign, since negative ones are measured from the far wall."""
    return max(0.0, coordinate + error) if coordinate >= 0 else min(-1e-3, coordinate + error)
