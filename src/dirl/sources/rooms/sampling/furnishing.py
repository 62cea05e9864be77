"""The furniture of a bathroom, a bedroom, a kitchen and a living room, and how it is placed.

Each function furnishes a `Draft` that has nothing but a door, in the wall that it is told; pieces that do not fit are
left out, so that no two rooms are alike.
"""

from typing import Any

from dirl.sources.rooms.description import SIDES, Piece
from dirl.sources.rooms.sampling.draft import Draft
from dirl.sources.rooms.sampling.groups import (
    chest,
    corner_things,
    counters,
    desk,
    dining,
    shelves,
    shower,
    sitting,
    windows,
)


def bathroom(draft: Draft, door: str) -> None:
    """Put tub or shower, toilet, vanity with a mirror; often a washing machine, shelves, towels."""
    rng, style = draft.rng, draft.style
    windows(draft, door, int(rng.integers(1, 3)), curtains=0.2)
    tub = None
    if rng.random() < 0.8:
        tub = draft.against_wall("bathtub", (draft.between(1.6, 1.8), draft.between(0.75, 0.85), 0.58))
    if rng.random() < 0.7 or tub is None:
        shower(draft)
    basins = int(rng.integers(1, 3))
    width = 0.7 * basins + draft.between(0.1, 0.4)
    options: dict[str, Any] = {"body": style.wood(), "top": style.worktop(), "basins": basins, "doors": 2 * basins}
    vanity = draft.against_wall("vanity", (width, 0.55, draft.between(0.8, 0.88)), free=True, **options)
    if vanity is not None:
        draft.above(vanity, "mirror", (width - 0.15, 0.06, 0.8), z=1.62, frame=style.wood())
    draft.against_wall("toilet", (0.42, 0.7, 0.82), free=True)
    if rng.random() < 0.7:
        draft.against_wall("washer", (0.62, 0.6, 0.86))
    if rng.random() < 0.8:
        contents = tuple(str(c) for c in rng.choice(["towels", "basket", "vases", "towels"], int(rng.integers(3, 6))))
        size = (draft.between(0.6, 1.0), 0.34, draft.between(1.5, 2.0))
        draft.against_wall("shelf", size, body=style.wood(), shelves=int(rng.integers(4, 6)), contents=contents)
    if rng.random() < 0.7:
        chest(draft, draft.between(0.7, 1.1))
    corner_things(draft)
    for _ in range(int(rng.integers(1, 3))):
        draft.freely("rug", (draft.between(0.9, 1.4), draft.between(0.6, 0.8), 0.01), yaws=(0, 90), image=style.rug())


def bedroom(draft: Draft, door: str) -> None:
    """Put a bed with nightstands, a wardrobe; often a desk, a chest of drawers, an armchair, shelves."""
    rng, style = draft.rng, draft.style
    windows(draft, door, int(rng.integers(1, 4)), curtains=0.85)
    width, wood = float(rng.choice([1.0, 1.4, 1.6, 1.8])), style.wood()
    bedding: dict[str, Any] = {"frame": wood, "duvet": style.cloth(), "pillow": style.cloth(0.9)}
    if rng.random() < 0.6:
        bedding["throw"] = style.cloth()
    bed = draft.against_wall("bed", (width, 2.1, draft.between(0.9, 1.3)), **bedding)
    if bed is not None and bed.wall and bed.along:
        for side in (-1, 1):
            nightstand(draft, bed.wall, round(bed.along + side * (width / 2 + 0.34), 2), wood)
    doors = int(rng.integers(2, 5))
    panel = style.wood() if rng.random() < 0.5 else ""
    size = (0.5 * doors, 0.6, draft.between(1.9, 2.3))
    draft.against_wall("cabinet", size, free=True, doors=doors, body=style.wood(), panel=panel)
    if rng.random() < 0.75:
        desk(draft)
    if rng.random() < 0.7:
        drawers = chest(draft, draft.between(0.9, 1.3))
        if drawers is not None and rng.random() < 0.6:
            draft.above(drawers, "mirror", (draft.between(0.5, 0.9), 0.06, 0.8), z=1.6, frame=style.wood())
    if rng.random() < 0.6:
        draft.in_corner("sofa", (0.95, 0.85, 0.85), yawed=True, seats=1, fabric=style.cloth())
    shelves(draft, int(rng.integers(0, 3)))
    corner_things(draft)
    for _ in range(int(rng.integers(1, 4))):
        size = (draft.between(1.4, 2.4), draft.between(0.8, 1.5), 0.01)
        draft.freely("rug", size, yaws=(0, 90), image=style.rug())


def nightstand(draft: Draft, wall: str, along: float, wood: str) -> None:
    """Put a small cabinet with a lamp or a vase on it, if there is room."""
    rng = draft.rng
    options = {"rows": 2, "doors": 1, "body": wood}
    stand = Piece("cabinet", (0.5, 0.42, 0.55), wall=wall, along=along, options=options)
    if not draft.put(stand):
        return
    if rng.random() < 0.6:
        draft.on_top(stand, "lamp", (0.28, 0.28, 1.05))
    else:
        draft.on_top(stand, "vase", (0.22, 0.22, 0.4), seed=draft.any_seed(), body=draft.style.worktop())


def kitchen(draft: Draft, door: str) -> None:
    """Put one or two runs of counters, a dining table; in a large room an island."""
    rng, style = draft.rng, draft.style
    units = {"body": style.wood(), "top": style.worktop()}
    walls = [str(side) for side in rng.permutation([side for side in SIDES if side != door])]
    counters(draft, walls[0], units, full=True)
    if rng.random() < 0.6:
        counters(draft, walls[1], units, full=False)
    windows(draft, door, int(rng.integers(1, 3)), curtains=0.6)
    dining(draft)
    if draft.size[0] * draft.size[1] > 40 and rng.random() < 0.7:
        top, body = style.worktop(), style.wood()
        size = (draft.between(1.6, 2.2), 0.95, 0.92)
        island = draft.freely("counter", size, yaws=(0, 90, 180, 270), top=top, body=body, doors=4)
        if island is not None:
            draft.on_top(island, "bowl", (0.36, 0.36, 0.14), shift=-0.4)
            draft.on_top(island, "vase", (0.3, 0.3, 0.5), shift=0.5, seed=draft.any_seed())
    if rng.random() < 0.5:
        draft.against_wall("washer", (0.62, 0.6, 0.9))
    board = chest(draft, draft.between(1.0, 1.6)) if rng.random() < 0.7 else None
    if board is not None:
        draft.on_top(board, "bowl", (0.36, 0.36, 0.14), body="accent")
    shelves(draft, int(rng.integers(1, 3)), contents=("basket", "vases", "books", "towels"))
    corner_things(draft)
    draft.freely("rug", (draft.between(1.4, 2.0), 0.8, 0.01), yaws=(0, 90), image=style.rug())


def living_room(draft: Draft, door: str) -> None:
    """Put a sofa before a television, armchairs around a low table; often a fireplace, a dining table, shelves."""
    rng, style = draft.rng, draft.style
    sitting(draft)
    if rng.random() < 0.55:
        body = "brick" if rng.random() < 0.5 else style.worktop()
        size = (draft.between(1.3, 1.7), 0.42, draft.between(1.1, 1.25))
        fire = draft.against_wall("fireplace", size, free=True, body=body)
        if fire is not None:
            if rng.random() < 0.5:
                draft.above(fire, "mirror", (0.9, 0.05, 0.8), z=1.85, frame=style.wood())
            else:
                draft.above(fire, "picture", (1.0, 0.05, 0.7), z=1.85, image=style.painting())
    windows(draft, door, int(rng.integers(1, 4)), curtains=0.8)
    if rng.random() < 0.6:
        dining(draft)
    shelves(draft, int(rng.integers(1, 4)))
    if rng.random() < 0.7:
        chest(draft, draft.between(1.0, 1.5))
    if rng.random() < 0.4:
        desk(draft)
    if rng.random() < 0.7:
        draft.in_corner("lamp", (0.4, 0.4, draft.between(1.45, 1.75)))
    corner_things(draft)
    draft.freely("rug", (draft.between(1.4, 2.2), draft.between(0.9, 1.4), 0.01), yaws=(0, 90), image=style.rug())
