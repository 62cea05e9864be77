"""Beds, sofas, tables, chairs, cabinets and shelves, a fireplace, a television."""

from itertools import product

import numpy as np

from dirl.sources.rooms.mesh import Array, Mesh

CONTENTS = ("books", "towels", "basket", "vases")


def bed(
    w: float, d: float, h: float, *, frame: str = "wood", duvet: str = "duvet", pillow: str = "pillow", throw: str = ""
) -> Mesh:
    """Build a bed with its head at the back, h high; with a throw over the foot if one is named."""
    mesh = Mesh().box(-w / 2, -d / 2, 0.12, w / 2, d / 2, 0.32, frame, 0.01)
    mesh.box(-w / 2 - 0.02, d / 2 - 0.06, 0, w / 2 + 0.02, d / 2, h, frame, 0.02)
    for x in (-w / 2 + 0.06, w / 2 - 0.06):
        mesh.cylinder(x, -d / 2 + 0.06, 0, 0.12, 0.03, frame)
    mattress = [(0.32, 0.49, 0.47, 12), (0.46, 0.495, 0.475, 10), (0.52, 0.48, 0.46, 8)]
    mesh.loft([(z, w * x, d * y, e) for z, x, y, e in mattress], "white_paint", at=(0, -0.03), sides=64)

    def cover(u: Array, v: Array) -> Array:
        x, y = (u - 0.5) * (w + 0.10), -d / 2 - 0.02 + v * d * 0.70
        # It falls over the sides and the foot within 7 cm of its edge.
        edge = np.clip(np.minimum(u, 1 - u) * (w + 0.1) / 0.07, 0, 1) * np.clip(v * d * 0.7 / 0.07, 0, 1)
        folds = 0.012 * np.sin(9 * u + 5 * v) + 0.010 * np.sin(23 * u * v + 4 * v)
        return np.stack([x, y, 0.30 + 0.27 * edge**0.5 + folds * edge], -1)

    mesh.sheet(cover, 48, 48, duvet, image=False)
    if throw:
        above = np.array([0, 0, 0.012])
        mesh.sheet(lambda u, v: above + cover(u, 0.05 + 0.28 * v), 48, 12, throw, image=False)
    pillows = 2 if w > 1.2 else 1
    rings = [
        (0.53, 0.30, 0.15, 3, 0),
        (0.58, 0.42, 0.22, 3, 0),
        (0.63, 0.42, 0.22, 3, 0.01),
        (0.69, 0.28, 0.13, 2.5, 0.02),
    ]
    for i in range(pillows):
        x = (i + 0.5) / pillows * w - w / 2
        scaled = [(z, w / pillows * rx, ry, e, 0, dy) for z, rx, ry, e, dy in rings]
        mesh.loft(scaled, pillow, at=(x, d / 2 - 0.32), sides=40, smooth=80)
    return mesh


def sofa(w: float, d: float, h: float, *, fabric: str = "sofa", seats: int = 3, cushion: tuple[str, ...] = ()) -> Mesh:
    """Build a sofa, or with one seat an armchair; a cushion of each material named, left and right in turn."""
    arm = 0.18
    mesh = Mesh().box(-w / 2 + 0.02, -d / 2 + 0.05, 0.1, w / 2 - 0.02, d / 2, 0.30, fabric, 0.03)
    for side in (-1, 1):
        x = side * (w / 2 - arm / 2)
        mesh.box(x - arm / 2, -d / 2 + 0.02, 0.1, x + arm / 2, d / 2, 0.60, fabric, 0.06)
        for end in (-1, 1):
            mesh.cylinder(side * (w / 2 - 0.1), end * (d / 2 - 0.1), 0, 0.1, 0.025, "wood_dark")
    mesh.box(-w / 2 + 0.05, d / 2 - 0.22, 0.1, w / 2 - 0.05, d / 2, h - 0.04, fabric, 0.07)
    width, depth = (w - 2 * arm) / seats, d - 0.22
    for i in range(seats):
        x = -w / 2 + arm + (i + 0.5) * width
        pad = [(0.30, 0.485, 8), (0.40, 0.495, 7), (0.455, 0.45, 6)]
        mesh.loft([(z, width * s, depth * s, e) for z, s, e in pad], fabric, at=(x, -0.12), smooth=70)
        mesh.box(x - width * 0.49, d / 2 - 0.36, 0.44, x + width * 0.49, d / 2 - 0.18, h, fabric, 0.07)
    for i, material in enumerate(cushion):
        _cushion(mesh, (-1) ** i * (w / 2 - arm - 0.22 - 0.1 * (i // 2)), d / 2 - 0.42, material)
    return mesh


def _cushion(mesh: Mesh, x: float, y: float, material: str) -> None:
    rings = [(-0.07, 0.10, 0.10, 3), (-0.04, 0.18, 0.18, 4), (0.04, 0.18, 0.18, 4), (0.07, 0.10, 0.10, 3)]
    lean = np.array([[1, 0, 0], [0, 0.3, 0.95], [0, -0.95, 0.3]])
    flat = Mesh().loft(rings, material, sides=32).parts[0].corners
    mesh.add(flat @ lean + [x, y, 0.64], material, smooth=80)


def tv(w: float, d: float, h: float, *, z: float = 0.55) -> Mesh:
    """Build a television on a foot at height z; h is the screen's height."""
    mesh = Mesh().box(-w / 2, 0.0, z + 0.06, w / 2, 0.05, z + 0.06 + h, "dark", 0.01)
    depth = min(d / 2, 0.1)
    mesh.box(-w * 0.2, -depth, z, w * 0.2, depth, z + 0.015, "dark", 0.004)
    mesh.box(-0.04, 0.01, z, 0.04, 0.04, z + 0.1, "dark", 0)
    x, z0, z1 = w / 2 - 0.02, z + 0.08, z + 0.04 + h
    return mesh.quad([(-x, -0.012, z0), (x, -0.012, z0), (x, -0.012, z1), (-x, -0.012, z1)], "screen", image=True)


def fireplace(w: float, d: float, h: float, *, body: str = "brick") -> Mesh:
    """Build a burning fireplace with a mantelpiece."""
    half, front, back = w * 0.28, -d / 2 + 0.08, d / 2
    mesh = Mesh().box(-w / 2, front, 0, -half, back, h - 0.08, body, 0.004)
    mesh.box(half, front, 0, w / 2, back, h - 0.08, body, 0.004)
    mesh.box(-half, front, h * 0.62, half, back, h - 0.08, body, 0)
    mesh.box(-half, back - 0.05, 0, half, back, h * 0.62, "dark", 0)
    mesh.box(-w / 2 - 0.06, -d / 2, h - 0.08, w / 2 + 0.06, back, h, "white_paint", 0.012)
    mesh.box(-w / 2, -d / 2, 0, w / 2, back, 0.06, "marble", 0.008)
    x, y, z = half * 0.8, back - 0.1, h * 0.5
    mesh.quad([(-x, y, 0.08), (x, y, 0.08), (x, y, z), (-x, y, z)], "fire", image=True)
    for k in range(3):
        left, right = (-half * 0.7, y - 0.1 - 0.05 * k, 0.1), (half * 0.7, y - 0.07 - 0.06 * k, 0.11 + 0.04 * k)
        mesh.tube([(*left[:2], left[2] + 0.03 * (k % 2)), right], 0.035, "wood_dark")
    return mesh


def cabinet(
    w: float, d: float, h: float, *, body: str = "wood", panel: str = "", doors: int = 2, rows: int = 1
) -> Mesh:
    """Build doors, or with several rows drawers, side by side; doors with a panel of another material if named."""
    legs = 0.06
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
            mesh.tube(ends, 0.007, "chrome")
    for x, y in product((-w / 2 + 0.04, w / 2 - 0.04), (-d / 2 + 0.05, d / 2 - 0.05)):
        mesh.cylinder(x, y, 0, legs, 0.02, "chrome")
    return mesh


def shelf(
    w: float, d: float, h: float, *, body: str = "wood", shelves: int = 4, contents: tuple[str, ...] = CONTENTS
) -> Mesh:
    """Build an open shelf; ``contents`` says what lies on the boards from the lowest up, in turn."""
    board = 0.022
    mesh = Mesh().box(-w / 2, -d / 2, 0, -w / 2 + board, d / 2, h, body, 0.004)
    mesh.box(w / 2 - board, -d / 2, 0, w / 2, d / 2, h, body, 0.004)
    mesh.box(-w / 2 + board, d / 2 - 0.01, 0, w / 2 - board, d / 2, h, body, 0)
    room = (h - board) / shelves - board
    for i in range(shelves + 1):
        z = i * (h - board) / shelves
        mesh.box(-w / 2 + board, -d / 2, z, w / 2 - board, d / 2 - 0.01, z + board, body, 0.003)
        if i < shelves and contents:
            _fill(mesh, contents[i % len(contents)], w / 2 - board, d / 2, z + board, room)
    return mesh


def _fill(mesh: Mesh, what: str, x: float, y: float, z: float, room: float) -> None:
    """Put something on a board at height z that is 2 x wide and 2 y deep; ``room`` is the height above it."""
    if what == "books":
        front = [(-x, -y / 2, z), (x, -y / 2, z), (x, -y / 2, z + room), (-x, -y / 2, z + room)]
        mesh.quad(front, "books", image=True)
    elif what == "towels":
        for k in range(int(min(3, room / 0.07))):
            low = z + k * 0.07
            mesh.box(-x + 0.04, -y + 0.03, low, x - 0.04, y - 0.03, low + 0.066, ("towel_a", "towel_b")[k % 2], 0.03)
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


def table(w: float, d: float, h: float, *, body: str = "wood", top: str = "") -> Mesh:
    """Build a table on four legs; its top of another material if one is named."""
    mesh = Mesh().box(-w / 2, -d / 2, h - 0.04, w / 2, d / 2, h, top or body, 0.01)
    mesh.box(-w / 2 + 0.06, -d / 2 + 0.06, h - 0.12, w / 2 - 0.06, d / 2 - 0.06, h - 0.04, body, 0.004)
    for x, y in product((-w / 2 + 0.09, w / 2 - 0.09), (-d / 2 + 0.09, d / 2 - 0.09)):
        mesh.loft([(0, 0.018, 0.018), (h - 0.04, 0.03, 0.03)], body, at=(x, y), exponent=4, sides=16)
    return mesh


def round_table(w: float, d: float, h: float, *, body: str = "wood", top: str = "") -> Mesh:
    """Build a round table on a pillar."""
    plate = [(h - 0.035, w / 2 - 0.01, d / 2 - 0.01), (h - 0.01, w / 2, d / 2), (h, w / 2 - 0.01, d / 2 - 0.01)]
    pillar = [
        (0, w * 0.28, d * 0.28),
        (0.03, w * 0.27, d * 0.27),
        (0.07, 0.05, 0.05),
        (h - 0.1, 0.04, 0.04),
        (h - 0.035, w * 0.2, d * 0.2),
    ]
    return Mesh().loft(plate, top or body, sides=56).loft(pillar, body, sides=40)


def chair(w: float, d: float, h: float, *, body: str = "wood", seat: str = "", slats: int = 4) -> Mesh:
    """Build a chair with its back at the back; no slats make the back a board."""
    z = 0.45
    mesh = Mesh().box(-w / 2, -d / 2, z - 0.035, w / 2, d / 2, z, seat or body, 0.015)
    for side in (-1, 1):
        x = side * (w / 2 - 0.03)
        mesh.tube([(x, -d / 2 + 0.03, 0), (x * 0.96, -d / 2 + 0.04, z - 0.03)], 0.018, body)
        mesh.tube([(x, d / 2 - 0.02, 0), (x * 0.96, d / 2 - 0.04, z), (x * 0.96, d / 2 - 0.01, h - 0.02)], 0.018, body)
    mesh.box(-w / 2 + 0.02, d / 2 - 0.035, h - 0.09, w / 2 - 0.02, d / 2 - 0.005, h, body, 0.01)
    if not slats:
        mesh.box(-w / 2 + 0.06, d / 2 - 0.035, z + 0.08, w / 2 - 0.06, d / 2 - 0.015, h - 0.09, seat or body, 0.008)
    for x in np.linspace(-w / 2 + 0.08, w / 2 - 0.08, slats):
        mesh.box(x - 0.015, d / 2 - 0.035, z, x + 0.015, d / 2 - 0.02, h - 0.08, body, 0.003)
    return mesh


def stool(w: float, d: float, h: float, *, body: str = "wood") -> Mesh:
    """Build a stool on four splayed legs."""
    seat = [(h - 0.04, w * 0.46, d * 0.46), (h - 0.01, w / 2, d / 2), (h, w * 0.48, d * 0.48)]
    mesh = Mesh().loft(seat, body, exponent=4, sides=40)
    for x, y in product((-w, w), (-d, d)):
        mesh.tube([(x * 0.34, y * 0.34, h - 0.03), (x * 0.45, y * 0.45, 0)], 0.016, body)
    return mesh
