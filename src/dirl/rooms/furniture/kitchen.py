"""Counters, fridge, hood, wall cupboards."""

from dirl.rooms.mesh import Mesh


def counter(
    w: float,
    d: float,
    h: float,
    *,
    body: str = "wood",
    top: str = "marble",
    trim: str = "chrome",
    doors: int = 3,
    drawers: bool = True,
    sink: bool = False,
    hob: bool = False,
) -> Mesh:
    """A base unit with a worktop; with a sink, or with a hob and an oven below."""
    mesh = Mesh().box(-w / 2, -d / 2 + 0.04, 0.1, w / 2, d / 2, h - 0.04, body, 0.004)
    mesh.box(-w / 2, -d / 2 + 0.09, 0, w / 2, d / 2, 0.1, "dark", 0)
    mesh.box(-w / 2 - 0.005, -d / 2, h - 0.04, w / 2 + 0.005, d / 2, h, top, 0.008)
    step = w / doors
    for i in range(doors):
        x0, x1 = -w / 2 + i * step + 0.008, -w / 2 + (i + 1) * step - 0.008
        for z0, z1 in ((0.11, h - 0.24), (h - 0.22, h - 0.05)) if drawers else ((0.11, h - 0.05),):
            mesh.box(x0, -d / 2 + 0.018, z0, x1, -d / 2 + 0.042, z1, body, 0.008)
            middle, y = (x0 + x1) / 2, -d / 2 - 0.01
            mesh.tube([(middle - 0.07, y, z1 - 0.05), (middle + 0.07, y, z1 - 0.05)], 0.007, trim)
    if sink:
        mesh.box(-0.32, -0.2, h - 0.001, 0.32, 0.18, h + 0.008, "steel", 0.004)
        mesh.box(-0.29, -0.17, h + 0.006, 0.29, 0.15, h + 0.0095, "dark", 0)
        tap = [(0.08, 0), (0.08, 0.26), (0.12, 0.33), (0.2, 0.33), (0.24, 0.28)]
        mesh.tube([(0, d / 2 - back, h + up) for back, up in tap], 0.015, trim)
    if hob:
        _hob(mesh, d, h, trim)
    return mesh


def _hob(mesh: Mesh, d: float, h: float, trim: str) -> None:
    """Four plates, a pot on one of them, and the oven."""
    mesh.box(-0.3, -0.26, h, 0.3, 0.24, h + 0.01, "glass_dark", 0.004)
    for x in (-0.15, 0.15):
        for y in (-0.13, 0.12):
            mesh.cylinder(x, y, h + 0.01, h + 0.02, 0.08, "dark").cylinder(x, y, h + 0.02, h + 0.026, 0.05, trim)
    pot = [(0.026, 0.09), (0.14, 0.1), (0.145, 0.03), (0.17, 0.03)]
    mesh.loft([(h + z, r, r) for z, r in pot], "pot", at=(0.15, 0.12), sides=32)
    z0, z1 = 0.16, h - 0.12
    mesh.box(-0.28, -d / 2, z0, 0.28, -d / 2 + 0.05, z1, "steel", 0.008)
    mesh.box(-0.22, -d / 2 - 0.006, z0 + 0.08, 0.22, -d / 2 + 0.02, z1 - 0.14, "glass_dark", 0.003)
    mesh.tube([(-0.24, -d / 2 - 0.04, z1 - 0.07), (0.24, -d / 2 - 0.04, z1 - 0.07)], 0.011, trim)


def fridge(w: float, d: float, h: float, *, body: str = "steel", trim: str = "chrome") -> Mesh:
    """A fridge over a freezer, its handles on the right."""
    mesh = Mesh().box(-w / 2, -d / 2 + 0.075, 0.03, w / 2, d / 2, h, body, 0.01)
    for z0, z1 in ((0.05, h * 0.36), (h * 0.37, h)):
        mesh.box(-w / 2, -d / 2, z0, w / 2, -d / 2 + 0.07, z1, body, 0.015)
        ends = [(w / 2 - 0.07, -d / 2 - 0.04, z0 + (z1 - z0) * share) for share in (0.25, 0.8)]
        mesh.tube(ends, 0.012, trim)
    return mesh


def wall_cupboard(
    w: float, d: float, h: float, *, z: float = 1.45, body: str = "wood", doors: int = 2, glass: bool = False
) -> Mesh:
    """A hanging cupboard, its lower edge at height z; glass doors show what looks like crockery."""
    mesh = Mesh().box(-w / 2, -d / 2 + 0.02, z, w / 2, d / 2, z + h, body, 0.004)
    panel = "books" if glass else body
    for i in range(doors):
        x0, x1 = -w / 2 + i * w / doors + 0.006, -w / 2 + (i + 1) * w / doors - 0.006
        mesh.box(x0, -d / 2, z + 0.006, x1, -d / 2 + 0.022, z + h - 0.006, body, 0.006)
        mesh.box(x0 + 0.06, -d / 2 - 0.005, z + 0.07, x1 - 0.06, -d / 2 + 0.01, z + h - 0.07, panel, 0.006)
        handle = x1 - 0.03 if i % 2 == 0 else x0 + 0.03
        mesh.tube([(handle, -d / 2 - 0.02, z + 0.06), (handle, -d / 2 - 0.02, z + 0.16)], 0.006, "chrome")
    return mesh


def hood(w: float, d: float, h: float, *, z: float = 1.6, body: str = "steel") -> Mesh:
    """An extractor hood with its chimney, its lower edge at height z."""
    rings: list[tuple[float, ...]] = [
        (z, w / 2, d / 2, 12),
        (z + 0.06, w / 2, d / 2, 12),
        (z + 0.28, w * 0.2, d * 0.3, 8, 0, d * 0.18),
        (z + h, w * 0.2, d * 0.3, 8, 0, d * 0.18),
    ]
    return Mesh().loft(rings, body)
