"""The bed."""

import numpy as np

from dirl.rooms.mesh import Array, Mesh


def bed(
    w: float,
    d: float,
    h: float,
    *,
    frame: str = "wood",
    duvet: str = "duvet",
    linen: str = "white_paint",
    pillow: str = "pillow",
    throw: str = "",
) -> Mesh:
    """A bed with its head at the back, h high; with a throw over the foot if one is named."""
    mesh = Mesh().box(-w / 2, -d / 2, 0.12, w / 2, d / 2, 0.32, frame, 0.01)
    mesh.box(-w / 2 - 0.02, d / 2 - 0.06, 0, w / 2 + 0.02, d / 2, h, frame, 0.02)
    for x in (-w / 2 + 0.06, w / 2 - 0.06):
        mesh.cylinder(x, -d / 2 + 0.06, 0, 0.12, 0.03, frame)
    mattress = [(0.32, 0.49, 0.47, 12), (0.46, 0.495, 0.475, 10), (0.52, 0.48, 0.46, 8)]
    mesh.loft([(z, w * x, d * y, e) for z, x, y, e in mattress], linen, at=(0, -0.03), sides=64)

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
