"""Groups of furniture: a run of counters, a table with its chairs, a seating area, and single pieces."""

import numpy as np

from dirl.sources.rooms.description import SIDES, Piece
from dirl.sources.rooms.layout import YAW
from dirl.sources.rooms.sampling.draft import Draft, rounded


def windows(draft: Draft, door: str, count: int, *, curtains: float) -> None:
    """Put windows with different outlooks, rather not beside the door."""
    rng = draft.rng
    for _ in range(count):
        width, height = draft.between(1.1, 2.0), draft.between(1.0, 1.3)
        panes = (int(rng.integers(2, 5)), int(rng.integers(1, 3)))
        curtain = draft.style.cloth() if rng.random() < curtains else ""
        walls = tuple(side for side in SIDES if side != door)
        piece = draft.against_wall("window", (width, 0.1, height), walls=walls, z=draft.between(1.6, 1.75), panes=panes,
                                  curtain=curtain, outlook=draft.style.outlook())  # fmt: skip
        if piece is None:  # a smaller one may fit
            draft.against_wall("window", (0.9, 0.1, 0.9), z=1.75, outlook=draft.style.outlook())


def shower(draft: Draft) -> None:
    """Put a shower in a corner, the wall on the left of who stands in it with the back to its own wall."""
    rng = draft.rng
    patterns = draft.style.repertoire.wallpapers
    pattern = "leaf" if "leaf" in patterns else patterns[0]
    curtain = draft.style.paper(pattern, float(rng.random())) if rng.random() < 0.6 else draft.style.cloth()
    for wall in rng.permutation(SIDES):
        along = 0.5 if wall in ("north", "west") else draft.length(str(wall)) - 0.5
        shower = Piece("shower", (1.0, 0.95, 2.0), wall=str(wall), along=round(along, 2), options={"curtain": curtain})
        if draft.put(shower):
            draft.keep_front_free(shower)
            return


def chest(draft: Draft, width: float) -> Piece | None:
    """Put a sideboard or a chest of drawers with something on it."""
    rows = int(draft.rng.integers(1, 5))
    size = (width, 0.46, draft.between(0.75, 0.98))
    doors = max(1, round(width / 0.5))
    placed = draft.against_wall("cabinet", size, free=True, body=draft.style.wood(), rows=rows, doors=doors)
    if placed is not None:
        draft.on_top(placed, "bottles", (0.3, 0.2, 0.26), shift=round(width / 4, 2), seed=draft.any_seed())
    return placed


def desk(draft: Draft) -> None:
    """Put a desk at a wall, a chair before it and a lamp on it."""
    rng, style = draft.rng, draft.style
    desk = draft.against_wall("table", (draft.between(1.1, 1.5), 0.65, 0.76), body=style.wood())
    if desk is None or desk.wall is None or desk.along is None:
        return
    chair = Piece("chair", (0.45, 0.45, 0.95), wall=desk.wall, along=desk.along, off=0.56, yaw=180,
                  options={"body": style.wood(), "seat": style.cloth(), "slats": int(rng.integers(0, 6))})  # fmt: skip
    tucked(draft, chair)
    draft.on_top(desk, "lamp", (0.26, 0.26, 1.22), shift=0.35)


def tucked(draft: Draft, chair: Piece) -> None:
    """Put a chair that reaches under a table: in nobody else's way, but in that table's box."""
    tables = [placed for placed in draft.placed if placed.piece.kind in ("table", "round_table")]
    draft.placed = [placed for placed in draft.placed if placed not in tables]
    draft.put(chair)
    draft.placed += tables


def dining(draft: Draft) -> None:
    """Put a table in the room with chairs around it, a rug below, something on it."""
    rng, style = draft.rng, draft.style
    chairs = int(rng.integers(2, 5))
    body, top, seat, wood = style.wood(), style.wood(), style.cloth(), style.wood()
    slats, yaw = int(rng.integers(0, 6)), float(rng.choice([0.0, 90.0]))
    is_round = bool(rng.random() < 0.35)
    width, depth = (draft.between(1.0, 1.25),) * 2 if is_round else (draft.between(1.2, 1.8), draft.between(0.8, 0.95))
    reach = depth / 2 + 0.45  # as far as the chairs stand out
    for _ in range(40):
        half = (width / 2, reach) if yaw == 0 else (reach, width / 2)
        lows = [h + 0.45 for h in half]
        highs = [length - h - 0.45 for h, length in zip(half, draft.size[:2], strict=True)]
        if any(low > high for low, high in zip(lows, highs, strict=True)):
            return
        x, y = (draft.between(low, high) for low, high in zip(lows, highs, strict=True))
        table = Piece("round_table" if is_round else "table", (width, depth, 0.75), at=(x, y), yaw=yaw,
                      options={"body": body, "top": top})  # fmt: skip
        if draft.put(table, around=1.0):
            break
    else:
        return
    draft.on_top(table, "vase", (0.3, 0.3, draft.between(0.4, 0.6)), seed=draft.any_seed(), body="pot")
    slots = [(side, k) for side in (-1, 1) for k in ((-0.25, 0.25) if width > 1.3 and not is_round else (0.0,))]
    turn = np.radians(yaw)
    for slot in rng.permutation(len(slots))[:chairs]:
        side, share = slots[slot]
        along, out = share * width, side * (depth / 2 + 0.1)
        at = (x + along * np.cos(turn) - out * np.sin(turn), y + along * np.sin(turn) + out * np.cos(turn))
        chair = Piece("chair", (0.45, 0.45, 0.95), at=rounded(at), yaw=yaw if side > 0 else yaw + 180,
                      options={"body": wood, "seat": seat, "slats": slats})  # fmt: skip
        tucked(draft, chair)
    if rng.random() < 0.7:
        rug = {"image": style.rug()}
        draft.put(Piece("rug", (width + 1.0, depth + 1.0, 0.01), at=(x, y), yaw=yaw, options=rug))


def counters(draft: Draft, wall: str, units: dict[str, str], *, full: bool) -> None:
    """Put a run of counters along a wall from one of its ends; the full one has sink, hob and fridge."""
    rng = draft.rng
    run: list[tuple[str, dict[str, object]]] = [
        ("counter", {"sink": True}),
        ("counter", {}),
        ("counter", {"hob": True}),
        ("counter", {}),
        ("fridge", {}),
    ]
    kinds = run if full else [("counter", {}), ("counter", {})]
    if rng.random() < 0.5:
        kinds = kinds[::-1]
    length = draft.length(wall)
    at = 0.7 + draft.between(0.0, 0.5)  # the corner may be another run's
    for kind, extra in kinds:
        special = bool(extra) or kind == "fridge"
        fridge, other = draft.between(0.75, 0.9), draft.between(1.0, 1.4) if special else draft.between(0.6, 1.2)
        width = fridge if kind == "fridge" else other
        if at + width > length - 0.1:
            return
        if kind == "fridge":
            options: dict[str, object] = {"body": "steel" if rng.random() < 0.6 else draft.style.wood()}
            size = (width, 0.7, draft.between(1.7, 1.95))
        else:
            options = {**units, **extra, "doors": max(1, round(width / 0.5)), "drawers": bool(rng.random() < 0.7)}
            size = (width, 0.62, 0.92)
        piece = Piece(kind, size, wall=wall, along=round(at + width / 2, 2), options=options)
        if draft.put(piece):
            draft.keep_front_free(piece, 0.7)
            if extra.get("hob"):
                draft.above(piece, "hood", (0.8, 0.5, min(1.1, draft.size[2] - 1.72)), z=1.7)
            elif kind == "counter" and not extra:
                glass = bool(rng.random() < 0.3)
                cupboard = {"body": units["body"], "doors": max(1, round(width / 0.45)), "glass": glass, "z": 1.55}
                if rng.random() < 0.75:
                    draft.above(piece, "wall_cupboard", (width, 0.36, 0.75), **cupboard)
                draft.on_top(piece, "bottles", (round(width * 0.6, 2), 0.25, 0.28), seed=draft.any_seed())
            elif extra.get("sink") and rng.random() < 0.6:
                window = {"z": 1.8, "panes": (3, 1), "outlook": draft.style.outlook()}
                draft.above(piece, "window", (round(width - 0.1, 2), 0.1, 0.95), **window)
        at += width + 0.03


def sitting(draft: Draft) -> None:
    """Put a television at a wall, a sofa facing it, a low table and armchairs between, all on a rug."""
    rng, style = draft.rng, draft.style
    for _ in range(30):
        wall = str(rng.choice(SIDES))
        deep = draft.size[1] if wall in ("north", "south") else draft.size[0]
        width = draft.between(1.5, 2.0)
        margin = 1.7
        if draft.length(wall) < 2 * margin:
            continue
        along = draft.between(margin, draft.length(wall) - margin)
        board = Piece("cabinet", (width, 0.45, 0.55), wall=wall, along=along,
                      options={"body": style.wood(), "doors": int(rng.integers(2, 5))})  # fmt: skip
        away = draft.between(2.9, max(3.0, min(3.6, deep - 1.2)))
        seats = int(rng.integers(2, 4))
        size = (0.65 * seats + 0.3, 0.92, 0.88)
        cloth = style.cloth()
        cushions = tuple(style.cloth() for _ in range(int(rng.integers(0, 4))))
        sofa = Piece("sofa", size, at=draft.from_wall(wall, along, away), yaw=(YAW[wall] + 180) % 360,
                     options={"fabric": cloth, "seats": seats, "cushion": cushions})  # fmt: skip
        before = list(draft.placed)
        if draft.put(board) and draft.put(sofa, around=0.4):
            break
        draft.placed = before
    else:
        return
    draft.keep_front_free(board)
    draft.on_top(board, "tv", (draft.between(1.1, 1.4), 0.2, 0.7))
    middle = (away - 0.46 + 0.45) / 2 + 0.15
    x, y = draft.from_wall(wall, along, middle)
    across = 0.0 if wall in ("north", "south") else 90.0
    if rng.random() < 0.5:
        side = draft.between(0.7, 0.95)
        table = Piece("round_table", (side, side, 0.42), at=(x, y), options={"body": style.wood()})
    else:
        size = (draft.between(0.9, 1.2), 0.55, 0.42)
        table = Piece("table", size, at=(x, y), yaw=across, options={"body": style.wood(), "top": style.wood()})
    if draft.put(table, around=0.35):
        draft.on_top(table, "bowl", (0.3, 0.3, 0.1))
    draft.put(Piece("rug", (draft.between(2.0, 2.6), draft.between(1.5, 1.9), 0.01), at=(x, y), yaw=across,
                    options={"image": style.rug()}))  # fmt: skip
    fabric = style.cloth() if rng.random() < 0.5 else cloth
    for side in rng.permutation([-1, 1])[: int(rng.integers(0, 3))]:
        at = draft.from_wall(wall, along + side * 1.75, middle)
        # Seen by who looks at the wall, an armchair at a larger ``along`` of north or east is on the other side.
        yaw = YAW[wall] + 90 * side * (1 if wall in ("south", "west") else -1)
        draft.put(
            Piece("sofa", (1.0, 0.9, 0.88), at=at, yaw=yaw % 360, options={"fabric": fabric, "seats": 1}), around=0.3
        )


def shelves(draft: Draft, count: int, *, contents: tuple[str, ...] = ("books", "books", "vases", "basket")) -> None:
    """Open shelves along the walls."""
    rng = draft.rng
    for _ in range(count):
        filled = tuple(str(c) for c in rng.permutation(list(contents)))
        size = (draft.between(0.8, 1.6), 0.36, draft.between(1.5, 2.15))
        draft.against_wall("shelf", size, body=draft.style.wood(), shelves=int(rng.integers(4, 7)), contents=filled)


def corner_things(draft: Draft) -> None:
    """Put plants, baskets and stools in corners and along walls."""
    rng = draft.rng
    for kind in rng.choice(["plant", "plant", "basket", "stool"], int(rng.integers(1, 4)), replace=False):
        if kind == "plant":
            side = draft.between(0.42, 0.55)
            size = (side, side, draft.between(0.9, 1.7))
            draft.in_corner("plant", size, seed=draft.any_seed(), pot=str(rng.choice(["accent", "pot", "wicker"])))
        elif kind == "basket":
            draft.against_wall("basket", (0.42, 0.42, draft.between(0.45, 0.65)), fill=draft.style.cloth())
        else:
            draft.against_wall("stool", (0.38, 0.38, draft.between(0.42, 0.6)), body=draft.style.wood())
