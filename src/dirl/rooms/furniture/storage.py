"""Cabinets and shelves."""

import numpy as np

from dirl.rooms.mesh import Mesh

CONTENTS = ("books", "towels", "basket", "vases")


def cabinet(
    w: float,
    d: float,
    h: float,
    *,
    body: str = "wood",
    panel: str = "",
    trim: str = "chrome",
    doors: int = 2,
    rows: int = 1,
    legs: float = 0.06,
) -> Mesh:
    """Doors side by side, or with several rows drawers; low ones are nightstands and sideboards, tall ones wardrobes.

    Doors have a panel of another material if one is named.
    """
    mesh = Mesh().box(-w / 2, -d / 2 + 0.02, legs, w / 2, d / 2, h, body, 0.006)
    for i in range(doors):
        for j in range(rows):
            x0, z0 = -w / 2 + i * w / doors, legs + j * (h - legs) / rows
            x1, z1 = x0 + w / doors, z0 + (h - legs) / rows
            mesh.box(x0 + 0.008, -d / 2, z0 + 0.01, x1 - 0.008, -d / 2 + 0.022, z1 - 0.01, body, 0.006)
            if panel:
                mesh.box(x0 + 0.08, -d / 2 - 0.004, z0 + 0.09, x1 - 0.08, -d / 2 + 0.01, z1 - 0.09, panel, 0.003)
            if rows == 1:
                x, z = (x1 - 0.04 if i % 2 == 0 else x0 + 0.04), (z0 + z1) / 2
                ends = [(x, -d / 2 - 0.02, z - 0.07), (x, -d / 2 - 0.02, z + 0.07)]
            else:
                x, z = (x0 + x1) / 2, z1 - 0.07
                ends = [(x - 0.06, -d / 2 - 0.02, z), (x + 0.06, -d / 2 - 0.02, z)]
            mesh.tube(ends, 0.007, trim)
    if legs > 0:
        for x in (-w / 2 + 0.04, w / 2 - 0.04):
            for y in (-d / 2 + 0.05, d / 2 - 0.05):
                mesh.cylinder(x, y, 0, legs, 0.02, trim)
    return mesh


def shelf(
    w: float,
    d: float,
    h: float,
    *,
    body: str = "wood",
    shelves: int = 4,
    contents: tuple[str, ...] = CONTENTS,
    towels: tuple[str, str] = ("towel_a", "towel_b"),
) -> Mesh:
    """An open shelf; ``contents`` says what lies on the boards from the lowest up, in turn.

    Raises:
        ValueError: something else than books, towels, a basket or vases is to lie there.
    """
    board = 0.022
    mesh = Mesh().box(-w / 2, -d / 2, 0, -w / 2 + board, d / 2, h, body, 0.004)
    mesh.box(w / 2 - board, -d / 2, 0, w / 2, d / 2, h, body, 0.004)
    mesh.box(-w / 2 + board, d / 2 - 0.01, 0, w / 2 - board, d / 2, h, body, 0)
    room = (h - board) / shelves - board
    for i in range(shelves + 1):
        z = i * (h - board) / shelves
        mesh.box(-w / 2 + board, -d / 2, z, w / 2 - board, d / 2 - 0.01, z + board, body, 0.003)
        if i < shelves and contents:
            _fill(mesh, contents[i % len(contents)], w / 2 - board, d / 2, z + board, room, towels)
    return mesh


def _fill(mesh: Mesh, what: str, x: float, y: float, z: float, room: float, towels: tuple[str, str]) -> None:
    """Put something on a board at height z that is 2 x wide and 2 y deep; ``room`` is the height above it."""
    if what == "books":
        front = [(-x, -y / 2, z), (x, -y / 2, z), (x, -y / 2, z + room), (-x, -y / 2, z + room)]
        mesh.quad(front, "books", image=True)
    elif what == "towels":
        for k in range(int(min(3, room / 0.07))):
            low = z + k * 0.07
            mesh.box(-x + 0.04, -y + 0.03, low, x - 0.04, y - 0.03, low + 0.066, towels[k % 2], 0.03)
    elif what == "basket":
        mesh.box(-x + 0.03, -y + 0.02, z, x - 0.03, y - 0.03, z + room * 0.6, "wicker", 0.02)
    elif what == "vases":
        for k, (at, material) in enumerate(
            zip(np.linspace(-x + 0.08, x - 0.08, 3), ("accent", "towel_a", "brass"), strict=True)
        ):
            r, scale = 0.035 + 0.012 * k, min(1.0, room / 0.2)
            outline = [(0, r * 0.6), (0.07, r), (0.15, r * 0.4), (0.18, r * 0.6)]
            mesh.loft([(z + up * scale, s, s) for up, s in outline], material, at=(float(at), 0), sides=24)
    else:
        raise ValueError(f"contents: there is no '{what}'; choose from {', '.join(CONTENTS)}")
