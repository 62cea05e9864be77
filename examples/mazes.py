"""Random mazes for VizDoom: thin walls between square cells, each of another texture, as maps in a WAD.

Maps are in UDMF, a text format (ZDoom builds the nodes itself).
"""

import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

CELL = 128
"""Units of a cell."""

SKIPPED = ("MID", "SKY", "AASHITTY", "BRNSMAL", "-")
"""Textures that one looks through, or that are not of walls."""

LAST = "T"
"""Textures from here on are left to others: SPTM's test mazes have the walls from T to Z."""

THINGS = (32, 35, 44, 31, 45, 46, 30, 33, 2028, 41, 48, 70)
"""Pillars, torches and lamps, by Doom's numbers."""

LIGHT = 190


class Maze(NamedTuple):
    """Walls between the cells of a maze."""

    right: NDArray[np.bool_]
    """Of each cell, whether there is a wall towards greater x, ``[width, height]``."""
    up: NDArray[np.bool_]
    """Likewise towards greater y."""


def draw_maze(random: np.random.Generator) -> Maze:
    """A maze of 5 to 10 cells a side, all of which can be reached; some have many ways, and open spaces."""
    width, height = random.integers(5, 11, 2)
    right, up = np.ones((width, height), bool), np.ones((width, height), bool)
    seen, stack = {(0, 0)}, [(0, 0)]
    while stack:
        x, y = stack[random.integers(len(stack))] if random.random() < 0.2 else stack[-1]
        beside = [(x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)]
        new = [(i, j) for i, j in beside if 0 <= i < width and 0 <= j < height and (i, j) not in seen]
        if not new:
            stack.remove((x, y))
            continue
        i, j = new[random.integers(len(new))]
        (right if i != x else up)[min(i, x), min(j, y)] = False
        seen.add((i, j))
        stack.append((i, j))
    opened = random.choice([0.05, 0.2, 0.4, 0.7, 0.9])
    right &= random.random((width, height)) > opened
    up &= random.random((width, height)) > opened
    right[-1], up[:, -1] = True, True
    return Maze(right, up)


def write_mazes(file: Path, mazes: list[Maze], iwad: Path, random: np.random.Generator) -> None:
    """Write mazes as ``map01``, ``map02``, ... with random walls, floors and things.

    Args:
        file: a WAD to write.
        mazes: what to write.
        iwad: the WAD with the textures, e.g. ``freedoom2.wad`` of VizDoom.
        random: what it draws from.
    """
    lumps = read_lumps(iwad)
    walls, floors = _walls(lumps), _floors(lumps)
    written: list[tuple[str, bytes]] = []
    for number, maze in enumerate(mazes, 1):
        text = _map_text(maze, walls, floors, random).encode()
        written += [(f"MAP{number:02d}", b""), ("TEXTMAP", text), ("ENDMAP", b"")]
    body, folder = b"".join(content for _, content in written), b""
    start = 12
    for name, content in written:
        folder += struct.pack("<ii8s", start, len(content), name.encode())
        start += len(content)
    file.write_bytes(struct.pack("<4sii", b"PWAD", len(written), start) + body + folder)


def read_lumps(wad: Path) -> list[tuple[str, bytes]]:
    """The parts of a WAD with their names, in its order."""
    content = wad.read_bytes()
    _, count, start = struct.unpack("<4sii", content[:12])
    entries = struct.iter_unpack("<ii8s", content[start : start + 16 * count])
    return [(name.rstrip(b"\0").decode(), content[place : place + size]) for place, size, name in entries]


def _walls(lumps: list[tuple[str, bytes]]) -> list[str]:
    """Textures that fill a wall."""
    found = set()
    for name, content in lumps:
        if name not in ("TEXTURE1", "TEXTURE2"):
            continue
        (count,) = struct.unpack("<i", content[:4])
        for start in struct.unpack(f"<{count}i", content[4 : 4 + 4 * count]):
            texture = content[start : start + 8].rstrip(b"\0").decode()
            width, height = struct.unpack("<hh", content[start + 12 : start + 16])
            if texture < LAST and width >= 64 and height >= 96 and not texture.startswith(SKIPPED):
                found.add(texture)
    return sorted(found)


def _floors(lumps: list[tuple[str, bytes]]) -> list[str]:
    names = [name for name, _ in lumps]
    flats = lumps[names.index("F_START") : names.index("F_END")]
    return [name for name, content in flats if len(content) == 4096 and not name.startswith("F_SKY")]


def _map_text(maze: Maze, walls: list[str], floors: list[str], random: np.random.Generator) -> str:
    """A map in UDMF."""
    width, height = maze.right.shape
    vertices: dict[tuple[int, int], int] = {}
    lines: list[str] = []
    sides: list[str] = []
    textures = random.choice(walls, min(len(walls), int(random.choice([8, 20, 40, 80]))), replace=False)

    def line(start: tuple[int, int], end: tuple[int, int], *, inside: bool) -> None:
        ends = [vertices.setdefault(point, len(vertices)) for point in (start, end)]
        front, back = len(sides), ""
        sides.append(random.choice(textures))
        if inside:
            sides.append(random.choice(textures) if random.random() < 0.7 else sides[front])
            back = f"sideback = {front + 1}; twosided = true; wrapmidtex = true; "
        lines.append(f"linedef {{ v1 = {ends[0]}; v2 = {ends[1]}; sidefront = {front}; blocking = true; {back}}}")

    for x in range(width):
        for y in range(height):
            if x < width - 1 and maze.right[x, y]:
                line((x + 1, y + 1), (x + 1, y), inside=True)
            if y < height - 1 and maze.up[x, y]:
                line((x, y + 1), (x + 1, y + 1), inside=True)
    for x in range(width):
        line((x + 1, 0), (x, 0), inside=False)
        line((x, height), (x + 1, height), inside=False)
    for y in range(height):
        line((0, y), (0, y + 1), inside=False)
        line((width, y + 1), (width, y), inside=False)
    cells = random.permutation([(x, y) for x in range(width) for y in range(height)])
    kinds = random.permutation(THINGS)[: min(random.integers(2, 8), len(cells) - 1)]
    middles = cells * CELL + CELL // 2
    places = middles[1 : 1 + len(kinds)] + random.integers(-30, 31, (len(kinds), 2))
    things = [(1, middles[0], int(random.integers(4)) * 90)]
    things += [(kind, place, 0) for kind, place in zip(kinds, places, strict=True)]
    always = " ".join(f"skill{level} = true;" for level in range(1, 6)) + " single = true;"
    floor, ceiling = random.choice(floors, 2)
    return "\n".join(
        [
            'namespace = "zdoom";',
            *(f"vertex {{ x = {x * CELL}; y = {y * CELL}; }}" for x, y in vertices),
            *lines,
            *(f'sidedef {{ sector = 0; texturemiddle = "{texture}"; }}' for texture in sides),
            f'sector {{ heightfloor = 0; heightceiling = {CELL}; texturefloor = "{floor}"; '
            f'textureceiling = "{ceiling}"; lightlevel = {LIGHT}; }}',
            *(
                f"thing {{ x = {place[0]}; y = {place[1]}; angle = {angle}; type = {kind}; {always} }}"
                for kind, place, angle in things
            ),
        ]
    )
