"""Small things: rugs, lamps, plants, and what stands on tables."""

import numpy as np

from dirl.rooms.mesh import Array, Mesh


def basket(w: float, d: float, h: float, *, body: str = "wicker", fill: str = "towel_a") -> Mesh:
    """A laundry basket, full."""
    sides = [(0, 0.40), (0.9, 0.48), (1.0, 0.5), (1.0, 0.45), (0.8, 0.43)]
    mesh = Mesh().loft([(h * z, w * r, d * r) for z, r in sides], body, exponent=3, sides=40)
    heap = [(0.78, 0.42, 2.5, 0, 0), (0.98, 0.36, 2.3, 0.01, 0), (1.08, 0.2, 2, -0.02, 0.02)]
    return mesh.loft([(h * z, w * r, d * r, e, x, y) for z, r, e, x, y in heap], fill, sides=40, smooth=80)


def plant(
    w: float, d: float, h: float, *, pot: str = "accent", leaf: str = "leaf", leaves: int = 26, seed: int = 0
) -> Mesh:
    """A plant with long arching leaves in a pot."""
    rng = np.random.default_rng(seed)
    r = min(w, d) * 0.32
    outline = [(0, 0.7), (0.22, 1), (0.24, 1.05), (0.26, 1.05), (0.26, 0.9), (0.23, 0.88)]
    mesh = Mesh().loft([(h * z, r * s, r * s) for z, s in outline], pot, sides=32)
    for _ in range(leaves):
        angle, rise = rng.uniform(0, 2 * np.pi), rng.uniform(0.55, 1.0)
        length, width = rng.uniform(0.75, 1.05) * w * 0.66, rng.uniform(0.05, 0.09) * h
        mesh.sheet(_blade(angle, rise * h * 0.745, length, width, h * 0.22), 5, 12, leaf)
    return mesh


def _blade(angle: float, rise: float, length: float, width: float, z0: float):  # type: ignore[no-untyped-def]
    """A leaf that grows from z0 on the axis up by ``rise`` and out by ``length``."""

    def surface(u: Array, v: Array) -> Array:
        out, up = v**1.5 * length, z0 + rise * np.sin(v * 1.9)
        side = (u - 0.5) * (2 * width * np.sin(np.pi * np.clip(v, 0.03, 1) ** 0.8) + 1e-4)
        x, y = out * np.cos(angle) - side * np.sin(angle), out * np.sin(angle) + side * np.cos(angle)
        return np.stack([x, y, up + 0.25 * np.abs(u - 0.5) * width], -1)

    return surface


def bottles(w: float, d: float, h: float, *, z: float = 0.0, seed: int = 0) -> Mesh:
    """A row of bottles on a surface at height z."""
    rng = np.random.default_rng(seed)
    colors = ("accent", "towel_a", "brass", "white_paint", "towel_b", "leaf")
    mesh = Mesh()
    for x in np.arange(-w / 2 + 0.03, w / 2 - 0.02, 0.075):
        r, high, y = rng.uniform(0.02, 0.03), rng.uniform(0.6, 1.0) * h, rng.uniform(-d / 2 + 0.03, d / 2 - 0.03)
        rings = [(z, r, r), (z + high * 0.7, r, r), (z + high * 0.8, r * 0.4, r * 0.4), (z + high, r * 0.45, r * 0.45)]
        mesh.loft(rings, colors[rng.integers(len(colors))], at=(x, y), sides=20)
    return mesh


def bowl(
    w: float,
    d: float,
    h: float,
    *,
    z: float = 0.0,
    body: str = "ceramic",
    fruit: tuple[str, ...] = ("towel_a", "leaf", "brass", "fruit"),
) -> Mesh:
    """A bowl of fruit on a surface at height z."""
    outline = [(0, 0.2), (0.6, 0.45), (1, 0.5), (1, 0.47), (0.5, 0.38), (0.15, 0.15)]
    mesh = Mesh().loft([(z + h * up, w * r, d * r) for up, r in outline], body, sides=36)
    for k in range(6 if fruit else 0):
        mesh.ball(w * 0.22 * np.cos(k * 1.1), d * 0.22 * np.sin(k * 1.1), z + h, w * 0.14, fruit[k % len(fruit)])
    return mesh


def vase(w: float, d: float, h: float, *, z: float = 0.0, body: str = "accent", stems: int = 7, seed: int = 0) -> Mesh:
    """A vase of flowers on a surface at height z."""
    rng = np.random.default_rng(seed)
    neck = h * 0.45
    outline = [(0, 0.18), (0.4, 0.3), (0.85, 0.12), (1, 0.17)]
    mesh = Mesh().loft([(z + neck * up, w * r, d * r) for up, r in outline], body, sides=28)
    for k in range(stems):
        angle, lean, top = rng.uniform(0, 2 * np.pi), rng.uniform(0.05, 0.45) * w, z + h * rng.uniform(0.75, 1.0)
        x, y = lean * np.cos(angle), lean * np.sin(angle)
        mesh.tube([(0, 0, z + neck * 0.9), (x / 2, y / 2, (z + neck + top) / 2), (x, y, top)], 0.004, "leaf", 6)
        mesh.ball(x, y, top, rng.uniform(0.025, 0.045), ("towel_a", "fruit", "white_paint")[k % 3], 12)
    return mesh


def rug(w: float, d: float, h: float, *, image: str = "rug", edge: str = "rug_edge") -> Mesh:
    """A rug, h thick."""
    mesh = Mesh().box(-w / 2, -d / 2, 0.001, w / 2, d / 2, h + 0.001, edge, 0.003)
    corners = [(-w / 2, -d / 2), (w / 2, -d / 2), (w / 2, d / 2), (-w / 2, d / 2)]
    return mesh.quad([(x, y, h + 0.002) for x, y in corners], image, image=True)


def lamp(w: float, d: float, h: float, *, base: str = "brass", shade: str = "lampshade", z: float = 0.0) -> Mesh:
    """A lamp that stands on the floor or on a surface at height z; its shade, which glows, ends at height h."""
    foot = [
        (z, w * 0.35, d * 0.35),
        (z + 0.02, w * 0.35, d * 0.35),
        (z + 0.04, 0.02, 0.02),
        (h - w * 0.7, 0.014, 0.014),
    ]
    mesh = Mesh().loft(foot, base, sides=32)
    return mesh.loft([(h - w * 0.75, w * 0.5, d * 0.5), (h, w * 0.36, d * 0.36)], shade, sides=40)


def ceiling_lamp(w: float, d: float, h: float, *, light: str = "lamp", trim: str = "chrome") -> Mesh:
    """A lamp that hangs h metres down; here z = 0 is the ceiling."""
    mesh = Mesh().cylinder(0, 0, -0.02, 0, w * 0.2, trim).cylinder(0, 0, -h + 0.04, 0, 0.012, trim, 12)
    mesh.loft([(-h, w * 0.46, d * 0.46), (-h + 0.05, w * 0.5, d * 0.5)], trim, sides=40, bottom=False)
    angle = np.linspace(0, 2 * np.pi, 41)
    ring = np.stack([w * 0.46 * np.cos(angle), d * 0.46 * np.sin(angle), np.full_like(angle, -h + 0.001)], -1)
    centre = np.broadcast_to([0, 0, -h + 0.001], ring[:-1].shape)
    return mesh.add(np.stack([centre, ring[1:], ring[:-1]], 1), light)
