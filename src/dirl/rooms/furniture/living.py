"""Sofas and armchairs, television, fireplace."""

import numpy as np

from dirl.rooms.mesh import Mesh


def sofa(
    w: float,
    d: float,
    h: float,
    *,
    fabric: str = "sofa",
    leg: str = "wood_dark",
    seats: int = 3,
    cushion: tuple[str, ...] = (),
) -> Mesh:
    """A sofa, or with one seat an armchair; a cushion of each material named, left and right in turn."""
    arm = 0.18
    mesh = Mesh().box(-w / 2 + 0.02, -d / 2 + 0.05, 0.1, w / 2 - 0.02, d / 2, 0.30, fabric, 0.03)
    for side in (-1, 1):
        x = side * (w / 2 - arm / 2)
        mesh.box(x - arm / 2, -d / 2 + 0.02, 0.1, x + arm / 2, d / 2, 0.60, fabric, 0.06)
        for end in (-1, 1):
            mesh.cylinder(side * (w / 2 - 0.1), end * (d / 2 - 0.1), 0, 0.1, 0.025, leg)
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
    """A square cushion that leans back."""
    rings = [(-0.07, 0.10, 0.10, 3), (-0.04, 0.18, 0.18, 4), (0.04, 0.18, 0.18, 4), (0.07, 0.10, 0.10, 3)]
    lean = np.array([[1, 0, 0], [0, 0.3, 0.95], [0, -0.95, 0.3]])
    flat = Mesh().loft(rings, material, sides=32).parts[0].corners
    mesh.add(flat @ lean + [x, y, 0.64], material, smooth=80)


def tv(w: float, d: float, h: float, *, z: float = 0.55, screen: str = "screen") -> Mesh:
    """A television on a foot at height z; h is the screen's height."""
    mesh = Mesh().box(-w / 2, 0.0, z + 0.06, w / 2, 0.05, z + 0.06 + h, "dark", 0.01)
    depth = min(d / 2, 0.1)
    mesh.box(-w * 0.2, -depth, z, w * 0.2, depth, z + 0.015, "dark", 0.004)
    mesh.box(-0.04, 0.01, z, 0.04, 0.04, z + 0.1, "dark", 0)
    x, z0, z1 = w / 2 - 0.02, z + 0.08, z + 0.04 + h
    return mesh.quad([(-x, -0.012, z0), (x, -0.012, z0), (x, -0.012, z1), (-x, -0.012, z1)], screen, image=True)


def fireplace(w: float, d: float, h: float, *, body: str = "brick", mantel: str = "white_paint") -> Mesh:
    """A burning fireplace with a mantelpiece."""
    half, front, back = w * 0.28, -d / 2 + 0.08, d / 2
    mesh = Mesh().box(-w / 2, front, 0, -half, back, h - 0.08, body, 0.004)
    mesh.box(half, front, 0, w / 2, back, h - 0.08, body, 0.004)
    mesh.box(-half, front, h * 0.62, half, back, h - 0.08, body, 0)
    mesh.box(-half, back - 0.05, 0, half, back, h * 0.62, "dark", 0)
    mesh.box(-w / 2 - 0.06, -d / 2, h - 0.08, w / 2 + 0.06, back, h, mantel, 0.012)
    mesh.box(-w / 2, -d / 2, 0, w / 2, back, 0.06, "marble", 0.008)
    x, y, z = half * 0.8, back - 0.1, h * 0.5
    mesh.quad([(-x, y, 0.08), (x, y, 0.08), (x, y, z), (-x, y, z)], "fire", image=True)
    for k in range(3):
        left, right = (-half * 0.7, y - 0.1 - 0.05 * k, 0.1), (half * 0.7, y - 0.07 - 0.06 * k, 0.11 + 0.04 * k)
        mesh.tube([(*left[:2], left[2] + 0.03 * (k % 2)), right], 0.035, "wood_dark")
    return mesh
