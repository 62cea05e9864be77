"""A room while it is being furnished: pieces are placed where there is space for them, or not at all."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dirl.sources.rooms.checks import door_strip
from dirl.sources.rooms.description import SIDES, Piece, Size
from dirl.sources.rooms.furniture import FURNITURE, NOT_SOLID
from dirl.sources.rooms.layout import place_of
from dirl.sources.rooms.mesh import Array
from dirl.sources.rooms.sampling.styles import Style

GAP = 0.02
"""Metres between pieces."""

TRIES = 40
"""Random places that are tried for a piece."""

PASSAGE = 0.6
"""Metres around what stands in the middle of the room, for the agent."""

EYE = (1.0, 1.75)
"""Heights between which a stretch of bare wall is a dull view."""


@dataclass(frozen=True)
class Placed:
    """A piece with the upright box around it: lower and upper corner, float64 ``[6]``."""

    piece: Piece
    box: Array
    solid: bool


class Draft:
    """An empty room of a size (metres) and a style, to be furnished; ``rng`` is what everything is sampled from."""

    def __init__(self, size: Size, style: Style, rng: np.random.Generator) -> None:
        self.size, self.style, self.rng = size, style, rng
        self.placed: list[Placed] = []
        self.kept_free: list[Array] = []

    def put(self, piece: Piece, *, around: float = GAP) -> bool:
        """Add a piece if it is inside the room, overlaps no other, and blocks nothing; returns whether it was added.

        ``around`` are the metres that must stay free between it and solid pieces.
        """
        x, y, yaw = place_of(piece, self.size)
        z = self.size[2] if piece.kind == "ceiling_lamp" else piece.lift
        box = _bounds(piece.kind, piece.size, yaw, tuple(sorted(piece.options.items()))) + np.tile([x, y, z], 2)
        inside = (box[:3] >= -1e-3).all() and (box[3:] <= np.array(self.size) + 1e-3).all()
        if not inside and piece.kind != "ceiling_lamp":
            return False
        solid = piece.kind not in NOT_SOLID
        if solid and any(_meets(box, zone, GAP) for zone in self.kept_free):
            return False
        for other in self.placed:
            alike = (piece.kind == "rug") == (other.piece.kind == "rug")  # anything may stand on a rug
            if alike and _meets(box, other.box, around if solid and other.solid else GAP):
                return False
        self.placed.append(Placed(piece, box, solid))
        return True

    def between(self, low: float, high: float) -> float:
        """Return a random length, to centimetres."""
        return round(float(self.rng.uniform(low, high)), 2)

    def any_seed(self) -> int:
        """Draw the seed of a piece that is sampled at random itself."""
        return int(self.rng.integers(*self.style.repertoire.seeds))

    def from_wall(self, wall: str, along: float, away: float) -> tuple[float, float]:
        """Return the point so far along a wall and away from it."""
        return rounded(place_of(Piece("", (0.0, 0.0, 0.0), wall=wall, along=along, off=away), self.size))

    def length(self, wall: str) -> float:
        """Return the length of a wall, metres."""
        return self.size[0] if wall in ("north", "south") else self.size[1]

    def against_wall(
        self, kind: str, size: Size, *, walls: tuple[str, ...] = SIDES, free: bool = False, **options: object
    ) -> Piece | None:
        """Put a piece with its back to one of the walls, wherever there is room; ``free`` keeps its front clear."""
        for _ in range(TRIES):
            wall = str(self.rng.choice(walls))
            low, high = size[0] / 2 + 0.05, self.length(wall) - size[0] / 2 - 0.05
            if low < high:
                piece = Piece(kind, size, wall=wall, along=self.between(low, high), options=options)
                if self.put(piece):
                    if free:
                        self.keep_front_free(piece)
                    return piece
        return None

    def in_corner(self, kind: str, size: Size, *, yawed: bool = False, **options: object) -> None:
        """Put a piece into a corner; ``yawed`` ones face the middle of the room."""
        reach = np.hypot(size[0], size[1]) / 2 if yawed else max(size[0], size[1]) / 2
        reach = round(float(reach) + 0.06, 2)
        for _ in range(12):
            east, north = self.rng.random() < 0.5, self.rng.random() < 0.5
            at = (self.size[0] - reach if east else reach, self.size[1] - reach if north else reach)
            yaw = (-45.0 if east else 45.0) if north else (-135.0 if east else 135.0)
            if self.put(Piece(kind, size, at=rounded(at), yaw=yaw if yawed else 0.0, options=options)):
                return

    def freely(self, kind: str, size: Size, *, yaws: tuple[float, ...], **options: object) -> Piece | None:
        """Put a piece into the middle of the room, with space to walk around it."""
        margin = max(size[0], size[1]) / 2 + (0.0 if kind in NOT_SOLID else PASSAGE)
        for _ in range(TRIES):
            at = tuple(float(self.rng.uniform(margin, max(margin, length - margin))) for length in self.size[:2])
            piece = Piece(kind, size, at=rounded(at), yaw=float(self.rng.choice(yaws)), options=options)
            if self.put(piece, around=PASSAGE):
                return piece
        return None

    def above(self, below: Piece, kind: str, size: Size, **options: object) -> None:
        """Hang something on the wall over the middle of a piece."""
        self.put(Piece(kind, size, wall=below.wall, along=below.along, options=options))

    def on_top(self, below: Piece, kind: str, size: Size, *, shift: float = 0.0, **options: object) -> None:
        """Put a small piece on another one, ``shift`` metres to the right of its middle."""
        x, y, yaw = place_of(below, self.size)
        turn = np.radians(yaw)
        at = (x + shift * np.cos(turn), y + shift * np.sin(turn))
        options = {"z": below.size[2], **options}
        self.put(Piece(kind, size, at=rounded(at), yaw=yaw, solid=False, options=options))

    def door(self) -> str:
        """Put a door, keep the space before it free, and return its wall."""
        size = (float(self.rng.choice([0.85, 0.9])), 0.08, 2.05)
        door = self.against_wall("door", size)
        assert door is not None  # nothing else is in the room yet
        assert door.wall is not None
        start, end = door_strip(door, self.size)
        low, high = np.minimum(start, end) - 0.3, np.maximum(start, end) + 0.3
        self.kept_free.append(np.array([*low, 0.0, *high, 2.0]))
        return door.wall

    def keep_front_free(self, piece: Piece, depth: float = PASSAGE) -> None:
        """Keep the floor in front of a piece clear of what is put later."""
        x, y, yaw = place_of(piece, self.size)
        turn = np.radians(yaw)
        across, ahead = np.array([np.cos(turn), np.sin(turn)]), np.array([np.sin(turn), -np.cos(turn)])
        near = np.array([x, y]) + ahead * piece.size[1] / 2
        corners = np.array(
            [near + side * across * piece.size[0] / 2 + far * ahead for side in (-1, 1) for far in (0.03, depth)]
        )
        self.kept_free.append(np.array([*corners.min(0), 0.0, *corners.max(0), 2.0]))

    def lamps(self, per_lamp: float) -> None:
        """Hang lamps, one for so many square metres, in rows."""
        across, deep = (max(1, round(length / per_lamp**0.5)) for length in self.size[:2])
        width = float(self.rng.uniform(0.35, 0.6))
        drop = float(self.rng.uniform(0.2, max(0.25, self.size[2] - 2.15)))
        for i in range(across):
            for j in range(deep):
                at = ((i + 0.5) / across * self.size[0], (j + 0.5) / deep * self.size[1])
                self.put(Piece("ceiling_lamp", (width, width, round(drop, 2)), at=rounded(at)))

    def dress_walls(self) -> None:
        """Hang pictures, a few mirrors, in wet rooms towels, until no long stretch of wall is bare at eye height."""
        for wall in SIDES:
            for _ in range(12):
                gaps = [(start, end) for start, end in self._bare(wall) if end - start > 0.5]
                if not gaps:
                    break
                start, end = max(gaps, key=lambda gap: gap[1] - gap[0])
                if not self._hang(wall, start, end):
                    break

    def _bare(self, wall: str) -> list[tuple[float, float]]:
        """Return stretches of a wall without anything on it or near before it at eye height."""
        axis, far = (0, self.size[1]) if wall in ("north", "south") else (1, self.size[0])
        taken = []
        for other in self.placed:
            low, high = other.box[1 - axis], other.box[4 - axis]
            near = high > far - 0.5 if wall in ("north", "east") else low < 0.5
            if near and other.box[2] < EYE[1] - 0.15 and other.box[5] > EYE[0] + 0.25:
                taken.append((other.box[axis], other.box[axis + 3]))
        gaps, at = [], 0.0
        for start, end in sorted(taken):
            gaps.append((at, float(start)))
            at = max(at, float(end))
        return [*gaps, (at, self.length(wall))]

    def _hang(self, wall: str, start: float, end: float) -> bool:
        for shrink in (1.0, 0.7, 0.5):
            room = end - start - 0.2
            width = round(float(min(room, self.rng.uniform(0.4, 1.2)) * shrink), 2)
            if width < 0.2:
                return False
            slack = max(0.0, end - start - width - 0.16)
            # Near one end of a long stretch, so that the rest has space for the next.
            along = start + width / 2 + 0.08 + float(self.rng.uniform(0, min(slack, 0.35)))
            height = round(float(np.clip(width * self.rng.uniform(0.6, 1.4), 0.35, 0.9)), 2)
            z, what = self.between(1.35, 1.55), self.rng.random()
            options: dict[str, object]
            if self.style.wet and what < 0.2 and width < 0.7:
                kind, size, options = "towel_rail", (width, 0.12, 1.45), {"towel": self.style.cloth()}
            elif what < 0.3 and width < 0.9:
                kind, size, options = "mirror", (width, 0.05, height), {"frame": self.style.wood(), "z": z}
            else:
                options = {"image": self.style.painting(), "frame": self.style.wood(), "z": z}
                kind, size = "picture", (width, 0.05, height)
            if self.put(Piece(kind, size, wall=wall, along=round(along, 2), options=options)):
                return True
        return False


@lru_cache(maxsize=1000)
def _bounds(kind: str, size: Size, yaw: float, options: tuple[tuple[str, object], ...]) -> Array:
    """Return the upright box around a turned piece at the origin, lower and upper corner, ``[6]``."""
    parts = FURNITURE[kind](*size, **dict(options)).parts
    corners = np.concatenate([part.moved((0, 0, 0), yaw, 1.0).corners.reshape(-1, 3) for part in parts])
    return np.concatenate([corners.min(0), corners.max(0)])


def _meets(a: Array, b: Array, gap: float) -> bool:
    """Return True if two boxes come nearer than a gap, seen from above, and overlap in height."""
    plan = (a[:2] < b[3:5] + gap).all() and (b[:2] < a[3:5] + gap).all()
    return bool(plan and a[2] < b[5] - 1e-3 and b[2] < a[5] - 1e-3)


def rounded(at: tuple[float, ...]) -> tuple[float, float]:
    """Round to centimetres, for readable descriptions."""
    return round(float(at[0]), 2), round(float(at[1]), 2)
