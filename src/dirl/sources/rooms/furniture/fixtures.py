"""What stands in bathrooms and kitchens: bathtub, toilet, washing machine; counters, fridge, hood, cupboards."""

import numpy as np

from dirl.sources.rooms.mesh import Array, Mesh, fan


def bathtub(w: float, d: float, h: float) -> Mesh:
    """Build a free-standing tub, its taps on the right."""
    rings: list[tuple[float, ...]] = [
        (0.02, w * 0.46, d * 0.44),
        (h * 0.5, w * 0.485, d * 0.475),
        (h - 0.05, w * 0.492, d * 0.485),
        (h - 0.03, w / 2, d / 2, 7),
        (h, w / 2, d / 2, 7),
        (h + 0.004, w * 0.495, d * 0.49, 7),
        (h, w * 0.45, d * 0.41),
        (h - 0.05, w * 0.44, d * 0.39),
        (0.16, w * 0.38, d * 0.32, 4),
        (0.12, w * 0.3, d * 0.24, 3),
    ]
    mesh = Mesh().loft(rings, "ceramic", exponent=5, sides=64)
    x = w * 0.40
    spout = [(0.05, 0), (0.05, 0.16), (0.02, 0.2), (-0.08, 0.2), (-0.11, 0.15)]
    mesh.tube([(x + dx, 0, h + dz) for dx, dz in spout], 0.018, "chrome")
    for side in (-1, 1):
        y = side * 0.12
        mesh.cylinder(x + 0.05, y, h, h + 0.07, 0.025, "chrome")
        mesh.tube([(x + 0.05, y - 0.03, h + 0.08), (x + 0.05, y + 0.03, h + 0.08)], 0.012, "chrome")
    return mesh


def toilet(w: float, d: float, h: float) -> Mesh:
    """Build a toilet with its cistern at the back."""
    bowl = -d * 0.12
    foot: list[tuple[float, ...]] = [
        (0.0, w * 0.30, d * 0.25, 3, 0, 0.08),
        (0.06, w * 0.27, d * 0.22, 3, 0, 0.08),
        (0.20, w * 0.28, d * 0.24, 2.5, 0, 0.05),
        (0.34, w * 0.46, d * 0.36),
        (0.40, w * 0.48, d * 0.38),
    ]
    lid = [(0.40, 0.49, 0.385), (0.425, 0.50, 0.39), (0.45, 0.49, 0.38), (0.455, 0.3, 0.25)]
    mesh = Mesh().loft(foot, "ceramic", at=(0, bowl), exponent=2.3)
    mesh.loft([(z, w * x, d * y) for z, x, y in lid], "ceramic", at=(0, bowl), exponent=2.3)
    mesh.box(-w / 2, d / 2 - 0.2, 0.38, w / 2, d / 2, h - 0.03, "ceramic", 0.03)
    mesh.box(-w / 2 - 0.01, d / 2 - 0.21, h - 0.03, w / 2 + 0.01, d / 2, h, "ceramic", 0.012)
    return mesh.cylinder(0, d / 2 - 0.1, h, h + 0.015, 0.028, "chrome")


def vanity(
    w: float, d: float, h: float, *, body: str = "wood", top: str = "marble", basins: int = 1, doors: int = 4
) -> Mesh:
    """Build a cabinet with basins on top."""
    mesh = Mesh().box(-w / 2, -d / 2 + 0.03, 0.08, w / 2, d / 2, h - 0.04, body, 0.006)
    mesh.box(-w / 2 + 0.03, -d / 2 + 0.08, 0, w / 2 - 0.03, d / 2, 0.1, "dark", 0)
    mesh.box(-w / 2 - 0.01, -d / 2, h - 0.04, w / 2 + 0.01, d / 2, h, top, 0.008)
    step = w / doors
    for i in range(doors):
        x = -w / 2 + i * step
        mesh.box(x + 0.012, -d / 2 + 0.012, 0.11, x + step - 0.012, -d / 2 + 0.035, h - 0.06, body, 0.008)
        mesh.box(x + 0.07, -d / 2 + 0.006, 0.18, x + step - 0.07, -d / 2 + 0.03, h - 0.13, body, 0.006)
        handle = x + (step - 0.035 if i % 2 == 0 else 0.035)
        mesh.tube([(handle, -d / 2 - 0.012, h * 0.62), (handle, -d / 2 - 0.012, h * 0.80)], 0.007, "chrome")
    basin = [(0, 0.15, 0.12), (0.10, 0.21, 0.165), (0.12, 0.22, 0.17), (0.12, 0.205, 0.155), (0.05, 0.15, 0.12)]
    tap = [(0.09, 0), (0.09, 0.24), (0.12, 0.28), (0.2, 0.28), (0.23, 0.24)]
    for k in range(basins):
        x = (k + 0.5) / basins * w - w / 2
        rings = [(h + z, rx, ry) for z, rx, ry in (*basin, (0.03, 0.05, 0.04))]
        mesh.loft(rings, "ceramic", at=(x, -0.02), exponent=2.4, sides=40, bottom=False)
        mesh.tube([(x, d / 2 - back, h + up) for back, up in tap], 0.014, "chrome")
        mesh.tube([(x + 0.03, d / 2 - 0.09, h + 0.2), (x + 0.1, d / 2 - 0.09, h + 0.24)], 0.009, "chrome")
    return mesh


def shower(w: float, d: float, h: float, *, curtain: str = "shower_curtain") -> Mesh:
    """Build a tray in a corner with a rail at height h, a half-drawn curtain and a shower head."""
    mesh = Mesh().box(-w / 2, -d / 2, 0, w / 2, d / 2, 0.12, "ceramic", 0.02)
    mesh.tube([(-w / 2, -d / 2 + 0.02, h), (w / 2 - 0.02, -d / 2 + 0.02, h), (w / 2 - 0.02, d / 2, h)], 0.013, "chrome")
    pipe = [(0.03, 1.0), (0.03, 2.1), (0.08, 2.15), (0.3, 2.12)]
    mesh.tube([(0, d / 2 - back, z) for back, z in pipe], 0.013, "chrome")
    mesh.loft([(2.06, 0.09, 0.09), (2.09, 0.09, 0.09), (2.12, 0.02, 0.02)], "chrome", at=(0, d / 2 - 0.3), sides=32)

    def folds(u: Array, v: Array) -> Array:
        x, y = -w / 2 + u * w * 0.62, -d / 2 + 0.02 + 0.03 * np.sin(u * 45)
        return np.stack([x, y, 0.16 + (h - 0.16) * v], -1)

    return mesh.sheet(folds, 90, 8, curtain)


def washer(w: float, d: float, h: float) -> Mesh:
    """Build a washing machine."""
    mesh = Mesh().box(-w / 2, -d / 2 + 0.02, 0.01, w / 2, d / 2, h, "appliance", 0.015)
    y, z, radius = -d / 2 + 0.02, h * 0.46, min(w, h) * 0.3
    angle = np.linspace(0, 2 * np.pi, 41)
    ring = np.stack([radius * np.cos(angle), np.full_like(angle, y), z + radius * np.sin(angle)], -1)
    mesh.tube(ring, 0.022, "chrome", 10)
    mesh.add(fan(np.array([0, y - 0.004, z]), ring - [0, 0.004, 0])[:, [0, 2, 1]], "glass_dark")
    return mesh.box(-w / 2 + 0.02, y - 0.012, h - 0.13, w / 2 - 0.02, y + 0.01, h - 0.03, "dark", 0.006)


def towel_rail(w: float, d: float, h: float, *, towel: str = "towel_a", drop: float = 0.75) -> Mesh:
    """Build a rail at height h with a towel over it that hangs down by ``drop`` metres."""
    y = d / 2 - 0.07
    mesh = Mesh().tube([(-w / 2, y, h), (w / 2, y, h)], 0.012, "chrome")
    for side in (-1, 1):
        mesh.tube([(side * w / 2, y, h), (side * w / 2, d / 2, h)], 0.012, "chrome")

    def front(u: Array, v: Array) -> Array:
        folds = 0.012 * np.sin(u * 14) * (1 - 0.7 * v) + 0.01 * (1 - v)
        return np.stack([(u - 0.5) * w * 0.8, y - 0.016 - folds, h + 0.014 - drop * (1 - v)], -1)

    def back(u: Array, v: Array) -> Array:
        return np.stack([(u - 0.5) * w * 0.8, np.full_like(u, y + 0.016), h + 0.014 - drop * 0.7 * v], -1)

    mesh.sheet(front, 40, 16, towel).sheet(back, 8, 6, towel)
    return mesh.tube([(-w * 0.4, y, h), (w * 0.4, y, h)], 0.02, towel)


def counter(
    w: float,
    d: float,
    h: float,
    *,
    body: str = "wood",
    top: str = "marble",
    doors: int = 3,
    drawers: bool = True,
    sink: bool = False,
    hob: bool = False,
) -> Mesh:
    """Build a base unit with a worktop; with a sink, or with a hob and an oven below."""
    mesh = Mesh().box(-w / 2, -d / 2 + 0.04, 0.1, w / 2, d / 2, h - 0.04, body, 0.004)
    mesh.box(-w / 2, -d / 2 + 0.09, 0, w / 2, d / 2, 0.1, "dark", 0)
    mesh.box(-w / 2 - 0.005, -d / 2, h - 0.04, w / 2 + 0.005, d / 2, h, top, 0.008)
    step = w / doors
    for i in range(doors):
        x0, x1 = -w / 2 + i * step + 0.008, -w / 2 + (i + 1) * step - 0.008
        for z0, z1 in ((0.11, h - 0.24), (h - 0.22, h - 0.05)) if drawers else ((0.11, h - 0.05),):
            mesh.box(x0, -d / 2 + 0.018, z0, x1, -d / 2 + 0.042, z1, body, 0.008)
            middle, y = (x0 + x1) / 2, -d / 2 - 0.01
            mesh.tube([(middle - 0.07, y, z1 - 0.05), (middle + 0.07, y, z1 - 0.05)], 0.007, "chrome")
    if sink:
        mesh.box(-0.32, -0.2, h - 0.001, 0.32, 0.18, h + 0.008, "steel", 0.004)
        mesh.box(-0.29, -0.17, h + 0.006, 0.29, 0.15, h + 0.0095, "dark", 0)
        tap = [(0.08, 0), (0.08, 0.26), (0.12, 0.33), (0.2, 0.33), (0.24, 0.28)]
        mesh.tube([(0, d / 2 - back, h + up) for back, up in tap], 0.015, "chrome")
    if hob:
        _hob(mesh, d, h)
    return mesh


def _hob(mesh: Mesh, d: float, h: float) -> None:
    """Build four plates, a pot on one of them, and the oven."""
    mesh.box(-0.3, -0.26, h, 0.3, 0.24, h + 0.01, "glass_dark", 0.004)
    for x in (-0.15, 0.15):
        for y in (-0.13, 0.12):
            mesh.cylinder(x, y, h + 0.01, h + 0.02, 0.08, "dark").cylinder(x, y, h + 0.02, h + 0.026, 0.05, "chrome")
    pot = [(0.026, 0.09), (0.14, 0.1), (0.145, 0.03), (0.17, 0.03)]
    mesh.loft([(h + z, r, r) for z, r in pot], "pot", at=(0.15, 0.12), sides=32)
    z0, z1 = 0.16, h - 0.12
    mesh.box(-0.28, -d / 2, z0, 0.28, -d / 2 + 0.05, z1, "steel", 0.008)
    mesh.box(-0.22, -d / 2 - 0.006, z0 + 0.08, 0.22, -d / 2 + 0.02, z1 - 0.14, "glass_dark", 0.003)
    mesh.tube([(-0.24, -d / 2 - 0.04, z1 - 0.07), (0.24, -d / 2 - 0.04, z1 - 0.07)], 0.011, "chrome")


def fridge(w: float, d: float, h: float, *, body: str = "steel") -> Mesh:
    """Build a fridge over a freezer, its handles on the right."""
    mesh = Mesh().box(-w / 2, -d / 2 + 0.075, 0.03, w / 2, d / 2, h, body, 0.01)
    for z0, z1 in ((0.05, h * 0.36), (h * 0.37, h)):
        mesh.box(-w / 2, -d / 2, z0, w / 2, -d / 2 + 0.07, z1, body, 0.015)
        ends = [(w / 2 - 0.07, -d / 2 - 0.04, z0 + (z1 - z0) * share) for share in (0.25, 0.8)]
        mesh.tube(ends, 0.012, "chrome")
    return mesh


def wall_cupboard(
    w: float, d: float, h: float, *, z: float = 1.45, body: str = "wood", doors: int = 2, glass: bool = False
) -> Mesh:
    """Build a hanging cupboard, its lower edge at height z; glass doors show what looks like crockery."""
    mesh = Mesh().box(-w / 2, -d / 2 + 0.02, z, w / 2, d / 2, z + h, body, 0.004)
    panel = "books" if glass else body
    for i in range(doors):
        x0, x1 = -w / 2 + i * w / doors + 0.006, -w / 2 + (i + 1) * w / doors - 0.006
        mesh.box(x0, -d / 2, z + 0.006, x1, -d / 2 + 0.022, z + h - 0.006, body, 0.006)
        mesh.box(x0 + 0.06, -d / 2 - 0.005, z + 0.07, x1 - 0.06, -d / 2 + 0.01, z + h - 0.07, panel, 0.006)
        handle = x1 - 0.03 if i % 2 == 0 else x0 + 0.03
        mesh.tube([(handle, -d / 2 - 0.02, z + 0.06), (handle, -d / 2 - 0.02, z + 0.16)], 0.006, "chrome")
    return mesh


def hood(w: float, d: float, h: float, *, z: float = 1.6) -> Mesh:
    """Build an extractor hood with its chimney, its lower edge at height z."""
    rings: list[tuple[float, ...]] = [
        (z, w / 2, d / 2, 12),
        (z + 0.06, w / 2, d / 2, 12),
        (z + 0.28, w * 0.2, d * 0.3, 8, 0, d * 0.18),
        (z + h, w * 0.2, d * 0.3, 8, 0, d * 0.18),
    ]
    return Mesh().loft(rings, "steel")
