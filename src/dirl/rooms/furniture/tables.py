"""Tables and what one sits on at them."""

import numpy as np

from dirl.rooms.mesh import Mesh


def table(w: float, d: float, h: float, *, body: str = "wood", top: str = "") -> Mesh:
    """A table on four legs; its top of another material if one is named."""
    mesh = Mesh().box(-w / 2, -d / 2, h - 0.04, w / 2, d / 2, h, top or body, 0.01)
    mesh.box(-w / 2 + 0.06, -d / 2 + 0.06, h - 0.12, w / 2 - 0.06, d / 2 - 0.06, h - 0.04, body, 0.004)
    for x in (-w / 2 + 0.09, w / 2 - 0.09):
        for y in (-d / 2 + 0.09, d / 2 - 0.09):
            mesh.loft([(0, 0.018, 0.018), (h - 0.04, 0.03, 0.03)], body, at=(x, y), exponent=4, sides=16)
    return mesh


def round_table(w: float, d: float, h: float, *, body: str = "wood", top: str = "") -> Mesh:
    """A round table on a pillar."""
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
    """A chair with its back at the back; no slats make the back a board."""
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
    """A stool on four splayed legs."""
    seat = [(h - 0.04, w * 0.46, d * 0.46), (h - 0.01, w / 2, d / 2), (h, w * 0.48, d * 0.48)]
    mesh = Mesh().loft(seat, body, exponent=4, sides=40)
    for x in (-w, w):
        for y in (-d, d):
            mesh.tube([(x * 0.34, y * 0.34, h - 0.03), (x * 0.45, y * 0.45, 0)], 0.016, body)
    return mesh
