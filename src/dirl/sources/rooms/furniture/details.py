"""Doors, windows, mirrors, pictures; rugs, lamps, plants, and what stands on tables."""

from functools import partial

import numpy as np

from dirl.sources.rooms.mesh import Array, Mesh, fan


def picture(w: float, d: float, h: float, *, image: str = "art_a", frame: str = "wood_dark", z: float = 1.5) -> Mesh:
    """Build a picture in a frame, its middle at height z; w and h are without the frame."""
    edge, back, front = 0.03, d / 2, d / 2 - 0.03
    z0, z1 = z - h / 2, z + h / 2
    mesh = Mesh()
    mesh.box(-w / 2 - edge, front, z0 - edge, w / 2 + edge, back, z0, frame, 0.006)
    mesh.box(-w / 2 - edge, front, z1, w / 2 + edge, back, z1 + edge, frame, 0.006)
    mesh.box(-w / 2 - edge, front, z0, -w / 2, back, z1, frame, 0.006)
    mesh.box(w / 2, front, z0, w / 2 + edge, back, z1, frame, 0.006)
    y = back - 0.012
    return mesh.quad([(-w / 2, y, z0), (w / 2, y, z0), (w / 2, y, z1), (-w / 2, y, z1)], image, image=True)


def mirror(w: float, d: float, h: float, *, frame: str = "wood", z: float = 1.55) -> Mesh:
    """Build a mirror in a frame, its middle at height z."""
    return picture(w, d, h, image="mirror", frame=frame, z=z)


def window(
    w: float,
    d: float,
    h: float,
    *,
    outlook: str = "outdoors",
    z: float = 1.5,
    panes: tuple[int, int] = (2, 2),
    curtain: str = "",
) -> Mesh:
    """Build a window, its middle at height z: a bright panel behind bars gives daylight and a view at once."""
    mesh = picture(w, d, h, image=outlook, frame="white_paint", z=z)
    z0, y = z - h / 2, d / 2 - 0.022
    for i in range(1, panes[0]):
        x = -w / 2 + i * w / panes[0]
        mesh.box(x - 0.015, y - 0.02, z0, x + 0.015, y, z0 + h, "white_paint", 0.003)
    for j in range(1, panes[1]):
        bar = z0 + j * h / panes[1]
        mesh.box(-w / 2, y - 0.02, bar - 0.015, w / 2, y, bar + 0.015, "white_paint", 0.003)
    mesh.box(-w / 2 - 0.08, d / 2 - 0.14, z0 - 0.06, w / 2 + 0.08, d / 2, z0 - 0.03, "white_paint", 0.006)
    if curtain:
        rod = z + h / 2 + 0.1
        mesh.tube([(-w / 2 - 0.2, d / 2 - 0.1, rod), (w / 2 + 0.2, d / 2 - 0.1, rod)], 0.012, "brass")
        for side in (-1, 1):
            drape = partial(_drape, side * (w / 2 + 0.15), -side * 0.28, d / 2 - 0.1, z0 - 0.25, h + 0.33)
            mesh.sheet(drape, 60, 10, curtain)
    return mesh


def _drape(x0: float, width: float, y: float, z0: float, height: float, u: Array, v: Array) -> Array:
    """Return points of cloth that hangs in folds from x0 to x0 + width."""
    across = u if width > 0 else 1 - u  # the same side of the cloth faces the room on either end
    folds = 0.025 * np.sin(across * 26) * (1 - 0.5 * v)
    return np.stack([x0 + width * across, y - folds, z0 + height * v], -1)


def door(w: float, d: float, h: float) -> Mesh:
    """Build a closed door with four panels in its frame; w and h are the leaf's."""
    y = d / 2
    mesh = Mesh().box(-w / 2 - 0.08, y - 0.035, 0, -w / 2, y, h + 0.08, "white_paint", 0.006)
    mesh.box(w / 2, y - 0.035, 0, w / 2 + 0.08, y, h + 0.08, "white_paint", 0.006)
    mesh.box(-w / 2, y - 0.035, h, w / 2, y, h + 0.08, "white_paint", 0.006)
    mesh.box(-w / 2, y - 0.028, 0, w / 2, y, h, "door", 0.0)
    for z0, z1 in ((0.15, 0.85), (1.0, h - 0.15)):
        for x0, x1 in ((-w / 2 + 0.1, -0.04), (0.04, w / 2 - 0.1)):
            mesh.box(x0, y - 0.042, z0, x1, y - 0.01, z1, "door", 0.012)
    handle = [(0.07, 0.02), (0.07, 0.07), (0.18, 0.07)]
    return mesh.tube([(w / 2 - dx, y - dy, 0.98) for dx, dy in handle], 0.011, "brass")


def basket(w: float, d: float, h: float, *, body: str = "wicker", fill: str = "towel_a") -> Mesh:
    """Build a laundry basket, full."""
    sides = [(0, 0.40), (0.9, 0.48), (1.0, 0.5), (1.0, 0.45), (0.8, 0.43)]
    mesh = Mesh().loft([(h * z, w * r, d * r) for z, r in sides], body, exponent=3, sides=40)
    heap = [(0.78, 0.42, 2.5, 0, 0), (0.98, 0.36, 2.3, 0.01, 0), (1.08, 0.2, 2, -0.02, 0.02)]
    return mesh.loft([(h * z, w * r, d * r, e, x, y) for z, r, e, x, y in heap], fill, sides=40, smooth=80)


def plant(w: float, d: float, h: float, *, pot: str = "accent", seed: int = 0) -> Mesh:
    """Build a plant with long arching leaves in a pot."""
    rng = np.random.default_rng(seed)
    r = min(w, d) * 0.32
    outline = [(0, 0.7), (0.22, 1), (0.24, 1.05), (0.26, 1.05), (0.26, 0.9), (0.23, 0.88)]
    mesh = Mesh().loft([(h * z, r * s, r * s) for z, s in outline], pot, sides=32)
    for _ in range(26):
        angle, rise = rng.uniform(0, 2 * np.pi), rng.uniform(0.55, 1.0)
        length, width = rng.uniform(0.75, 1.05) * w * 0.66, rng.uniform(0.05, 0.09) * h
        mesh.sheet(partial(_blade, angle, rise * h * 0.745, length, width, h * 0.22), 5, 12, "leaf")
    return mesh


def _blade(angle: float, rise: float, length: float, width: float, z0: float, u: Array, v: Array) -> Array:
    """Return points of a leaf that grows from z0 on the axis up by ``rise`` and out by ``length``."""
    out, up = v**1.5 * length, z0 + rise * np.sin(v * 1.9)
    side = (u - 0.5) * (2 * width * np.sin(np.pi * np.clip(v, 0.03, 1) ** 0.8) + 1e-4)
    x, y = out * np.cos(angle) - side * np.sin(angle), out * np.sin(angle) + side * np.cos(angle)
    return np.stack([x, y, up + 0.25 * np.abs(u - 0.5) * width], -1)


def bottles(w: float, d: float, h: float, *, z: float = 0.0, seed: int = 0) -> Mesh:
    """Build a row of bottles on a surface at height z."""
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
    """Build a bowl of fruit on a surface at height z."""
    outline = [(0, 0.2), (0.6, 0.45), (1, 0.5), (1, 0.47), (0.5, 0.38), (0.15, 0.15)]
    mesh = Mesh().loft([(z + h * up, w * r, d * r) for up, r in outline], body, sides=36)
    for k in range(6 if fruit else 0):
        mesh.ball(w * 0.22 * np.cos(k * 1.1), d * 0.22 * np.sin(k * 1.1), z + h, w * 0.14, fruit[k % len(fruit)])
    return mesh


def vase(w: float, d: float, h: float, *, z: float = 0.0, body: str = "accent", seed: int = 0) -> Mesh:
    """Build a vase of flowers on a surface at height z."""
    rng = np.random.default_rng(seed)
    neck = h * 0.45
    outline = [(0, 0.18), (0.4, 0.3), (0.85, 0.12), (1, 0.17)]
    mesh = Mesh().loft([(z + neck * up, w * r, d * r) for up, r in outline], body, sides=28)
    for k in range(7):
        angle, lean, top = rng.uniform(0, 2 * np.pi), rng.uniform(0.05, 0.45) * w, z + h * rng.uniform(0.75, 1.0)
        x, y = lean * np.cos(angle), lean * np.sin(angle)
        mesh.tube([(0, 0, z + neck * 0.9), (x / 2, y / 2, (z + neck + top) / 2), (x, y, top)], 0.004, "leaf", 6)
        mesh.ball(x, y, top, rng.uniform(0.025, 0.045), ("towel_a", "fruit", "white_paint")[k % 3], 12)
    return mesh


def rug(w: float, d: float, h: float, *, image: str = "rug", edge: str = "rug_edge") -> Mesh:
    """Build a rug, h thick."""
    mesh = Mesh().box(-w / 2, -d / 2, 0.001, w / 2, d / 2, h + 0.001, edge, 0.003)
    corners = [(-w / 2, -d / 2), (w / 2, -d / 2), (w / 2, d / 2), (-w / 2, d / 2)]
    return mesh.quad([(x, y, h + 0.002) for x, y in corners], image, image=True)


def lamp(w: float, d: float, h: float, *, z: float = 0.0) -> Mesh:
    """Build a lamp that stands on the floor or on a surface at height z; its shade, which glows, ends at height h."""
    foot = [
        (z, w * 0.35, d * 0.35),
        (z + 0.02, w * 0.35, d * 0.35),
        (z + 0.04, 0.02, 0.02),
        (h - w * 0.7, 0.014, 0.014),
    ]
    mesh = Mesh().loft(foot, "brass", sides=32)
    return mesh.loft([(h - w * 0.75, w * 0.5, d * 0.5), (h, w * 0.36, d * 0.36)], "lampshade", sides=40)


def ceiling_lamp(w: float, d: float, h: float) -> Mesh:
    """Build a lamp that hangs h metres down; here z = 0 is the ceiling."""
    mesh = Mesh().cylinder(0, 0, -0.02, 0, w * 0.2, "chrome").cylinder(0, 0, -h + 0.04, 0, 0.012, "chrome", 12)
    mesh.loft([(-h, w * 0.46, d * 0.46), (-h + 0.05, w * 0.5, d * 0.5)], "chrome", sides=40, bottom=False)
    angle = np.linspace(0, 2 * np.pi, 41)
    ring = np.stack([w * 0.46 * np.cos(angle), d * 0.46 * np.sin(angle), np.full_like(angle, -h + 0.001)], -1)
    return mesh.add(fan(np.array([0, 0, -h + 0.001]), ring), "lamp")
